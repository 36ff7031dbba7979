"""``gspn plot``: plots results to picture files."""

from __future__ import annotations

import argparse
import logging
import textwrap
import warnings
from pathlib import Path
from typing import Any, BinaryIO, Callable, List, Mapping, Optional, Sequence, Union

import numpy as np

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.fitting import PlaceFit
from gspn_framework_package.analysis.fitting.durations import kaplan_meier
from gspn_framework_package.analysis.intervals import AnswerTables, ends_of, half_widths
from gspn_framework_package.analysis.plan.space import replaced_durations
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.fit import fit_options, learn
from gspn_framework_package.cli.limits import (
    LIMIT_OPTIONS,
    PHASES_OPTION,
    check_phases,
    limits_of,
    working,
)
from gspn_framework_package.cli.net_input import add_subject_arguments, print_notes, read_subject
from gspn_framework_package.cli.options import Argument, Arguments, add_options, choice
from gspn_framework_package.model.duration import Kind
from gspn_framework_package.model.errors import UsageError, how_to_install
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

_COLORS = 10
"""Number of colours in matplotlib's default cycle; further curves differ by line style."""

_LINES = ("-", "--", "-.", ":")

_TEXT_WIDTH = 70
"""Characters in a line of text below a plot; the narrowest has room for so many."""

_SAME = 1e-3
"""Curves that differ by at most this fraction of the height are drawn as one."""

_NAMES = 8
"""Maximum number of names in the legend for curves that are drawn as one."""

_ROWS = 20
"""Number of curves per column of the legend."""

_PLACES = 60
"""Maximum number of places in a picture of fitted durations."""

PLOTS = ("tokens", "throughput", "distribution", "passage")


_OPTIONS: Arguments = {
    Argument("-o --output", "FILE", required=True): "the picture: .png, .svg or .pdf",
    choice("--what", PLOTS, "tokens"): (
        "mean tokens or throughput over time, the distribution of tokens in the steady state, or "
        "the probability of reaching a condition over time (default: tokens)"
    ),
    Argument("--time", "T", numbers.duration): (
        "end of the time axis (s); by default the time until the net has settled"
    ),
    Argument("--points", "N", numbers.whole(2, 100_000), 60): (
        "points in time (default %(default)s)"
    ),
    Argument("--only", "NAME", default=[], nargs="+"): "only these places or transitions",
    Argument("--condition", "CONDITION"): "of --what passage",
}

_FIT: Arguments = {
    Argument("--fit", "LOG", nargs="+"): (
        "plot for each place the durations in these event logs: a histogram with the fitted "
        "density, and their quantiles against those of the fitted distribution"
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    add_subject_arguments(parser)
    add_options(parser, _OPTIONS)
    fit = parser.add_argument_group("durations of a plan, learned from logs (gspn fit)")
    add_options(fit, {**_FIT, **fit_options()})
    add_options(parser.add_argument_group("effort"), {**LIMIT_OPTIONS, **PHASES_OPTION})


def run(args: argparse.Namespace) -> int:
    """Plot the picture."""
    if (args.what == "passage") != (args.condition is not None):
        raise UsageError("--what passage and --condition belong together")
    if args.fit and (args.what != "tokens" or args.time is not None):
        raise UsageError("--what and --time do not apply to --fit")
    begin_picture(args.output)
    subject, notes = read_subject(args)
    check_phases(args, subject, not args.fit)
    if args.fit:
        return _plot_fit(subject, notes, args)
    limits = limits_of(args)

    def make(progress: Progress, cancel: Cancel) -> Any:
        analysis = Analysis(
            subject,
            limits=limits,
            structure=False,
            phases=args.phases,
            progress=progress,
            cancel=cancel,
        )
        figure = figure_of(
            analysis,
            args.what,
            time=args.time,
            points=args.points,
            only=args.only,
            condition=args.condition,
        )
        notes.extend(replaced_durations(analysis.space))
        return figure

    save_picture(working(make, limits.memory), args.output)
    print_notes(notes)
    return 0


def begin_picture(path: str) -> None:
    """Get ready to save a picture at ``path``.

    :raises UsageError: the name does not end like a picture's, or matplotlib is not installed.
    """
    if Path(path).suffix.lower() not in (".png", ".svg", ".pdf"):
        raise UsageError("a picture must end in .png, .svg or .pdf, unlike '%s'" % path)
    try:
        import matplotlib
    except ImportError:
        raise UsageError("matplotlib is not installed", hint=how_to_install("matplotlib")) from None
    matplotlib.use("Agg")
    # Its warnings about fonts and layouts are for programmers; unknown letters in names are drawn
    # as boxes.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)


def save_picture(figure: Any, file: Union[str, BinaryIO], image: Optional[str] = None) -> None:
    """Save a figure of matplotlib.

    :param image: the format; None: that of the file's name.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        figure.savefig(file, dpi=150, format=image)


def _plot_fit(subject: Union[Net, Plan], notes: List[str], args: argparse.Namespace) -> int:
    """Plot the durations in logs next to the fitted distributions."""
    if not isinstance(subject, Plan):
        raise UsageError("this is a net, which has no actions", hint="give the plan that ran")
    learned = learn(subject, args.fit, args.durations, args.seed)
    fitted = {p: found for p, found in learned.report.places.items() if found.fit is not None}
    if not fitted:
        raise UsageError(
            "the logs contain too little data to plot", hint="; ".join(learned.report.notes)
        )
    names = _chosen(list(fitted), args.only)
    if len(names) > _PLACES:
        raise UsageError(
            "%d places are too many for one picture" % len(names), hint="choose some with --only"
        )
    save_picture(fit_figure({name: fitted[name] for name in names}), args.output)
    print_notes([*notes, *learned.report.notes])
    return 0


def fit_figure(places: Mapping[str, PlaceFit]) -> Any:
    """A row for each place: the histogram of its durations with the fitted density, and their
    quantiles against the fitted ones. Censored times are included by the Kaplan-Meier estimate."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 2.6 * len(places)), constrained_layout=True)
    all_axes = figure.subplots(len(places), 2, squeeze=False)
    for (left, right), (name, found) in zip(all_axes, places.items()):
        assert found.fit is not None
        duration = found.fit.duration
        times, after = kaplan_meier(found.sample)
        weights = -np.diff(after, prepend=1.0)
        bins = int(min(max(round(2 * found.n ** (1 / 3)), 5), 60))
        width = max(float(np.ptp(times)), 0.02 * float(times[-1]))
        middle = (times[0] + times[-1]) / 2
        ends = max(middle - 0.52 * width, 0.0), middle + 0.52 * width
        edges = np.linspace(*ends, bins + 1)
        counts, _ = np.histogram(times, edges, weights=weights)
        left.bar(edges[:-1], counts / np.diff(edges), np.diff(edges), align="edge", color="0.8")
        if duration.kind is Kind.DETERMINISTIC:
            left.axvline(duration.mean, color="C0")
        else:
            x = np.linspace(edges[0], edges[-1], 400)
            left.plot(x, np.exp(duration.log_density(x)), color="C0")
        left.set_ylim(0, None)
        left.set_title("%s\n%s; n = %d" % (name, duration.describe(), found.n), fontsize="small")
        left.set_xlabel("duration [s]", fontsize="small")
        left.set_ylabel("density [1/s]", fontsize="small")
        model = duration.quantile(np.clip(1 - after - weights / 2, 1e-9, 1 - 1e-9))
        right.plot(model, times, ".", markersize=3, color="C1")
        right.plot(edges[[0, -1]], edges[[0, -1]], color="0.5", linewidth=0.8)
        says = "p = %.3g" % found.test.p if found.test else ""
        right.set_title("quantiles%s" % (", " + says if says else ""), fontsize="small")
        right.set_xlabel("fitted [s]", fontsize="small")
        right.set_ylabel("observed [s]", fontsize="small")
        for axes in (left, right):
            axes.tick_params(labelsize="small")
    return figure


def figure_of(
    analysis: Analysis,
    what: str = "tokens",
    *,
    time: Optional[float] = None,
    points: int = 60,
    only: Sequence[str] = (),
    condition: Optional[str] = None,
) -> Any:
    """A figure of matplotlib. Where answers have intervals, they are bands around the curves, or
    lines at the ends of the bars; a text says what they take into account, and where none is known.

    :param what: one of :data:`PLOTS`.
    :param time: end of the time axis (s); None: the time until the net has settled.
    :param points: number of points in time.
    :param only: the places or transitions to plot; none: all.
    :param condition: of ``passage``: the condition to reach.
    :raises UsageError: a name in ``only`` is not there.
    :raises GspnError: see :class:`~gspn_framework_package.analysis.analyse.Analysis`.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5), constrained_layout=True)
    axes = figure.add_subplot()
    axes.set_title(analysis.plan.name if analysis.plan else analysis.net.name)
    if what == "distribution":
        _distribution(axes, analysis, only)
        return figure
    end = time if time is not None else 1.2 * analysis.time_to_steady_state() or 1.0
    times = np.linspace(0.0, end, points).tolist()
    axes.set_xlim(0, end)
    if what == "passage":
        assert condition is not None
        _passage(axes, analysis, condition, times)
    else:
        _over_time(axes, analysis, what, times, only)
    return figure


def _passage(axes: Any, analysis: Analysis, condition: str, times: List[float]) -> None:
    def reached(of: Analysis) -> AnswerTables:
        chances = of.first_passage(condition, times).within
        return {"mean_time_to.0": {"within.%d" % i: v for i, v in enumerate(chances)}}

    found = _Answers(analysis, reached)
    (here,), (spans,) = found.here.values(), found.ends.values()
    axes.plot(times, list(here.values()))
    _band(axes, times, [list(spans.values())], "C0")
    axes.set_xlabel("time [s]" + found.says)
    axes.set_ylabel("probability of %s until then" % condition)
    axes.set_ylim(0, 1.02)


def _over_time(
    axes: Any, analysis: Analysis, what: str, times: List[float], only: Sequence[str]
) -> None:
    of_nodes = "mean_tokens" if what == "tokens" else "throughput"
    found = _Answers(
        analysis,
        lambda of: {
            "transient.%d.%s" % (i, of_nodes): getattr(measures, of_nodes)
            for i, (_, measures) in enumerate(of.at(times))
        },
    )
    series, spans_of = list(found.here.values()), list(found.ends.values())
    axes.set_xlabel("time [s]" + found.says)
    axes.set_ylabel("mean tokens" if what == "tokens" else "throughput [1/s]")
    curves = {
        name: np.array([values[name] for values in series])
        for name in _chosen(list(series[0]), only)
    }
    groups = alike(curves)
    for number, names in enumerate(groups):
        color, line = number % _COLORS, _LINES[number // _COLORS % len(_LINES)]
        axes.plot(times, curves[names[0]], color="C%d" % color, linestyle=line, label=_title(names))
        _band(axes, times, [[at[name] for at in spans_of] for name in names], "C%d" % color)
    axes.set_ylim(bottom=-0.02 * axes.get_ylim()[1])  # keeps a curve of zeros visible
    # The legend is outside the plot; it has a line per group and wraps long names.
    axes.legend(
        fontsize="small",
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
        ncol=1 + (len(groups) - 1) // _ROWS,
    )
    axes.figure.set_size_inches(
        11 + 3 * ((len(groups) - 1) // _ROWS), max(5.0, 0.19 * _rows(groups))
    )


class _Answers:
    """Answers to plot, with their intervals.

    :ivar here: the answers.
    :ivar ends: their intervals; None where there is none, or where it is not known.
    :ivar says: what the intervals take into account, as further lines of the picture; empty if
        there are none.
    """

    def __init__(self, analysis: Analysis, answers: Callable[[Analysis], AnswerTables]) -> None:
        self.here = answers(analysis)
        found = half_widths(analysis, self.here, answers)
        self.ends = ends_of(self.here, found)
        notes = found.notes
        if any(None in table.values() for table in self.ends.values()):
            notes.append("where no band or line is, it is not known")
        if not found.sources:  # the answers are exact, or their intervals not known at all
            self.ends = {key: dict.fromkeys(table) for key, table in self.here.items()}
        self.says = "".join("\n" + textwrap.fill(note, _TEXT_WIDTH) for note in notes)


def _band(
    axes: Any, times: Any, spans: Sequence[Sequence[Optional[Sequence[float]]]], color: str
) -> None:
    """Fill the intervals of curves that are drawn as one; None: it is not known."""
    ends = np.array([[span or (np.nan, np.nan) for span in curve] for curve in spans])
    low, high = ends[..., 0].min(axis=0), ends[..., 1].max(axis=0)
    if not np.isnan(low).all():
        axes.fill_between(times, low, high, color=color, alpha=0.2, linewidth=0)


def alike(curves: Mapping[str, Any]) -> List[List[str]]:
    """Group the names of curves that coincide; the groups are in the order of their first
    curves."""
    height = max((float(np.abs(curve).max(initial=0.0)) for curve in curves.values()), default=0.0)
    groups: List[List[str]] = []
    for name, curve in curves.items():
        for group in groups:
            if np.abs(curves[group[0]] - curve).max(initial=0.0) <= _SAME * height:
                group.append(name)
                break
        else:
            groups.append([name])
    return groups


def _title(names: Sequence[str]) -> str:
    """Return the legend entry for curves that are drawn as one, with two names per row."""
    shown = list(names[:_NAMES]) + (
        ["and %d more" % (len(names) - _NAMES)] if len(names) > _NAMES else []
    )
    return ",\n".join(", ".join(shown[i : i + 2]) for i in range(0, len(shown), 2))


def _rows(groups: Sequence[Sequence[str]]) -> int:
    """Return the maximum number of text rows in a column of the legend."""
    return sum(_title(names).count("\n") + 1 for names in groups[:_ROWS])


def _distribution(axes: Any, analysis: Analysis, only: Sequence[str]) -> None:
    answers = _Answers(
        analysis,
        lambda of: {
            "steady_state.token_distribution." + place: {str(n): v for n, v in shares.items()}
            for place, shares in of.measures.token_distribution.items()
        },
    )
    found = analysis.measures.token_distribution
    names = _chosen(list(found), only)
    spans = [answers.ends["steady_state.token_distribution." + name] for name in names]
    most = max((n for name in names for n in found[name]), default=0)
    left = np.zeros(len(names))
    for count in range(most + 1):
        shares = np.array([found[name].get(count, 0.0) for name in names])
        ends = np.array([of.get(str(count)) or (np.nan, np.nan) for of in spans])
        if shares.any():
            off = None if np.isnan(ends).all() else abs(ends.T - shares)
            axes.barh(names, shares, left=left, label="%d" % count, xerr=off, ecolor="0.3")
        left += shares
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.02)
    axes.set_xlabel("probability in the steady state" + answers.says)
    axes.legend(title="tokens", fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _chosen(names: List[str], only: Sequence[str]) -> Sequence[str]:
    for name in only:
        if name not in names:
            raise UsageError(
                "there is no '%s' to plot" % name, hint="choose from: %s" % ", ".join(names[:12])
            )
    return only or names

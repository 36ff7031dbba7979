"""Plots a sweep: each measure over the first parameter, with a line for each combination of the
others."""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Sequence, Tuple

from gspn_framework_package.analysis.sweeps.sweep import Sweep, SweepPoint
from gspn_framework_package.model.errors import UsageError

_MOST = 12
"""Maximum number of measures in a picture."""

_LINES = 12
"""Maximum number of lines named in the legend."""

_UNITS = {"throughput": "throughput (1/s)", "mean_tokens": "mean tokens"}


def sweep_figure(
    sweep: Sweep, points: Sequence[SweepPoint], wanted: Sequence[Tuple[str, str]]
) -> Any:
    """A diagram for each measure, with the intervals.

    :raises UsageError: there are too many measures.
    """
    from matplotlib.figure import Figure

    if len(wanted) > _MOST:
        raise UsageError(
            "%d measures are too many for one picture" % len(wanted),
            hint="choose some with --measure",
        )
    figure = Figure(figsize=(8, 3.2 * len(wanted)), constrained_layout=True)
    first = sweep.variations[0]
    numbers = not any(isinstance(value, str) for value in first.values)
    place = {v: v if numbers else i for i, v in enumerate(first.values)}
    for row, (measure, name) in enumerate(wanted, 1):
        axes = figure.add_subplot(len(wanted), 1, row)
        axes.set_title(name or measure.replace("_", " "))
        axes.set_xlabel(first.name)
        axes.set_ylabel(_UNITS.get(measure, measure.replace("_", " ")))
        for number, (title, line) in enumerate(_lines(sweep, points, measure, name).items()):
            unknown = [place[x] for x, _, half in line if half is None]
            if unknown:
                means = [mean for _, mean, half in line if half is None]
                axes.plot(unknown, means, "o", fillstyle="none", color="0.3")
                axes.set_xlabel("%s\n○: the interval is not known" % first.name)
            axes.errorbar(
                [place[x] for x, _, _ in line],
                [mean for _, mean, _ in line],
                [half or 0.0 for _, _, half in line],
                marker=".",
                capsize=2,
                label=title if title and number < _LINES else None,
            )
        if not numbers:
            axes.set_xticks(list(place.values()))
            axes.set_xticklabels([str(value) for value in first.values])
        if len(sweep.variations) > 1:
            axes.legend(fontsize="small")
    return figure


def _lines(
    sweep: Sweep, points: Sequence[SweepPoint], measure: str, name: str
) -> Dict[str, List[Tuple[Any, float, Optional[float]]]]:
    """Title -> (value of the first variation, mean, half width)."""
    found: Dict[str, List[Tuple[Any, float, Optional[float]]]] = {}
    for point in points:
        if name in point.measures.get(measure, {}):
            mean, half = point.measures[measure][name]
            others = zip(sweep.variations[1:], point.values[1:])
            title = ", ".join("%s=%s" % (variation.name, value) for variation, value in others)
            found.setdefault(title, []).append((point.values[0], mean, half))
    return found

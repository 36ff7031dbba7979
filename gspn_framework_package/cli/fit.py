"""``gspn fit``: learns the durations and outcomes of actions from the logs of runs."""

from __future__ import annotations

import argparse
import json
import os
from typing import Any, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.analysis.executors import Executor, open_executor
from gspn_framework_package.analysis.fitting import (
    ArrivalsFit,
    FitReport,
    OutcomeFit,
    PlaceFit,
    family_choices,
    fit_plan,
    with_day,
)
from gspn_framework_package.analysis.limits import DEFAULT_MEMORY
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.limits import ON_OPTION, working
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.cli.options import Argument, Arguments, add_options, choice
from gspn_framework_package.cli.plan_output import plan_path, refuse_existing, write_plan
from gspn_framework_package.execution.event_log import log_files
from gspn_framework_package.execution.logged_attempts import gather
from gspn_framework_package.execution.seen_firings import SeenFiring, attempts_between
from gspn_framework_package.formats.plan_file import plan_document, read_plan
from gspn_framework_package.formats.plan_json import plan_to_short_json
from gspn_framework_package.model.attempt import Attempt, EventCount
from gspn_framework_package.model.errors import CancelledError, LogError
from gspn_framework_package.model.plan import Plan


class Learned(NamedTuple):
    """The result of learning from logs: the ``report``, the names of the ``logs``, and the numbers
    of ``runs`` and ``attempts``."""

    report: FitReport
    logs: Tuple[str, ...]
    runs: int
    attempts: int


def durations_option() -> Arguments:
    """The option for the family of the durations, of which a package may have added some."""
    return {
        choice("--durations", family_choices(), "auto"): (
            "the distribution of durations: the one that fits the times best, or a fixed one "
            "(default %(default)s)"
        )
    }


def fit_options() -> Arguments:
    """How to fit."""
    return {
        **durations_option(),
        Argument("--seed", kind=numbers.seed, default=0): (
            "seed of the simulated tests (default %(default)s)"
        ),
    }


_OPTIONS: Arguments = {
    Argument("plan", "PLAN"): "a plan file, or a folder with a plan.json",
    Argument("logs", "LOG", nargs="+"): (
        "event logs of runs of the plan, or folders of them; for a team, give the logs of all its "
        "robots; also rosbags of fired_transitions, which contain less information"
    ),
    Argument("-o --output", "NEW_PLAN", required=True): (
        "the plan with the learned parameters: a new .json file, or a folder for plan.json and the "
        "functions"
    ),
}

_OUTPUT: Arguments = {
    "--per-robot": (
        "where robots differ, give each its own durations, outcomes and failures (own_times): "
        "simulations and comparisons follow them"
    ),
    Argument("--within", "PERCENT", numbers.number(0.01, 100.0), 5.0): (
        "precision of each value: the largest half-width of its 95 %% interval, in percent of a "
        "mean duration or a rate, or in points of a probability; the output says how much more log "
        "that needs (default %(default)g)"
    ),
    **ON_OPTION,
    "--day": (
        "where arrivals change over the day, give NEW_PLAN a clock, and each its own rate in each "
        "period, for optimise and simulate"
    ),
    "--force": "overwrite NEW_PLAN if it exists",
    "--json": "print the report as one JSON object",
}

EPILOG = "Exit codes: 0 the plan was written, 2 not a plan, or not logs of its net."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    add_options(parser, {**_OPTIONS, **fit_options(), **_OUTPUT})


def run(args: argparse.Namespace) -> int:
    """Fit the plan, write it, and print what was learned."""
    plan = read_plan(args.plan)
    path = plan_path(args.output)
    if not args.force:
        refuse_existing(path, "give the name of a new file, or --force")
    learned = learn(plan, args.logs, args.durations, args.seed, args.on)
    new = learned.report.apply(plan, learned.logs, args.per_robot)
    if args.day and learned.report.arrivals.day:
        new = with_day(new, learned.report.arrivals, learned.logs)
        data = plan_to_short_json(new)  # with its own net
    else:
        data = plan_document(args.plan, new, os.path.dirname(os.path.abspath(path)))
    notes: List[str] = []
    try:
        notes = write_plan(new, data, args.output)
    finally:  # the result is printed even if it cannot be written
        _print(learned, notes, args)
    return 0


def _print(learned: Learned, notes: Sequence[str], args: argparse.Namespace) -> None:
    within = args.within / 100
    if args.json:
        report = learned.report._replace(notes=(*learned.report.notes, *notes))
        print(json.dumps(report.to_json(within), indent=2, ensure_ascii=False))
        return
    print(source_text(learned))
    for line in (*fit_table(learned.report), *needs_text(learned.report, within)):
        print(line)
    print_notes([*learned.report.notes, *notes])


def learn(plan: Plan, paths: Sequence[str], choice: str, seed: int, on: str = "local") -> Learned:
    """Read logs and fit the plan, with a progress line; an interrupt ends it.

    :param on: the executor, as given by ``--on``.
    :raises LogError: a log cannot be read, or belongs to another net.
    """

    def work(progress: Progress, cancel: Cancel) -> Learned:
        def tell(what: str, count: int, seconds: float) -> None:
            if cancel():
                raise CancelledError("the fit was interrupted")
            progress(what, count, seconds)

        with open_executor(on) as executor:
            return learn_from_logs(plan, paths, choice, seed, tell, executor)

    return working(work, DEFAULT_MEMORY, "")


def learn_from_logs(
    plan: Plan,
    paths: Sequence[str],
    choice: str,
    seed: int,
    progress: Progress,
    on: Optional[Executor] = None,
) -> Learned:
    """Read logs and fit the plan.

    :param paths: event logs and rosbags, or folders of them.
    :param choice: the family of the durations, or ``auto``.
    :param seed: seed of the simulated tests.
    :param progress: called with the progress.
    :param on: where to compute: by default in this process.
    :raises LogError: a log cannot be read, or belongs to another net.
    """
    files = log_files(paths)
    bags = [path for path in files if path.endswith(".bag")]
    files = [path for path in files if path not in bags]
    attempts: List[Attempt] = []
    events: Mapping[str, EventCount] = {}
    notes: List[str] = []
    runs = 0
    if files:
        gathered = gather(files, plan, progress)
        attempts, events = list(gathered.attempts), gathered.events
        notes, runs = list(gathered.notes), len(gathered.runs)
    for number, path in enumerate(bags, len(files)):
        found, remarks, of = _from_bag(plan, path, number)
        attempts += found
        notes += remarks
        runs += of
    report = fit_plan(plan, attempts, events, choice, seed=seed, progress=progress, on=on)
    report = report._replace(notes=(*notes, *report.notes))
    names = tuple(os.path.basename(name) for name in (*files, *bags))
    return Learned(report, names, runs, len(attempts))


def _from_bag(plan: Plan, path: str, number: int) -> Tuple[List[Attempt], List[str], int]:
    """The attempts inferred from the firings in a rosbag, notes, and the number of runs.

    :raises LogError: it is not a rosbag, contains no firings, or contains firings of another net.
    """
    from gspn_framework_package.visualizer.bag_replay import read_bag

    messages = read_bag(path)
    firings = [
        SeenFiring(
            seconds,
            message.run,
            message.transition,
            message.robot,
            tuple(zip(message.robots, message.robot_places)),
            (message.robot, message.visit)
            if message.private_move
            else (message.slot, message.index),
        )
        for seconds, message in messages
    ]
    try:
        found, notes = attempts_between(plan, firings, number)
    except LogError as error:
        raise error.located(file=path) from None
    named = ["%s: %s" % (os.path.basename(path), note) for note in notes]
    return found, named, len({firing.run for firing in firings})


def source_text(learned: Learned) -> str:
    """The sources of the fit, in a few words."""
    logs, runs = _many(len(learned.logs)), _many(learned.runs)
    return "%d attempts in %d log%s of %d run%s" % (learned.attempts, *logs, *runs)


def _many(count: int) -> Tuple[int, str]:
    return count, "" if count == 1 else "s"


def fit_table(report: FitReport) -> List[str]:
    """The report as lines of text."""
    rows: List[Tuple[str, ...]] = [("place", "n", "cut", "mean [s]", "95 %", "distribution", "p")]
    rows += [_row(place, found) for place, found in report.places.items()]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join(
            cell.ljust(width) if i in (0, 5) else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths))
        ).rstrip()
        for row in rows
    ]
    for place, found in report.places.items():
        lines += _shares(place, found, ("outcomes", "failures"))
    for robot, keys in report.own.items():
        for key, places in keys.items():
            for place, found in places.items():
                label = "%s in %s" % (robot, place)
                if key == "durations" and found.fit is not None:
                    lines.append(
                        "%s: mean %.4g s (%.4g to %.4g), n = %d"
                        % (label, found.fit.duration.mean, *found.fit.interval, found.n)
                    )
                lines += _shares(label, found, (key,))
    for name, event in report.rates.items():
        lines.append(
            "%s: %d firings, %.4g/s (%.4g to %.4g)"
            % (name, event.seen, event.rate, *event.interval)
        )
    return lines + list(_arrivals_text(report.arrivals))


def _arrivals_text(found: ArrivalsFit) -> Iterator[str]:
    for name, arrival in found.arrivals.items():
        if arrival.p is None or arrival.shows is None:
            few = "%s: %d arrivals are too few to test whether they change over the day"
            yield few % (name, arrival.seen)
        elif arrival.changes:
            yield "%s changes over the day (p = %.2g)" % (name, arrival.p)
        else:
            yield (
                "%s: no change over the day is seen (p = %.2g, %d parts); one of %.0f %% would "
                "show in four of five cases" % (name, arrival.p, arrival.parts, 100 * arrival.shows)
            )
        if len(found.arrivals) > 1:
            yield from _share_lines("arrivals", {name: arrival.share})
        for key, shares in arrival.data.items():
            yield from _share_lines("%s, %s" % (name, key), shares)
    for period in found.day:
        for name, rate in period.rates.items():
            low, mean, high = (3600 * value for value in sorted((rate.rate, *rate.interval)))
            hourly = "%.3g an hour (%.3g to %.3g)" % (mean, low, high)
            when = "from %d to %d h (UTC)" % period.span
            yield "%s %s: %d arrivals, %s" % (name, when, rate.seen, hourly)


def _shares(label: str, found: PlaceFit, keys: Sequence[str]) -> Iterator[str]:
    shares = list(found.outcomes.items()) if "outcomes" in keys and len(found.outcomes) > 1 else []
    if found.failure is not None and "failures" in keys:
        shares.append(("failure", found.failure))
    yield from _share_lines(label, {name or "no transition named": share for name, share in shares})


def _share_lines(label: str, shares: Mapping[Any, OutcomeFit]) -> Iterator[str]:
    for name, share in shares.items():
        counted = share.seen, share.total, share.probability, *share.interval
        yield "%s: %s %d of %d: %.3g (%.3g to %.3g)" % (label, name, *counted)


def needs_text(report: FitReport, within: float) -> List[str]:
    """The quantities for which the logs are too short, as lines of text; ``within`` as in
    :meth:`.FitReport.needs`."""
    needs = report.needs(within)
    if not needs:
        return ["every value is known to %.3g %%" % (100 * within)]
    lines = ["%d values are not known to %.3g %%:" % (len(needs), 100 * within)]
    return lines + ["  " + need.text() for need in needs]


def _row(place: str, found: PlaceFit) -> Tuple[str, ...]:
    if found.fit is None:
        return place, str(found.n), str(found.censored), "", "", "too little data", ""
    return (
        place,
        str(found.n),
        str(found.censored),
        "%.4g" % found.fit.duration.mean,
        "%.4g to %.4g" % found.fit.interval,
        found.fit.duration.describe().replace(", mean %.4g s" % found.fit.duration.mean, ""),
        "%.3g" % found.test.p if found.test else "",
    )

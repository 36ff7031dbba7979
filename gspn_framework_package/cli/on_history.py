"""Plays recorded runs on another plan: what would have happened, and is it worse?"""

from __future__ import annotations

import argparse
import json
import os
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.decisions.aims import Objective
from gspn_framework_package.analysis.executors import Executor, WorkItem, Workload
from gspn_framework_package.analysis.fitting import FitReport, fit_plan
from gspn_framework_package.analysis.monitoring.differences import (
    Difference,
    Ratio,
    difference,
    per_window,
)
from gspn_framework_package.analysis.watch import Progress, Watch
from gspn_framework_package.cli.aims import pairs
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.execution.event_log import log_files
from gspn_framework_package.execution.history import (
    RecordedRun,
    attempts_of,
    read_run,
    runs_of_logs,
)
from gspn_framework_package.execution.history_run import HistoryRun, PlanNames, PlayedHistory
from gspn_framework_package.execution.log_parts import LogPart
from gspn_framework_package.execution.net_difference import net_difference
from gspn_framework_package.fleet.store import Store
from gspn_framework_package.model.attempt import EventCount
from gspn_framework_package.model.errors import LogError, UsageError
from gspn_framework_package.model.plan import Plan

_WINDOWS = 30
"""If there are fewer runs, their time is divided into this many parts, and the intervals are
computed from the spread of the parts."""

_PATIENCE = 10.0
"""A run that ends by a condition may take this many times as long as the recorded one."""

_MOST_LINES = 10
"""Kinds of refusals that are printed."""


class _Shared(NamedTuple):
    """What the workers need to play runs: the ``new`` plan, the names that differ, and the
    ``report`` of the fit."""

    new: Plan
    mapping: Mapping[str, str]
    report: FitReport


class HistoryComparison(NamedTuple):
    """Recorded runs on the old plan and on the new one.

    :ivar runs: the number of runs; ``robot_hours``: how long they were, times robots.
    :ivar measures: every measure of both plans.
    :ivar aim: what counts, if that is known.
    :ivar old: the runs on the old plan; ``new``: on the new one.
    :ivar recorded: firings in the record, and ``played``: those of the old plan in its own world.
    :ivar worse: why the new plan is worse; empty if it is not.
    :ivar margin: by how much it may be (percent).
    """

    runs: int
    robot_hours: float
    measures: List[Difference]
    aim: Optional[Difference]
    old: List[PlayedHistory]
    new: List[PlayedHistory]
    recorded: int
    played: int
    worse: List[str]
    margin: float
    notes: List[str]

    def to_json(self) -> Dict[str, Any]:
        """As plain JSON values."""
        return {
            "runs": self.runs,
            "robot_hours": self.robot_hours,
            "measures": [m.to_json() for m in self.measures],
            "aim": None if self.aim is None else self.aim.to_json(),
            "late": {"old": _late(self.old), "new": _late(self.new)},
            "refused": _refused(self.new),
            "stands_still": [
                {"run": number, "since": p.stands_still[0], "where": p.stands_still[1]}
                for number, p in enumerate(self.new)
                if p.stands_still is not None
            ],
            "attempts": {
                "recorded": sum(p.recorded for p in self.new),
                "drawn": sum(p.drawn for p in self.new),
            },
            "firings": {"recorded": self.recorded, "old": self.played},
            "margin": self.margin,
            "worse": list(self.worse),
            "notes": list(self.notes),
        }

    def lines(self) -> Iterator[str]:
        """As text."""
        drawn, recorded = (sum(getattr(p, key) for p in self.new) for key in ("drawn", "recorded"))
        yield "%d recorded run%s, %.4g robot-hours; %s attempts as recorded, %s (%.1f %%) drawn" % (
            self.runs,
            "" if self.runs == 1 else "s",
            self.robot_hours,
            format(recorded, ","),
            format(drawn, ","),
            100 * drawn / max(recorded + drawn, 1),
        )
        yield "the old plan on its own record: %s firings, %s were recorded" % (
            format(self.played, ","),
            format(self.recorded, ","),
        )
        yield ""
        yield "%-44s %11s %11s %11s  %s" % ("measure", "old", "new", "change", "95 % interval")
        for measure in (*self.measures, *filter(None, (self.aim,))):
            yield _line(measure)
        yield ""
        for what, count in sorted(_refused(self.new).items(), key=lambda x: -x[1])[:_MOST_LINES]:
            yield "refused %d time%s: %s" % (count, "" if count == 1 else "s", what)
        if any(_late(played) for played in (self.old, self.new)):
            yield "tasks that are late: %d instead of %d" % (_late(self.new), _late(self.old))
        for reason in self.worse:
            yield "WORSE: %s" % reason
        yield self.verdict

    @property
    def verdict(self) -> str:
        """The result in a sentence."""
        if self.worse:
            return "the new plan is worse than the old one on the recorded runs"
        if self.aim is None:
            return "nothing says what counts (--reward); the new plan does not stand still"
        return "on the recorded runs, the new plan is not found to be worse by more than %g %%" % (
            self.margin
        )


def history_files(paths: Sequence[str]) -> List[str]:
    """The logs that the arguments name: files, folders of them, and stores of a fleet's history,
    whose logs have to be where they were.

    :raises GspnError: a folder has no logs, or a store is damaged.
    """
    found: List[str] = []
    for path in paths:
        if not os.path.exists(os.path.join(path, "history.json")):
            found += log_files([path])
            continue
        logs = [log["path"] for run in Store(path).runs() for log in run["logs"].values()]
        if not logs:
            raise LogError("the store holds no runs", file=path)
        found += logs
    return found


def on_history(
    new: Plan,
    paths: Sequence[str],
    *,
    mapping: Mapping[str, str],
    rewards: Mapping[str, float],
    margin: float = 5.0,
    progress: Progress,
    on: Executor,
) -> HistoryComparison:
    """Play recorded runs on the plan that they followed, and on another one.

    :param paths: logs, folders of them, or stores of a fleet's history.
    :param mapping: name of a place or transition -> its name in the new plan, where they differ.
    :param rewards: what counts: place or transition (or a pattern) -> its worth per second or
        firing; empty: tasks that are done.
    :param margin: by how many percent the new plan may be worse.
    :raises LogError: a log cannot be read, or the logs are of different nets.
    :raises UsageError: a reward names nothing of the plan.
    """
    objective = Objective.long_run(rewards).resolved(new.net) if rewards else None
    watch = Watch(progress)
    reading = Workload(_nothing, _read, None)
    groups = runs_of_logs(history_files(paths))
    found: List[RecordedRun] = on.ordered(
        [WorkItem(reading, g) for g in groups], "runs read", watch
    )
    runs, left_out = _of_one_net(found, [group[0].several for group in groups])
    counts = EventCount.summed(run.counts for run in runs)
    report = fit_plan(runs[0].plan, attempts_of(runs), counts, samples=0, on=on)
    shared = _Shared(new, mapping, report)
    playing = Workload(_same, _play, shared)
    whole = sum(run.seconds for run in runs)
    items = [WorkItem(playing, (_bare(run), _windows(run, new, whole, len(runs)))) for run in runs]
    played: List[Tuple[PlayedHistory, PlayedHistory]] = on.ordered(items, "runs played", watch)
    olds, news = [old for old, _ in played], [one for _, one in played]
    names = PlanNames.between(runs[0].plan, new, mapping)
    measures = list(_measures(runs[0].plan, new, names, olds, news))
    aim = _aim(runs[0].plan, new, names, objective, olds, news)
    firings = sum(sum(old.firings[-1]) for old in olds)
    return HistoryComparison(
        len(runs),
        sum(run.seconds * len(run.roster) for run in runs) / 3600,
        measures,
        aim,
        olds,
        news,
        sum(sum(run.firings.values()) for run in runs),
        firings,
        list(_worse(aim, margin, olds, news)),
        margin,
        [*left_out, *dict.fromkeys(note for run in runs for note in run.notes)],
    )


def history_in_arguments(
    args: argparse.Namespace,
    new: Plan,
    paths: Sequence[str],
    mapping: Mapping[str, str],
    progress: Progress,
    on: Executor,
) -> HistoryComparison:
    """Play recorded runs as the options say; see :func:`on_history`."""
    return on_history(
        new,
        paths,
        mapping=mapping,
        rewards=pairs(args.reward, "--reward", float, "NAME=NUMBER"),
        margin=args.margin,
        progress=progress,
        on=on,
    )


# -- the work --------------------------------------------------------------------------------------


def _nothing(_: Any) -> None:
    return None


def _same(shared: _Shared) -> _Shared:
    return shared


def _read(_: None, logs: Sequence[LogPart], __: Watch) -> RecordedRun:
    return read_run(logs)


def _of_one_net(
    found: Sequence[RecordedRun], parts: Sequence[bool]
) -> Tuple[List[RecordedRun], List[str]]:
    """The runs of the net that was followed last, and notes about those that are left out.

    :param parts: of each run, whether it is a part of one in which the team adopted another plan.
    :raises LogError: a whole run is of another net.
    """
    last = max(found, key=lambda run: run.began)
    kept, notes = [], []
    for run, part in zip(found, parts):
        differs = net_difference(last.plan, run.plan)
        if not differs:
            kept.append(run)
        elif part:
            row = run.name, run.seconds, differs
            notes.append("%s is left out (%.4g s), its net is not that of the last plan: %s" % row)
        else:
            raise LogError("the nets of %s and %s differ: %s" % (last.name, run.name, differs))
    return kept, notes


def _play(
    shared: _Shared, piece: Tuple[RecordedRun, int], _: Watch
) -> Tuple[PlayedHistory, PlayedHistory]:
    run, windows = piece
    sides = []
    for plan, mapping in ((run.plan, {}), (shared.new, shared.mapping)):
        names = PlanNames.between(run.plan, plan, mapping)
        patience = _PATIENCE if run.came and plan.until is not None else 1.0
        world = HistoryRun(_fitted(plan, names, shared.report), run, names)
        sides.append(world.play(windows, patience))
    return sides[0], sides[1]


def _bare(run: RecordedRun) -> RecordedRun:
    """The run without what only the fit needs."""
    return run._replace(attempts=(), counts={})


def _windows(run: RecordedRun, new: Plan, whole: float, runs: int) -> int:
    if runs >= _WINDOWS or run.plan.until is not None or new.until is not None:
        return 1
    return max(1, round(_WINDOWS * run.seconds / whole))


def _fitted(plan: Plan, names: PlanNames, report: FitReport) -> Plan:
    """The plan with what was learned about actions and events that it has as well."""
    net = plan.net
    places = {}
    for place, old in names.places.items():
        found = report.places.get(old)
        if found is None:
            continue
        leaving = {net.transitions[t].name for t in net.consumers[net.place_index[place]]}
        outcomes = {names.new(t) if t else t: o for t, o in found.outcomes.items()}
        # the plan keeps its own outcomes if it lacks one of these, or has the same name for two
        known = all(not t or t in leaving for t in outcomes)
        known = known and len(outcomes) == len(found.outcomes)
        places[place] = found._replace(outcomes=outcomes if known else {})
    rates = {names.new(t): rate for t, rate in report.rates.items()}
    kept = {t: r for t, r in rates.items() if t in net.transition_index and net.transition(t).timed}
    return FitReport(places, kept, ()).apply(plan, ())


# -- what they say ---------------------------------------------------------------------------------


def _windowed(played: Sequence[PlayedHistory], key: str) -> Any:
    return np.concatenate([per_window(getattr(one, key)) for one in played])


def _measures(
    old: Plan,
    new: Plan,
    names: PlanNames,
    olds: Sequence[PlayedHistory],
    news: Sequence[PlayedHistory],
) -> Iterator[Difference]:
    seconds = _windowed(olds, "seconds"), _windowed(news, "seconds")
    if old.submissions or new.submissions:
        done = _windowed(olds, "done"), _windowed(news, "done")
        yield difference("tasks done", "1/s", *map(Ratio, done, seconds))
        times = _windowed(olds, "task_seconds"), _windowed(news, "task_seconds")
        yield difference("time of a task", "s", *map(Ratio, times, done))
    transitions = [[t.name for t in plan.net.transitions] for plan in (old, new)]
    places = [[p.name for p in plan.net.places] for plan in (old, new)]
    for kind, unit, key, (old_names, new_names) in (
        ("throughput", "1/s", "firings", transitions),
        ("mean tokens", "", "tokens", places),
    ):
        before, after = _windowed(olds, key), _windowed(news, key)
        known = {names.new(name): i for i, name in enumerate(old_names)}
        for i, name in enumerate(new_names):
            earlier = Ratio(before[:, known[name]], seconds[0]) if name in known else None
            later = Ratio(after[:, i], seconds[1])
            yield difference("%s %s" % (kind, name), unit, earlier, later)


def _aim(
    old: Plan,
    new: Plan,
    names: PlanNames,
    objective: Optional[Objective],
    olds: Sequence[PlayedHistory],
    news: Sequence[PlayedHistory],
) -> Optional[Difference]:
    seconds = _windowed(olds, "seconds"), _windowed(news, "seconds")
    if objective is None:
        done = _windowed(olds, "done"), _windowed(news, "done")
        if not (old.submissions and new.submissions) or not done[0].sum():
            return None
        return difference("aim: tasks done", "1/s", *map(Ratio, done, seconds))
    earned = []
    for plan, played, renamed in ((old, olds, names.new), (new, news, str)):
        firings, tokens = _windowed(played, "firings"), _windowed(played, "tokens")
        worth = objective.rewards
        of_firings = [worth.get(renamed(t.name), 0.0) for t in plan.net.transitions]
        of_tokens = [worth.get(renamed(p.name), 0.0) for p in plan.net.places]
        earned.append(firings @ of_firings + tokens @ of_tokens)
    return difference("aim: rewards", "1/s", *map(Ratio, earned, seconds))


def _worse(
    aim: Optional[Difference],
    margin: float,
    olds: Sequence[PlayedHistory],
    news: Sequence[PlayedHistory],
) -> Iterator[str]:
    """Why the new plan is worse."""
    for number, (old, new) in enumerate(zip(olds, news), 1):
        if new.stands_still is not None and old.stands_still is None:
            yield "in run %d the team stands still from %.6g s on: %s" % (
                number,
                *new.stands_still,
            )
    refused = sum(_refused(news).values()) - sum(_refused(olds).values())
    if refused > 0:
        yield "%d more refusals than with the old plan" % refused
    late, before = _late(news), _late(olds)
    if late > before * (1 + margin / 100):
        yield "%d tasks are late instead of %d" % (late, before)
    if aim is None or aim.new is None or aim.old is None:
        return
    certain = aim.significant or aim.low is None
    if aim.new < aim.old - abs(aim.old) * margin / 100 and certain:
        row = aim.name, aim.new, aim.old, aim.unit, margin
        yield "%s: %.5g instead of %.5g %s, which is worse by more than %g %%" % row


def _refused(played: Sequence[PlayedHistory]) -> Dict[str, int]:
    found: Dict[str, int] = {}
    for one in played:
        for what, count in one.refused.items():
            found[what] = found.get(what, 0) + count
    return found


def _late(played: Sequence[PlayedHistory]) -> int:
    return sum(one.late for one in played)


def _line(measure: Difference) -> str:
    change, old = measure.change, measure.old
    percent = "  %+.3g %%" % (100 * change / abs(old)) if change is not None and old else ""
    interval = ""
    if measure.low is not None and measure.high is not None:
        interval = "%+.4g to %+.4g" % (measure.low, measure.high)
    return "%-44s %11s %11s %11s  %-24s%s" % (
        measure.name + (" (%s)" % measure.unit if measure.unit else ""),
        *("-" if value is None else "%.5g" % value for value in (old, measure.new)),
        "-" if change is None else "%+.4g" % change,
        interval,
        percent if measure.significant else "",
    )


def print_history(found: HistoryComparison, as_json: bool) -> int:
    """Print the comparison; returns the exit code."""
    if as_json:
        print(json.dumps(found.to_json(), indent=2, allow_nan=False))
    else:
        print_notes(found.notes)
        print("\n".join(found.lines()))
    return 1 if found.worse else 0


def require_aim(new: Plan, rewards: Sequence[str]) -> None:
    """:raises UsageError: nothing says what counts, so that no plan could be found worse."""
    if not rewards and not new.submissions:
        raise UsageError(
            "--replay cannot say whether the plan is worse: it has no tasks",
            hint="say what counts, for example --reward TRANSITION=1",
        )

"""``gspn compare``: checks from a run's logs whether it went as its plan predicts."""

from __future__ import annotations

import argparse
import json
import math
import re
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.analysis.executors import Executor, open_executor
from gspn_framework_package.analysis.monitoring.comparison import (
    Observed,
    PredictedMeasure,
    RunComparison,
    compare,
)
from gspn_framework_package.analysis.monitoring.monitor import ALARM_EVERY, DAY, Monitor
from gspn_framework_package.analysis.monitoring.playing import play_to_monitor
from gspn_framework_package.analysis.monitoring.prediction import (
    PREDICTION_REPLICATIONS,
    Span,
    expected_paces,
    predict,
)
from gspn_framework_package.analysis.monitoring.streams import PACES
from gspn_framework_package.analysis.watch import Progress, Watch
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.history_options import HISTORY_OPTIONS, read_mapping
from gspn_framework_package.cli.limits import ON_OPTION
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.cli.options import Argument, Arguments, repeated
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.execution.attempts import AttemptFollower
from gspn_framework_package.execution.event_log import log_files
from gspn_framework_package.execution.log_parts import LogPart
from gspn_framework_package.execution.logged_attempts import gather
from gspn_framework_package.execution.observation import RunObserver
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.attempt import Attempt
from gspn_framework_package.model.errors import LogError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming

UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": DAY}


def _time(text: str) -> float:
    """Parse a time such as 12h."""
    found = re.match(r"([0-9.eE+-]+)\s*(s|min|h|d)?$", text.strip())
    try:
        value = float(found.group(1)) * UNITS[found.group(2) or "s"] if found else math.nan
    except ValueError:
        value = math.nan
    if not 1.0 <= value <= numbers.MOST_SECONDS:
        raise argparse.ArgumentTypeError(
            "'%.40s' is not a time of at least 1 s (examples: 90s, 20min, 12h, 30d)" % text
        )
    return value


OPTIONS: Arguments = {
    Argument("plan", "PLAN"): "a plan file, or a folder with a plan.json",
    Argument("logs", "LOG", nargs="+"): (
        "event logs of one or several runs of the plan, or folders of them"
    ),
    "--replay": (
        "replay the recorded runs under PLAN, which may differ from their plan, and compare it "
        "with the plan that they followed: the same tasks, durations, outcomes, failures and losses"
    ),
    repeated("--map", "OLD=NEW"): (
        "with --replay: a place or transition of the recorded net and its name in PLAN"
    ),
    **HISTORY_OPTIONS,
    Argument("--alarm-every", "TIME", _time, ALARM_EVERY): (
        "mean time between false alarms of all streams together: a number with s, min, h or d "
        "(default 30d)"
    ),
    Argument("--replications", "N", numbers.replications): (
        "simulated runs for the prediction (default %d; fewer if they are long)"
        % PREDICTION_REPLICATIONS
    ),
    Argument("--seed", "N", numbers.whole(0, 2**63 - 1), 0): (
        "seed of the simulated runs (default 0)"
    ),
    **ON_OPTION,
    "--json": "print the result as one JSON object",
}

EPILOG = (
    "Exit codes: 0 the run matches the prediction, 1 it deviates from the plan, 2 wrong input. "
    "With --replay: 0 PLAN is not worse than the recorded plan, 1 it is."
)


class _Run(NamedTuple):
    """A run as shown by its logs."""

    name: str
    observer: RunObserver
    attempts: List[Attempt]


class LogComparison(NamedTuple):
    """The comparison of some runs with their plan; a monitor for each run."""

    comparison: RunComparison
    runs: List[_Run]
    monitors: List[Monitor]
    notes: List[str]
    alarm_every: float
    replications: int

    @property
    def departs(self) -> bool:
        """Whether a stream raised an alarm, or the measures deviate from the prediction."""
        return self.comparison.departs or any(m.alarms for m in self.monitors)

    def to_json(self) -> Dict[str, Any]:
        """The result as a JSON object."""
        streams = []
        alarms = []
        for run, monitor in zip(self.runs, self.monitors):
            streams += [{**stream.to_json(), "run": run.name} for stream in monitor.streams]
            alarms += [{**alarm.to_json(), "run": run.name} for alarm in monitor.alarms]
        return {
            "measures": [m.to_json() for m in self.comparison.measures],
            "streams": streams,
            "alarms": alarms,
            "false_alarm_every": self.alarm_every,
            "unusual": self.comparison.unusual,
            "farthest": self.comparison.farthest,
            "departs": self.departs,
            "runs": [
                {
                    "name": run.name,
                    "seconds": run.observer.seconds,
                    "robots": run.observer.robots,
                    "attempts": len(run.attempts),
                }
                for run in self.runs
            ],
            "replications": self.replications,
            "notes": self.notes,
        }


def run(args: argparse.Namespace) -> int:
    """Compare runs with the prediction, and print the result."""
    plan = read_plan(args.plan)
    with open_executor(args.on) as executor, ProgressLine() as progress:
        if args.replay:
            # imported here, because other comparisons do not need it
            from gspn_framework_package.cli.on_history import history_in_arguments, print_history

            mapping = read_mapping(args.map)
            return print_history(
                history_in_arguments(args, plan, args.logs, mapping, progress, executor), args.json
            )
        for option in ("map", "reward"):
            if getattr(args, option):
                raise UsageError("--%s is for --replay" % option)
        result = compare_logs(
            plan,
            args.logs,
            alarm_every=args.alarm_every,
            replications=args.replications,
            seed=args.seed,
            progress=progress,
            on=executor,
        )
    if args.json:
        print(json.dumps(result.to_json(), indent=2, allow_nan=False))
    else:
        print_notes(result.notes)
        print("\n".join(comparison_text(result)))
    return 1 if result.departs else 0


# -- reading ---------------------------------------------------------------------------------------


def _read_runs(
    plan: Plan, paths: Sequence[str], progress: Progress
) -> Tuple[List[_Run], List[str]]:
    gathered = gather(paths, plan, progress)
    notes = list(gathered.notes)
    runs = []
    for numbers_of_logs in gathered.runs:
        log = gathered.logs[numbers_of_logs[0]]
        name, observer = _observe(plan, log, progress)
        attempts = [a for a in gathered.attempts if a.log in numbers_of_logs]
        if observer.seconds <= 0:
            raise LogError("contains no run: its duration is 0", file=log.path)
        notes += ["run %s: %s" % (name, note) for note in observer.all_notes()]
        runs.append(_Run(name, observer, attempts))
    return runs, notes


def _observe(plan: Plan, log: LogPart, progress: Progress) -> Tuple[str, RunObserver]:
    """Follow a log from beginning to end."""
    agents = bool(log.header.get("agents"))
    follower = AttemptFollower(log.plan, log.robot, agents=agents, stage=log.stage)
    observer = RunObserver(plan, log.plan)
    watch = Watch(progress)
    for line, record in log.numbered_records():
        try:
            follower.take(record)
        except LogError as error:
            raise error.located(file=log.path, line=line) from None
        if follower.step is not None:
            observer.take(follower.step, follower.now)
        if line % 1024 == 0:
            watch.step("records compared", line)
    observer.wait(follower.now)
    return str(log.header["run"]), observer


# -- comparing -------------------------------------------------------------------------------------


def compare_logs(
    plan: Plan,
    paths: Sequence[str],
    *,
    alarm_every: float = ALARM_EVERY,
    replications: Optional[int] = None,
    seed: int = 0,
    progress: Progress,
    on: Optional[Executor] = None,
) -> LogComparison:
    """Compare runs of a plan, as their logs show them, with its prediction.

    :param paths: event logs, or folders of them.
    :param alarm_every: mean time (s) between false alarms of all streams together.
    :param replications: number of simulated runs; None: as many as are needed.
    :param seed: seed of the simulated runs.
    :param progress: called with the progress.
    :param on: where to simulate: by default in this process.
    :raises LogError: a log cannot be read, contains no run, or belongs to another net.
    """
    runs, notes = _read_runs(plan, log_files(paths), progress)
    notes = [*plan.notes, *notes]
    ends = plan.until is not None
    spans = [
        Span(r.observer.start_of(plan), r.observer.seconds, r.observer.came and ends) for r in runs
    ]
    sample = predict(spans, replications=replications, seed=seed, progress=progress, on=on)
    comparison = compare(plan, sample, _observed(runs))
    paces = expected_paces(plan, sample)
    monitors = [_watch(plan, r, paces, alarm_every, progress) for r in runs]
    notes = notes + ["assumed: %s" % text for text in PlanTiming(plan).assumptions]
    return LogComparison(comparison, runs, monitors, notes, alarm_every, sample.size)


def _observed(runs: Sequence[_Run]) -> Observed:
    firings: Dict[str, int] = {}
    tokens: Dict[str, float] = {}
    observers = [r.observer for r in runs]
    for observer in observers:
        for name, count in observer.firings.items():
            firings[name] = firings.get(name, 0) + count
        for name, held in observer.tokens.items():
            tokens[name] = tokens.get(name, 0.0) + held
    seconds = sum(observer.seconds for observer in observers)
    return Observed(seconds, firings, tokens, all(observer.came for observer in observers))


def _watch(
    plan: Plan, run: _Run, paces: Dict[str, float], alarm_every: float, progress: Progress
) -> Monitor:
    observer = run.observer
    monitor = Monitor(observer.start_of(plan), observer.robots, paces, alarm_every)
    began = observer.began or 0.0
    play_to_monitor(monitor, run.attempts, observer.choices, began=began, progress=progress)
    return monitor


# -- output for people -----------------------------------------------------------------------------


def comparison_text(result: LogComparison) -> Iterator[str]:
    """Yield the lines of a comparison."""
    runs = result.runs
    yield "%d run%s, %.6g s, %s attempts; predicted by %d simulated runs" % (
        len(runs),
        "" if len(runs) == 1 else "s",
        sum(r.observer.seconds for r in runs),
        format(sum(len(r.attempts) for r in runs), ","),
        result.replications,
    )
    yield ""
    yield "%-44s %11s  %-25s %11s" % ("measure", "predicted", "95 % interval", "observed")
    for measure in result.comparison.measures:
        yield _measure_line(measure)
    yield ""
    for run_, monitor in zip(runs, result.monitors):
        if len(runs) > 1:
            yield "run %s" % run_.name
        yield "%-44s %11s  %11s" % ("stream", "cusum", "threshold")
        for stream in monitor.streams:
            nearest = stream.nearest()
            if nearest.value == 0 and stream.kind not in PACES and not stream.alarms:
                continue
            name = " ".join(p for p in (stream.kind, stream.place, stream.robot) if p)
            if stream.transition:
                name += ": " + stream.transition
            raised = "  ALARM after %.1f s" % stream.alarms[0].at if stream.alarms else ""
            yield "%-44s %11.2f  %11.2f%s" % (name, nearest.value, nearest.threshold, raised)
        for alarm in monitor.alarms:
            row = alarm.at, max(alarm.since, 0.0), alarm.describe()
            yield "ALARM after %.1f s, since about %.1f s: %s" % row
    yield ""
    yield "all thresholds together: one false alarm in %s" % _long(result.alarm_every)
    outside = sum(not m.inside for m in result.comparison.measures)
    yield (
        "%d of %d measures inside their intervals; a run that follows the plan is at least this "
        "far out in %.3g %% of cases%s"
        % (
            len(result.comparison.measures) - outside,
            len(result.comparison.measures),
            100 * result.comparison.unusual,
            " (%s)" % result.comparison.farthest if result.comparison.farthest else "",
        )
    )
    yield "the run deviates from the plan" if result.departs else "the run matches the prediction"


def _measure_line(measure: PredictedMeasure) -> str:
    change = measure.change
    return "%-44s %11s  %-25s %11s%s" % (
        measure.name + (" (%s)" % measure.unit if measure.unit else ""),
        _short(measure.predicted),
        "%s to %s" % (_short(measure.low), _short(measure.high)),
        "not reached" if measure.observed is None else _short(measure.observed),
        ""
        if measure.inside
        else "  OUTSIDE" + (" (%+.1f %%)" % (100 * change) if change is not None else ""),
    )


def _short(value: float) -> str:
    return "%.5g" % value if math.isfinite(value) else "never"


def _long(seconds: float) -> str:
    for unit in ("d", "h", "min"):
        if seconds >= UNITS[unit]:
            return "%.3g %s" % (seconds / UNITS[unit], unit)
    return "%.3g s" % seconds

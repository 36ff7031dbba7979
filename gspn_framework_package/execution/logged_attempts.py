"""The attempts at actions in the logs of several robots and runs, each once."""

from __future__ import annotations

import time
from typing import (
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    TypeVar,
    Union,
)

from gspn_framework_package.execution.attempts import AttemptFollower
from gspn_framework_package.execution.log_parts import LogPart, log_parts
from gspn_framework_package.execution.net_difference import net_difference
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.attempt import Attempt, EventCount
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.plan import Plan, Synchronisation

ReadingProgress = Callable[[str, int, float], None]
"""Called from time to time with what is counted, the count, and the seconds so far."""

_Counted = TypeVar("_Counted")

_BETWEEN = 2_000
"""Records between two reports of progress."""


class Gathered(NamedTuple):
    """The attempts of several logs, merged.

    :ivar plan: the plan of the first log.
    :ivar attempts: every attempt once, run by run and robot by robot in the order of time.
    :ivar events: the transitions of the environment and those of events, by name, over all runs.
    :ivar logs: the logs, as the attempts number them. One in which the team adopted another plan
        is as many as it has parts.
    :ivar runs: for each run, the indices of its logs in ``logs``, the longest first.
    :ivar notes: what a person should know about the logs.
    """

    plan: Plan
    attempts: List[Attempt]
    events: Dict[str, EventCount]
    logs: Tuple[LogPart, ...]
    runs: Tuple[Tuple[int, ...], ...]
    notes: Tuple[str, ...]


class _Log(NamedTuple):
    """A log among those given; ``length`` is the number of its slots."""

    number: int
    file: LogPart
    length: int
    hashes: Dict[int, str]

    @property
    def robot(self) -> str:
        return self.file.robot


def gather(
    paths: Sequence[Union[str, LogPart]],
    plan: Optional[Plan] = None,
    progress: Optional[ReadingProgress] = None,
) -> Gathered:
    """Read logs of one or several runs of a plan: of standalone runs, or of the robots of teams.

    Of a team, each robot's attempts come from its own log. If that is not among the logs, they come
    from another's, with the times of its slots; in partial synchronisation, where those times say
    little, they are left out. A log that is given twice counts once. Of a team that adopted another
    plan, each part is a run, and parts with another net are left out, with a note.

    :param plan: the plan that they must be runs of, as far as its net goes; by default that of the
        first log.
    :param progress: called as the logs are read.
    :raises LogError: a log cannot be read or is damaged, or its plan has another net.
    """
    count = _Counter(progress)
    notes: List[str] = []
    logs: List[_Log] = []
    parts = _of_the_net([part for path in paths for part in log_parts(path)], plan, notes)
    for number, file in enumerate(parts):
        hashes: Dict[int, str] = {}
        for line, record in count(file.numbered_records()):
            if record["kind"] in ("slot", "snapshot"):
                slot = record.get("slot")
                if type(slot) is not int:
                    raise LogError("the record is damaged (no slot)", file=file.path, line=line)
                hashes[slot] = str(record.get("hash"))
        if file.cut:
            notes.append("the last line of %s was cut off; it is left out" % file.path)
        logs.append(_Log(number, file, len(hashes), hashes))
    attempts: List[Attempt] = []
    counts: List[Mapping[str, EventCount]] = []
    runs = _runs(logs, notes)
    for run in runs:
        found, counted = _read_run(run, count, notes)
        attempts += found
        counts.append(counted)
    return Gathered(
        logs[0].file.plan if plan is None else plan,
        attempts,
        EventCount.summed(counts),
        tuple(parts),
        tuple(
            tuple(log.number for log in sorted(run, key=lambda log: -log.length)) for run in runs
        ),
        tuple(notes),
    )


def _of_the_net(parts: Sequence[LogPart], plan: Optional[Plan], notes: List[str]) -> List[LogPart]:
    """The parts whose net is that of ``plan``, or of the last part of the first log.

    :raises LogError: a log has none.
    """
    reference, whose = plan, "the plan" if plan is None else plan.file or "the plan"
    if reference is None:
        last = [part for part in parts if part.path == parts[0].path][-1]
        reference, whose = last.plan, last.path
    found: List[LogPart] = []
    differences: Dict[str, List[str]] = {}
    for part in parts:
        difference = net_difference(reference, part.plan)
        if not difference:
            found.append(part)
        elif part.several:
            notes.append("%s: left out, its net differs: %s" % (part.name, difference))
        differences.setdefault(part.path, []).append(difference)
    for path, of_parts in differences.items():
        if all(of_parts):
            raise LogError(
                "its net differs from that of %s: %s" % (whose, of_parts[-1]),
                file=path,
                hint="give logs of runs of the same net only",
            )
    return found


def _runs(logs: Sequence[_Log], notes: List[str]) -> List[List[_Log]]:
    """Group the logs by run. Logs of teams are of one run if the run has the same name and the
    first slot that they share is the same; a standalone log is a run of its own."""
    runs: List[List[_Log]] = []
    for log in logs:
        same = [
            run
            for run in runs
            if any(_is_copy(log, other) or _is_of_run(log, other) for other in run)
        ]
        if not same:
            runs.append([log])
            continue
        run = same[0]
        twin = next((other for other in run if _is_copy(log, other)), None)
        if twin is None:
            run.append(log)
            continue
        longer, shorter = (log, twin) if log.length > twin.length else (twin, log)
        run[run.index(twin)] = longer
        notes.append(
            "%s and %s are the same log; %s is left out"
            % (twin.file.path, log.file.path, shorter.file.path)
        )
    return runs


def _is_copy(log: _Log, other: _Log) -> bool:
    return bool(log.file.header["log"] == other.file.header["log"] and log.robot == other.robot)


def _is_of_run(log: _Log, other: _Log) -> bool:
    if not log.robot or not other.robot or log.file.header["run"] != other.file.header["run"]:
        return False
    shared = log.hashes.keys() & other.hashes.keys()
    first = min(shared, default=None)
    return first is None or log.hashes[first] == other.hashes[first]


def _read_run(
    run: Sequence[_Log], count: _Counter, notes: List[str]
) -> Tuple[List[Attempt], Dict[str, EventCount]]:
    """The attempts of one run, and what its longest log says of the environment."""
    plan = run[0].file.plan
    own: Set[str] = {log.robot for log in run}
    others = any(robot.name not in own for robot in plan.robots) or len(own - {""}) < 1
    game = TokenGame(plan)
    counts = bool(game.environment_transitions or game.interrupts)
    needs_replay = others or counts or not own - {""}
    longest = max(run, key=lambda log: log.length)
    found: Dict[Tuple[str, int, int], Attempt] = {}
    events: Dict[str, EventCount] = {}
    late: Set[str] = set()
    for log in sorted(run, key=lambda log: log is not longest):
        follower = AttemptFollower(
            log.file.plan,
            log.robot,
            agents=bool(log.file.header.get("agents")),
            own_only=bool(log.robot) and not (needs_replay and log is longest),
            log=log.number,
            stage=log.file.stage,
        )
        for attempt in _follow(follower, log.file, count):
            if attempt.robot != log.robot and attempt.robot in own:
                continue
            if log.robot and attempt.robot != log.robot:
                late.add(attempt.robot)
                if plan.synchronisation is Synchronisation.PARTIAL:
                    continue
            key = attempt.robot, attempt.visit, attempt.attempt
            known = found.get(key)
            if known is None or (attempt.completed and not known.completed):
                found[key] = attempt
        if log is longest:
            events = follower.events
    if late:
        partial = plan.synchronisation is Synchronisation.PARTIAL
        notes.append(
            "the logs of %s are missing: %s"
            % (
                ", ".join(sorted(late)),
                "in partial synchronisation, the logs of others do not show when its actions end, "
                "so it is left out"
                if partial
                else "its times are those at which %s heard of them" % longest.robot,
            )
        )
    ordered = sorted(found.values(), key=lambda a: (a.robot, a.visit, a.attempt))
    return ordered, events


def _follow(follower: AttemptFollower, file: LogPart, count: _Counter) -> Iterator[Attempt]:
    for line, record in count(file.numbered_records()):
        try:
            yield from follower.take(record)
        except LogError as error:
            raise error.located(file=file.path, line=line) from None
    yield from follower.running(follower.now)


class _Counter:
    """Counts records as they are read, and reports progress."""

    def __init__(self, progress: Optional[ReadingProgress]) -> None:
        self._progress = progress
        self._count = 0
        self._begin = time.monotonic()

    def __call__(self, records: Iterable[_Counted]) -> Iterator[_Counted]:
        for record in records:
            self._count += 1
            if self._progress is not None and self._count % _BETWEEN == 0:
                self._progress("records read", self._count, time.monotonic() - self._begin)
            yield record

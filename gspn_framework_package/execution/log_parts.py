"""The parts of a log: a new one begins where the team adopts another plan.

A part is read like a log of a run of its plan. After a deploy it begins in the middle of the run,
as the log of a robot does that joined later: with the state of the team.
"""

from __future__ import annotations

import math
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple, Union

from gspn_framework_package.execution.event_log import LogFile, LogPosition, Record
from gspn_framework_package.execution.replayer import Replayer
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.plan import Plan

_NAMES_A_PLAN = b'"adopt'
"""Text in every line by which a team adopts a plan, or reports that it has adopted one."""


class _Begin(NamedTuple):
    """Where a part begins: the log's ``position``, and the records that bring a reader to the
    state there. ``stage``: which adopted plan it is."""

    stage: int
    plan: Plan
    position: Optional[LogPosition]
    before: Tuple[Record, ...]


class LogPart:
    """The part of a log in which the team follows one plan.

    :ivar header: the header of the log; of later parts, ``run`` and ``log`` have other names.
    :ivar plan: the plan that the team follows.
    :ivar stage: which adopted plan it is; 0 for the one with which the run began.
    :ivar several: whether the log has other parts.
    """

    def __init__(
        self, file: LogFile, begin: _Begin, end: float = math.inf, number: int = 0
    ) -> None:
        self._file, self._begin, self._end = file, begin, end
        self.path, self.plan, self.stage = file.path, begin.plan, begin.stage
        self.several = number > 0 or end < math.inf
        self.header = dict(file.header)
        if begin.stage:
            self.header["run"] = "%s, plan %d" % (file.header["run"], begin.stage + 1)
        if number:
            self.header["log"] = "%s, part %d" % (file.header["log"], number + 1)

    @property
    def robot(self) -> str:
        """The robot that wrote the log; "" for a standalone run."""
        return str(self.header["robot"])

    @property
    def name(self) -> str:
        """The name for people: the path and, for a part, the plan."""
        return self.path if not self.several else "%s, plan %d" % (self.path, self.stage + 1)

    @property
    def cut(self) -> bool:
        """Whether a truncated last line has been met."""
        return self._file.cut and self._end == math.inf

    def numbered_records(self) -> Iterator[Tuple[int, Record]]:
        """The line and the record of each line, as :meth:`.LogFile.checked_records` yields
        them. Those that bring a reader to the beginning have the number of the line before it.

        :raises LogError: a line is not a record, or does not follow from those before it.
        """
        position = self._begin.position
        line = 2 if position is None else position.line
        for record in self._begin.before:
            yield line - 1, record
        for record, after in self._file.go_on(position):
            if after.offset > self._end:
                return
            yield line, record
            line = after.line


def log_parts(log: Union[str, LogPart]) -> List[LogPart]:
    """The parts of a log, in their order; a log that is already a part is its own only part.

    :param log: its path.
    :raises LogError: the log cannot be read, or holds what cannot be played again.
    """
    if isinstance(log, LogPart):
        return [log]
    file = LogFile(log)
    whole = _Begin(0, file.plan, None, ())
    with file.open() as lines:
        if not any(_NAMES_A_PLAN in line for line in lines):
            return [LogPart(file, whole)]
    begins, ends = _Splitter(file).split()
    return [LogPart(file, begin, end, n) for n, (begin, end) in enumerate(zip(begins, ends))]


class _Splitter:
    """Finds where the parts of a log begin."""

    def __init__(self, file: LogFile) -> None:
        self._file = file
        self._robot = str(file.header["robot"])
        self._live = not self._robot
        self._life: Optional[Record] = None

    def split(self) -> Tuple[Sequence[_Begin], Sequence[float]]:
        """Where the parts begin, and the bytes at which they end; those without a slot are left
        out."""
        file = self._file
        replayer = Replayer(TokenGame(file.plan, agents=bool(file.header.get("agents"))))
        begins, slots = [_Begin(0, file.plan, None, ())], [0]
        ends: List[float] = []
        before: Optional[LogPosition] = None
        for record, after in file.go_on(None):
            line = 2 if before is None else before.line
            try:
                step = replayer.take(record)
                self._follow(record)
            except LogError as error:
                raise error.located(file=file.path, line=line) from None
            stage = adopted_number(replayer.state)
            if stage == begins[-1].stage:
                slots[-1] += step is not None
            else:
                ends.append(before.offset if before is not None else file.begin)
                slots.append(0)
                plan, known = replayer.game.plan, self._known(record)
                if record["kind"] == "slot":
                    state = replayer.state.to_json(replayer.game.net)
                    here = {**record, "kind": "snapshot", "state": state}
                    begins.append(_Begin(stage, plan, after, (here, *known)))
                else:  # it brings the state itself
                    begins.append(_Begin(stage, plan, before, tuple(known)))
            before = after
        ends.append(math.inf)
        kept = [n for n, count in enumerate(slots) if count or n == len(slots) - 1]
        return [begins[n] for n in kept], [ends[n] for n in kept]

    def _follow(self, record: Record) -> None:
        """Follow whether slots are received when they are decided."""
        kind = record["kind"]
        if kind == "life":
            self._life, self._live = record, False
        elif kind == "reset":
            self._live = False
        elif kind == "active":
            self._live = True
        elif kind == "slot" and not self._live:
            life = 0 if self._life is None else self._life["incarnation"]
            joins = [e for e in record["entries"] if e.get("entry") == "join"]
            self._live = any(
                e.get("robot") == self._robot and e.get("incarnation", -1) >= life for e in joins
            )

    def _known(self, record: Record) -> Iterator[Dict[str, Any]]:
        """The records about the robot's node, with the time of ``record``."""
        clocks = {clock: record.get(clock) for clock in ("wall", "mono")}
        if self._life is not None:
            yield {**self._life, **clocks}
        if self._live and self._robot:
            yield {"kind": "active", **clocks}


def adopted_number(state: TeamState) -> int:
    """Which adopted plan the team follows; 0 for the one with which the run began."""
    return 0 if state.adopted is None else state.adopted.number

"""Extracts the attempts at actions from event logs: when each began and ended, and its outcome.

An attempt begins when its action starts: with the ``goal`` record in the log of the robot itself,
otherwise with the slot that moved the robot, plus the delay of a retry. It ends with the slot that
holds its ``Done`` or ``Failed``, or with the ``private`` record of a local transition; what the
robot waits for afterwards is not part of it. The time that a team needs to agree on the slot is
included, because every action of the run has it; an outage is not (see :data:`OUTAGE`). A pause has
no effect: actions continue, and their ends are logged.

An attempt whose end is not known is *censored*: its duration is only known to be at least the
observed one. This happens at the end of the log or of the run, when an event interrupts the action,
when the operator moves the robot or removes it from the team, and when its node ends. If not even
the start is known, for example while a robot learns the log from the others, the attempt is left
out.
"""

from __future__ import annotations

from collections import Counter
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Set, Tuple, Union

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import LogClock, Record
from gspn_framework_package.execution.firing import CancelAction, StartAction
from gspn_framework_package.execution.log_parts import adopted_number
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.replayer import RECORD_FAULTS, Replayed, Replayer, unusable
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.execution.turn import ASKS_POLICY
from gspn_framework_package.model.attempt import Attempt, EventCount
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import NO_REQUEST

OUTAGE = 1.0
"""Seconds. If a team takes longer than this to agree that an action has ended, for example because
there is no quorum, the attempt ends at the time of the ``invoked`` record in the robot's own
log."""


class _Going(NamedTuple):
    """A running attempt. ``start`` is None if unknown."""

    place: str
    incarnation: int
    visit: int
    attempt: int
    start: Optional[float]


class _Count:
    """A growing :class:`.EventCount`."""

    def __init__(self) -> None:
        self.firings, self.exposure = 0, 0.0
        self.hours: Dict[int, Tuple[int, float]] = {}
        self.data: Dict[str, Counter[Union[str, int]]] = {}

    def expose(self, seconds: float, clock: LogClock, times: int) -> None:
        """Add the last seconds on a clock, in which it could occur, ``times`` times as often."""
        self.exposure += times * seconds
        for hour, part in clock.by_hour(seconds):
            firings, exposure = self.hours.get(hour, (0, 0.0))
            self.hours[hour] = firings, exposure + times * part

    def occur(self, hour: Optional[int], data: Mapping[str, Any]) -> None:
        """Add an occurrence, which may be a task with data."""
        self.firings += 1
        if hour is not None:
            firings, exposure = self.hours.get(hour, (0, 0.0))
            self.hours[hour] = firings + 1, exposure
        for name, value in data.items():
            if isinstance(value, (str, int)):
                self.data.setdefault(name, Counter())[value] += 1


class AttemptFollower:
    """Follows one log, or the slots of a live team, record by record.

    :param plan: the plan in the header of the log.
    :param robot: the robot that keeps the log; "" for a standalone run or a live team, where all
        slots are timed by their decision.
    :param agents: whether it is a standalone run (as in the header).
    :param own_only: follow only the robot that keeps the log. This is faster, because it replays
        nothing.
    :param log: the log index to assign to the attempts.
    :param stage: which adopted plan ``plan`` is (see :func:`.log_parts.adopted_number`).

    :ivar now: the time of the newest record (s).
    :ivar step: what the newest record changed, as replayed; None if it holds no slot.
    """

    def __init__(
        self,
        plan: Plan,
        robot: str = "",
        *,
        agents: bool = False,
        own_only: bool = False,
        log: int = 0,
        stage: int = 0,
    ) -> None:
        self.plan = plan
        self.robot = robot
        self.now = 0.0
        self.step: Optional[Replayed] = None
        self._log, self._stage = log, stage
        self._clock = LogClock()
        self._game = TokenGame(plan, agents=agents)
        self._replayer = None if own_only else Replayer(self._game)
        self._going: Dict[str, _Going] = {}
        self._live = not robot
        """Whether slots are received when they are decided; false while the robot catches up."""
        self._life = 0
        self._own_end: Optional[Tuple[float, log_entries.Entry]] = None
        """When and how the log's own robot's attempt ended, before the team has agreed on it."""
        self._delay = 0.0
        """Delay in seconds before the next goal of the log's own robot starts."""
        self._failures = 0
        """How often its action has failed since its visit began, or the operator had it retry."""
        self._interrupts = [
            t
            for t, event in self._game.interrupts.items()
            if event.comes_after is None and plan.flows[t].taken
        ]
        self._arrivals = {
            t
            for t in self._game.submissions
            if not plan.simulate_environment or plan.net.transitions[t].name in plan.events
        }
        """The transitions through which tasks arrive from outside."""
        self._came: Set[Tuple[object, ...]] = set()
        """The tasks and events that were counted."""
        self._counted = {
            t: _Count()
            for t in (*self._game.environment_transitions, *self._interrupts)
            if t not in self.plan.net.functions
        }

    @property
    def events(self) -> Dict[str, EventCount]:
        """The counts so far, by the name of a transition of the environment or of an event."""
        names = self.plan.net.transitions
        return {
            names[t].name: EventCount(count.firings, count.exposure, count.hours, count.data)
            for t, count in self._counted.items()
        }

    def _refuse_another_plan(self, record: Record) -> None:
        """:raises LogError: from this record on, the team follows another plan."""
        if self.step is not None and adopted_number(self.step.state) != self._stage:
            raise LogError(
                "from slot %s on, the team follows another plan" % record.get("slot"),
                hint="follow each part of the log with its plan",
            )

    def take(self, record: Record) -> List[Attempt]:
        """Process the next record, and return the attempts that ended with it.

        :raises LogError: the record does not follow from the previous ones, or is damaged.
        """
        try:
            return self._take(record)
        except RECORD_FAULTS as error:
            raise unusable(error) from None

    def running(self, now: float) -> List[Attempt]:
        """The attempts still running at ``now`` (s, on the clock of the log), as censored ones."""
        return [
            a for robot, going in self._going.items() for a in self._censored(robot, going, now)
        ]

    # -- records -----------------------------------------------------------------------------------

    def _take(self, record: Record) -> List[Attempt]:
        before, self.now = self.now, self._clock.read(record)
        kind = record["kind"]
        self._count_exposure(self.now - before)
        self.step = self._replayer.take(record) if self._replayer is not None else None
        self._refuse_another_plan(record)
        if kind == "slot":
            return self._slot(record)
        if kind == "snapshot":
            if self.step is not None:
                self._jump()
        elif kind == "goal":
            return self._goal(record)
        elif kind == "cancel":
            going = self._going.get(self.robot)
            if going is not None and going.visit <= record["visit"]:
                return self._cut(self.robot, self.now)
        elif kind == "private":
            return self._end(log_entries.from_json(record["entry"]))
        elif kind == "invoked":
            entry = log_entries.from_json(record["entry"])
            if self._ends(entry, self._going.get(self.robot)):
                self._own_end = self.now, entry
        elif kind == "life":
            return self._new_life(record, before)
        elif kind == "active":
            self._live = True
        elif kind == "reset":
            self._live = False
            self._forget_others()
        elif kind == "ended":
            return self._cut_all()
        return []

    def _slot(self, record: Record) -> List[Attempt]:
        ended: List[Attempt] = []
        entries = (
            self.step.entries
            if self.step is not None
            else tuple(log_entries.from_json(entry) for entry in record["entries"])
        )
        for entry in entries:
            ended += self._end(entry)
            if self._live:
                self._count_entry(entry)
        if self.step is not None:
            ended += self._commands(self.step)
        return ended

    def _commands(self, step: Replayed) -> List[Attempt]:
        ended: List[Attempt] = []
        for command in step.commands:
            if isinstance(command, CancelAction) and command.robot != self.robot:
                ended += self._cut(command.robot, self.now)
            elif isinstance(command, StartAction) and command.robot != self.robot:
                robot = step.state.robots.get(command.robot)
                if (
                    robot is not None
                    and robot.phase is Phase.DOING
                    and (robot.visit, robot.attempt) == (command.visit, command.attempt)
                ):
                    self._going[command.robot] = _Going(
                        command.place,
                        command.incarnation,
                        command.visit,
                        command.attempt,
                        self.now + command.delay if self._live else None,
                    )
        for name in [name for name in self._going if name != self.robot]:
            if name not in step.state.robots:  # an agent destroyed by a join transition
                del self._going[name]
        if step.state.ended is not None:
            ended += self._cut_all()
        return ended

    def _end(self, entry: log_entries.Entry) -> List[Attempt]:
        """Process an entry that may end an attempt."""
        if isinstance(entry, (log_entries.Done, log_entries.Failed)):
            going = self._going.get(entry.robot)
            if going is None or not self._ends(entry, going):
                return []
            del self._going[entry.robot]
            end = self.now
            if entry.robot == self.robot:
                if self._own_end is not None and end - self._own_end[0] > OUTAGE:
                    end = self._own_end[0]
                self._own_end = None
            return self._completed(entry, going, end)
        if isinstance(entry, log_entries.Retry):
            if entry.robot == self.robot:
                self._delay, self._failures = 0.0, 0
        elif isinstance(entry, log_entries.Join):
            if entry.robot == self.robot:
                self._live = self._live or entry.incarnation >= self._life
            else:  # its node restarted, so the end of the attempt is unknown
                self._going.pop(entry.robot, None)
        elif isinstance(entry, (log_entries.SetPlace, log_entries.Leave)):
            if entry.robot != self.robot:
                return self._cut(entry.robot, self.now)
        elif isinstance(entry, log_entries.Evict) and entry.robot != self.robot:
            silent = self.plan.timing.evict_after
            going = self._going.get(entry.robot)
            if going is not None and going.incarnation == entry.incarnation:
                # the robot has been silent for that long
                return self._cut(entry.robot, self.now - silent)
        return []

    @staticmethod
    def _ends(entry: log_entries.Entry, going: Optional[_Going]) -> bool:
        """Whether an entry is the end of this attempt."""
        if going is None or not isinstance(entry, (log_entries.Done, log_entries.Failed)):
            return False
        if isinstance(entry, log_entries.Failed) and entry.attempt != going.attempt:
            return False
        return (entry.incarnation, entry.visit) == (going.incarnation, going.visit)

    def _is_bad(self, place: str, result: str) -> bool:
        """Whether an action of this place cannot have that result, so that it counts as a
        failure."""
        net = self.plan.net
        p = net.place_number(place)
        leaving = net.consumers[p]
        if result:
            return bool(leaving) and net.transition_index.get(result) not in leaving
        return self._game.unnamed[p] == NO_REQUEST

    def _goal(self, record: Record) -> List[Attempt]:
        """Process the start of an action by the robot's own node."""
        going = _Going(
            record["place"], record["incarnation"], record["visit"], record["attempt"], None
        )
        self.plan.net.place_number(going.place)
        delay, self._delay = self._delay, 0.0
        if going.attempt == 1:
            self._failures = 0
        known = self._going.get(self.robot)
        ended = self._cut(self.robot, self.now) if known is not None else []
        self._going[self.robot] = going._replace(start=self.now + delay)
        return ended

    def _new_life(self, record: Record, before: float) -> List[Attempt]:
        """Process a start or restart of the node of the log's own robot."""
        self._life = record["incarnation"]
        self._live = False
        self._delay = 0.0
        self._forget_others()
        return self._cut(self.robot, before)

    def _jump(self) -> None:
        """Process an adopted snapshot: everything before it has no times."""
        assert self.step is not None
        for name in [name for name in self._going if name != self.robot]:
            robot = self.step.state.robots.get(name)
            going = self._going[name]
            if robot is None or (robot.incarnation, robot.visit, robot.attempt) != going[1:4]:
                del self._going[name]

    # -- attempts ----------------------------------------------------------------------------------

    def _completed(
        self, entry: Union[log_entries.Done, log_entries.Failed], going: _Going, end: float
    ) -> List[Attempt]:
        """The attempt that ended with ``entry``; none if its times are unknown."""
        result = failed = ""
        if isinstance(entry, log_entries.Failed):
            failed = entry.reason or "failed"
        else:
            result = "" if entry.result in ASKS_POLICY else entry.result
            if self._is_bad(going.place, result):
                result, failed = "", Outcome.BAD_RESULT
        if entry.robot == self.robot:
            self._failures = self._failures + 1 if failed else 0
            rule = self.plan.failure_rule(going.place)
            self._delay = rule.delay(self._failures) if failed else 0.0
        return self._attempt(entry.robot, going, end, True, result, failed)

    def _cut(self, robot: str, end: float) -> List[Attempt]:
        """End a robot's attempt, if it has one, without a known end."""
        going = self._going.get(robot)
        found = self._censored(robot, going, end) if going is not None else []
        self._going.pop(robot, None)
        if robot == self.robot:
            self._own_end = None
        return found

    def _cut_all(self) -> List[Attempt]:
        return [a for robot in list(self._going) for a in self._cut(robot, self.now)]

    def _censored(self, robot: str, going: _Going, end: float) -> List[Attempt]:
        if robot == self.robot and self._own_end is not None:
            # the action had ended, but the team had not learned of it
            ended, entry = self._own_end
            assert isinstance(entry, (log_entries.Done, log_entries.Failed))
            return self._completed(entry, going, ended)
        return self._attempt(robot, going, end, False)

    def _attempt(
        self,
        robot: str,
        going: _Going,
        end: float,
        completed: bool,
        result: str = "",
        failed: str = "",
    ) -> List[Attempt]:
        timed = self._live or robot == self.robot
        if going.start is None or not timed or end < going.start:
            return []
        return [
            Attempt(
                robot,
                going.place,
                going.visit,
                going.attempt,
                going.start,
                end,
                completed,
                result,
                failed,
                self._log,
            )
        ]

    def _forget_others(self) -> None:
        self._going = {r: going for r, going in self._going.items() if r == self.robot}

    # -- the environment ---------------------------------------------------------------------------

    def _count_exposure(self, seconds: float) -> None:
        """Add the time since the last record to the exposure of the transitions that could fire in
        it."""
        if self._replayer is None or not self._live or seconds <= 0:
            return
        state = self._replayer.state
        if state.ended is not None or not state.robots:
            return
        net = self.plan.net
        for t, count in self._counted.items():
            if t in self._interrupts or t in self._arrivals:
                times = self._exposed(state, t) if t in self._interrupts else 1
            elif state.paused or net.transitions[t].number <= 0:
                continue
            else:
                times = net.busy_servers(state.marking, t)
            if times:
                count.expose(seconds, self._clock, times)

    def _exposed(self, state: TeamState, t: int) -> int:
        """The number of robots for which the event of ``t`` can occur now."""
        place = next(p for p, _ in self.plan.net.inputs[t] if self._game.acts[p])
        free = self._game.interrupts[t].hold or self.plan.net.is_enabled(state.marking, t)
        return sum(
            robot.place == place and t not in robot.held and (free or state.paused or robot.paused)
            for robot in state.active()
        )

    def _count_entry(self, entry: log_entries.Entry) -> None:
        """Count a firing of the environment, a task or an event."""
        if not isinstance(entry, (log_entries.Fire, log_entries.Interrupt, log_entries.Submit)):
            return
        t = self.plan.net.transition_index.get(entry.transition)
        if t is None or t not in self._counted or self.step is None:
            return
        fired = [f for f in self.step.firings if f.transition == entry.transition]
        key: Tuple[object, ...] = ()
        if isinstance(entry, log_entries.Interrupt):
            robot = self.step.state.robots.get(entry.robot)
            held = robot is not None and robot.visit == entry.visit and t in robot.held
            counts = held or any((f.robot, f.visit) == (entry.robot, entry.visit) for f in fired)
            key = entry[:4]
        elif isinstance(entry, log_entries.Submit):
            counts = t in self._arrivals or bool(fired)
            key = t, entry.id
        else:
            counts = t not in self._arrivals and any(not f.robot for f in fired)
        if not counts or key in self._came:
            return
        if key:
            self._came.add(key)
        task = entry.data if isinstance(entry, log_entries.Submit) else {}
        self._counted[t].occur(self._clock.hour, task)

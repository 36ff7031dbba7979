"""A plan in the simulated room without ROS, by default the patrol's: the plan's own token game
decides, and the robots really drive.

Time is that of the physics, so a run is as fast as the machine. Its log is a real event log, whose
clocks show the physics' time: ``gspn verify``, ``fit`` and ``compare`` read it.
"""

from __future__ import annotations

import random
import uuid
from collections import Counter, deque
from typing import Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.actions import ActionFailed
from gspn_framework_package.execution.environment import next_of_clock
from gspn_framework_package.execution.event_log import header
from gspn_framework_package.execution.firing import CancelAction, Ended, StartAction
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.errors import PlanError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.world import patrol
from gspn_framework_package.world.driving_team import CONTROL_PERIOD, DrivingTeam
from gspn_framework_package.world.referee import Referee
from gspn_framework_package.world.room import Pose, Room
from gspn_framework_package.world.traffic import SimulatedRobot


class _Running(NamedTuple):
    """An action that runs: the attempt, and its steps."""

    command: StartAction
    steps: patrol.ActionSteps


Steps = Callable[[SimulatedRobot, Room, str], patrol.ActionSteps]
"""Makes the steps of a robot's action in a place."""


class RoomRun:
    """One run of a plan with robots that drive.

    :param plan: plans/patrol, or a plan with the same places; for as many robots as it names.
    :param room: the room, with a location for each of the plan's.
    :param seed: seed of the start headings and of the policy.
    :param log: the file of the event log, a new one; None: no log.
    :param steps: for a plan with other places: what robots do in them.
    :param comes: what comes from outside: (time in s, entry), in order.
    :param day: how fast the time of day goes, which is 0:00 at the start.
    :raises PlanError: an action place is not one of the patrol.

    :ivar failures: what went wrong, for people.
    :ivar fired: transition -> how often it fired.
    :ivar token_seconds: for each place, how long its tokens were there together (s).
    """

    def __init__(
        self,
        plan: Plan,
        room: Room,
        seed: int = 0,
        log: Optional[str] = None,
        *,
        steps: Optional[Steps] = None,
        comes: Sequence[Tuple[float, log_entries.Entry]] = (),
        day: float = 1.0,
    ) -> None:
        for place in plan.action_places if steps is None else ():
            if patrol.PATROL_PLACE.match(place) is None:
                raise PlanError("not a place of the patrol", element="place '%s'" % place)
        self._steps, self._comes, self._day = steps or patrol_steps, deque(comes), day
        self.fired: Counter[str] = Counter()
        self.token_seconds = [0.0] * len(plan.net.places)
        self.plan = plan.with_seed(seed)
        heading = random.Random(seed)
        starts = [Pose(p.x, p.y, p.yaw + heading.uniform(-0.5, 0.5)) for p in room.spawn]
        names = [robot.name for robot in plan.robots]
        self.team = DrivingTeam(room, names, starts)
        self.referee = Referee(self.team)
        self.failures: List[str] = []
        self.ended: Optional[Ended] = None
        self._robots = {name: SimulatedRobot(self.team, name) for name in names}
        self._running: Dict[str, _Running] = {}
        self._ledger = Ledger(TokenGame(self.plan))
        self.state = self._ledger.state
        self._log: Optional[EventLogWriter] = None
        if log is not None:
            first = header(
                self.plan, "%s_%d" % (plan.name, seed), "", uuid.uuid4().hex, virtual=True
            )
            self._log = EventLogWriter(log, first, clocks=self._clocks)
        self._reduce([self._ledger.game.start_entry()])

    def _clocks(self) -> Tuple[float, float]:
        return self.team.time, self.team.time

    def run(self, seconds: float) -> None:
        """Continue for that many seconds of the physics, or until the plan ends."""
        for _ in range(round(seconds / CONTROL_PERIOD)):
            if self.ended is not None:
                return
            while self._comes and self._comes[0][0] <= self.team.time:
                self._reduce([self._comes.popleft()[1]])
            clock = next_of_clock(self._ledger.game, self.state, self._day * self.team.time)
            if clock is not None and not clock[0]:
                self._reduce([clock[1]])
            self._step_actions()
            for place, tokens in enumerate(self.state.marking):
                self.token_seconds[place] += tokens * CONTROL_PERIOD
            self.team.step()
            self.referee.watch()

    def close(self) -> None:
        """End the run and its log, and free the memory of the physics."""
        if self.ended is None:
            self._reduce([log_entries.Stop("the end of the simulated time")])
        if self._log is not None:
            self._log.close()
        self.team.close()

    def _step_actions(self) -> None:
        for name, running in list(self._running.items()):
            if self._running.get(name) is not running:
                continue
            command = running.command
            entry: log_entries.Entry
            try:
                next(running.steps)
                continue
            except StopIteration as done:
                result = self.plan.transition_meant(command.place, done.value or "")
                entry = log_entries.Done(name, command.incarnation, command.visit, result)
            except ActionFailed as error:
                self.failures.append("%s at %.1f s: %s" % (name, self.team.time, error))
                entry = log_entries.Failed(
                    name, command.incarnation, command.visit, command.attempt, "aborted", str(error)
                )
            del self._running[name]
            self._reduce([entry])

    def _reduce(self, entries: List[log_entries.Entry]) -> None:
        slot = self._ledger.length
        step = self._ledger.game.reduce(self.state, slot, entries)
        if self._log is not None:
            self._log.append(self._ledger.record(slot, entries, [], step))
        self.fired.update(firing.transition for firing in step.firings)
        for command in step.commands:
            if isinstance(command, StartAction):
                steps = self._steps(self._robots[command.robot], self.team.room, command.place)
                self._running[command.robot] = _Running(command, steps)
            elif isinstance(command, CancelAction):
                self._running.pop(command.robot, None)
            elif isinstance(command, Ended):
                self.ended = command


def patrol_steps(robot: SimulatedRobot, room: Room, place: str) -> patrol.ActionSteps:
    """What a robot does in a place of the patrol."""
    found = patrol.PATROL_PLACE.match(place)
    assert found is not None
    what, location = found.group("what"), found.group("location")
    if what == "Check_Temperature":
        high, low = patrol.temperature_transitions(int(found.group(1)), location)
        return patrol.measure_temperature(robot, room, location, 30.0, high, low)
    if what == "Alarm":
        return patrol.sound_alarm(robot, location, 5.0)
    if what == "Wait":
        slot = patrol.preferred_slot(robot.name)
        return patrol.wait_in_bay(robot, room, location, 4.0, slot)
    return _nothing()


def _nothing() -> patrol.ActionSteps:
    return None
    yield ""

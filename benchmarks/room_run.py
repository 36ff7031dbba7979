"""A plan of the patrol in the simulated room without ROS: the plan's own token game decides, and
the robots really drive.

Time is that of the physics, so a run is as fast as the machine. Its log is a real event log, whose
clocks show the physics' time: ``gspn verify``, ``fit`` and ``compare`` read it.
"""

from __future__ import annotations

import random
import uuid
from typing import Dict, List, NamedTuple, Optional, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.actions import ActionFailed
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


class RoomRun:
    """One run of the patrol's plan with robots that drive.

    :param plan: plans/patrol, or a plan with the same places; for as many robots as it names.
    :param room: the room, with a location for each of the plan's.
    :param seed: seed of the start headings and of the policy.
    :param log: the file of the event log, a new one; None: no log.
    :raises PlanError: an action place is not one of the patrol.

    :ivar failures: what went wrong, for people.
    """

    def __init__(self, plan: Plan, room: Room, seed: int = 0, log: Optional[str] = None) -> None:
        for place in plan.action_places:
            if patrol.PATROL_PLACE.match(place) is None:
                raise PlanError("not a place of the patrol", element="place '%s'" % place)
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
            self._step_actions()
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
        for command in step.commands:
            if isinstance(command, StartAction):
                self._running[command.robot] = _Running(command, self._steps(command))
            elif isinstance(command, CancelAction):
                self._running.pop(command.robot, None)
            elif isinstance(command, Ended):
                self.ended = command

    def _steps(self, command: StartAction) -> patrol.ActionSteps:
        found = patrol.PATROL_PLACE.match(command.place)
        assert found is not None
        robot, room = self._robots[command.robot], self.team.room
        what, location = found.group("what"), found.group("location")
        if what == "Check_Temperature":
            high, low = patrol.temperature_transitions(int(found.group(1)), location)
            return patrol.measure_temperature(robot, room, location, 30.0, high, low)
        if what == "Alarm":
            return patrol.sound_alarm(robot, location, 5.0)
        if what == "Wait":
            slot = patrol.preferred_slot(command.robot)
            return patrol.wait_in_bay(robot, room, location, 4.0, slot)
        return _nothing()


def _nothing() -> patrol.ActionSteps:
    return None
    yield ""

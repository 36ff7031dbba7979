"""A plan in virtual time whose robots drive in the simulated room: time is that of the physics.

The durations of driving come from the physics, everything else is drawn as in every run in virtual
time. It needs no ROS, and a run is as fast as the machine.
"""

from __future__ import annotations

import math
from typing import Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.actions import ActionFailed
from gspn_framework_package.execution.firing import CancelAction, GameCommand, StartAction
from gspn_framework_package.execution.token_game import Step
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.world import patrol
from gspn_framework_package.world.driving_team import CONTROL_PERIOD, DrivingTeam
from gspn_framework_package.world.referee import Referee
from gspn_framework_package.world.traffic import SimulatedRobot

Drives = Callable[[StartAction, SimulatedRobot], Optional[patrol.ActionSteps]]
"""What a robot does in the room in a place; None: its action only takes its time."""


class Visits(VirtualRun):
    """A run in virtual time that knows since when each robot has been where it is."""

    def __init__(self, plan: Plan, seed: int) -> None:
        super().__init__(plan, seed=seed)
        self._since: Dict[str, Tuple[int, float]] = {}  # robot -> visit, its beginning

    def _report(
        self, entries: Sequence[log_entries.Entry], step: Step, before: Tuple[int, ...]
    ) -> None:
        for robot in self.state.active():
            if self._since.get(robot.name, (-1, 0.0))[0] != robot.visit:
                self._since[robot.name] = robot.visit, self.now

    def stays(self) -> Dict[str, Tuple[str, float]]:
        """Robot -> its place, and for how long it has been there (s)."""
        return {
            robot.name: (
                self.plan.net.places[robot.place].name,
                self.now - self._since[robot.name][1],
            )
            for robot in self.state.active()
        }

    def count(self, prefix: str) -> int:
        """How often transitions fired whose names begin so."""
        return sum(
            number
            for t, number in zip(self.plan.net.transitions, self._firings)
            if t.name.startswith(prefix)
        )


class _Driving(NamedTuple):
    command: StartAction
    steps: patrol.ActionSteps


class DrivenRun(Visits):
    """One run of a plan with robots that drive.

    :param team: the robots of the plan, in their room.
    :param drives: what they do in which place.

    :ivar failures: what went wrong, for people.
    """

    def __init__(self, plan: Plan, team: DrivingTeam, drives: Drives, seed: int) -> None:
        super().__init__(plan, seed)
        self.team = team
        self.referee = Referee(team)
        self.failures: List[str] = []
        self._drives = drives
        self._robots = {name: SimulatedRobot(team, name) for name in team.robots}
        self._driving: Dict[str, _Driving] = {}

    def drive(self, seconds: float) -> None:
        """Continue for that many seconds of the physics, or until the plan ends."""
        for _ in range(round(seconds / CONTROL_PERIOD)):
            while self.step(self.team.time):
                pass
            if self.result is not None:
                return
            self.wait_until(self.team.time)
            self._step_actions()
            self.team.step()
            self.referee.watch()

    def _attempt(self, command: StartAction) -> Tuple[float, log_entries.Entry]:
        steps = self._drives(command, self._robots[command.robot])
        if steps is None:
            return super()._attempt(command)
        self._driving[command.robot] = _Driving(command, self._delayed(steps, command.delay))
        # how it ends comes from the room
        return math.inf, self._done(command, "")

    def _delayed(self, steps: patrol.ActionSteps, delay: float) -> patrol.ActionSteps:
        begin = self.now + delay
        while self.team.time < begin:
            yield "waits before it tries again"
        return (yield from steps)

    def _carry_out(self, command: GameCommand) -> None:
        if isinstance(command, CancelAction) and command.robot in self._driving:
            del self._driving[command.robot]
            self._robots[command.robot].stop()
        super()._carry_out(command)

    def _step_actions(self) -> None:
        for name, driving in list(self._driving.items()):
            if self._driving.get(name) is not driving:
                continue
            command = driving.command
            entry: log_entries.Entry
            try:
                next(driving.steps)
                continue
            except StopIteration:
                p = self.plan.net.place_index[command.place]
                entry = self._done(
                    command, self._outcome(self.timing.of(command.robot, p).outcomes)
                )
            except ActionFailed as error:
                self.failures.append("%s at %.1f s: %s" % (name, self.team.time, error))
                entry = command.failed(Outcome.ABORTED, str(error))
            del self._driving[name]
            self._running.pop(name, None)
            self._reduce([entry])

    @staticmethod
    def _done(command: StartAction, result: str) -> log_entries.Done:
        return log_entries.Done(command.robot, command.incarnation, command.visit, result)

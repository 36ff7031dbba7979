"""The patrol without ROS: robots that physically drive, with the plan's rule applied centrally.

It replaces the execution nodes when the world itself is tested and measured: each robot checks a
location, decides, then waits in the bay or continues to the next location, and no location is ever
granted to two robots.
"""

from __future__ import annotations

import random
from typing import Dict, List, Optional, Sequence

from gspn_framework_package.execution.actions import ActionFailed
from gspn_framework_package.world import patrol
from gspn_framework_package.world.driving_team import CONTROL_PERIOD, DrivingTeam
from gspn_framework_package.world.navigation import NavigationStatus
from gspn_framework_package.world.referee import Referee
from gspn_framework_package.world.room import Pose, Room

_THRESHOLD = 30.0  # degrees Celsius above which a location is too hot
_WAIT = 4.0  # mean seconds that a robot waits before it decides again


class SimulatedRobot:
    """One robot of a team, with the interface of the patrol's actions (:class:`.patrol.Robot`)."""

    def __init__(self, team: DrivingTeam, name: str) -> None:
        self.name = name
        self._team = team
        self._navigator = team.navigators[name]

    def now(self) -> float:
        """The time in seconds."""
        return self._team.time

    def pose(self) -> Pose:
        """The pose of the robot."""
        return self._team.physics.pose(self.name)

    def others(self) -> Dict[str, Pose]:
        """The poses of the other robots, by name."""
        return {
            name: self._team.physics.pose(name) for name in self._team.robots if name != self.name
        }

    def temperature(self) -> float:
        """The measured temperature in degrees Celsius."""
        return self._team.physics.temperature(self.name)

    def go(self, goal: Pose) -> None:
        """Start driving to a pose."""
        self._navigator.go(goal, self._team.time)

    def arrived(self) -> Optional[bool]:
        """None while driving; afterwards whether the last goal was reached."""
        return (
            None if self._navigator.active else self._navigator.status is NavigationStatus.REACHED
        )

    def trouble(self) -> str:
        """Why the last goal was not reached."""
        return self._navigator.reason

    def stop(self) -> None:
        """Drop the goal."""
        self._navigator.cancel()


class _Patroller:
    def __init__(self, robot: SimulatedRobot, slot: int, at: str) -> None:
        self.robot = robot
        self.slot = slot
        self.at = at
        self.state = "wait"
        self.action: Optional[patrol.ActionSteps] = None
        self.feedback = ""


class Patrol:
    """A team on patrol.

    As in plans/patrol, the first robots start with a check, one in each location; the others wait.

    :param room: a room whose locations form a ring, in the order of the file.
    :param robots: names of the robots.
    :param seed: seed of all random numbers.
    """

    def __init__(self, room: Room, robots: Sequence[str], seed: int = 0) -> None:
        self._random = random.Random(seed)
        self._ring = list(room.locations)
        # random start headings, so that no two seeds give the same run
        starts = [Pose(p.x, p.y, p.yaw + self._random.uniform(-0.5, 0.5)) for p in room.spawn]
        self.team = DrivingTeam(room, robots, starts)
        self.referee = Referee(self.team)
        self.failures: List[str] = []
        self._members = [
            _Patroller(SimulatedRobot(self.team, name), index, self._ring[index % len(self._ring)])
            for index, name in enumerate(robots)
        ]
        for member in self._members[: len(self._ring)]:
            member.state = "check"
            self.referee.order.grant(member.robot.name, member.at)
        self._dead: Dict[str, _Patroller] = {}

    def step(self) -> None:
        """Advance the team and its actions by one control period."""
        order = list(self._members)
        self._random.shuffle(order)
        for member in order:
            self._act(member)
        self.team.step()
        self.referee.watch()

    def run(self, seconds: float) -> None:
        """Continue for a number of simulated seconds."""
        for _ in range(round(seconds / CONTROL_PERIOD)):
            self.step()

    def kill(self, robot: str) -> None:
        """Stop a robot permanently, wherever it is; its body stays."""
        member = next(m for m in self._members if m.robot.name == robot)
        self._members.remove(member)
        self._dead[robot] = member
        self.team.navigators[robot].cancel()
        self.referee.order.withdraw(robot)

    def revive(self, robot: str) -> None:
        """Bring a robot back; it starts its last action again."""
        member = self._dead.pop(robot)
        member.action = None
        self._members.append(member)
        if member.state == "check":
            self.referee.order.grant(robot, member.at)
            self._start(member)

    def _next(self, location: str) -> str:
        return self._ring[(self._ring.index(location) + 1) % len(self._ring)]

    def _act(self, member: _Patroller) -> None:
        if member.action is None:
            self._start(member)
        assert member.action is not None
        try:
            member.feedback = next(member.action)
        except StopIteration as done:
            member.action = None
            self._decide(member, done.value)
        except ActionFailed as error:
            self.failures.append("%s at %.1f s: %s" % (member.robot.name, self.team.time, error))
            member.action = None

    def _decide(self, member: _Patroller, answer: Optional[str]) -> None:
        if answer == "high":
            member.state = "alarm"
            return
        target = self._next(member.at)
        # a robot lost in a location still holds it, as its token does until it is evicted
        if any(other.at == target and other.state != "wait" for other in self._members):
            member.state = "wait"
        else:
            member.state, member.at = "check", target
            self.referee.order.grant(member.robot.name, target)

    def _start(self, member: _Patroller) -> None:
        room, robot = self.team.room, member.robot
        if member.state == "check":
            member.action = patrol.measure_temperature(
                robot, room, member.at, _THRESHOLD, "high", "low"
            )
        elif member.state == "alarm":
            member.action = patrol.sound_alarm(robot, member.at, 5.0)
        else:
            seconds = _WAIT * self._random.uniform(0.5, 1.5)
            member.action = patrol.wait_in_bay(robot, room, member.at, seconds, member.slot)

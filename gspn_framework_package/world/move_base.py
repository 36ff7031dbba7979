"""``move_base`` of a simulated robot: an action server in front of its navigator.

It behaves like move_base (a new goal preempts the old one; blocked and unreachable goals are
aborted with a reason), so that plan actions need not know whether the robot is real. It has the
topic for goals without an action client, and the services to plan a path and to replan.
"""

from __future__ import annotations

import math
from typing import Any, Callable, Optional

import actionlib
import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from move_base_msgs.msg import MoveBaseAction, MoveBaseActionGoal, MoveBaseFeedback, MoveBaseGoal
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan
from std_srvs.srv import Empty, EmptyResponse

from gspn_framework_package.world.driving_team import DrivingTeam
from gspn_framework_package.world.messages import (
    path_message,
    pose_from,
    pose_message,
    stamp_of,
)
from gspn_framework_package.world.navigation import NavigationStatus
from gspn_framework_package.world.room import Pose

MAP_FRAME = "map"
"""The frame of all goals."""

FEEDBACK_PERIOD = 0.5
"""Seconds of world time between two feedback messages."""


class MoveBase:
    """Serves the action ``ROBOT/move_base`` (move_base_msgs/MoveBaseAction) and what belongs to it.

    ROS callbacks only pass goals and cancellations on to the thread that steps the world.

    :param robot: name of the robot, which is also its namespace.
    :param team: the team of the robot.
    :param hand_off: called from ROS threads with a function to run in the world's thread.
    """

    def __init__(
        self, robot: str, team: DrivingTeam, hand_off: Callable[[Callable[[], None]], None]
    ) -> None:
        self._robot = robot
        self._team = team
        self._navigator = team.navigators[robot]
        self._current: Optional[Any] = None
        self._target = Pose(0.0, 0.0)
        self._feedback_time = -math.inf
        self._server = actionlib.ActionServer(
            "/%s/move_base" % robot,
            MoveBaseAction,
            goal_cb=lambda handle: hand_off(lambda: self._take(handle)),
            cancel_cb=lambda handle: hand_off(lambda: self._drop(handle)),
            auto_start=False,
        )
        self._server.start()
        goals = rospy.Publisher("/%s/move_base/goal" % robot, MoveBaseActionGoal, queue_size=5)
        rospy.Subscriber(
            "/%s/move_base_simple/goal" % robot,
            PoseStamped,
            lambda pose: goals.publish(MoveBaseActionGoal(goal=MoveBaseGoal(pose))),
            queue_size=5,
        )
        rospy.Service("/%s/move_base/make_plan" % robot, GetPlan, self._make_plan)
        rospy.Service("/%s/move_base/clear_costmaps" % robot, Empty, self._plan_anew)
        self._hand_off = hand_off

    @property
    def target(self) -> Optional[Pose]:
        """The pose that the robot is driving to; None if it has no goal."""
        return self._target if self._current is not None else None

    def _take(self, handle: Any) -> None:
        try:
            goal = _in_map(handle.get_goal().target_pose)
        except ValueError as error:
            handle.set_rejected(text=str(error))
            return
        if self._current is not None:
            self._current.set_canceled(text="preempted by a newer goal")
        handle.set_accepted()
        self._current, self._target = handle, goal
        self._navigator.go(goal, self._team.time)

    def _drop(self, handle: Any) -> None:
        if self._current is not None and handle.get_goal_id().id == self._current.get_goal_id().id:
            self._navigator.cancel()
            self._current.set_canceled(text="cancelled")
            self._current = None

    def _make_plan(self, request: Any) -> Path:
        """The path between two poses among walls and obstacles, robots left out; without poses if
        there is none. The start is the robot's own pose if it names no frame."""
        try:
            goal = _in_map(request.goal)
            start = (
                _in_map(request.start)
                if request.start.header.frame_id
                else self._team.physics.pose(self._robot)
            )
        except ValueError as error:
            raise rospy.ServiceException(str(error)) from None
        grid, end = self._team.grid, (goal.x, goal.y)
        if not grid.free[grid.cell(end)]:
            near = grid.cells_near(end, request.tolerance)
            near = near[grid.free[near]]
            if len(near):
                cell = near[np.argmin(np.hypot(grid.xs[near] - goal.x, grid.ys[near] - goal.y))]
                end = (float(grid.xs[cell]), float(grid.ys[cell]))
        points = grid.field(end).path((start.x, start.y))
        return path_message(points, goal, stamp_of(self._team.time), MAP_FRAME)

    def _plan_anew(self, _request: Any) -> EmptyResponse:
        self._hand_off(self._navigator.plan_anew)
        return EmptyResponse()

    def update(self) -> None:
        """Report the robot's progress to the client; call this after each step of the world."""
        handle = self._current
        if handle is None:
            return
        if self._navigator.active:
            if self._team.time - self._feedback_time >= FEEDBACK_PERIOD:
                self._feedback_time = self._team.time
                pose = pose_message(self._team.physics.pose(self._robot))
                base = PoseStamped(pose=pose)
                base.header.frame_id = MAP_FRAME
                base.header.stamp = stamp_of(self._team.time)
                handle.publish_feedback(MoveBaseFeedback(base_position=base))
            return
        self._current = None
        if self._navigator.status is NavigationStatus.REACHED:
            handle.set_succeeded(text="reached")
        else:
            handle.set_aborted(text=self._navigator.reason)


def _in_map(stamped: PoseStamped) -> Pose:
    """The pose of a message. :raises ValueError: it is not a pose in the frame of the map."""
    frame = stamped.header.frame_id.lstrip("/")
    pose = pose_from(stamped.pose)
    if frame not in ("", MAP_FRAME):
        raise ValueError("goals are in the frame '%s', not '%s'" % (MAP_FRAME, frame))
    return pose

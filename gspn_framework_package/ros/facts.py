"""Publishes a robot's firings and activity on ROS."""

from __future__ import annotations

import json
from typing import Any, Dict, List

import rospy
from std_msgs.msg import String

from gspn_framework_package.execution.team_messages import activity_fields
from gspn_framework_package.msg import FiredTransition, Marking, RobotActivity, TeamState
from gspn_framework_package.ros.messages import FIRED_TOPIC, TASKS_TOPIC, stamped_message
from gspn_framework_package.ros.transport.eager_publisher import eager_publisher


class RosFacts:
    """Publishes ``/fired_transitions`` (gspn_framework_package/FiredTransition),
    ``/finished_tasks`` (std_msgs/String, JSON) and, in the namespace of the robot and latched:

    - ``activity`` (std_msgs/String, JSON: see
      :meth:`~gspn_framework_package.team.self_report.SelfReport.activity`) and ``robot_activity``
      (RobotActivity), at most ten times a second;
    - ``marking`` (Marking) and ``team_state`` (TeamState), while somebody subscribes, at most five
      times a second.

    :param namespace: absolute namespace of the robot.
    """

    def __init__(self, namespace: str) -> None:
        self._fired = eager_publisher(FIRED_TOPIC, FiredTransition)
        self._tasks = eager_publisher(TASKS_TOPIC, String)

        def latched(name: str, kind: Any) -> Any:
            return rospy.Publisher(
                rospy.names.ns_join(namespace, name), kind, latch=True, queue_size=10
            )

        self._activity = latched("activity", String)
        self._robot = latched("robot_activity", RobotActivity)
        self._marking = latched("marking", Marking)
        self._team = latched("team_state", TeamState)

    def publish_firings(self, firings: List[Dict[str, Any]]) -> None:
        """See :class:`Carrier`."""
        for fields in firings:
            self._fired.publish(stamped_message(FiredTransition, **fields))

    def publish_task(self, task: Dict[str, Any]) -> None:
        """See :class:`Carrier`."""
        self._tasks.publish(json.dumps(task))

    def is_watched(self) -> bool:
        """See :class:`Carrier`."""
        return bool(self._activity.get_num_connections() or self._robot.get_num_connections())

    def publish_activity(self, activity: Dict[str, Any]) -> None:
        """See :class:`Carrier`."""
        self._activity.publish(json.dumps(activity))
        self._robot.publish(stamped_message(RobotActivity, **activity_fields(activity)))

    def is_team_watched(self) -> bool:
        """See :class:`Carrier`."""
        return bool(self._marking.get_num_connections() or self._team.get_num_connections())

    def publish_team(self, marking: Dict[str, Any], team: Dict[str, Any]) -> None:
        """See :class:`Carrier`."""
        self._marking.publish(stamped_message(Marking, **marking))
        robots = [stamped_message(RobotActivity, **robot) for robot in team["robots"]]
        self._team.publish(stamped_message(TeamState, **{**team, "robots": robots}))

"""Connects an execution node to an action server in the same process, without topics."""

from __future__ import annotations

import time
from typing import Any, Callable, Dict, Optional, Set

import genpy
import rospy
from actionlib_msgs.msg import GoalStatus

from gspn_framework_package.msg import ExecGSPNActionGoal, ExecGSPNGoal
from gspn_framework_package.ros.action_connection import ENDED
from gspn_framework_package.ros.goal_state import GoalNews
from gspn_framework_package.ros.messages import stamped_message
from gspn_framework_package.ros.place_servers import PlaceServer


class DirectConnection:
    """Has the interface of :class:`ActionConnection`, but uses calls instead of messages.

    The server treats the goal like any other, and also publishes its status, feedback and result on
    its topics; only the goal itself does not appear on ``SERVER/goal``. Over topics, each of the
    1,000 servers of 50 robots in 20 places would need five connections within its process.

    :param server: the server, in this process.
    :param hand_on: see :class:`ActionConnection`.
    """

    def __init__(
        self, server: PlaceServer, hand_on: Callable[[DirectConnection, GoalNews, str, Any], None]
    ) -> None:
        self.server = server.ns
        self._server = server
        self._hand_on = hand_on
        self._watched = ""
        self._abandoned: Set[str] = set()

    @property
    def last_status(self) -> Dict[str, float]:
        """This node and the current monotonic time, as if a status had just arrived."""
        return {rospy.get_name(): time.monotonic()}

    def ready_server(self) -> Optional[str]:
        """The name of this node, once the server has been started."""
        return rospy.get_name() if self._server.started else None

    def is_connected(self, caller: str) -> bool:
        """Whether the server accepts goals."""
        return self._server.started

    def silence(self, caller: str) -> float:
        """Always 0: a server in the same process is alive."""
        return 0.0

    def period(self, caller: str) -> float:
        """See :meth:`ActionConnection.period`."""
        return 0.0

    def learn_periods(self) -> None:
        """Do nothing: see :meth:`silence`."""

    def send(self, goal_id: str, goal: ExecGSPNGoal, incarnation: int, text: str = "") -> None:
        """See :meth:`ActionConnection.send`."""
        self._watched = goal_id
        message = stamped_message(ExecGSPNActionGoal, goal=goal)
        message.header.frame_id = text
        message.goal_id.id = goal_id
        self._server.take(message, self._reported)
        self._hand_on(self, GoalNews.ACKNOWLEDGED, goal_id, rospy.get_name())

    def forget(self) -> None:
        """Stop watching the goal."""
        self._watched = ""

    def abandon(self, goal_id: str) -> None:
        """See :meth:`ActionConnection.abandon`."""
        self._abandoned.add(goal_id)
        self.forget()
        self._server.cancel_goal(goal_id)

    def still_has(self, goal_id: str) -> bool:
        """See :meth:`ActionConnection.still_has`."""
        has = goal_id in self._abandoned and self._server.started
        self._abandoned.discard(goal_id)
        return has

    def _reported(self, what: GoalNews, status: GoalStatus, message: genpy.Message) -> None:
        """Called by the server, on any thread; ``what`` is FEEDBACK or RESULT."""
        goal_id = status.goal_id.id
        if what is GoalNews.RESULT:
            self._abandoned.discard(goal_id)
        if goal_id != self._watched:
            return
        if what is GoalNews.FEEDBACK:
            self._hand_on(self, what, goal_id, message)
        elif status.status in ENDED:
            self._hand_on(self, what, goal_id, (ENDED[status.status], status.text, message))

"""Those services of Gazebo that need no messages of its own: pause and go on, and reset.

``gazebo_msgs``, which the others need, is in no package of Debian 12.
"""

from __future__ import annotations

from typing import Any, Callable

import rospy
from std_srvs.srv import Empty, EmptyResponse


class GazeboServices:
    """Serves ``/gazebo/pause_physics``, ``unpause_physics``, ``reset_world`` and
    ``reset_simulation`` (std_srvs/Empty).

    :param hand_off: runs a function in the world's thread and returns when it has.
    :param reset: puts the robots back, and the time too if its argument says so.

    :ivar paused: whether the world is to stand still.
    """

    def __init__(
        self, hand_off: Callable[[Callable[[], None]], None], reset: Callable[[bool], None]
    ) -> None:
        self.paused = False
        self._hand_off = hand_off
        orders = {
            "pause_physics": lambda: self._pause(True),
            "unpause_physics": lambda: self._pause(False),
            "reset_world": lambda: reset(False),
            "reset_simulation": lambda: reset(True),
        }
        for name, order in orders.items():
            rospy.Service("/gazebo/" + name, Empty, self._server(order))

    def _pause(self, paused: bool) -> None:
        self.paused = paused

    def _server(self, order: Callable[[], None]) -> Callable[[Any], EmptyResponse]:
        def serve(_request: Any) -> EmptyResponse:
            self._hand_off(order)
            return EmptyResponse()

        return serve

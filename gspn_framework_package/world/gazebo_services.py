"""Services and a topic of Gazebo that tests of robots use: pause and reset, and models.

Their types are those of ``gazebo_msgs`` if it is installed. Debian 12 has no package of it; there,
this package's own types have the same fields, and ROS compares nothing else when a service is
called. So a client written for ``gazebo_msgs`` gets an answer in both cases.
"""

from __future__ import annotations

from typing import Any, Callable

import rospy
from geometry_msgs.msg import Twist as TwistMessage
from geometry_msgs.msg import Vector3
from std_srvs.srv import Empty, EmptyResponse

from gspn_framework_package.world import messages
from gspn_framework_package.world.models import Models, Placed

try:
    from gazebo_msgs.msg import ModelStates
    from gazebo_msgs.srv import DeleteModel, GetModelState, SetModelState, SpawnModel
except ImportError:
    from gspn_framework_package.msg import ModelStates
    from gspn_framework_package.srv import DeleteModel, GetModelState, SetModelState, SpawnModel

STATES_PERIOD = 0.1
"""Seconds of world time between two messages on ``/gazebo/model_states``."""


class GazeboServices:
    """Serves ``/gazebo/pause_physics``, ``unpause_physics``, ``reset_world``, ``reset_simulation``
    (std_srvs/Empty), ``get_model_state``, ``set_model_state``, ``spawn_urdf_model`` and
    ``delete_model``, and publishes ``model_states``.

    :param hand_off: runs a function in the world's thread and returns when it has.
    :param reset: puts the robots back, and also resets the time if its argument requests it.

    :ivar paused: whether the world is to stand still.
    """

    def __init__(
        self,
        hand_off: Callable[[Callable[[], None]], None],
        reset: Callable[[bool], None],
        models: Models,
    ) -> None:
        self.paused = False
        self._hand_off = hand_off
        self._models = models
        orders = {
            "pause_physics": lambda: self._pause(True),
            "unpause_physics": lambda: self._pause(False),
            "reset_world": lambda: reset(False),
            "reset_simulation": lambda: reset(True),
        }
        for name, order in orders.items():
            rospy.Service("/gazebo/" + name, Empty, self._server(order))
        for name, kind, answer in (
            ("get_model_state", GetModelState, self._get),
            ("set_model_state", SetModelState, self._set),
            ("spawn_urdf_model", SpawnModel, self._spawn),
            ("delete_model", DeleteModel, self._delete),
        ):
            rospy.Service("/gazebo/" + name, kind, self._model_server(kind, answer))
        self._states = rospy.Publisher("/gazebo/model_states", ModelStates, queue_size=1)
        self._next = 0.0

    def publish(self, time: float) -> None:
        """Publish where all models are, if it is time and somebody listens.

        :param time: of the world, in seconds.
        """
        if self._states.get_num_connections() and not 0.0 < self._next - time <= STATES_PERIOD:
            self._next = time + STATES_PERIOD
            names = self._models.names()
            placed = [self._models.placed(name) for name in names]
            poses = [_pose_message(one) for one in placed]
            self._states.publish(ModelStates(names, poses, [_twist_message(p) for p in placed]))

    def _pause(self, paused: bool) -> None:
        self.paused = paused

    def _server(self, order: Callable[[], None]) -> Callable[[Any], EmptyResponse]:
        def serve(_request: Any) -> EmptyResponse:
            self._hand_off(order)
            return EmptyResponse()

        return serve

    def _model_server(self, kind: Any, answer: Callable[[Any, Any], None]) -> Callable[[Any], Any]:
        """A service whose answer says whether it did what was asked."""

        def serve(request: Any) -> Any:
            response = kind._response_class()

            def order() -> None:
                try:
                    answer(request, response)
                    response.success = True
                except ValueError as error:
                    response.status_message = str(error)

            self._hand_off(order)
            return response

        return serve

    def _get(self, request: Any, response: Any) -> None:
        placed = self._models.placed(request.model_name)
        placed = self._models.seen_from(request.relative_entity_name, placed)
        response.header.stamp = rospy.Time.now()
        response.header.frame_id = request.relative_entity_name
        response.pose, response.twist = _pose_message(placed), _twist_message(placed)

    def _set(self, request: Any, _response: Any) -> None:
        state = request.model_state
        placed = self._models.in_map(state.reference_frame, _placed(state.pose))
        self._models.move(state.model_name, placed)

    def _spawn(self, request: Any, _response: Any) -> None:
        placed = self._models.in_map(request.reference_frame, _placed(request.initial_pose))
        self._models.spawn(request.model_name, request.model_xml, placed)

    def _delete(self, request: Any, _response: Any) -> None:
        self._models.delete(request.model_name)


def _placed(pose: Any) -> Placed:
    """A pose of a message. :raises ValueError: it is not a pose, or is not upright."""
    turned = pose.orientation
    if turned == type(turned)():
        turned.w = 1.0  # nothing filled in, as in a call by hand
    if max(abs(turned.x), abs(turned.y)) > 1e-3:
        raise ValueError("the orientation is not upright: models stand on the floor")
    return Placed(messages.pose_from(pose), pose.position.z)


def _pose_message(placed: Placed) -> Any:
    pose = messages.pose_message(placed.pose)
    pose.position.z = placed.height
    return pose


def _twist_message(placed: Placed) -> TwistMessage:
    x, y, turn = placed.twist
    return TwistMessage(Vector3(x, y, 0.0), Vector3(0.0, 0.0, turn))

"""Parking as an action of robots with ``move_base``; plans/warehouse uses it in several places."""

from __future__ import annotations

from typing import Optional, Sequence

from gspn_framework_package.world import patrol
from gspn_framework_package.world.base_client import (
    Feedback,
    IsCancelled,
    carry_out,
    client_of,
)
from gspn_framework_package.world.room import Pose


class Park:
    """Drives the robot to a free slot, unless it is already in one.

    :param slots: poses ``[x, y, yaw]`` in the map, in metres and radians.
    :param radius: radius of a robot, in metres.
    :param then: the transition that follows; by default the policy, or the place's only one.
    """

    def __init__(
        self, slots: Sequence[Sequence[float]], radius: float = 0.105, then: str = ""
    ) -> None:
        self._slots = [Pose(*(float(number) for number in slot)) for slot in slots]
        self._radius = radius
        self._then = then

    def __call__(
        self, place: str, robot: str, feedback: Feedback, is_cancelled: IsCancelled
    ) -> Optional[str]:
        """Park; what is to follow does."""
        client = client_of(robot)
        client.connect(thermometer=False)
        steps = self._steps(client)
        return carry_out(steps, client, place, feedback, is_cancelled)

    def _steps(self, client: patrol.Robot) -> patrol.ActionSteps:
        first = patrol.preferred_slot(client.name)
        yield from patrol.park(client, self._slots, first, self._radius)
        return self._then or None

"""The carrier of a ROS robot whose team communicates over Zenoh, so that its master need not know
the others."""

from __future__ import annotations

from typing import Any, Dict, List

from gspn_framework_package.execution.agreement.interface import Send
from gspn_framework_package.model.plan import Plan, Synchronisation
from gspn_framework_package.ros.facts import RosFacts
from gspn_framework_package.ros.options import NodeOptions
from gspn_framework_package.team.carrier import Carrier, NotTaken
from gspn_framework_package.team.commands import handlers_of
from gspn_framework_package.team.host import ReplicaHost
from gspn_framework_package.team.keys import keys_of_robot
from gspn_framework_package.team.zenoh_carrier import ZenohCarrier
from gspn_framework_package.team.zenoh_session import TeamAccess


class PublishedOnRos(RosFacts):
    """A carrier whose facts are published on ROS as well (see :class:`Carrier`).

    :param carrier: carries the messages, and publishes the facts over Zenoh.
    :param namespace: absolute namespace of the robot.
    """

    def __init__(self, carrier: Carrier, namespace: str) -> None:
        super().__init__(namespace)
        self._carrier = carrier

    @property
    def sent(self) -> int:
        """See :class:`Carrier`."""
        return self._carrier.sent

    def send(self, sends: List[Send]) -> None:
        """See :class:`Carrier`."""
        self._carrier.send(sends)

    def publish_firings(self, firings: List[Dict[str, Any]]) -> None:
        """See :class:`Carrier`."""
        super().publish_firings(firings)
        self._carrier.publish_firings(firings)

    def publish_task(self, task: Dict[str, Any]) -> None:
        """See :class:`~gspn_framework_package.team.carrier.Carrier`."""
        super().publish_task(task)
        self._carrier.publish_task(task)

    def is_watched(self) -> bool:
        """See :class:`Carrier`."""
        return super().is_watched() or self._carrier.is_watched()

    def publish_activity(self, activity: Dict[str, Any]) -> None:
        """See :class:`Carrier`."""
        super().publish_activity(activity)
        self._carrier.publish_activity(activity)

    def refusals(self) -> List[NotTaken]:
        """See :class:`Carrier`."""
        return self._carrier.refusals()

    def close(self) -> None:
        """See :class:`Carrier`."""
        self._carrier.close()


def zenoh_transport(
    host: ReplicaHost, plan: Plan, namespace: str, options: NodeOptions
) -> PublishedOnRos:
    """Create the carrier of a robot with ``transport`` zenoh.

    :param plan: the plan with which the robot starts.
    :param namespace: absolute namespace of the robot.
    :raises GspnError: the keys cannot be used, or no other process can be reached.
    """
    keys = keys_of_robot(options.keys, host.robot) if options.keys else None
    access = TeamAccess(tuple(options.router.split()), (), keys)
    partial = plan.synchronisation is Synchronisation.PARTIAL
    carrier = ZenohCarrier(host.robot, host.run, access, handlers_of(host), partial)
    return PublishedOnRos(carrier, namespace)

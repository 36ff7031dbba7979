"""The execution node of one robot: the host of its replica, on ROS."""

from __future__ import annotations

import contextlib
from typing import Any, Callable, Optional

import rospy

from gspn_framework_package.execution.agreement.interface import Message
from gspn_framework_package.model.plan import Plan, Synchronisation, Transport
from gspn_framework_package.ros.diagnostics import RosReporter
from gspn_framework_package.ros.event_sources import EventSources
from gspn_framework_package.ros.inbound import InboundMessages
from gspn_framework_package.ros.links import ServiceLink, TopicLink
from gspn_framework_package.ros.network_fault import SlowNetwork
from gspn_framework_package.ros.node_services import NodeServices
from gspn_framework_package.ros.options import NodeOptions
from gspn_framework_package.ros.robot_actions import RobotActions
from gspn_framework_package.team.carrier import Carrier
from gspn_framework_package.team.host import HostOptions, ReplicaHost
from gspn_framework_package.team.seal import Seal, read_team_key


class ExecutionNode(ReplicaHost):
    """Executes a plan for one robot, until the run is over.

    Its ROS interface is documented in :class:`TopicLink`, :class:`RosFacts`, :class:`NodeServices`,
    :class:`RosReporter`, :class:`PlaceServers`, :class:`ActionCaller` and :class:`EventSources`;
    with simulated time, :class:`SlowNetwork`, too.

    :param plan: the checked plan, with the team at the start of the run.
    :param namespace: absolute namespace of the robot.
    :param options: see :class:`NodeOptions`.
    :raises GspnError: the log or the actions cannot be used.

    :ivar actions: the actions of the robot; start their servers before the node.
    """

    def __init__(self, plan: Plan, robot: str, namespace: str, options: NodeOptions) -> None:
        witness = robot in plan.witness
        self._network: Optional[SlowNetwork] = None
        super().__init__(
            plan,
            robot,
            HostOptions(options.run, options.log_file(robot), options.place, options.stay),
            RosReporter(robot, namespace, options.run),
            lambda plan, listener: EventSources(plan, robot, namespace, witness, listener),
        )
        with contextlib.ExitStack() as undo:
            undo.callback(self.discard)
            self.actions = RobotActions(self, plan, namespace, options)
            undo.callback(self.actions.close)
            inbound = InboundMessages(
                options.transport != Transport.ZENOH.value,
                Seal(read_team_key(options.team_key_file), options.run, robot)
                if options.team_key_file
                else None,
            )
            if not rospy.rostime.is_wallclock():
                self._network = SlowNetwork(robot)
                undo.callback(self._network.close)
            services = NodeServices(self, namespace, inbound)
            undo.callback(services.close)
            self.connect(
                _carrier(self, plan, namespace, options, services.uri, inbound),
                self.actions,
                [services.close],
            )
            undo.pop_all()

    def receive(self, message: Message) -> None:
        """See :class:`ReplicaHost`."""
        self._pass_on(super().receive, message)

    def serve(self, message: Message, answer: Callable[[Message], None]) -> None:
        """See :class:`ReplicaHost`."""
        self._pass_on(super().serve, message, answer)

    def _pass_on(self, take: Callable[..., None], *arguments: Any) -> None:
        if self._network is None:
            take(*arguments)
        else:
            self._network.pass_on(take, *arguments)

    def _close(self) -> None:
        try:
            super()._close()
        finally:
            if self._network is not None:
                self._network.close()
            self.actions.stop_serving()


def _carrier(
    host: ReplicaHost,
    plan: Plan,
    namespace: str,
    options: NodeOptions,
    service_uri: str,
    inbound: InboundMessages,
) -> Carrier:
    if options.transport == Transport.ZENOH.value:
        # imported here, since a team that communicates over ROS does not need its libraries
        from gspn_framework_package.ros.zenoh_transport import zenoh_transport

        return zenoh_transport(host, plan, namespace, options)
    kind = TopicLink if plan.synchronisation is Synchronisation.FULL else ServiceLink
    return kind(host, namespace, service_uri, inbound)

"""The execution node of one robot: the host of its replica, on ROS."""

from __future__ import annotations

import contextlib
from typing import Callable, Dict, List, Optional

from gspn_framework_package.model.plan import Plan, Synchronisation, Transport
from gspn_framework_package.ros.action_targets import ActionTarget
from gspn_framework_package.ros.diagnostics import RosReporter
from gspn_framework_package.ros.event_sources import EventSources
from gspn_framework_package.ros.inbound import InboundMessages
from gspn_framework_package.ros.links import ServiceLink, TopicLink
from gspn_framework_package.ros.node_services import NodeServices
from gspn_framework_package.ros.options import NodeOptions
from gspn_framework_package.ros.robot_actions import RobotActions
from gspn_framework_package.team.carrier import Carrier
from gspn_framework_package.team.host import HostOptions, ReplicaHost
from gspn_framework_package.team.jobs import Job
from gspn_framework_package.team.seal import Seal, read_team_key


class ExecutionNode:
    """Executes a plan for one robot, until the run is over.

    Its ROS interface is documented in :class:`TopicLink`, :class:`RosFacts`, :class:`NodeServices`,
    :class:`RosReporter`, :class:`PlaceServers`, :class:`ActionCaller` and :class:`EventSources`.

    :param plan: the checked plan, with the team at the start of the run.
    :param namespace: absolute namespace of the robot.
    :param options: see :class:`NodeOptions`.
    :raises GspnError: the log or the actions cannot be used.
    """

    def __init__(self, plan: Plan, robot: str, namespace: str, options: NodeOptions) -> None:
        self.robot = robot
        witness = robot in plan.witness
        self._host = host = ReplicaHost(
            plan,
            robot,
            HostOptions(options.run, options.log_file(robot), options.place, options.stay),
            RosReporter(robot, namespace, options.run),
            lambda plan, listener: EventSources(plan, robot, namespace, witness, listener),
        )
        with contextlib.ExitStack() as undo:
            undo.callback(host.discard)
            self._actions = RobotActions(
                plan,
                robot,
                namespace,
                options,
                host.enqueue,
                host.attempt_ended,
                host.attempt_progress,
                host.warn,
            )
            undo.callback(self._actions.close)
            inbound = InboundMessages(
                options.transport != Transport.ZENOH.value,
                Seal(read_team_key(options.team_key_file), options.run, robot)
                if options.team_key_file
                else None,
            )
            services = NodeServices(host, namespace, inbound)
            undo.callback(services.close)
            host.connect(
                _carrier(host, plan, namespace, options, services.uri, inbound),
                self._actions,
                [services.close],
            )
            undo.pop_all()

    @property
    def jobs(self) -> Dict[str, Job]:
        """The robot's actions that are no action servers, by place."""
        return self._actions.jobs

    @property
    def foreign_servers(self) -> List[ActionTarget]:
        """The robot's goals for action servers that this node does not serve."""
        return self._actions.foreign_servers

    @property
    def exit_code(self) -> Optional[int]:
        """See :class:`ReplicaHost`."""
        return self._host.exit_code

    def serve(self) -> None:
        """Start the place servers, if this node has them."""
        self._actions.serve()

    def start(self, ended: Callable[[str], None]) -> None:
        """Start the host; call :meth:`serve` first.

        :param ended: receives the name of the robot when the node has ended.
        """

        def over(robot: str) -> None:
            try:
                self._actions.stop_serving()
            finally:
                ended(robot)

        self._host.start(over)

    def stop(self) -> None:
        """End soon, without leaving the team; the running action is cancelled."""
        self._host.stop()

    def join(self, timeout: Optional[float] = None) -> None:
        """See :class:`ReplicaHost`."""
        self._host.join(timeout)


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
    quiet = 3 * host.heartbeat
    link = kind(
        host.robot, options.run, namespace, host.receive, host.serve, quiet, inbound, host.knows
    )
    link.serve_at(service_uri)
    return link

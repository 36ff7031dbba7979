"""Entry points of the node scripts: the execution node of one robot, of a whole team, or only place
servers."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from functools import partial
from typing import TYPE_CHECKING, Callable, Dict, List, Sequence, Tuple

import rosgraph
import rospy

from gspn_framework_package.execution.plan_modules import allow_modules, names_of
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import ExecutionError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros.options import (
    NodeOptions,
    launched_file,
    read_options,
    read_options_of,
)
from gspn_framework_package.ros.transport.ending import Ending
from gspn_framework_package.ros.transport.node_process import (
    ERRORS,
    await_master,
    be_node,
    report_error,
    run_node,
    share_log_configuration,
    share_source_lines,
)
from gspn_framework_package.ros.transport.process_family import FamilyMember, run_family
from gspn_framework_package.ros.transport.registration import (
    MASTER_ERRORS,
    published_topics,
    registered_together,
)
from gspn_framework_package.team.plan_examination import check_plan
from gspn_framework_package.team.router_wait import await_router

if TYPE_CHECKING:
    from gspn_framework_package.ros.action_targets import ActionTarget
    from gspn_framework_package.team.jobs import Job


def run_execution_node() -> int:
    """Run the execution node of a robot; returns the exit code of the process."""
    return run_node(
        "gspn_executor",
        lambda ending: _execute(read_options(), ending),
        lambda: refuse_taken([_own_namespace()]),
    )


def run_hosted_robots() -> int:
    """Run a node that hosts the execution nodes of a whole simulated team, each in its own
    namespace; returns the exit code of the process."""
    return run_node("gspn_hosted", lambda ending: _host(read_options(), ending))


def run_team() -> int:
    """Run the execution nodes of a whole team, each in a process forked from this one; returns the
    largest of their exit codes. This process is not a node itself."""
    name = rospy.names.get_mappings().get("__name", "gspn_team")
    # signals are handled here until the team is forked
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        await_master(Ending())
        return _fork(read_options_of(rospy.names.ns_join(_own_namespace(), name)))
    except ERRORS as error:
        return report_error(name, error)


def run_place_servers() -> int:
    """Run a node with only the place servers of a robot; returns the exit code of the process."""
    return run_node("gspn_place_servers", lambda ending: _serve(read_options(), ending))


def robot_of(plan: Plan, options: NodeOptions) -> Tuple[Plan, str]:
    """The plan with the team at the start of the run, and the name of the robot selected by the
    options.

    :raises UsageError: no robot was named, or the plan does not have it.
    """
    if options.robots:
        plan = plan.for_robots(options.robots)
    names = [robot.name for robot in plan.robots]
    if options.number:
        if not 1 <= options.number <= len(names):
            raise UsageError(
                "there is no robot %d in a team of %d" % (options.number, len(names)),
                element="~number",
            )
        return plan, names[options.number - 1]
    if not options.robot:
        raise UsageError("which robot is this?", element="~robot", hint=", ".join(names))
    if options.robot not in names + list(plan.witness) and not options.place:
        raise UsageError(
            "the plan has no robot '%s'" % options.robot,
            element="~robot",
            hint="robots of the plan: %s; a robot that joins the running team needs ~place"
            % ", ".join(names),
        )
    return plan, options.robot


def refuse_taken(namespaces: List[str]) -> None:
    """Refuse to start if a robot is running in one of the namespaces: node names are unique, so ROS
    would silently end its node. A namespace where no node answers, or where the run is over, is
    free.

    :param namespaces: the absolute namespaces of the robots to start.
    :raises ExecutionError: a namespace is taken.
    """
    from gspn_framework_package.ros.service_line import status_in

    for namespace in namespaces:
        status = status_in(namespace)
        if status is not None and status["ended"] is None:
            raise ExecutionError(
                "%s is taken: %s of run '%s' is running there"
                % (namespace, status["robot"], status["run"]),
                hint="choose another namespace for this team (prefix:=, ns:=), or end that run: "
                "gspn stop --run %s" % status["run"],
            )


def await_servers(targets: Sequence[ActionTarget], seconds: float, ending: Ending) -> None:
    """Wait until the master knows the action servers of all these goals, or until the process
    should end.

    :param seconds: how long to wait.
    :raises ExecutionError: a server did not appear in time, or has another type.
    """
    missing = {target.server for target in targets}
    if not missing:
        return
    rospy.loginfo("waits for the action servers %s", ", ".join(sorted(missing)))
    deadline = time.monotonic() + seconds
    while not ending.is_set():
        with contextlib.suppress(*MASTER_ERRORS):  # retried by the loop
            published = published_topics()
            for clash in filter(None, (target.clash(published) for target in targets)):
                raise ExecutionError(clash)
            missing = {
                target.server
                for target in targets
                if not {target.server + "/status", target.server + "/result"} <= set(published)
            }
        if not missing:
            return
        if time.monotonic() > deadline:
            raise ExecutionError(
                "there is no action server %s" % ", ".join(sorted(missing)),
                hint="waited %g s; set ~server_timeout to change that" % seconds,
            )
        ending.wait(0.2)


def await_jobs(jobs: Sequence[Job], seconds: float, ending: Ending) -> None:
    """Wait until everything that actions need exists, or until the process should end.

    :param jobs: the actions.
    :param seconds: how long to wait.
    :raises ExecutionError: something did not appear in time, or has another type.
    """
    deadline = time.monotonic() + seconds
    reported = False
    while not ending.is_set():
        missing = sorted(set(filter(None, (job.missing() for job in jobs))))
        if not missing:
            break
        if not reported:
            rospy.loginfo("waits: %s", "; ".join(missing))
            reported = True
        if time.monotonic() > deadline:
            raise ExecutionError(
                "; ".join(missing), hint="waited %g s; set ~server_timeout to change that" % seconds
            )
        ending.wait(0.2)
    if reported:
        for clash in filter(None, (job.clash({}) for job in jobs)):
            raise ExecutionError(clash)


def _launched_plan(options: NodeOptions) -> Plan:
    """Allow plans to use the modules named by the options, and return the plan."""
    allow_modules(names_of(options.modules))
    return read_plan(launched_file(options.plan, "~plan"))


def _execute(options: NodeOptions, ending: Ending) -> int:
    plan, robot = robot_of(_launched_plan(options), options)
    return _run_robots(plan, {robot: _own_namespace()}, options.for_plan(plan), ending)


def _host(options: NodeOptions, ending: Ending) -> int:
    plan, namespaces = _team(options)
    options = options.for_plan(plan)
    refuse_taken(list(namespaces.values()))
    return _run_robots(plan, namespaces, options, ending)


def _team(options: NodeOptions) -> Tuple[Plan, Dict[str, str]]:
    """The plan with the team at the start of the run, and the namespaces of its robots by name."""
    plan = _launched_plan(options)
    if options.robots:
        plan = plan.for_robots(options.robots)
    return plan, {
        robot.name: rospy.names.ns_join(_own_namespace(), "%s%d" % (options.prefix, number))
        for number, robot in enumerate(plan.robots, 1)
    }


def _fork(options: NodeOptions) -> int:
    plan, namespaces = _team(options)
    options = options.for_plan(plan)
    if options.check:
        check_plan(plan, lambda text: print("warning: " + text, file=sys.stderr))
    # import and compute everything that all members need once, before forking
    from gspn_framework_package.ros import execution_node, service_line  # noqa: F401
    from gspn_framework_package.ros.transport import master_watch  # noqa: F401

    plan.hash()
    share_log_configuration()
    share_source_lines()
    rosgraph.network.get_local_addresses()  # rosgraph keeps them
    members = []
    for robot, namespace in namespaces.items():
        run = partial(_run_robots, plan, {robot: namespace}, options, checked=True)
        members.append(_member("executor", namespace, run, partial(refuse_taken, [namespace])))
        if options.place_server_nodes:
            serve = partial(_serve_places, plan, robot, namespace)
            members.append(_member("place_servers", namespace, serve))
    return run_family(members, options.respawn)


MASTER_PERIOD = 2.0
"""Seconds between two checks whether the master is still the same process. In a team of more than
eight robots the period grows in proportion, since the team would otherwise call it constantly."""


def _member(
    name: str,
    namespace: str,
    body: Callable[[Ending], int],
    before: Callable[[], None] = lambda: None,
) -> FamilyMember:
    """A process that becomes a node; see :func:`run_node`."""

    def be_robot() -> int:
        be_node(name, namespace)
        return run_node(name, body, before)

    return FamilyMember(rospy.names.ns_join(namespace, name), be_robot)


def _own_namespace() -> str:
    return rospy.get_namespace().rstrip("/") or "/"


def _run_robots(
    plan: Plan,
    namespaces: Dict[str, str],
    options: NodeOptions,
    ending: Ending,
    checked: bool = False,
) -> int:
    """Execute a plan for some robots, each with its own replica, until the run is over for all of
    them.

    :param plan: the plan, with the team at the start of the run.
    :param namespaces: robot -> its absolute namespace.
    :param checked: whether the plan has already been checked.
    :returns: the largest of their exit codes.
    """
    from gspn_framework_package.ros.event_sources import event_clashes
    from gspn_framework_package.ros.execution_node import ExecutionNode
    from gspn_framework_package.ros.transport.master_watch import MasterWatch

    for note in plan.notes:
        rospy.loginfo("%s: %s", plan.name, note)
    if options.check and not checked:
        check_plan(plan, rospy.logwarn)
    for namespace in namespaces.values() if options.check else ():
        for transition, why in event_clashes(plan, namespace).items():
            raise ExecutionError(why, file=plan.file, element="event of '%s'" % transition)
    await_router(options.router.split(), rospy.logwarn, ending.wait)
    if ending.is_set():
        return 0
    nodes: List[ExecutionNode] = []
    try:
        with registered_together():
            nodes += [
                ExecutionNode(plan, robot, namespace, options)
                for robot, namespace in namespaces.items()
            ]
        for robot in namespaces:
            rospy.loginfo(
                "%s: plan %s, run %s, %d robots; log: %s",
                robot,
                plan.name,
                options.run,
                len(plan.robots),
                options.log_file(robot),
            )
        if options.check:
            targets = [target for node in nodes for target in node.actions.foreign_servers]
            await_servers(targets, options.server_timeout, ending)
            jobs = [job for node in nodes for job in node.actions.jobs.values()]
            await_jobs(jobs, options.server_timeout, ending)
        watch = MasterWatch(MASTER_PERIOD * max(1.0, len(plan.robots) / 8))
        watch.start()
        with registered_together():
            for node in nodes:
                node.actions.serve()
        running = [node.robot for node in nodes]

        def ended(robot: str) -> None:
            running.remove(robot)
            if not running:
                ending.set()

        for node in nodes:
            node.start(ended)
        ending.wait()
        watch.stop()
    finally:
        for node in nodes:
            node.stop()
        for node in nodes:
            node.join(5.0)
    return max(node.exit_code or 0 for node in nodes)


def _serve(options: NodeOptions, ending: Ending) -> int:
    plan, robot = robot_of(_launched_plan(options), options)
    return _serve_places(plan, robot, _own_namespace(), ending)


def _serve_places(plan: Plan, robot: str, namespace: str, ending: Ending) -> int:
    from gspn_framework_package.ros.place_servers import PlaceServers
    from gspn_framework_package.ros.transport.master_watch import MasterWatch

    servers = PlaceServers(plan, robot, namespace)
    servers.start()
    rospy.loginfo("%s: serves %s", robot, ", ".join(servers.names) or "nothing")
    watch = MasterWatch()
    watch.start()
    ending.wait()
    servers.stop()
    watch.stop()
    return 0

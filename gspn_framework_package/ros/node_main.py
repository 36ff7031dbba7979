"""What the node scripts start: one robot's execution node, or its place servers alone."""

from __future__ import annotations

import contextlib
import logging
import logging.handlers
import queue
import resource
import signal
import sys
import threading
import time
from typing import Any, Callable, Dict, Iterable, List, Optional, Tuple

import rospy
from rospy.impl.rosout import RosOutHandler

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import ExecutionError, GspnError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros.options import NodeOptions, read_options


def run_execution_node() -> int:
    """The execution node of a robot; returns the exit code of the process."""
    return _node("gspn_executor", _execute)


def run_hosted_robots() -> int:
    """A node that hosts the execution nodes of a whole simulated team, each in a namespace of its
    own; returns the exit code of the process."""
    return _node("gspn_hosted", _host)


def run_place_servers() -> int:
    """A node that only serves the places of a robot."""
    return _node("gspn_place_servers", _serve)


def robot_of(plan: Plan, options: NodeOptions) -> Tuple[Plan, str]:
    """The plan with the team that begins the run, and the robot that is meant.

    :raises UsageError: no robot was named, or one that the plan does not have.
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
            "the plan has no robot '%s'" % options.robot, element="~robot",
            hint="it has: %s; a robot that joins the running team needs ~place" % ", ".join(names),
        )  # fmt: skip
    return plan, options.robot


def raise_descriptor_limit(wanted: int = 65536) -> None:
    """Allow this process as many open files as it may have: each connected action takes twenty."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def check_plan(plan: Plan) -> None:
    """Refuse a plan that must not run, and tell its warnings. :raises ExecutionError: refused."""
    from gspn_framework_package.analysis.preflight import check
    from gspn_framework_package.analysis.preflight_report import Severity

    report = check(plan)
    for item in report.items:
        if item.severity is Severity.WARNING:
            rospy.logwarn("%s: %s: %s", plan.name, item.check, item.text)
    if report.refused:
        reasons = [i.text for i in report.items if i.severity is Severity.REFUSED]
        raise ExecutionError("the plan is refused: %s" % "; ".join(reasons), file=plan.file)


def await_servers(names: Iterable[str], seconds: float, ending: threading.Event) -> None:
    """Wait until the master knows every one of these action servers.

    :raises ExecutionError: one was not there in time.
    """
    missing = set(names)
    if not missing:
        return
    rospy.loginfo("waits for the action servers %s", ", ".join(sorted(missing)))
    deadline = time.monotonic() + seconds
    while not ending.is_set():
        published = {topic for topic, _ in rospy.get_published_topics()}
        missing = {name for name in missing if name + "/status" not in published}
        if not missing:
            return
        if time.monotonic() > deadline:
            raise ExecutionError(
                "no such action server: %s" % ", ".join(sorted(missing)),
                hint="waited %g s; ~server_timeout says for how long" % seconds,
            )
        ending.wait(0.2)


class _Lines(logging.handlers.QueueHandler):
    """Hands on lines of the log; drops what is too much, rather than wait."""

    def enqueue(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(queue.Full):
            self.queue.put_nowait(record)


def publish_log_lines_on_a_thread() -> None:
    """Publish on ``/rosout`` from a thread of its own. rospy asks the master for a parameter at every line, with no
    limit of time: a master that is out of reach (a partition, not a death) would hold whoever logs, for minutes."""
    logger = logging.getLogger("rosout")
    for handler in [h for h in logger.handlers if isinstance(h, RosOutHandler)]:
        lines: queue.Queue[logging.LogRecord] = queue.Queue(1000)
        logger.removeHandler(handler)
        logger.addHandler(_Lines(lines))
        logging.handlers.QueueListener(lines, handler).start()


def _node(name: str, body: Callable[[NodeOptions, threading.Event], int]) -> int:
    """Start a ROS node, and end it in order on SIGINT, SIGTERM and ``rosnode kill``."""
    raise_descriptor_limit()
    ending, ended = threading.Event(), threading.Event()
    signals: List[int] = []

    def on_signal(number: int, frame: Any) -> None:
        signals.append(number)
        ending.set()

    def on_shutdown() -> None:
        # rosnode kill: rospy closes its topics after this, so that a goal must be cancelled now
        ending.set()
        ended.wait(2.0)

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    try:
        rospy.init_node(name, disable_signals=True)
        publish_log_lines_on_a_thread()
        rospy.on_shutdown(on_shutdown)
        code = body(read_options(), ending)
    except GspnError as error:
        rospy.logfatal("%s", error)
        code = error.exit_code
    except rospy.ROSException as error:
        print("%s: %s" % (name, error), file=sys.stderr)
        code = 1
    ended.set()
    rospy.signal_shutdown("the end")
    return code if not signals or code else 128 + signals[0]


def _execute(options: NodeOptions, ending: threading.Event) -> int:
    plan, robot = robot_of(read_plan(options.plan), options)
    return _run_robots(plan, {robot: _own_namespace()}, options, ending)


def _host(options: NodeOptions, ending: threading.Event) -> int:
    plan = read_plan(options.plan)
    if options.robots:
        plan = plan.for_robots(options.robots)
    names = {
        robot.name: rospy.names.ns_join(_own_namespace(), "%s%d" % (options.prefix, number))
        for number, robot in enumerate(plan.robots, 1)
    }
    return _run_robots(plan, names, options, ending)


def _own_namespace() -> str:
    return rospy.get_namespace().rstrip("/") or "/"


def _run_robots(plan: Plan, namespaces: Dict[str, str], options: NodeOptions, ending: threading.Event) -> int:
    """Execute a plan for some robots, each with its own replica, until the run is over for all of them.

    :param namespaces: robot -> its absolute namespace.
    :returns: the largest of their exit codes.
    """
    from gspn_framework_package.ros.execution_node import ExecutionNode
    from gspn_framework_package.ros.master_watch import MasterWatch

    for note in plan.notes:
        rospy.loginfo("%s: %s", plan.name, note)
    if options.check:
        check_plan(plan)
    nodes = []
    try:
        for robot, namespace in namespaces.items():
            nodes.append(ExecutionNode(plan, robot, namespace, options))
            rospy.loginfo(
                "%s: plan %s, run %s, %d robots; log: %s",
                robot, plan.name, options.run, len(plan.robots), options.log_file(robot),
            )  # fmt: skip
        if options.check:
            servers = {server for node in nodes for server in node.foreign_servers}
            await_servers(servers, options.server_timeout, ending)
        watch = MasterWatch()
        watch.start()
        for node in nodes:
            node.start()
        while not ending.wait(0.1) and any(node.is_running() for node in nodes):
            pass
        watch.stop()
    finally:
        for node in nodes:
            node.stop()
        for node in nodes:
            node.join(5.0)
    return max(node.exit_code or 0 for node in nodes)


def _serve(options: NodeOptions, ending: threading.Event) -> int:
    from gspn_framework_package.ros.master_watch import MasterWatch
    from gspn_framework_package.ros.place_servers import PlaceServers

    plan, robot = robot_of(read_plan(options.plan), options)
    servers = PlaceServers(plan, robot, _own_namespace())
    servers.start()
    rospy.loginfo("%s: serves %s", robot, ", ".join(servers.names) or "nothing")
    watch = MasterWatch()
    watch.start()
    ending.wait()
    servers.stop()
    watch.stop()
    return 0


def exit_with(code: Optional[int]) -> None:
    """End the process at once: an action that never returns must not hold it."""
    import os

    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code or 0)

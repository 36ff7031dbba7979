"""A process that is a ROS node: waits for the master, shuts down in order, and reports an error in
one line."""

from __future__ import annotations

import contextlib
import logging
import logging.handlers
import os
import queue
import resource
import signal
import sys
import threading
from typing import Any, Callable, Optional

import rosgraph
import rospkg
import rospy
from rospy.impl import tcpros_base
from rospy.impl.paramserver import get_param_server_cache
from rospy.impl.rosout import RosOutHandler

from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.ros.transport.ending import Ending
from gspn_framework_package.ros.transport.registration import MASTER_ERRORS, master_proxy

ERRORS = (GspnError, rospy.ROSException, *MASTER_ERRORS)
"""What a node may end with, reported in one line."""

SHUTDOWN_TIME = 5.0
"""Seconds that the node has to unregister at its end; a master that does not answer is not waited
for any longer."""


def run_node(
    name: str, body: Callable[[Ending], int], before: Callable[[], None] = lambda: None
) -> int:
    """Start a ROS node, and end it in order on SIGINT, SIGTERM and ``rosnode kill``.

    :param name: of the node, if nothing else names it.
    :param body: the node's work; its argument says when the node should end. Its errors are
      reported in one line.
    :param before: called when there is a master, before the node takes its name from a node that
      has it.
    :returns: the exit code: that of ``body`` or of its error, or 128 + the signal.
    """
    raise_descriptor_limit()
    say_nothing_of_sockets_after_the_end()
    ending, ended = Ending(), threading.Event()
    ending.listen(signal.SIGINT, signal.SIGTERM)

    def on_shutdown() -> None:
        # rosnode kill: rospy closes its topics after this, so that a goal must be cancelled now
        ending.set()
        ended.wait(2.0)

    try:
        await_master(ending)
        if ending.is_set():
            return 128 + ending.signals[0]
        before()
        rospy.init_node(name, disable_signals=True)
        accept_many_connections()
        publish_log_lines_on_a_thread()
        rospy.on_shutdown(on_shutdown)
        code = body(ending)
    except ERRORS as error:
        code = tell_error(name, error)
    ended.set()
    rospy.signal_shutdown("the end")
    _await_shutdown()
    return code if not ending.signals or code else 128 + ending.signals[0]


def _await_shutdown() -> None:
    """Wait until another thread has shut the node down, if one does: after ``rosnode kill``, rospy
    unregisters the node on a thread that dies with the process, and the master would list the node
    indefinitely."""
    if rospy.core._shutdown_lock.acquire(timeout=SHUTDOWN_TIME):
        rospy.core._shutdown_lock.release()


def tell_error(name: str, error: BaseException) -> int:
    """Report one of :data:`ERRORS` in one line; returns its exit code.

    :param name: of the node or command.
    """
    if isinstance(error, GspnError):
        if rospy.core.is_initialized():
            rospy.logfatal("%s", error)
        else:
            print("%s: %s" % (name, error), file=sys.stderr)
        return error.exit_code
    if isinstance(error, rospy.ROSException):
        print("%s: %s" % (name, error), file=sys.stderr)
        return 1
    if isinstance(error, OSError) and error.filename is not None:
        print("%s: %s: %s" % (name, os.fsdecode(error.filename), error.strerror), file=sys.stderr)
        return 2
    print("%s: the ROS master went away (%s)" % (name, error), file=sys.stderr)
    return 1


def be_node(name: str, namespace: str) -> None:
    """Be another node than this process was started as, before it is initialised.

    :param name: the ``name`` that :func:`run_node` will get.
    :param namespace: absolute.
    """
    kept = [word for word in sys.argv if not word.startswith("_")]
    for word in sys.argv:
        if word.startswith("__log:="):  # a file for each
            folder = os.path.dirname(word[len("__log:=") :])
            file = "%s-%s.log" % (namespace.strip("/").replace("/", "-"), name)
            kept.append("__log:=" + os.path.join(folder, file))
    sys.argv = kept
    os.environ["ROS_NAMESPACE"] = namespace
    rospy.names.reload_mappings(sys.argv)
    rospy.names._set_caller_id(rospy.names.ns_join(namespace, "unnamed"))


def share_log_configuration() -> None:
    """Look up once, for all nodes that this process will fork, where rospy's logging is configured:
    to find it, each would search all packages."""
    if "ROS_PYTHON_LOG_CONFIG_FILE" not in os.environ:
        for folder in (
            os.path.join(rospkg.get_ros_home(), "config"),
            rospkg.get_etc_ros_dir(),
            os.path.join(rospkg.RosPack().get_path("rosgraph"), "conf"),
        ):
            for name in ("python_logging.conf", "python_logging.yaml"):
                file = os.path.join(folder, name)
                if os.path.isfile(file):
                    os.environ["ROS_PYTHON_LOG_CONFIG_FILE"] = file
                    return


def await_master(ending: Ending) -> None:
    """Wait until the ROS master answers, and say so; rospy itself fails without one."""
    told = False
    while not ending.is_set():
        try:
            master_proxy().getPid("/gspn")
            return
        except MASTER_ERRORS as error:
            if not told:
                print(
                    "waits for the ROS master at %s (%s)" % (rosgraph.get_master_uri(), error),
                    file=sys.stderr,
                )
            told = True
        ending.wait(0.5)


def raise_descriptor_limit(wanted: int = 65536) -> None:
    """Allow this process as many open files as it may have: each connected action takes twenty."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def say_nothing_of_sockets_after_the_end() -> None:
    """A node that ends closes its sockets under threads of rospy that are about to use them. The
    resulting tracebacks mean nothing, and would hide other messages."""
    tell = threading.excepthook

    def tell_unless_ended(args: Any) -> None:
        if not (rospy.is_shutdown() and issubclass(args.exc_type, OSError)):
            tell(args)

    threading.excepthook = tell_unless_ended


class _Lines(logging.handlers.QueueHandler):
    """Hands on lines of the log; drops excess lines rather than wait."""

    def enqueue(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(queue.Full):
            self.queue.put_nowait(record)


def publish_log_lines_on_a_thread() -> None:
    """Publish on ``/rosout`` from a separate thread. rospy asks the master for a parameter at every
    line, without a time limit: a master that is out of reach (a partition, not a death) would block
    the logging thread for minutes.

    The parameter is ``/rosout_disable_topics_generation``: whether a line goes without the names of
    all topics of the node. It is asked for once here, and taken for true where nobody has set it: a
    robot has five topics for each place.
    """
    parameter = "/rosout_disable_topics_generation"
    get_param_server_cache().set(parameter, rospy.get_param(parameter, True))
    logger = logging.getLogger("rosout")
    for handler in [h for h in logger.handlers if isinstance(h, RosOutHandler)]:
        lines: queue.Queue[logging.LogRecord] = queue.Queue(1000)
        logger.removeHandler(handler)
        logger.addHandler(_Lines(lines))
        logging.handlers.QueueListener(lines, handler).start()


def accept_many_connections() -> None:
    """Let a whole team connect to this node at once. rospy lets five connections wait; the sixth is
    dropped, and its robot tries again after a second, or three."""
    tcpros_base.start_tcpros_server()
    tcpros_base._tcpros_server.tcp_ros_server.server_sock.listen(1024)


def exit_with(code: Optional[int]) -> None:
    """End the process at once: an action that never returns must not hold it."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code or 0)

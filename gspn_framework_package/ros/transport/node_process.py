"""Runs a process as a ROS node: waits for the master, shuts down in order, and reports an error in
one line."""

from __future__ import annotations

# rospy imports some of these when a node starts; imported here, the nodes of a team share them
import configparser  # noqa: F401
import contextlib
import encodings.ascii  # noqa: F401
import linecache
import logging
import logging.handlers
import os
import pwd  # noqa: F401
import queue
import resource
import signal
import sys
import threading
import weakref
from typing import Any, Callable, MutableMapping, Optional, Tuple

import rosgraph
import rospkg
import rospy
from rospy.impl import tcpros_base, tcpros_pubsub
from rospy.impl.masterslave import ROSHandler
from rospy.impl.paramserver import get_param_server_cache
from rospy.impl.rosout import RosOutHandler

from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.ros.transport.ending import Ending
from gspn_framework_package.ros.transport.registration import MASTER_ERRORS, master_proxy

ERRORS = (GspnError, rospy.ROSException, *MASTER_ERRORS)
"""The exceptions that may end a node; they are reported in one line."""

SHUTDOWN_TIME = 5.0
"""Seconds that the node has to unregister at its end, even if the master does not answer."""


def run_node(
    name: str, body: Callable[[Ending], int], before: Callable[[], None] = lambda: None
) -> int:
    """Start a ROS node, and end it in order on SIGINT, SIGTERM and ``rosnode kill``.

    :param name: the default name of the node.
    :param body: the node's work; its argument signals when the node should end. Its :data:`ERRORS`
      are reported in one line.
    :param before: called once the master answers, before the node registers its name, which would
        end another node of that name.
    :returns: the exit code: that of ``body`` or of its error, or 128 + the signal.
    """
    raise_descriptor_limit()
    say_nothing_of_sockets_after_the_end()
    ending, ended = Ending(), threading.Event()
    ending.listen(signal.SIGINT, signal.SIGTERM)

    def on_shutdown() -> None:
        # rosnode kill: rospy closes its topics after this, so a goal must be cancelled now
        ending.set()
        ended.wait(2.0)

    try:
        await_master(ending)
        if ending.is_set():
            return 128 + ending.signals[0]
        before()
        connect_once()
        rospy.init_node(name, disable_signals=True)
        accept_many_connections()
        publish_log_lines_on_a_thread()
        rospy.on_shutdown(on_shutdown)
        code = body(ending)
    except ERRORS as error:
        code = report_error(name, error)
    ended.set()
    rospy.signal_shutdown("the end")
    _await_shutdown()
    return code if not ending.signals or code else 128 + ending.signals[0]


def _await_shutdown() -> None:
    """If another thread is shutting down the node, wait until it has finished. After ``rosnode
    kill``, rospy unregisters the node on a thread that dies with the process; without this wait,
    the master could list the node indefinitely."""
    if rospy.core._shutdown_lock.acquire(timeout=SHUTDOWN_TIME):
        rospy.core._shutdown_lock.release()


def report_error(name: str, error: BaseException) -> int:
    """Report one of :data:`ERRORS` in one line; returns its exit code.

    :param name: the name of the node or command.
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
    """Turn this process into a different node than it was started as; call this before the node is
    initialised.

    :param name: the ``name`` that will be passed to :func:`run_node`.
    :param namespace: the node's absolute namespace.
    """
    kept = [word for word in sys.argv if not word.startswith("_")]
    for word in sys.argv:
        if word.startswith("__log:="):  # each node has its own file
            folder = os.path.dirname(word[len("__log:=") :])
            file = "%s-%s.log" % (namespace.strip("/").replace("/", "-"), name)
            kept.append("__log:=" + os.path.join(folder, file))
    sys.argv = kept
    os.environ["ROS_NAMESPACE"] = namespace
    rospy.names.reload_mappings(sys.argv)
    rospy.names._set_caller_id(rospy.names.ns_join(namespace, "unnamed"))


def connect_once() -> None:
    """Let a node connect to a publisher of a topic once. When others start at the same time, the
    master announces a publisher several times in a moment; rospy then connects several times and
    drops all but the last connection, and the publisher logs a failed inbound connection."""
    connect: Callable[[ROSHandler, str, str], Any] = ROSHandler._connect_topic
    connecting: MutableMapping[Tuple[str, str], Any] = weakref.WeakValueDictionary()
    mutex = threading.Lock()

    def connect_after_others(handler: ROSHandler, topic: str, publisher: str) -> Any:
        with mutex:
            turn = connecting.setdefault((topic, publisher), threading.Lock())
        with turn:
            return connect(handler, topic, publisher)

    ROSHandler._connect_topic = connect_after_others


def share_log_configuration() -> None:
    """Find rospy's logging configuration once for all nodes that this process forks, so that
    they need not each search all packages for it."""
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


def share_source_lines() -> None:
    """Read the lines of source that appear in the traceback of a lost connection once for all nodes
    that this process forks. For its debug log, rospy formats one whenever a connection ends."""
    for module in (threading, tcpros_base, tcpros_pubsub):
        linecache.getlines(str(module.__file__))


def await_master(ending: Ending) -> None:
    """Wait until the ROS master answers, and print a line if it does not answer at once; rospy
    itself fails without a master."""
    reported = False
    while not ending.is_set():
        try:
            master_proxy().getPid("/gspn")
            return
        except MASTER_ERRORS as error:
            if not reported:
                print(
                    "waiting for the ROS master at %s (%s)" % (rosgraph.get_master_uri(), error),
                    file=sys.stderr,
                )
            reported = True
        ending.wait(0.5)


def raise_descriptor_limit() -> None:
    """Raise the limit of open files to 65536, or as far as allowed: each connected action
    takes twenty."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 65536 if hard == resource.RLIM_INFINITY else min(65536, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def say_nothing_of_sockets_after_the_end() -> None:
    """Suppress tracebacks of socket errors after the node has shut down. A node that ends closes
    sockets that threads of rospy are about to use; the resulting tracebacks mean nothing, and would
    hide other messages."""
    tell = threading.excepthook

    def report_unless_ended(args: Any) -> None:
        if not (rospy.is_shutdown() and issubclass(args.exc_type, OSError)):
            tell(args)

    threading.excepthook = report_unless_ended


class _Lines(logging.handlers.QueueHandler):
    """Passes log lines to another thread; drops lines instead of waiting when the queue is full."""

    def enqueue(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(queue.Full):
            self.queue.put_nowait(record)


def publish_log_lines_on_a_thread() -> None:
    """Publish on ``/rosout`` from a separate thread. rospy queries the master for a parameter at
    every line, without a time limit; an unreachable master (after a partition rather than a crash)
    would block the logging thread for minutes.

    The parameter is ``/rosout_disable_topics_generation``: whether lines omit the names of all
    topics of the node. It is queried once here and defaults to true, because a robot has five
    topics for each place.
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
    """Let a whole team connect to this node at once. rospy queues only five pending connections; it
    drops the sixth, and that robot retries after one to three seconds."""
    tcpros_base.start_tcpros_server()
    tcpros_base._tcpros_server.tcp_ros_server.server_sock.listen(1024)


def exit_with(code: Optional[int]) -> None:
    """End the process at once, even if an action never returns."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code or 0)

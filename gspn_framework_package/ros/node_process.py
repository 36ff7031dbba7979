"""A process that is a ROS node: waits for the master, ends in order, and says in one line what is wrong."""

from __future__ import annotations

import contextlib
import http.client
import logging
import logging.handlers
import os
import queue
import resource
import signal
import sys
import threading
import xmlrpc.client
from typing import Any, Callable, List, Optional

import rosgraph
import rospy
from rospy.impl.rosout import RosOutHandler

from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.ros.master_watch import master_proxy


def run_node(name: str, body: Callable[[threading.Event], int]) -> int:
    """Start a ROS node, and end it in order on SIGINT, SIGTERM and ``rosnode kill``.

    :param name: of the node, where nobody gives it another.
    :param body: what the node does; given an event that is set when the node shall end. Its errors
        are told in one line.
    :returns: the exit code: that of ``body`` or of its error, or 128 + the signal.
    """
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
        await_master(ending)
        if ending.is_set():
            return 128 + signals[0]
        rospy.init_node(name, disable_signals=True)
        publish_log_lines_on_a_thread()
        rospy.on_shutdown(on_shutdown)
        code = body(ending)
    except GspnError as error:
        rospy.logfatal("%s", error)
        code = error.exit_code
    except rospy.ROSException as error:
        print("%s: %s" % (name, error), file=sys.stderr)
        code = 1
    except (OSError, http.client.HTTPException, xmlrpc.client.Error) as error:
        if isinstance(error, OSError) and error.filename is not None:
            print("%s: %s: %s" % (name, os.fsdecode(error.filename), error.strerror), file=sys.stderr)
            code = 2
        else:
            print("%s: the ROS master went away (%s)" % (name, error), file=sys.stderr)
            code = 1
    ended.set()
    rospy.signal_shutdown("the end")
    return code if not signals or code else 128 + signals[0]


def await_master(ending: threading.Event) -> None:
    """Wait until the ROS master answers, and say so; rospy itself fails without one."""
    told = False
    while not ending.is_set():
        try:
            master_proxy().getPid("/gspn")
            return
        except (OSError, http.client.HTTPException, xmlrpc.client.Error) as error:
            if not told:
                print("waits for the ROS master at %s (%s)" % (rosgraph.get_master_uri(), error), file=sys.stderr)
            told = True
        ending.wait(0.5)


def raise_descriptor_limit(wanted: int = 65536) -> None:
    """Allow this process as many open files as it may have: each connected action takes twenty."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


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


def exit_with(code: Optional[int]) -> None:
    """End the process at once: an action that never returns must not hold it."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code or 0)

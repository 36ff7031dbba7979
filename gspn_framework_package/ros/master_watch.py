"""Notices that the ROS master was restarted, and registers this node there again."""

from __future__ import annotations

import http.client
import threading
import xmlrpc.client
from typing import Any, Optional

import rosgraph
import rospy
from rospy.impl import registration


class _Transport(xmlrpc.client.Transport):
    """A transport that gives up: without it a master that hangs would hold us for ever."""

    def __init__(self, timeout: float) -> None:
        super().__init__()
        self._timeout = timeout

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = self._timeout
        return connection


def master_proxy(timeout: float = 2.0) -> xmlrpc.client.ServerProxy:
    """The master's interface, each call with a time limit in seconds."""
    return xmlrpc.client.ServerProxy(rosgraph.get_master_uri(), _Transport(timeout))


class MasterWatch:
    """Asks the master for its process id every ``period`` seconds. A new one has forgotten every
    registration, and rospy does not register again by itself; topics and persistent service calls
    that are connected go on meanwhile.

    :ivar present: whether the master answered last time.
    """

    def __init__(self, period: float = 2.0) -> None:
        self.present = True
        self._period = period
        self._pid: Optional[int] = None
        self._stopping = threading.Event()

    def start(self) -> None:
        """Begin to watch, on a thread of its own."""
        threading.Thread(target=self._watch, name="master", daemon=True).start()

    def stop(self) -> None:
        """Watch no more."""
        self._stopping.set()

    def _watch(self) -> None:
        while not rospy.is_shutdown():
            self.look()
            if self._stopping.wait(self._period):
                return

    def look(self) -> None:
        """Ask the master once, and do what is needed."""
        try:
            answer: Any = master_proxy().getPid(rospy.get_name())
        except (OSError, http.client.HTTPException, xmlrpc.client.Error):
            if self.present:
                rospy.logwarn("the ROS master does not answer; what is connected goes on")
            self.present = False
            return
        pid = answer[2]
        try:
            if self._pid is not None and pid != self._pid:
                rospy.logwarn("the ROS master was restarted; registering again")
                register_again()
            elif not self.present:
                rospy.loginfo("the ROS master answers again")
        except (OSError, http.client.HTTPException, xmlrpc.client.Error) as error:
            rospy.logwarn("registering again failed (%s); will try once more", error)
            return
        self._pid = pid
        self.present = True


def register_again() -> None:
    """Register every publisher, subscriber and service of this node, and connect to whoever
    publishes by now. :raises OSError: no master."""
    topics, services = registration.get_topic_manager(), registration.get_service_manager()
    caller, uri = rospy.get_name(), rospy.get_node_uri()
    calls = xmlrpc.client.MultiCall(master_proxy(10.0))
    subscribed = topics.get_subscriptions()
    for name, data_type in subscribed:
        calls.registerSubscriber(caller, name, data_type, uri)
    for name, data_type in topics.get_publications():
        calls.registerPublisher(caller, name, data_type, uri)
    for name, service_uri in services.get_services():
        calls.registerService(caller, name, service_uri, uri)
    results: Any = calls()
    answers = list(results)
    own = xmlrpc.client.ServerProxy(uri, _Transport(10.0))
    for (name, _), (code, _, publishers) in zip(subscribed, answers):
        if code == 1 and publishers:
            own.publisherUpdate("/master", name, publishers)

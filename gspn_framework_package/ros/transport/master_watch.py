"""Detects that the ROS master was restarted, and registers this node with it again."""

from __future__ import annotations

import threading
from typing import Any, Optional

import rospy
from rospy.impl import registration

from gspn_framework_package.ros.transport.registration import (
    MASTER_ERRORS,
    MasterEntry,
    master_proxy,
    register_with_master,
)


class MasterWatch:
    """Queries the master's process id every ``period`` seconds. A new master has no registrations,
    and rospy does not register again by itself. Connected topics and persistent service calls keep
    working in the meantime.

    :param period: seconds between two checks.
    :ivar present: whether the master answered the last time.
    """

    def __init__(self, period: float = 2.0) -> None:
        self.present = True
        self._period = period
        self._pid: Optional[int] = None
        self._stopping = threading.Event()

    def start(self) -> None:
        """Start watching, on a separate thread."""
        threading.Thread(target=self._watch, name="master", daemon=True).start()

    def stop(self) -> None:
        """Stop watching."""
        self._stopping.set()

    def _watch(self) -> None:
        while not rospy.is_shutdown():
            self.look()
            if self._stopping.wait(self._period):
                return

    def look(self) -> None:
        """Check the master once, and register again if it was restarted."""
        try:
            answer: Any = master_proxy().getPid(rospy.get_name())
        except MASTER_ERRORS:
            if self.present:
                rospy.logwarn("the ROS master does not answer; existing connections keep working")
            self.present = False
            return
        pid = answer[2]
        try:
            if self._pid is not None and pid != self._pid:
                rospy.logwarn("the ROS master was restarted; registering again")
                register_again()
            elif not self.present:
                rospy.loginfo("the ROS master answers again")
        except MASTER_ERRORS as error:
            rospy.logwarn("registering again failed (%s); will retry", error)
            return
        self._pid = pid
        self.present = True


def register_again() -> None:
    """Register every publisher, subscriber and service of this node, and connect to all current
    publishers. :raises OSError: or another of ``MASTER_ERRORS``, the master does not answer."""
    topics, services = registration.get_topic_manager(), registration.get_service_manager()
    kinds = registration.Registration
    entries = [
        MasterEntry(kinds.PUB, name, data_type) for name, data_type in topics.get_publications()
    ]
    entries += [
        MasterEntry(kinds.SRV, name, service_uri) for name, service_uri in services.get_services()
    ]
    entries += [
        MasterEntry(kinds.SUB, name, data_type) for name, data_type in topics.get_subscriptions()
    ]
    register_with_master(entries)

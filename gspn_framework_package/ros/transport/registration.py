"""Registers topics and services with the ROS master together, instead of with one call for each.

rospy calls the master once for every publisher, subscriber and service. A robot with a thousand
action servers has five thousand of them; one by one, they took over a minute.
"""

from __future__ import annotations

import contextlib
import http.client
import logging
import time
import xmlrpc.client
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence

import rosgraph
import rospy
from rospy.impl.registration import (
    Registration,
    RegistrationListener,
    RegManager,
    get_registration_listeners,
)

from gspn_framework_package.model.errors import ExecutionError

CALLS = 500
"""Maximum number of registrations in one request, so that the master can serve others between two
requests."""

RETRY_AFTER = 0.2
"""Seconds until a master that did not answer is called again (as in rospy)."""

MASTER_ERRORS = (OSError, http.client.HTTPException, xmlrpc.client.Error)
"""The exceptions that a call of :func:`master_proxy` may raise: there is no master, it does not
answer in time, or its answer is invalid."""


class MasterEntry(NamedTuple):
    """A topic or service to register: ``kind`` is a value of rospy's ``Registration``; ``detail``
    is the type of a topic or the address of a service."""

    kind: str
    name: str
    detail: str


class _Transport(xmlrpc.client.Transport):
    """A transport with a timeout; without it, a hanging master would block us indefinitely."""

    def __init__(self, timeout: float) -> None:
        super().__init__()
        self._timeout = timeout

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = self._timeout
        return connection


def master_proxy(timeout: float = 2.0) -> xmlrpc.client.ServerProxy:
    """The master's interface; each call has a time limit of ``timeout`` seconds."""
    return xmlrpc.client.ServerProxy(rosgraph.get_master_uri(), _Transport(timeout))


def require_master(timeout: float = 2.0) -> None:
    """Check that there is a ROS master. :raises ExecutionError: none answers in time."""
    try:
        master_proxy(timeout).getPid("/gspn")
    except MASTER_ERRORS as error:
        raise ExecutionError(
            "no ROS master answers at %s (%s)" % (rosgraph.get_master_uri(), error),
            hint="start roscore, or set ROS_MASTER_URI to where one runs",
        ) from None


# -- questions to the master, which raise one of MASTER_ERRORS if it does not answer in time


def published_topics(timeout: float = 2.0) -> Dict[str, str]:
    """Topic -> type, for published topics; rospy's own function has no time limit."""
    master: Any = master_proxy(timeout)
    _, _, topics = master.getPublishedTopics(rospy.get_name(), "")
    return dict(topics)


def topic_types(timeout: float = 2.0) -> Dict[str, str]:
    """Topic -> type, for topics with a publisher or subscriber. (The master also remembers the
    types of others.)"""
    master: Any = master_proxy(timeout)
    _, _, types = master.getTopicTypes(rospy.get_name())
    _, _, (published, subscribed, _) = master.getSystemState(rospy.get_name())
    live = {topic for topic, _ in (*published, *subscribed)}
    return {topic: kind for topic, kind in types if topic in live}


def service_names(timeout: float = 2.0) -> List[str]:
    """The names of all services."""
    master: Any = master_proxy(timeout)
    _, _, (_, _, services) = master.getSystemState(rospy.get_name())
    return sorted(name for name, _ in services)


def subscribers(topic: str) -> List[str]:
    """The nodes that subscribe to a topic."""
    master: Any = master_proxy()
    _, _, (_, subscribed, _) = master.getSystemState(rospy.get_name())
    return [node for name, nodes in subscribed if name == topic for node in nodes]


def address_of(service: str, timeout: float = 2.0) -> Optional[str]:
    """The address of a service, ``rosrpc://host:port``; None if the master does not know it."""
    master: Any = master_proxy(timeout)
    code, _, uri = master.lookupService(rospy.get_name(), service)
    return uri if code == 1 else None


def found_parameter(name: str, default: Any, timeout: float = 2.0) -> Any:
    """The parameter with this name found by searching upwards from this node; ``default`` if there
    is none or no master answers."""
    try:
        return nearest_parameter(name, rospy.get_name(), default, timeout)
    except MASTER_ERRORS:
        return default


def nearest_parameter(name: str, node: str, default: Any, timeout: float = 2.0) -> Any:
    """The parameter with this name found by searching upwards from a node; ``default`` if there is
    none.

    :param node: absolute name of the node.
    """
    master: Any = master_proxy(timeout)
    code, _, key = master.searchParam(node, name)
    if code != 1:
        return default
    code, _, value = master.getParam(node, key)
    return value if code == 1 else default


@contextlib.contextmanager
def registered_together() -> Iterator[None]:
    """At the end of the ``with`` block, register all topics and services created inside it, with as
    few calls as possible. Like rospy's own registrations, this waits until the master answers."""
    listeners = get_registration_listeners()
    collected = _Collected()
    with listeners.lock:
        managers = _managers()
        if managers:
            listeners.listeners = [item for item in listeners.listeners if item not in managers] + [
                collected
            ]
    if not managers:  # there is no node yet, or an enclosing block registers for this one
        yield
        return
    try:
        yield
    finally:
        with listeners.lock:
            if collected in listeners.listeners:  # otherwise the node is shutting down
                listeners.listeners.remove(collected)
                listeners.listeners += managers
    _register_for_sure(collected.entries)


def _managers() -> List[Any]:
    """rospy's listener that calls the master, in a list; empty before the node is initialised."""
    return [item for item in get_registration_listeners().listeners if isinstance(item, RegManager)]


class _Collected(RegistrationListener):
    def __init__(self) -> None:
        self.entries: List[MasterEntry] = []

    def reg_added(self, resolved_name: str, data_type_or_uri: str, reg_type: str) -> None:
        self.entries.append(MasterEntry(reg_type, resolved_name, data_type_or_uri))

    def reg_removed(self, resolved_name: str, data_type_or_uri: str, reg_type: str) -> None:
        removed = (reg_type, resolved_name)
        self.entries = [entry for entry in self.entries if (entry.kind, entry.name) != removed]


def _register_for_sure(entries: Sequence[MasterEntry]) -> None:
    reported = False
    while not rospy.is_shutdown():
        try:
            register_with_master(entries)
            return
        except MASTER_ERRORS as error:
            if not reported:
                logging.getLogger("rospy.registration").error(
                    "the master does not register: %s", error
                )
            reported = True
            time.sleep(RETRY_AFTER)


def register_with_master(entries: Sequence[MasterEntry]) -> None:
    """Register entries with the master, and connect subscribers among them to their publishers.

    :param entries: what to register.
    :raises OSError: or another of :data:`MASTER_ERRORS`, the master does not answer for 30 s.
    """
    caller, uri = rospy.get_name(), rospy.get_node_uri()
    for begin in range(0, len(entries), CALLS):
        some = entries[begin : begin + CALLS]
        calls = xmlrpc.client.MultiCall(master_proxy(30.0))
        for entry in some:
            if entry.kind == Registration.PUB:
                calls.registerPublisher(caller, entry.name, entry.detail, uri)
            elif entry.kind == Registration.SUB:
                calls.registerSubscriber(caller, entry.name, entry.detail, uri)
            else:
                calls.registerService(caller, entry.name, entry.detail, uri)
        answers: Any = calls()
        for entry, (code, text, value) in zip(some, answers):
            if code != 1:
                rospy.logfatal("cannot register %s with the master: %s", entry.name, text)
            elif entry.kind == Registration.SUB and value:
                for manager in _managers():
                    manager.publisher_update(entry.name, value)

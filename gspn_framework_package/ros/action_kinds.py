"""The kinds of action other than action servers, as an execution node carries them out: service
calls, publishing a message, waiting for a message, and actions that need no ROS.

To add a kind: add its class in ``model.action`` (with its form in ``plan.schema.json``), and a
:class:`Job` in :data:`JOBS` here, or an entry in ``execution.local_kinds`` if it needs no ROS.
"""

from __future__ import annotations

import threading
import time
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional

import genpy
import rosgraph.names
import rospy

from gspn_framework_package.execution.local_kinds import LOCAL_KINDS
from gspn_framework_package.model.action import (
    Action,
    PublishAction,
    ServerAction,
    ServiceAction,
    WaitAction,
)
from gspn_framework_package.model.errors import ExpressionError, PlanError
from gspn_framework_package.model.message_condition import MessageCondition
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros.action_targets import check_kept, filled, kept, target
from gspn_framework_package.ros.message_fields import (
    UnknownTypeError,
    check_condition,
    check_fields,
    fill_message,
    message_class,
    service_class,
)
from gspn_framework_package.ros.transport.registration import (
    MASTER_ERRORS,
    published_topics,
    subscribers,
    topic_types,
)
from gspn_framework_package.ros.transport.service_call import (
    ServiceCall,
    ServiceFailed,
    service_type,
    service_uri,
)
from gspn_framework_package.team.jobs import CANCELLED, Job, JobAttempt, JobEnd, LocalJob

_LOOK_EVERY = 0.1
"""Seconds between two checks for a service or subscriber."""


class ServiceJob(Job):
    """Calls a service. A cancelled call is abandoned; the service does not learn of it."""

    def __init__(self, plan: Plan, place: str, action: ServiceAction, namespace: str) -> None:
        super().__init__(place, action)
        self._name = absolute(action.service, namespace)
        self._class = service_class(action.type)
        check_fields(self._class._request_class(), action.request, "request")
        check_kept(self._class._response_class, action.keep)

    def clash(self, types: Mapping[str, str]) -> Optional[str]:
        """See :meth:`Job.clash`."""
        found = service_type(self._name)
        if found is None or found.checksum == self._class._md5sum:
            return None
        if found.type == self.action.type:
            return "%s has another version of the type %s" % (self._name, found.type)
        return "%s is of type %s, not %s" % (self._name, found.type, self.action.type)

    def missing(self) -> Optional[str]:
        """See :meth:`Job.missing`."""
        return None if service_type(self._name) else "there is no service %s" % self._name

    def prepare(self, data: Mapping[str, Any]) -> genpy.Message:
        """See :meth:`Job.prepare`."""
        request = self._class._request_class()
        fill_message(request, filled(self.action.request, data, "request"), "request")
        return request

    def run(self, prepared: genpy.Message, attempt: JobAttempt) -> JobEnd:
        """See :meth:`Job.run`."""
        give_up = time.monotonic() + attempt.patience.server
        attempt.wait_for("waits for the service %s" % self._name)
        while True:
            call = ServiceCall(self._name, self._class)
            attempt.is_cancelled.on_cancel(call.close)
            try:
                uri = service_uri(self._name)
                if uri is not None:
                    call.connect(uri, attempt.patience.server)
                    break
            except ServiceFailed as error:
                return JobEnd(error.outcome, self.clash({}) or str(error))
            except OSError:
                pass  # the service may be about to start
            if time.monotonic() > give_up:
                text = "%s did not answer within %g s (~server_timeout)"
                return JobEnd(Outcome.NO_SERVER, text % (self._name, attempt.patience.server))
            if attempt.is_cancelled.wait(_LOOK_EVERY):
                return CANCELLED
        attempt.wait_for("")
        attempt.begin()
        try:
            response = call.ask(prepared)
        except ServiceFailed as error:
            return CANCELLED if attempt.is_cancelled() else JobEnd(error.outcome, str(error))
        finally:
            call.close()
        data = kept(response, self.action.keep)
        if getattr(response, "success", True) is False:
            text = getattr(response, "message", "")
            text = text if isinstance(text, str) and text else "%s reported no success" % self._name
            return JobEnd(Outcome.ABORTED, text, data=data)
        return JobEnd(Outcome.SUCCEEDED, data=data)


class PublishJob(Job):
    """Publishes a message. A node that has just started waits until the subscribers known to the
    master are connected, since they would miss the message."""

    def __init__(self, plan: Plan, place: str, action: PublishAction, namespace: str) -> None:
        super().__init__(place, action)
        self._topic = absolute(action.topic, namespace)
        self._class = message_class(action.type)
        check_fields(self._class(), action.message, "message")
        self._publisher: Optional[rospy.Publisher] = None
        self._opened_at = 0.0

    def open(self) -> None:
        """See :meth:`Job.open`."""
        self._opened_at = time.monotonic()
        self._publisher = rospy.Publisher(
            self._topic, self._class, queue_size=100, tcp_nodelay=True
        )

    def clash(self, types: Mapping[str, str]) -> Optional[str]:
        """See :meth:`Job.clash`."""
        return other_type(self._topic, self.action.type, types)

    def prepare(self, data: Mapping[str, Any]) -> genpy.Message:
        """See :meth:`Job.prepare`."""
        message = self._class()
        fill_message(message, filled(self.action.message, data, "message"), "message")
        return message

    def run(self, prepared: genpy.Message, attempt: JobAttempt) -> JobEnd:
        """See :meth:`Job.run`."""
        assert self._publisher is not None
        attempt.begin()
        give_up = self._opened_at + attempt.patience.acknowledgement
        while time.monotonic() < give_up:
            if self._publisher.get_num_connections() >= self._known_subscribers():
                break
            attempt.wait_for("waits for the subscribers of %s" % self._topic)
            if attempt.is_cancelled.wait(_LOOK_EVERY):
                return CANCELLED
        self._publisher.publish(prepared)
        return JobEnd(Outcome.SUCCEEDED)

    def _known_subscribers(self) -> int:
        try:
            return len(subscribers(rospy.resolve_name(self._topic)))
        except MASTER_ERRORS:
            return 0


class WaitJob(Job):
    """Waits for a message. The node subscribes to the topic at its start, so that a wait begins at
    once; messages that arrive at other times are read only if they are latched."""

    def __init__(self, plan: Plan, place: str, action: WaitAction, namespace: str) -> None:
        super().__init__(place, action)
        self._topic = absolute(action.topic, namespace)
        self._class = message_class(action.type)
        self._condition = MessageCondition(action.when) if action.when else None
        if self._condition is not None:
            try:
                check_condition(self._class, self._condition)
            except ExpressionError as error:
                raise PlanError("when: %s" % error.message, hint=error.hint) from None
        check_kept(self._class, action.keep)
        self._lock = threading.Lock()
        self._take: Optional[Callable[[genpy.Message], None]] = None
        self._latched: Optional[genpy.Message] = None
        self._subscriber: Optional[rospy.Subscriber] = None
        self._complained = False

    def open(self) -> None:
        """See :meth:`Job.open`."""
        self._subscriber = rospy.Subscriber(self._topic, self._class, self._heard, tcp_nodelay=True)

    def clash(self, types: Mapping[str, str]) -> Optional[str]:
        """See :meth:`Job.clash`."""
        return other_type(self._topic, self.action.type, types)

    def run(self, prepared: Any, attempt: JobAttempt) -> JobEnd:
        """See :meth:`Job.run`."""
        found: List[genpy.Message] = []
        over = threading.Event()
        attempt.is_cancelled.on_cancel(over.set)
        attempt.begin()

        def take(message: genpy.Message) -> None:
            if not found and self._holds(message):
                found.append(message)
                over.set()

        with self._lock:
            self._take = take
            if self._latched is not None and self._is_there(self._latched):
                take(self._latched)
        attempt.wait_for("waits for a message on %s%s" % (self._topic, self._what()))
        try:
            over.wait()
        finally:
            with self._lock:
                if self._take is take:  # no later attempt has started
                    self._take = None
        return (
            JobEnd(Outcome.SUCCEEDED, data=kept(found[0], self.action.keep)) if found else CANCELLED
        )

    def _what(self) -> str:
        return " with %s" % self.action.when if self.action.when else ""

    def _heard(self, message: genpy.Message) -> None:
        with self._lock:
            if message._connection_header.get("latching") == "1":
                self._latched = message
            if self._take is not None:
                self._take(message)

    def _holds(self, message: genpy.Message) -> bool:
        try:
            return self._condition is None or self._condition.holds(message)
        except ExpressionError as error:
            if not self._complained:
                self._complained = True
                rospy.logwarn("%s: a message on %s: %s", self.place, self._topic, error.message)
            return False

    def _is_there(self, message: genpy.Message) -> bool:
        """Whether the node that latched the message still offers it."""
        assert self._subscriber is not None
        caller = message._connection_header.get("callerid", "")
        return any(c.callerid_pub == caller for c in self._subscriber.impl.connections)


JOBS: Dict[type, Callable[[Plan, str, Any, str], Job]] = {
    ServiceAction: ServiceJob,
    PublishAction: PublishJob,
    WaitAction: WaitJob,
}
"""Kind of action -> its job; kinds that need no ROS are in ``LOCAL_KINDS``."""


def job(plan: Plan, place: str, action: Action, namespace: str) -> Optional[Job]:
    """The job of a robot in a place; None if its action is an action server, or none.

    :raises PlanError: see :class:`Job`.
    """
    kind = JOBS.get(type(action))
    try:
        if type(action) in LOCAL_KINDS:
            return LocalJob(plan, place, action, LOCAL_KINDS[type(action)](plan, action))
        return None if kind is None else kind(plan, place, action, namespace)
    except PlanError as error:
        raise error.located(element="action of '%s'" % place) from None


def jobs(plan: Plan, robot: str, namespace: str) -> Dict[str, Job]:
    """The jobs of a robot by place. :raises PlanError: see :class:`Job`."""
    found = {}
    for place in plan.action_places:
        try:
            made = job(plan, place, plan.action(robot, place), namespace)
        except PlanError as error:
            raise error.located(file=plan.file) from None
        if made is not None:
            found[place] = made
    return found


def absolute(name: str, namespace: str) -> str:
    """Resolve a name in a plan to an absolute name. :raises PlanError: it is not legal in ROS."""
    found: str = rospy.names.ns_join(namespace, name)
    if not rosgraph.names.is_legal_name(found):
        raise PlanError("'%s' is not a legal name in ROS" % name)
    return found


def other_type(topic: str, wanted: str, types: Mapping[str, str]) -> Optional[str]:
    """What is wrong if a topic has another type; None if nothing is."""
    found = types.get(rospy.resolve_name(topic), wanted)
    if found in (wanted, "*"):
        return None
    return "%s has messages of type %s, not %s" % (topic, found, wanted)


class TypeFindings(NamedTuple):
    """Findings about the types of messages in a plan, by where they are."""

    misfits: Dict[str, str]
    """Topics, fields and conditions that do not fit their type, and types that are not those of the
    ROS graph."""
    unknown: Dict[str, str]
    """What was not checked because its type is unknown in this shell."""


def look_at_actions(plan: Plan) -> TypeFindings:
    """Check whether the actions of a plan, named "ROBOT in PLACE", fit their types. This needs
    neither a node nor a master; if there is a master, the types that it knows are compared too. A
    robot's namespace is taken to be its name."""
    found = TypeFindings({}, {})
    types: Optional[Mapping[str, str]] = None
    published: Optional[Mapping[str, str]] = None
    for robot in plan.robots:
        for place in plan.action_places:
            action = plan.action(robot.name, place)
            where = "%s in %s" % (robot.name, place)
            clash = None
            try:
                if isinstance(action, ServerAction):
                    goal = target(place, action, "/" + robot.name)
                    published = live_types(published_topics) if published is None else published
                    clash = goal.clash(published)
                made = job(plan, place, action, "/" + robot.name)
            except UnknownTypeError as error:
                found.unknown[where] = error.message
                continue
            except PlanError as error:
                found.misfits[where] = error.message
                continue
            if made is not None:
                types = live_types() if types is None else types
                clash = made.clash(types)
            if clash:
                found.misfits[where] = clash
    return found


def live_types(asked: Callable[[], Mapping[str, str]] = topic_types) -> Mapping[str, str]:
    """Topic -> type, from a function of ``transport.registration``; empty without a master."""
    try:
        return asked()
    except MASTER_ERRORS:
        return {}

"""Watches the topics and functions that produce a plan's events and tasks, for one robot.

Each callback of rospy evaluates the condition itself. Only changes reach the replica, so a flooding
topic costs the robot's node no more than reading its messages and handling its rising edges.
"""

from __future__ import annotations

import contextlib
import json
import threading
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

import genpy
import rosgraph.names
import rospy

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement.interface import EventObserved, TaskCame
from gspn_framework_package.model.errors import DataError, ExpressionError, GspnError, PlanError
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.message_condition import (
    MessageCondition,
    field_name,
    field_of,
    parse_field,
)
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros import message_fields
from gspn_framework_package.ros.action_kinds import TypeFindings, live_types, other_type
from gspn_framework_package.team.function_sources import Complaints, FunctionSources
from gspn_framework_package.team.sides import EventListener

CAUSE_LIMIT = 200
"""Maximum length of a field's value in the cause of an event, in characters of JSON."""


class ConditionSource:
    """An event that holds while a condition on the last message does.

    Messages may arrive on several threads. Changes that the worker has not processed yet are
    merged, so that a busy worker has only one pending call.
    """

    def __init__(self, transition: str, source: EventSource, host: EventListener) -> None:
        self._transition, self._host = transition, host
        self._condition = MessageCondition(source.when)
        self._complaints = Complaints(host, "event '%s' (%s)" % (transition, source.label))
        self._lock = threading.Lock()
        self._holds = False
        self._given = False  # the state that the replica knows
        # the cause of an occurrence that it does not know
        self._rise: Optional[Mapping[str, Any]] = None
        self._on_its_way = False

    def take(self, message: Any) -> None:
        """Process a message."""
        try:
            holds = self._condition.holds(message)
        except ExpressionError as error:
            # an undetermined condition changes nothing
            self._complaints.report(error.message)
            return
        with self._lock:
            if holds == self._holds:
                return
            self._holds = holds
            if holds:
                self._rise = cause_of(self._condition, message)
            if self._on_its_way:
                return
            self._on_its_way = True
        self._host.enqueue(self._hand_over)

    def _hand_over(self) -> None:
        with self._lock:
            self._on_its_way = False
            rise, self._rise = self._rise, None
            holds, given = self._holds, self._given
            self._given = holds
        if rise is not None:
            if given:
                self._host.give(EventObserved(self._transition, False))
            self._host.give(EventObserved(self._transition, True, rise))
        if not holds:
            self._host.give(EventObserved(self._transition, False))


class MomentSource:
    """An instantaneous event that occurs with each message."""

    def __init__(self, transition: str, source: EventSource, host: EventListener) -> None:
        self._transition, self._host = transition, host
        self._lock = threading.Lock()
        self._on_its_way = False

    def take(self, message: Any) -> None:
        """Process a message, which counts only if the event could interrupt the robot now."""
        if self._on_its_way or not self._host.watches(self._transition):
            return
        with self._lock:
            if self._on_its_way:
                return
            self._on_its_way = True
        self._host.enqueue(self._hand_over, _short_fields(message))

    def _hand_over(self, cause: Mapping[str, Any]) -> None:
        self._on_its_way = False
        self._host.give(EventObserved(self._transition, None, cause))


class TaskSource:
    """A source of tasks: each message is one."""

    def __init__(self, transition: str, source: EventSource, host: EventListener) -> None:
        self._transition, self._source, self._host = transition, source, host
        self._complaints = Complaints(host, "tasks of '%s' (%s)" % (transition, source.label))

    def take(self, message: Any) -> None:
        """Process a message."""
        try:
            task = task_of(self._transition, self._source, message)
        except GspnError as error:
            self._complaints.report("a message cannot be used as a task: %s" % error.message)
            return
        self._host.enqueue(self._host.give, TaskCame(task))


def cause_of(condition: MessageCondition, message: Any) -> Dict[str, Any]:
    """The fields that a condition reads, as the cause of an event in the log."""
    return {name: _short(value) for name, value in condition.read(message).items()}


def task_of(transition: str, source: EventSource, message: Any) -> log_entries.Submit:
    """The task in a message.

    Its data are the fields of the message, or the JSON object in the field ``json``. Its id is in
    the field ``id``, or in the one that the plan names; without either, it is composed of the
    topic, the publisher's name, and the sequence number and time stamp in the header.

    :raises GspnError: the message has no id, or its data are not JSON.
    """
    data: Any = message_fields.message_to_json(message)
    if source.json:
        text = field_of(message, parse_field(source.json))
        try:
            data = json.loads(text)
        except (TypeError, ValueError, RecursionError) as error:
            raise DataError("its field '%s' is not JSON: %s" % (source.json, error)) from None
        if not isinstance(data, dict):
            raise DataError("its field '%s' is not a JSON object" % source.json)
    task_id = _task_id(source, message, data)
    data.pop("id", None)
    return log_entries.make_submit(transition, task_id, data)


def _task_id(source: EventSource, message: Any, data: Mapping[str, Any]) -> Any:
    path = parse_field(source.id or "id")
    value = None
    for place in (data, message):
        try:
            value = field_of(place, path)
            break
        except ExpressionError:
            continue
    if value is None and not source.id:
        header = getattr(message, "header", None)
        if header is None:
            raise DataError("the message has no field 'id' and no header")
        known = getattr(message, "_connection_header", {})
        sender = "%s %s" % (known.get("topic", ""), known.get("callerid", ""))
        # a restarted publisher counts from 1 again
        return "%s:%d@%d.%09d" % (sender, header.seq, header.stamp.secs, header.stamp.nsecs)
    if value is None or value == "":
        raise DataError("its field '%s' is empty" % field_name(path))
    return value


def _short(value: Any) -> Any:
    """Shorten a value for a cause, which is for people: a long one is described."""
    if isinstance(value, float) and message_fields.message_to_json(value) is None:
        return str(value)
    plain = message_fields.message_to_json(value)
    text = json.dumps(plain)
    if len(text) <= CAUSE_LIMIT:
        return plain
    if not isinstance(value, (list, tuple, bytes)):
        return text[: CAUSE_LIMIT - 3] + "..."
    numbers = [v for v in value if isinstance(v, (int, float)) and v == v]
    if len(numbers) < len(value):
        return "%d elements" % len(value)
    return "%d elements, %g to %g" % (len(value), min(numbers), max(numbers))


def _short_fields(message: Any) -> Dict[str, Any]:
    """The first fields of a message, for the cause of an event without a condition."""
    return {name: _short(getattr(message, name)) for name in message.__slots__[:10]}


# -- checks of a plan's events -------------------------------------------


def watched_topics(plan: Plan) -> Dict[str, EventSource]:
    """The events and tasks of a plan that come from a topic: transition -> source."""
    return {t: source for t, source in plan.events.items() if source.topic}


def look_at_event(plan: Plan, transition: str) -> Tuple[type, str]:
    """The type of the messages of an event from a topic, and what is wrong with its fields and
    condition ("" for nothing). This needs neither a node nor a master.

    :raises PlanError: the type does not exist in this workspace.
    """
    source = plan.events[transition]
    try:
        message = message_fields.message_class(source.type)
    except PlanError as error:
        where = "event of '%s'" % transition
        raise PlanError(error.message, file=plan.file, element=where, hint=error.hint) from None
    if not rosgraph.names.is_legal_name(source.topic) or source.topic.startswith("~"):
        return message, "'%s' is not a legal name of a topic" % source.topic
    if transition in plan.submissions:
        return message, _why_no_task(source, message)
    if source.when:
        return message, _why_no_condition(MessageCondition(source.when), message)
    return message, ""


def _why_no_condition(condition: MessageCondition, message: type) -> str:
    try:
        message_fields.check_condition(message, condition)
    except ExpressionError as error:
        return "'when' (%s): %s" % (condition.text, error.message)
    return ""


def _why_no_task(source: EventSource, message: type) -> str:
    try:
        if source.json:
            if message_fields.check_field(message, parse_field(source.json)) != "string":
                return "'json': the field '%s' is not a string" % source.json
            return ""
        if not source.id:
            try:
                message_fields.check_field(message, ("id",))
            except ExpressionError:
                return _why_no_header(source, message)
        kind = message_fields.check_field(message, parse_field(source.id or "id"))
    except ExpressionError as error:
        return "%s: %s" % ("'json'" if source.json else "'id'", error.message)
    if kind != "string" and (kind.endswith("]") or "int" not in kind):
        return (
            "'id': the field '%s' cannot identify a task: it is neither a string nor a whole number"
            % (source.id or "id")
        )
    return ""


def _why_no_header(source: EventSource, message: type) -> str:
    try:
        message_fields.check_field(message, ("header", "seq"))
    except ExpressionError:
        return (
            "%s has no field 'id' and no header, so duplicate tasks are not recognised: name a "
            "field that identifies a task with 'id'" % source.type
        )
    return ""


def event_clashes(plan: Plan, namespace: str) -> Dict[str, str]:
    """Events whose topic has another type according to the master, if there is one: transition ->
    what is wrong.

    :param namespace: the absolute namespace of a robot.
    """
    watched = watched_topics(plan)
    types = live_types() if watched else {}
    clashes = {
        t: other_type(rospy.names.ns_join(namespace, source.topic), source.type, types)
        for t, source in watched.items()
    }
    return {t: why for t, why in clashes.items() if why}


def look_at_events(plan: Plan) -> TypeFindings:
    """Check whether the fields and conditions of a plan's events fit the types of their messages.
    This needs neither a node nor a master; if there is a master, the types that it knows are
    compared too. A robot's namespace is taken to be its name."""
    found = TypeFindings({}, {})
    types: Dict[str, str] = {}
    for transition, source in watched_topics(plan).items():
        try:
            _, why = look_at_event(plan, transition)
        except PlanError as error:
            found.unknown[transition] = error.message
            continue
        other = types.setdefault(source.topic, source.type)
        if not why and other != source.type:
            why = "the topic %s has messages of %s for another event" % (source.topic, other)
        if why:
            found.misfits[transition] = why
    for robot in plan.robots:
        for transition, why in event_clashes(plan, "/" + robot.name).items():
            found.misfits.setdefault(transition, why)
    return found


class EventSources:
    """Watches the topics and functions of a robot's events and of the tasks.

    :param namespace: absolute namespace of the robot, to which the topics are relative.
    :param witness: whether the node is a witness's, which takes only tasks.
    :param host: the robot's node.
    :raises PlanError: a topic, type, field or condition is invalid, or a function is missing.
    """

    def __init__(
        self, plan: Plan, robot: str, namespace: str, witness: bool, host: EventListener
    ) -> None:
        self._functions = FunctionSources(plan, robot, witness, host, topics=True)
        self._takers: Dict[str, Tuple[type, List[Callable[[Any], None]]]] = {}
        self._subscribers: List[rospy.Subscriber] = []
        for transition, source in watched_topics(plan).items():
            outside = transition in plan.submissions
            if witness and not outside:
                continue
            message, why = look_at_event(plan, transition)
            topic = rospy.names.ns_join(namespace, source.topic)
            known, takers = self._takers.setdefault(topic, (message, []))
            if not why and known is not message:
                why = ("the topic %s has messages of %s for another event") % (topic, known._type)  # type: ignore[attr-defined]
            if why:
                raise PlanError(why, file=plan.file, element="event of '%s'" % transition)
            kind: Any = TaskSource if outside else ConditionSource if source.when else MomentSource
            takers.append(kind(transition, source, host).take)

    def subscribe(self) -> None:
        """Subscribe to the topics."""
        for topic, (message, takers) in self._takers.items():
            self._subscribers.append(
                rospy.Subscriber(topic, message, _give_to(takers), tcp_nodelay=True)
            )

    def start(self) -> None:
        """Start the functions."""
        self._functions.start()

    def visit_began(self) -> None:
        """See :class:`EventSide`."""
        self._functions.visit_began()

    def close(self) -> None:
        """Unsubscribe, and stop the functions."""
        self._functions.close()
        for subscriber in self._subscribers:
            with contextlib.suppress(rospy.ROSException):  # rospy may already have closed it
                subscriber.unregister()
        self._subscribers = []


def _give_to(takers: List[Callable[[Any], None]]) -> Callable[[genpy.Message], None]:
    if len(takers) == 1:
        return takers[0]

    def give(message: genpy.Message) -> None:
        for take in takers:
            take(message)

    return give

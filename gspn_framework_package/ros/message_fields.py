"""Handles messages of any type: finds their classes, converts their fields to JSON values, and
fills them for plans."""

from __future__ import annotations

import glob
import io
import math
import os
import sys
from typing import Any, Callable, Dict, List, Mapping, Optional, Set, Tuple, Union

import genmsg.msgs
import genpy
import roslib.message
import rospy

from gspn_framework_package.model.data import is_reference
from gspn_framework_package.model.errors import ExpressionError, PlanError, closest
from gspn_framework_package.model.message_condition import MessageCondition, field_name

_Path = Tuple[Union[str, int], ...]

_TIMES = {"time": genpy.Time, "duration": genpy.Duration}

_MISFITS = (genpy.MessageException, genpy.SerializationError, TypeError, ValueError, AttributeError)


class UnknownTypeError(PlanError):
    """This workspace does not have the type."""


def message_class(name: str, kind: str = "message") -> type:
    """The class of a message type.

    :param kind: what error messages call it.
    :raises UnknownTypeError: this workspace does not have it.
    """
    return _class_of(kind, name, roslib.message.get_message_class)


def service_class(name: str) -> Any:
    """The class of a service type. :raises UnknownTypeError: this workspace does not have it."""
    return _class_of("service", name, roslib.message.get_service_class)


def _class_of(kind: str, name: str, find: Callable[[str], Optional[type]]) -> type:
    try:
        found = find(name)
    except Exception as error:  # importing a foreign package may raise anything
        raise UnknownTypeError("cannot load the %s type '%s': %s" % (kind, name, error)) from None
    if found is None:
        raise UnknownTypeError(
            "there is no %s type '%s'" % (kind, name),
            hint="write package/Name; is the package in this workspace?",
        )
    return found


def fill_message(message: genpy.Message, fields: Mapping[str, Any], what: str) -> None:
    """Set fields of a message. Empty time stamps stay empty ("the latest"); the word ``now`` for a
    stamp means the present time.

    :param message: a new message.
    :param fields: the fields with other values than their default, as nested maps and lists.
    :param what: what the message is in the plan, for the error: "goal", "request", "message".
    :raises PlanError: the fields do not fit the type of the message.
    """
    try:
        if fields:
            now = rospy.get_rostime() if rospy.core.is_initialized() else genpy.Time()
            genpy.message.fill_message_args(message, [dict(fields)], keys={"now": now})
        message.serialize(io.BytesIO())
    except _MISFITS as error:
        raise PlanError(
            "its %s does not fit %s: %s"
            % (what, message._type, _unknown(type(message), fields) or _misfit(message, error))
        ) from None


def _unknown(owner: Any, fields: Mapping[str, Any], path: str = "") -> str:
    """Describe the first field that the messages of a class do not have, in words; "" if there is
    none."""
    types = dict(zip(owner.__slots__, getattr(owner, "_slot_types", ())))
    for name, value in fields.items():
        if name not in types:
            meant = closest(name, types)
            hint = (
                "did you mean '%s%s'?" % (path, meant)
                if meant
                else "it has %s" % (", ".join(types) or "no fields")
            )
            return "there is no field '%s%s'; %s" % (path, name, hint)
        base, _, _ = genmsg.msgs.parse_type(types[name])
        if base in genmsg.msgs.PRIMITIVE_TYPES or base in ("time", "duration"):
            continue
        inner = roslib.message.get_message_class(_full_type(base))
        for part in value if isinstance(value, (list, tuple)) else [value]:
            found = inner and isinstance(part, Mapping) and _unknown(inner, part, path + name + ".")
            if found:
                return str(found)
    return ""


def _misfit(message: genpy.Message, error: Exception) -> str:
    """Describe what does not fit, by the name of the field if possible."""
    try:
        message._check_types()
    except genpy.SerializationError as named:
        return str(named)
    except _MISFITS:
        pass
    return str(error)


def check_fields(message: genpy.Message, fields: Mapping[str, Any], what: str) -> None:
    """Check whether fields of a plan fit a message, as far as that can be known before the run:
    references to data are assumed to fit.

    :param message: a new message; it is changed.
    :param fields: see :func:`fill_message`.
    :param what: see :func:`fill_message`.
    :raises PlanError: the fields do not fit.
    """
    if not is_reference(fields):
        fill_message(message, _without_references(type(message), fields), what)


def _without_references(owner: Any, fields: Mapping[str, Any]) -> Dict[str, Any]:
    """The fields with each reference replaced by a value that fits."""
    types = dict(zip(owner.__slots__, getattr(owner, "_slot_types", ())))
    return {
        name: _plain(types[name], value) if name in types else value
        for name, value in fields.items()
    }


def _plain(field_type: str, value: Any) -> Any:
    base, is_array, length = genmsg.msgs.parse_type(field_type)
    if is_reference(value):
        return [_default(base)] * (length or 0) if is_array else _default(base)
    if is_array and isinstance(value, (list, tuple)):
        return [_plain(base, part) for part in value]
    if isinstance(value, Mapping) and base not in genmsg.msgs.PRIMITIVE_TYPES:
        inner = roslib.message.get_message_class(_full_type(base))
        return value if inner is None else _without_references(inner, value)
    return value


def _default(base: str) -> Any:
    if base == "string":
        return ""
    return 0 if base in genmsg.msgs.PRIMITIVE_TYPES and base not in ("time", "duration") else {}


def check_field(owner: type, path: _Path) -> str:
    """Check whether messages of a class have a field, or a constant of that name.

    :param owner: the class.
    :param path: its steps, as in ``MessageCondition.fields``.
    :returns: the type of the field, e.g. ``string`` or ``geometry_msgs/Pose[]``; "" for a constant.
    :raises ExpressionError: the messages do not have the field.
    """
    name = owner._type  # type: ignore[attr-defined]
    there: Any = owner
    field_type, is_array = name, False
    for number, step in enumerate(path):
        if isinstance(step, int):
            known = is_array or field_type == "string"
            is_array = False
        else:
            types = dict(zip(getattr(there, "__slots__", ()), getattr(there, "_slot_types", ())))
            if field_type in ("time", "duration"):
                types = {"secs": "int32", "nsecs": "int32"}
            if number == len(path) - 1 and not is_array and _is_constant(there, step):
                return ""
            known = not is_array and step in types
            if known:
                field_type, is_array, _ = genmsg.msgs.parse_type(types[step])
        if not known:
            raise ExpressionError("%s has no field '%s'" % (name, field_name(path[: number + 1])))
        there = None
        if field_type not in genmsg.msgs.PRIMITIVE_TYPES:
            there = roslib.message.get_message_class(_full_type(field_type))
    return field_type + "[]" * is_array


def _is_constant(owner: Any, name: str) -> bool:
    """Whether a name is a constant of a message class."""
    return (
        name not in getattr(owner, "__slots__", (name,))
        and not name.startswith("_")
        and isinstance(getattr(owner, name, None), (bool, int, float, str))
    )


def check_condition(owner: type, condition: MessageCondition) -> None:
    """Check whether messages of a class have the fields that a condition reads, and whether it
    makes sense with their types.

    :raises ExpressionError: they lack one, or the condition compares what cannot be compared.
    """
    for path in condition.fields:
        check_field(owner, path)
    numbers = [step for path in condition.fields for step in path if isinstance(step, int)]
    try:
        condition.holds(_sample(owner, max(numbers, default=0) + 1))
    except ExpressionError as error:
        if isinstance(error.__context__, TypeError):  # everything else depends on the values
            raise


def _sample(owner: Any, elements: int) -> Any:
    """A sample message for evaluating a condition, in which each variable-length array has a given
    number of elements (arrays of messages have none)."""
    found = owner()
    for name, field_type in zip(owner.__slots__, owner._slot_types):
        base, is_array, length = genmsg.msgs.parse_type(field_type)
        kind = None
        if base not in genmsg.msgs.PRIMITIVE_TYPES:
            kind = roslib.message.get_message_class(_full_type(base))
        if is_array:
            default: Any = _default(base) if kind is None else _sample(kind, 0)
            if base in _TIMES:
                default = _TIMES[base]()
            setattr(found, name, [default] * (elements if length is None else length))
        elif kind is not None:
            setattr(found, name, _sample(kind, elements))
    return found


def _full_type(name: str) -> str:
    return "std_msgs/Header" if name == "Header" else name


def message_to_json(value: Any) -> Any:
    """A message, or the value of a field, as a JSON value: times as ``{"secs", "nsecs"}``, bytes as
    lists of numbers, non-finite floats as None. :func:`fill_message` is the inverse."""
    if isinstance(value, genpy.Message):
        return {name: message_to_json(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, genpy.TVal):
        return {"secs": value.secs, "nsecs": value.nsecs}
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): message_to_json(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [message_to_json(part) for part in value]
    return value


# -- for forms in the editor -----------------------------------------------------------------------


def action_fields(kind: str, name: str) -> Dict[str, Optional[List[Dict[str, Any]]]]:
    """The messages that an action of a plan sends and receives, for a form.

    :param kind: the key of the action: "server", "service", "publish" or "wait_for".
    :param name: its type.
    :returns: ``sent`` and ``received``: the fields, as in :func:`field_tree`; None if there is no
        message.
    :raises PlanError: the type does not exist here, or does not belong to an action.
    """
    sent: Any = None
    received: Any = None
    if kind == "server":
        action = message_class(name, "action")()
        if not hasattr(action, "action_goal"):
            raise PlanError(
                "'%s' is a message, not an action type" % name, hint="write package/NameAction"
            )
        sent, received = type(action.action_goal.goal), type(action.action_result.result)
    elif kind == "service":
        service = service_class(name)
        sent, received = service._request_class, service._response_class
    elif kind == "publish":
        sent = message_class(name)
    else:
        received = message_class(name)
    return {
        "sent": None if sent is None else field_tree(sent),
        "received": None if received is None else field_tree(received),
    }


def field_tree(owner: Any) -> List[Dict[str, Any]]:
    """The fields of a message class, recursively.

    :returns: for each field ``name``, ``type`` (without brackets), ``array`` (whether it is one),
        ``length`` (of a fixed-length array, otherwise None), and ``fields`` if it holds messages,
        otherwise ``default``.
    """
    tree = []
    for name, written in zip(owner.__slots__, owner._slot_types):
        base, is_array, length = genmsg.msgs.parse_type(written)
        field = {"name": name, "type": _full_type(base), "array": is_array, "length": length}
        if base in _TIMES:
            field["default"] = message_to_json(_TIMES[base]())
        elif base in genmsg.msgs.PRIMITIVE_TYPES:
            field["default"] = False if base == "bool" else _default(base)
        else:
            field["fields"] = field_tree(message_class(_full_type(base)))
        tree.append(field)
    return tree


def installed_types() -> Dict[str, List[str]]:
    """The types that this workspace has, by the kind of action that uses them, as in
    :func:`action_fields`. Imports nothing."""
    names: Dict[str, Set[str]] = {"msg": set(), "srv": set()}
    for folder, found in names.items():
        for entry in sys.path:
            for file in glob.iglob(os.path.join(glob.escape(entry), "*", folder, "_*.py")):
                package, _, module = file.split(os.sep)[-3:]
                if not module.startswith("__"):
                    found.add("%s/%s" % (package, module[1 : -len(".py")]))
    actions = {name for name in names["msg"] if name + "Goal" in names["msg"]}
    parts = {
        stem + part
        for name in actions
        for stem in (name, name[: -len("Action")])
        for part in ("Goal", "Result", "Feedback")
    }
    plain = sorted(names["msg"] - actions - parts)
    return {
        "server": sorted(actions),
        "service": sorted(names["srv"]),
        "publish": plain,
        "wait_for": plain,
    }

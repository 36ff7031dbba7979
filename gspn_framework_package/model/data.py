"""Data that flows between the actions of a plan: named JSON values.

A name has a scope: ``robot.NAME`` belongs to one robot, ``team.NAME`` to all (the last write in the
log counts), ``task.NAME`` to the task that the robot carries. A name without a scope is the
robot's. Data never enables a transition: tokens decide, data flows.
"""

from __future__ import annotations

import collections.abc
import json
import re
from typing import Any, Dict, Iterator, Mapping, Optional, Tuple

from gspn_framework_package.model.errors import DataError

SCOPES = ("robot", "team", "task")

VALUE_LIMIT = 64_000
"""Maximum length of a value, in characters of compact JSON."""

NAMES_LIMIT = 1_000
"""Maximum number of names of a robot, task or team."""

TOTAL_LIMIT = 256_000
"""Maximum length of the data of an action or task, in characters of compact JSON."""

_TEXT = json.JSONEncoder(allow_nan=False, separators=(",", ":")).encode

_NAME = re.compile(r"(?:(%s)\.)?([A-Za-z_][A-Za-z0-9_]{0,99})" % "|".join(SCOPES))


def split(name: str) -> Tuple[str, str]:
    """Return scope and name. :raises DataError: it is not a name of data."""
    found = _NAME.fullmatch(name) if isinstance(name, str) else None
    if found is None:
        raise DataError(
            "%.100r is not a name of data" % (name,),
            hint="use a name of letters, digits and _, with the prefix robot., team. or task.",
        )
    return found.group(1) or "robot", found.group(2)


def full_name(name: str) -> str:
    """Return the name with its scope. :raises DataError: it is not a name of data."""
    return "%s.%s" % split(name)


_KINDS: Dict[type, str] = {
    dict: "an object",
    list: "a list",
    str: "a text",
    bool: "true or false",
    int: "a number",
    float: "a number",
    type(None): "null",
}


def kind_of(value: Any) -> str:
    """Describe the type of a JSON value in words, with an article; for anything else, its class."""
    return _KINDS.get(type(value), "the Python type %s" % type(value).__name__)


def check_values(values: Any, limit: Optional[int] = TOTAL_LIMIT) -> Dict[str, Any]:
    """Return a copy of the data of an action or a task, as JSON stores it (a tuple becomes a list,
    a key of a map becomes text).

    :param values: name -> JSON value.
    :param limit: maximum total length, in characters of JSON; None for no limit.
    :raises DataError: a name is not one, or a value is not JSON or too long.
    """
    if not isinstance(values, collections.abc.Mapping):
        raise DataError("data is a JSON object, not %s" % kind_of(values))
    if len(values) > NAMES_LIMIT:
        raise DataError("%d names of data; at most %d are kept" % (len(values), NAMES_LIMIT))
    kept = {}
    total = 0
    for name, value in values.items():
        split(name)
        text, why = _as_text(value)
        if why:
            raise DataError("the value of '%s' %s" % (name, why))
        total += len(text)
        if limit is not None and total > limit:
            raise DataError("the data is longer than %d characters as JSON" % limit)
        kept[name] = value if type(value) is int else json.loads(text)
    return kept


def why_not_kept(value: Any) -> Optional[str]:
    """Return why a value cannot be stored as data; None if it can."""
    return _as_text(value)[1]


def _as_text(value: Any) -> Tuple[str, Optional[str]]:
    """The value as JSON, and why it cannot be stored (None if it can)."""
    try:
        # most values are counters and ids: integers need no round trip through JSON
        text = repr(value) if type(value) is int else _TEXT(value)
    except (TypeError, ValueError, RecursionError) as error:
        return "", "is not JSON: %.200s" % error
    if len(text) > VALUE_LIMIT:
        why = "is %d characters long as JSON; at most %d are kept" % (len(text), VALUE_LIMIT)
        return text, why
    return text, None


def is_reference(value: Any) -> bool:
    """Whether a part of a goal stands for data: ``{"from": "task.pose"}``."""
    return isinstance(value, Mapping) and set(value) == {"from"} and isinstance(value["from"], str)


def references(template: Any) -> Iterator[str]:
    """Yield the full names of data that a goal, request, message or command refers to.

    :raises DataError: a reference is not a name of data.
    """
    if is_reference(template):
        yield full_name(template["from"])
    elif isinstance(template, Mapping):
        for value in template.values():
            yield from references(value)
    elif isinstance(template, (list, tuple)):
        for value in template:
            yield from references(value)


def fill(template: Any, data: Mapping[str, Any]) -> Any:
    """Return a goal, request, message or command with its references replaced by values.

    :param template: nested maps and lists.
    :param data: full name -> value.
    :raises DataError: a name has no value.
    """
    if is_reference(template):
        name = full_name(template["from"])
        if name not in data:
            raise DataError("there is no data '%s'" % name)
        return data[name]
    if isinstance(template, Mapping):
        return {key: fill(value, data) for key, value in template.items()}
    if isinstance(template, (list, tuple)):
        return [fill(value, data) for value in template]
    return template

"""The fields of an operator's order: what a field holds, and how it is read and checked."""

from __future__ import annotations

import datetime
import enum
import time
from typing import TYPE_CHECKING, Any, Dict, NamedTuple, Optional, Tuple

from gspn_framework_package.model.errors import DataError, RefusedError

if TYPE_CHECKING:
    from gspn_framework_package.model.plan import Plan

LONGEST_NUMBER = 18
"""Maximum number of digits of a number in an argument."""


class FieldKind(enum.Enum):
    """The type of an order's field; the value is its name for the page."""

    ROBOT = "robot"
    PLACE = "place"
    TRANSITION = "transition"
    ENTRANCE = "entrance"
    """A transition through which tasks enter."""
    TEXT = "text"
    ID = "id"
    NUMBER = "number"
    NAMES = "names"
    OBJECT = "object"
    TIME = "time"
    """A time of day, in seconds since 1970."""
    SPAN = "span"
    """A duration, in whole seconds."""
    FLAG = "flag"
    """Yes or no; on a command line, its name means yes."""


_TYPES: Dict[FieldKind, Tuple[Tuple[type, ...], str]] = {
    FieldKind.ID: ((str, int), "text or a whole number"),
    FieldKind.NUMBER: ((int,), "a whole number"),
    FieldKind.TIME: ((int,), "a time"),
    FieldKind.SPAN: ((int,), "a number of seconds, or 10m"),
    FieldKind.FLAG: ((bool,), "true or false"),
    FieldKind.NAMES: ((list,), "a list of names"),
    FieldKind.OBJECT: ((dict,), "a JSON object"),
}
"""The types of a kind in Python, and in words; the other kinds are text."""


_UNITS = {"s": 1, "m": 60, "h": 3600, "d": 86400}


def span_of(text: str) -> Optional[int]:
    """The seconds in a text such as ``90s``, ``10m``, ``2h`` or ``1d``; None if the text is not a
    duration."""
    if text[:-1].isdecimal() and text[-1] in _UNITS and len(text) <= LONGEST_NUMBER:
        return int(text[:-1]) * _UNITS[text[-1]]
    return None


def seconds_of(text: str, now: Optional[float] = None) -> int:
    """The time of day in a text: ``+90s``, ``+10m``, ``+2h`` or ``+1d`` from now, ``17:30`` (the
    next one), or ``2026-11-27T17:30``; in local time.

    :param now: seconds since 1970; None for the present time.
    :returns: seconds since 1970.
    :raises DataError: it is not a time.
    """
    now = time.time() if now is None else now
    span = span_of(text[1:]) if text.startswith("+") else None
    if span is not None:
        return int(now) + span
    try:
        if len(text) <= len("00:00:00"):
            today = datetime.datetime.fromtimestamp(now)
            clock = datetime.time.fromisoformat(text)
            found = datetime.datetime.combine(today.date(), clock)
            if found <= today:
                found += datetime.timedelta(days=1)
        else:
            found = datetime.datetime.fromisoformat(text)
        return int(found.timestamp())
    except (ValueError, OverflowError, OSError):
        raise DataError(
            "'%.100s' is not a time" % text, hint="write +10m, 17:30 or 2026-11-27T17:30"
        ) from None


class OrderField(NamedTuple):
    """A field of an order.

    :ivar help: what it is, on the command line.
    :ivar default: its value if it is not given; a function is called with the source of the order.
    :ivar label: what it is, on the page.
    :ivar placeholder: what the page shows in its place while it is empty.
    """

    name: str
    kind: FieldKind
    help: str = ""
    required: bool = True
    default: Any = ""
    label: str = ""
    placeholder: str = ""

    def value(self, given: Any, source: str, plan: Optional[Plan]) -> Any:
        """The value of the field, checked; see :meth:`OrderKind.values`."""
        if self.kind is FieldKind.ID and isinstance(given, str):
            given = given.strip()
        if given is None or given == "":
            if self.required:
                raise DataError("'%s' is missing" % self.name)
            return self.default(source) if callable(self.default) else self.default
        if self.kind is FieldKind.TIME and isinstance(given, str):
            given = seconds_of(given)
        if self.kind is FieldKind.SPAN and isinstance(given, str):
            span = span_of(given)
            given = given if span is None else span
        types, words = _TYPES.get(self.kind, ((str,), "text"))
        fits = isinstance(given, types) and isinstance(given, bool) == (bool in types)
        if self.kind is FieldKind.NAMES and fits:
            fits = all(isinstance(name, str) for name in given)
        if not fits:
            raise DataError("'%s' is not %s but %.100r" % (self.name, words, given))
        if plan is not None:
            self._look_up(given, plan)
        return given

    def _look_up(self, name: Any, plan: Plan) -> None:
        """:raises GspnError: the plan has no such place or transition."""
        if self.kind is FieldKind.PLACE:
            plan.net.place_number(name)
        elif self.kind is FieldKind.TRANSITION:
            plan.net.transition_number(name)
        elif self.kind is FieldKind.ENTRANCE and name not in plan.submissions:
            raise RefusedError(
                "no tasks come in by '%s'" % name[:80],
                hint="possible: %s" % (", ".join(plan.submissions) or "nothing"),
            )

    def read(self, text: str) -> Any:
        """The value in an argument that holds only this field; not yet checked."""
        if self.kind is FieldKind.NAMES:
            from gspn_framework_package.execution.breakpoints import read_names

            return read_names(text)
        digits = text[1:] if text.startswith("-") else text
        if self.kind is FieldKind.NUMBER and digits.isdecimal() and len(digits) <= LONGEST_NUMBER:
            return int(text)
        if self.kind is FieldKind.FLAG and text == self.name:
            return True
        return text

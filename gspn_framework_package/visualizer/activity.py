"""What can go on in an open net: one activity at a time feeds its hub.

Each activity takes *commands* from the page. A command is a name and JSON fields; whatever is wrong
with it raises a :class:`~gspn_framework_package.model.errors.GspnError` that the page shows.
"""

from __future__ import annotations

from typing import Any, Callable, Dict, Mapping, Optional

from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.visualizer.hub import Hub

Fields = Mapping[str, Any]
Handler = Callable[[Fields], Dict[str, Any]]


class Activity:
    """Base of all activities.

    :cvar mode: what the page calls it.
    """

    mode = ""

    def __init__(self) -> None:
        self.commands: Dict[str, Handler] = {}

    @property
    def running(self) -> Optional[bool]:
        """Whether a plan is being executed; None: as the status of the board says."""
        return None

    def begin(self, hub: Hub) -> None:
        """Take over ``hub``, which starts a new epoch."""
        raise NotImplementedError

    def end(self) -> None:
        """Let go of the hub, and of everything else that is held. May be called twice."""

    def command(self, name: str, fields: Fields) -> Dict[str, Any]:
        """Do what the page asks. :raises UsageError: this activity has no such command."""
        handler = self.commands.get(name)
        if handler is None:
            raise UsageError(
                "'%s' cannot be done here" % name[:40],
                hint="possible: %s" % (", ".join(sorted(self.commands)) or "nothing"),
            )
        return handler(fields)


def whole_number(fields: Fields, key: str, default: int, low: int, high: int) -> int:
    """A whole number among the fields of a command. :raises UsageError: not one, or out of
    range."""
    value = fields.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise UsageError("'%s' is a whole number from %d to %d" % (key, low, high))
    return value


def text_field(fields: Fields, key: str, default: Optional[str] = None) -> str:
    """A text among the fields of a command.

    :param default: what stands for a field that is left out; None: it must be there.
    :raises UsageError: it is not there, or not a text.
    """
    value = fields.get(key, default)
    if not isinstance(value, str):
        raise UsageError("'%s' is missing" % key)
    return value

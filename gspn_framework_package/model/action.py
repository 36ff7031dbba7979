"""What a robot does in an action place: the kinds of action that a plan can name.

Each kind is one class here: its fields, and how it is read from a plan file and written to it. The
key that only this kind has (``function``, ``server``, ...) identifies it; ``plan.schema.json``
describes each. Actions are carried out at the edge: ``execution.actions`` for functions and
commands, the package ``ros`` for the others.
"""

from __future__ import annotations

import re
from typing import Any, Dict, Iterator, Mapping, NamedTuple, Optional, Union

from gspn_framework_package.model.data import full_name, references
from gspn_framework_package.model.errors import DataError, ExpressionError

EXEC_GSPN = "gspn_framework_package/ExecGSPNAction"
"""The action type of the thesis's action servers, and of those of this package."""


class FunctionAction(NamedTuple):
    """An action that is a Python function or class in the plan's folder, ``module.function``. In
    ROS, an ExecGSPN action server named ``server`` runs it. ``settings`` are passed by name to the
    function, or to the constructor of the class."""

    function: str
    server: str
    settings: Mapping[str, Any] = {}

    @property
    def label(self) -> str:
        """The name of the action for people."""
        return self.function

    @classmethod
    def from_json(cls, place: str, data: Mapping[str, Any]) -> FunctionAction:
        """The action in a JSON object that fits the schema."""
        server = data.get("server", server_name(place))
        return cls(data["function"], server, data.get("settings", {}))

    def to_json(self) -> Dict[str, Any]:
        """The action as a JSON object."""
        data: Dict[str, Any] = {"function": self.function, "server": self.server}
        return {**data, "settings": dict(self.settings)} if self.settings else data


class ServerAction(NamedTuple):
    """An existing action server, ``server``, of the action type ``type`` (package/NameAction).

    An ``ExecGSPNAction`` names its transition itself. For any other type, ``goal`` holds the goal's
    fields (nested maps, which may refer to data), and ``outcomes`` maps the outcomes that actionlib
    has (:class:`~gspn_framework_package.model.outcome.Outcome`) to transitions; "" lets the policy
    decide. An outcome that is not listed is a failure, except that an unlisted success lets the
    policy decide. ``keep`` maps names of data to fields of the result (``error.code``) that are
    written to them.
    """

    type: str
    server: str
    goal: Optional[Mapping[str, Any]] = None
    outcomes: Mapping[str, str] = {}
    keep: Mapping[str, str] = {}

    @property
    def label(self) -> str:
        """The name of the action for people."""
        return "%s (%s)" % (self.server, self.type)

    @classmethod
    def from_json(cls, place: str, data: Mapping[str, Any]) -> ServerAction:
        """The action in a JSON object that fits the schema."""
        return cls(
            data.get("type", EXEC_GSPN),
            data["server"],
            data.get("goal"),
            data.get("outcomes", {}),
            data.get("keep", {}),
        )

    def to_json(self) -> Dict[str, Any]:
        """The action as a JSON object."""
        data: Dict[str, Any] = {"type": self.type, "server": self.server}
        if self.goal is not None:
            data["goal"] = self.goal
        return _with(data, outcomes=self.outcomes, keep=self.keep)


class ServiceAction(NamedTuple):
    """A call of the ROS service ``service`` of the type ``type`` (package/Name), with the fields
    ``request``. The call succeeds when it returns; where the response has a boolean field
    ``success`` that is false, the outcome is ``aborted``. ``outcomes`` and ``keep`` are as in
    :class:`ServerAction`."""

    service: str
    type: str
    request: Mapping[str, Any] = {}
    outcomes: Mapping[str, str] = {}
    keep: Mapping[str, str] = {}

    @property
    def label(self) -> str:
        """The name of the action for people."""
        return "call %s (%s)" % (self.service, self.type)

    @classmethod
    def from_json(cls, place: str, data: Mapping[str, Any]) -> ServiceAction:
        """The action in a JSON object that fits the schema."""
        return cls(
            data["service"],
            data["type"],
            data.get("request", {}),
            data.get("outcomes", {}),
            data.get("keep", {}),
        )

    def to_json(self) -> Dict[str, Any]:
        """The action as a JSON object."""
        data = {"service": self.service, "type": self.type}
        return _with(data, request=self.request, outcomes=self.outcomes, keep=self.keep)


class PublishAction(NamedTuple):
    """Publish one message of the type ``type`` on ``topic``, with the fields ``message``; done as
    soon as it is sent."""

    topic: str
    type: str
    message: Mapping[str, Any] = {}

    @property
    def label(self) -> str:
        """The name of the action for people."""
        return "publish %s (%s)" % (self.topic, self.type)

    @classmethod
    def from_json(cls, place: str, data: Mapping[str, Any]) -> PublishAction:
        """The action in a JSON object that fits the schema."""
        return cls(data["publish"], data["type"], data.get("message", {}))

    def to_json(self) -> Dict[str, Any]:
        """The action as a JSON object."""
        return _with({"publish": self.topic, "type": self.type}, message=self.message)


class WaitAction(NamedTuple):
    """Wait for a message of the type ``type`` on ``topic`` for which the condition ``when`` holds
    ("": for the next message). Only messages that arrive after the action has begun count, and
    latched ones. ``keep`` is as in :class:`ServerAction`, for fields of the message."""

    topic: str
    type: str
    when: str = ""
    keep: Mapping[str, str] = {}

    @property
    def label(self) -> str:
        """The name of the action for people."""
        return "wait for %s (%s)" % (self.topic, self.type)

    @classmethod
    def from_json(cls, place: str, data: Mapping[str, Any]) -> WaitAction:
        """The action in a JSON object that fits the schema."""
        return cls(data["wait_for"], data["type"], data.get("when", ""), data.get("keep", {}))

    def to_json(self) -> Dict[str, Any]:
        """The action as a JSON object."""
        data = {"wait_for": self.topic, "type": self.type}
        return _with(data, when=self.when, keep=self.keep)


class CommandAction(NamedTuple):
    """A program on the robot's computer: ``command`` is a list of the program and its arguments,
    each of which may be a reference to data. It runs only where the operator allows commands. Exit
    code 0 is ``succeeded``, any other ``aborted``. ``keep`` writes the last line of the program's
    output, read as JSON, to that name of data."""

    command: Any
    outcomes: Mapping[str, str] = {}
    keep: str = ""

    @property
    def label(self) -> str:
        """The name of the action for people."""
        return "run %s" % (self.command[0],)

    @classmethod
    def from_json(cls, place: str, data: Mapping[str, Any]) -> CommandAction:
        """The action in a JSON object that fits the schema."""
        return cls(tuple(data["command"]), data.get("outcomes", {}), data.get("keep", ""))

    def to_json(self) -> Dict[str, Any]:
        """The action as a JSON object."""
        return _with({"command": list(self.command)}, outcomes=self.outcomes, keep=self.keep)


ActionKind = Union[
    FunctionAction, ServerAction, ServiceAction, PublishAction, WaitAction, CommandAction
]
Action = Optional[ActionKind]
"""The action of an action place; None means no action, so a robot there is done at once."""

ACTION_KINDS: Dict[str, Any] = {
    "function": FunctionAction,
    "server": ServerAction,
    "service": ServiceAction,
    "publish": PublishAction,
    "wait_for": WaitAction,
    "command": CommandAction,
}
"""The key in a plan file that only this kind has -> the kind. One that another package has added
has its JSON Schema as ``FORM``."""

ROS_KINDS = (ServerAction, ServiceAction, PublishAction, WaitAction)
"""The kinds that can only be carried out on ROS."""


def server_name(place: str) -> str:
    """Return the name of a place's action server: the name of the place, as far as ROS allows."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", place).strip("_")
    return name if name[:1].isalpha() else "place_" + name


def action_from_json(place: str, data: Any) -> Action:
    """Return the action of a place in a plan file that fits the schema."""
    if data is None:
        return None
    if isinstance(data, str):
        data = {"function": data}
    kind = next(kind for key, kind in ACTION_KINDS.items() if key in data)
    action: Action = kind.from_json(place, data)
    return action


def action_to_json(action: Action) -> Any:
    """Return the action as a JSON value."""
    return None if action is None else action.to_json()


def outcomes_of(action: Action) -> Mapping[str, str]:
    """Return the map from outcomes to transitions of an action, empty if its kind has none."""
    return getattr(action, "outcomes", {})


def why_not_valid(action: Action) -> Optional[str]:
    """What is wrong with an action considered by itself (names of data and fields, conditions);
    None if nothing is."""
    try:
        for name in (*read_by(action), *written_by(action)):
            full_name(name)
        keep = getattr(action, "keep", {})
        fields = list(keep.values()) if isinstance(keep, Mapping) else []
        when = getattr(action, "when", "")
        if fields or when:  # the actions of most plans have neither
            from gspn_framework_package.model.message_condition import (
                MessageCondition,
                parse_field,
            )

            for field in fields:
                parse_field(field)
            if when:
                MessageCondition(when)
    except (DataError, ExpressionError) as error:
        return str(error)
    return None


def written_by(action: Action) -> Iterator[str]:
    """Yield the names of data that an action is known to write; what a function or an action server
    of this package writes is unknown."""
    keep = getattr(action, "keep", {})
    yield from ([keep] if isinstance(keep, str) and keep else keep)


def read_by(action: Action) -> Iterator[str]:
    """Yield the names of data that the goal, request, message or command of an action refers to."""
    for key in ("goal", "request", "message", "command"):
        yield from references(getattr(action, key, None))


def _with(data: Dict[str, Any], **more: Any) -> Dict[str, Any]:
    """Add those of the further fields that are not empty to the object."""
    given = {k: dict(v) if isinstance(v, Mapping) else v for k, v in more.items() if v}
    return {**data, **given}

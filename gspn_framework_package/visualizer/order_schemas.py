"""The orders that ``POST /api/do`` takes, as JSON schemas.

Those to a run or a team are read from the table of orders
(:data:`~gspn_framework_package.team.orders.ORDERS`); the commands of the simulation and of an open
net are here.
"""

from __future__ import annotations

from typing import Dict, Mapping, NamedTuple

from gspn_framework_package.team.order_fields import FieldKind, OrderField
from gspn_framework_package.team.orders import ORDERS
from gspn_framework_package.visualizer.schemas import (
    COUNTS,
    FLAG,
    NAMES,
    NUMBER,
    OBJECT,
    TEXT,
    WHOLE,
    Schema,
    component,
    described_as,
    map_to,
    object_with,
)

_WHOLE_OR_TEXT: Schema = {"type": ["integer", "string"]}

_OF_KIND: Dict[FieldKind, Schema] = {
    FieldKind.ID: _WHOLE_OR_TEXT,
    FieldKind.NUMBER: {"type": "integer"},
    FieldKind.NAMES: NAMES,
    FieldKind.OBJECT: OBJECT,
    FieldKind.TIME: _WHOLE_OR_TEXT,
    FieldKind.SPAN: _WHOLE_OR_TEXT,
    FieldKind.FLAG: FLAG,
}
"""The schema of a field; of the other kinds, it is a text."""


class PageCommand(NamedTuple):
    """A command that is not in the table of orders: what it does, and its fields."""

    about: str
    fields: Mapping[str, Schema] = {}


_STEPS: Schema = {**WHOLE, "minimum": 1, "description": "how many (default: 1)"}

PAGE_COMMANDS: Dict[str, PageCommand] = {
    "step": PageCommand("simulation: fire transitions at random", {"steps?": _STEPS}),
    "back": PageCommand("simulation: undo firings", {"steps?": _STEPS}),
    "reset": PageCommand("simulation: return to the initial marking"),
    "clear": PageCommand("simulation: remove every token"),
    "move": PageCommand(
        "simulation: continue from another marking",
        {"marking": described_as(COUNTS, "the number of tokens in each place")},
    ),
    "probabilities": PageCommand(
        "simulation: choose transitions by other probabilities",
        {"probabilities": described_as(map_to(NUMBER), "transition -> its probability")},
    ),
    "layout": PageCommand("compute new positions for the nodes; changes nothing"),
    "start": PageCommand(
        "execute the plan on the server", {"confirmed": described_as(FLAG, "has to be true")}
    ),
    "simulate": PageCommand("return to the simulation after a run"),
}
"""The commands that are not in the table of orders."""

_FIRE_ANYWAY: Dict[str, Schema] = {
    "any_priority?": {
        **FLAG,
        "description": "in the simulation: even if transitions of higher priority are enabled",
    }
}


def _field(field: OrderField) -> Schema:
    schema = _OF_KIND.get(field.kind, TEXT)
    return described_as(schema, field.help or field.label or field.name)


def _order(command: str, about: str, fields: Mapping[str, Schema]) -> Schema:
    # an enum of one value, which is the default: clients need not give it, and a "const" would be
    # one that they have to
    name: Schema = {**TEXT, "enum": [command], "default": command}
    run: Schema = described_as(TEXT, "the run that is meant; refused if another one is shown")
    schema = object_with({"command": name, **fields, "run?": run})
    return described_as(schema, about)


def schema_name(command: str) -> str:
    """The name of the schema of a command, such as ``SetPlaceOrder``."""
    return "".join(word.capitalize() for word in command.split("_")) + "Order"


def order_schemas() -> Dict[str, Schema]:
    """The schemas of all commands: name of the schema -> the schema."""
    found = {
        command: _order(
            command,
            kind.help,
            {
                **{f.name if f.required else f.name + "?": _field(f) for f in kind.fields},
                **(_FIRE_ANYWAY if command == "fire" else {}),
            },
        )
        for command, kind in ORDERS.items()
        if kind.form is not None
    }
    found.update({name: _order(name, *command) for name, command in PAGE_COMMANDS.items()})
    return {schema_name(command): schema for command, schema in found.items()}


def any_order() -> Schema:
    """One of these, distinguished by ``command``."""
    known = {
        schema["properties"]["command"]["default"]: name for name, schema in order_schemas().items()
    }
    return {
        "oneOf": [component(name) for name in known.values()],
        "discriminator": {
            "propertyName": "command",
            "mapping": {command: component(name)["$ref"] for command, name in known.items()},
        },
    }

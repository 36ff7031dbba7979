"""The verbs for the orders of :data:`~gspn_framework_package.team.orders.ORDERS`."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from typing import Any, Dict, NamedTuple

from gspn_framework_package.cli.options import add_options
from gspn_framework_package.model.errors import DataError, InputError, UsageError
from gspn_framework_package.team.order_fields import FieldKind, OrderField
from gspn_framework_package.team.orders import ORDERS, SUBMITTED, OrderKind

OWN_MODULES = ("status", "tasks", "breakpoints", "trust")
"""The orders whose verb shows or asks more, in the module of that name."""


class OrderVerb(NamedTuple):
    """A verb that gives an order.

    :ivar command: the name of the order.
    :ivar order: its row of the table.
    """

    command: str
    order: OrderKind

    @property
    def help(self) -> str:
        """What the verb does, in one line."""
        return self.order.help

    @property
    def example(self) -> str:
        """The words of a command line."""
        return " ".join(filter(None, (verb_of(self.command), self.order.example)))

    def load(self) -> Any:
        """Return what declares the verb's arguments and runs it: a separate module, or this."""
        if self.command in OWN_MODULES:
            return importlib.import_module("." + self.command, __package__)
        return self

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments of the verb: a required field is an argument, any other an
        option."""
        from gspn_framework_package.cli.team_client import TEAM_OPTIONS

        for field in self.order.fields:
            is_object = field.kind is FieldKind.OBJECT
            metavar = "FILE|JSON" if is_object else field.name.upper()
            words: Dict[str, Any] = {"metavar": metavar, "help": field.help}
            if field.required:
                parser.add_argument(field.name, **words)
            elif field.kind is FieldKind.ROBOT:
                parser.add_argument(field.name, nargs="?", default="", **words)
            elif field.kind is FieldKind.FLAG:
                parser.add_argument("--" + field.name, action="store_true", help=field.help)
            else:
                default = "{}" if is_object else ""
                parser.add_argument("--" + field.name, default=default, **words)
        add_options(parser, TEAM_OPTIONS)
        parser.epilog = self.order.note or None

    def run(self, args: argparse.Namespace) -> int:
        """Give the order; return 0 if the team carried it out, otherwise 1."""
        from gspn_framework_package.cli.team_client import team_client

        given = {field.name: _given(field, args) for field in self.order.fields}
        values = self.order.checked(given, SUBMITTED)
        done, message = team_client(args).order(
            self.command, values.get("robot", ""), self.order.argument(values), args.run_name
        )
        made = {f.name: values[f.name] for f in self.order.fields if f.kind is FieldKind.ID}
        if args.json:
            print(json.dumps({"order": self.command, "done": done, "message": message, **made}))
        else:
            about = "".join("%s %s: " % (self.order.noun, name) for name in made.values())
            word = self.order.word
            print("%s: %s%s" % (word if done else "not " + word, about, message))
        return 0 if done else 1


def verb_of(command: str) -> str:
    """The verb for an order."""
    return command.replace("_", "-")


def order_verbs() -> Dict[str, OrderVerb]:
    """Verb -> order, for those that have a verb."""
    return {
        verb_of(command): OrderVerb(command, order)
        for command, order in ORDERS.items()
        if order.example is not None
    }


def _given(field: OrderField, args: argparse.Namespace) -> Any:
    text = getattr(args, field.name)
    if field.kind is FieldKind.NUMBER:
        return field.read(text)
    return read_data(text) if field.kind is FieldKind.OBJECT else text


def read_data(text: str) -> Dict[str, Any]:
    """Read a JSON object from an argument: the text itself, or the file that it names ("-" for
    standard input).

    :raises UsageError: it cannot be read.
    :raises DataError: the text is not a JSON object.
    """
    from gspn_framework_package.formats.json_file import TOO_DEEP, is_too_deep
    from gspn_framework_package.formats.source import read_text

    where = "--data"
    if text == "-":
        text = sys.stdin.read()
    elif not text.lstrip().startswith("{"):
        where = text
        try:
            text = read_text(text)
        except InputError as error:
            raise UsageError(
                error.message,
                file=where,
                hint="--data takes a JSON object, or a file that contains one",
            ) from None
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DataError("is not JSON: %s" % error, file=where) from None
    if is_too_deep(data):
        raise DataError(TOO_DEEP, file=where)
    if not isinstance(data, dict):
        raise DataError("is not a JSON object but %.100r" % (data,), file=where)
    return data

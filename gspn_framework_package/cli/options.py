"""Tables of the arguments of a verb: each with its help."""

from __future__ import annotations

import argparse
from typing import Any, Mapping, Sequence, Union

from gspn_framework_package.execution.plan_modules import names_of


class Argument:
    """An argument of a verb that has a value.

    :param names: ``"-o --output"``, or without a dash for a positional argument.
    :param kind: reads the value from a text.
    :param more: other settings of ``argparse.ArgumentParser.add_argument``.
    """

    def __init__(
        self, names: str, metavar: Any = None, kind: Any = None, default: Any = None, **more: Any
    ) -> None:
        self.names = names.split()
        settings = {"metavar": metavar, "type": kind, "default": default, **more}
        self.settings = {name: given for name, given in settings.items() if given is not None}


Arguments = Mapping[Union[str, Argument], str]
"""Argument -> its help. A text is the name of an option without a value."""


def value_name(argument: Union[str, Argument]) -> str:
    """The name under which a parser keeps the value of an argument."""
    if isinstance(argument, Argument):
        name = str(argument.settings.get("dest", argument.names[-1]))
    else:
        name = argument
    return name.lstrip("-").replace("-", "_")


def repeated(names: str, metavar: Any = None, kind: Any = None, **more: Any) -> Argument:
    """An option that may be repeated; its value is a list. Parameters as for :class:`Argument`."""
    return Argument(names, metavar, kind, [], action="append", **more)


def choice(names: str, choices: Sequence[str], default: Any = None) -> Argument:
    """An option whose value is one of a few texts."""
    return Argument(names, default=default, choices=choices)


def add_options(
    parser: Union[argparse.ArgumentParser, argparse._ArgumentGroup], arguments: Arguments
) -> None:
    """Declare arguments on a parser, or on a group of its arguments."""
    for argument, text in arguments.items():
        if isinstance(argument, str):
            parser.add_argument(argument, action="store_true", help=text)
        else:
            parser.add_argument(*argument.names, **argument.settings, help=text)


MODULES_OPTION: Arguments = {
    Argument("--modules", "M,...", names_of, ()): (
        "installed modules, packages or (with a '/') folders whose functions plans may name in "
        "addition to those in their own folders"
    ),
}
"""The option of the verbs that load or look up the functions of plans; the dispatcher allows the
named modules before the verb runs."""

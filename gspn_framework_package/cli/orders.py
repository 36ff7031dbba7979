"""The operator's orders to a running team: one row of :data:`ORDERS` per verb.

To add an order, add a row here and its command to
:mod:`~gspn_framework_package.execution.agreement.orders`."""

from __future__ import annotations

import argparse
import json
from typing import Dict, NamedTuple, Tuple


class OrderVerb(NamedTuple):
    """A verb that gives an order.

    :ivar command: the ``command`` of the Command service.
    :ivar help: what the verb does, in one line.
    :ivar robot: ``ROBOT`` if the verb takes a robot, ``[ROBOT]`` if the robot is optional.
    :ivar argument: the name and a description of the verb's argument; empty for none.
    """

    command: str
    help: str
    robot: str = ""
    argument: Tuple[str, str] = ("", "")

    @property
    def example(self) -> str:
        """The words of a command line."""
        verb = self.command.replace("_", "-")
        argument = {"set_place": " Door", "fire": " open_shop"}.get(self.command, "")
        return verb + (" robot_2" if self.robot else "") + argument

    def load(self) -> OrderVerb:
        """Return this object, which declares the verb's arguments and runs it."""
        return self

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments of the verb."""
        from gspn_framework_package.cli.team_client import add_team_options

        if self.robot:
            parser.add_argument(
                "robot",
                metavar="ROBOT",
                nargs="?" if self.robot.startswith("[") else None,
                default="",
                help="name of the robot" + ("; default: the team" if "[" in self.robot else ""),
            )
        metavar, meaning = self.argument
        if metavar:
            parser.add_argument("argument", metavar=metavar, help=meaning)
        add_team_options(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Give the order; return 0 if the team carried it out, else 1."""
        from gspn_framework_package.cli.team_client import team_client

        robot, argument = getattr(args, "robot", ""), getattr(args, "argument", "")
        done, message = team_client(args).order(self.command, robot or "", argument, args.run_name)
        if args.json:
            print(json.dumps({"order": self.command, "done": done, "message": message}))
        else:
            print("%s: %s" % ("done" if done else "not done", message))
        return 0 if done else 1


ORDERS: Dict[str, OrderVerb] = {
    "pause": OrderVerb(
        "pause", "stop all firing until resume, or the firings of one robot", "[ROBOT]"
    ),
    "resume": OrderVerb("resume", "end a pause of the team, or of one robot", "[ROBOT]"),
    "set-place": OrderVerb(
        "set_place",
        "put a robot into a place; its action there starts",
        "ROBOT",
        ("PLACE", "the place"),
    ),
    "retry": OrderVerb("retry", "try the failed action of a robot again", "ROBOT"),
    "fire": OrderVerb(
        "fire", "fire a transition of the environment", argument=("TRANSITION", "the transition")
    ),
    "evict": OrderVerb("evict", "remove a robot from the team as lost", "ROBOT"),
    "force-evict": OrderVerb(
        "force_evict",
        "the same without a quorum: you assert that the robot is switched off",
        "ROBOT",
    ),
    "leave": OrderVerb("leave", "make a robot leave the team, with its token", "ROBOT"),
    "stop": OrderVerb("stop", "end the run of a team"),
}
"""Verb -> order."""

"""The operator's orders to a running team: a module for each verb, and here what they share."""

from __future__ import annotations

import argparse
import json
import os
from typing import NamedTuple

from gspn_framework_package.model.errors import UsageError


class Order(NamedTuple):
    """A verb that gives an order: the ``command`` of the Command service; ``robot`` and
    ``argument`` say what words it takes ("" for none, "ROBOT" for one, "[ROBOT]" for one that may
    be left out)."""

    command: str
    robot: str = ""
    argument: str = ""
    help: str = ""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the words of the verb."""
        if self.robot:
            parser.add_argument(
                "robot",
                metavar="ROBOT",
                nargs="?" if self.robot.startswith("[") else None,
                default="",
                help="name of the robot" + ("; none: the team" if "[" in self.robot else ""),
            )
        if self.argument:
            parser.add_argument("argument", metavar=self.argument.strip("[]"), help=self.help)
        add_team_options(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Give the order; 0 when it was carried out, 1 when it was not."""
        require_ros()
        from gspn_framework_package.ros.operator_client import OperatorClient

        robot, argument = getattr(args, "robot", ""), getattr(args, "argument", "")
        done, message = OperatorClient().order(self.command, robot or "", argument, args.run_name)
        if args.json:
            print(json.dumps({"order": self.command, "done": done, "message": message}))
        else:
            print("%s: %s" % ("done" if done else "not done", message))
        return 0 if done else 1


def add_team_options(parser: argparse.ArgumentParser) -> None:
    """Declare what every verb that talks to a team takes."""
    parser.add_argument(
        "--run",
        dest="run_name",
        default="",
        metavar="NAME",
        help="the run, where there are several",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def require_ros() -> None:
    """:raises UsageError: there is no ROS in this shell."""
    try:
        import rospy  # noqa: F401

        import gspn_framework_package.srv  # noqa: F401
    except ImportError as error:
        raise UsageError(
            "this verb needs ROS (%s)" % error,
            hint="source the workspace's setup.bash; ROS_MASTER_URI is %s"
            % os.environ.get("ROS_MASTER_URI", "not set"),
        ) from None

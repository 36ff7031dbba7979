"""Connects the operators' verbs to a team, through ROS or a router."""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING

from gspn_framework_package.cli.options import Argument, Arguments, repeated
from gspn_framework_package.model.errors import UsageError

if TYPE_CHECKING:
    from gspn_framework_package.team.operator_client import OperatorClient
    from gspn_framework_package.team.zenoh_session import TeamAccess


def way_options(connect: str) -> Arguments:
    """The options for reaching a team without ROS.

    :param connect: the help of ``--connect``.
    """
    return {
        repeated("--connect", "ENDPOINT"): connect,
        Argument("--keys", "DIR", default=""): "your keys, from 'gspn keys'; with --connect",
    }


TEAM_OPTIONS: Arguments = {
    Argument("--run", "NAME", default="", dest="run_name"): "name of the run, if there are several",
    "--json": "print JSON",
    Argument("--team-key-file", "FILE", default=""): (
        "the key of a team on ROS, from 'gspn keys shared', to give it orders"
    ),
    **way_options("reach the robots through this router instead of ROS: tls/HOST:7447"),
}
"""The options of every verb that contacts a team."""


def team_client(args: argparse.Namespace) -> OperatorClient:
    """The client selected by the options of a verb.

    :raises GspnError: the team cannot be reached that way.
    """
    if args.keys and not args.connect:
        raise UsageError("--keys requires --connect")
    if args.team_key_file and args.connect:
        raise UsageError("--team-key-file cannot be used with --connect", hint="use --keys DIR")
    if args.connect:
        from gspn_framework_package.team.zenoh_operator import client_on_zenoh

        return client_on_zenoh(access_of(args))
    require_ros()
    from gspn_framework_package.ros.service_line import client_on_ros
    from gspn_framework_package.team.seal import read_team_key

    key = read_team_key(args.team_key_file) if args.team_key_file else None
    return client_on_ros(key)


def access_of(args: argparse.Namespace, robot: str = "") -> TeamAccess:
    """The endpoints and keys named by the options of a verb.

    :param robot: use the keys of this robot, which may also be in the folder of its team.
    :raises GspnError: the keys cannot be used.
    """
    from gspn_framework_package.team.keys import keys_of_robot, read_keys
    from gspn_framework_package.team.zenoh_session import TeamAccess

    keys = None
    if args.keys:
        keys = keys_of_robot(args.keys, robot) if robot else read_keys(args.keys)
    return TeamAccess(tuple(args.connect), tuple(getattr(args, "listen", ())), keys)


def require_ros(what: str = "this verb") -> None:
    """Check that ROS is available.

    :param what: what needs it.
    :raises UsageError: there is no ROS in this shell.
    """
    try:
        import rospy  # noqa: F401

        import gspn_framework_package.srv  # noqa: F401
    except ImportError as error:
        raise UsageError(
            "%s needs ROS (%s)" % (what, error),
            hint="source the workspace's setup.bash; ROS_MASTER_URI is %s"
            % os.environ.get("ROS_MASTER_URI", "not set"),
        ) from None

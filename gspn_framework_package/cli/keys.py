"""``gspn keys``: manages the certificates of a team, which keep others out."""

from __future__ import annotations

import argparse
import json
from typing import List, Sequence

from gspn_framework_package.cli.options import Argument, Arguments, add_options
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.team import keys

DAYS = 365
"""Default validity of certificates, in days."""

_ROLE_OPTIONS = {
    "robot": "robots, named as in the plan",
    "operator": "people or programs that give orders",
    "watcher": "people or programs that only watch",
    "router": "routers, each with its addresses: hub=10.0.0.1,hub.lan",
}

_FOLDER: Arguments = {Argument("folder", "DIR"): "the folder of the team's keys"}

_NEW_MEMBERS: Arguments = {
    **_FOLDER,
    **{
        Argument("--%ss" % role, "NAME[=HOST,...]", default=[], nargs="+"): who
        for role, who in _ROLE_OPTIONS.items()
    },
    Argument("--days", "N", int, DAYS): "validity of the certificates in days (default: %d)" % DAYS,
}

_JSON: Arguments = {"--json": "print JSON"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the subcommands of this verb with their arguments."""
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, about, command in (
        ("team", "create an authority, and keys for each member, in a new folder", _make),
        ("add", "create keys for further members, or new keys for revoked ones", _add),
    ):
        made = commands.add_parser(name, help=about, description=about)
        add_options(made, {**_NEW_MEMBERS, **_JSON})
        made.set_defaults(command=command)
    about = "remove a member from the allow-list; then copy the new team.json to each router"
    revoked = commands.add_parser("revoke", help=about, description=about)
    add_options(revoked, {**_FOLDER, Argument("name", "NAME"): "name of the member", **_JSON})
    revoked.set_defaults(command=_revoke)
    about = "create a key shared by all robots and operators of a team on ROS"
    shared = commands.add_parser("shared", help=about, description=about)
    add_options(shared, {Argument("file", "FILE"): "a new file; copy it to each robot"})
    shared.set_defaults(command=_share)
    about = "show the members of the team, and how long their certificates are valid"
    shown = commands.add_parser("show", help=about)
    add_options(
        shown, {Argument("folder", "DIR"): "the folder of the team or of one member", **_JSON}
    )
    shown.set_defaults(command=_show)
    parser.epilog = (
        "Copy only the folder DIR/NAME to each member; keep the folder "
        "DIR/%s yourself. Exit codes: 0 success, 2 failure." % keys.AUTHORITY
    )


def run(args: argparse.Namespace) -> int:
    """Run the subcommand; return 0."""
    return int(args.command(args))


def _make(args: argparse.Namespace) -> int:
    return _report(keys.make_team(args.folder, _named(args), args.days), args)


def _add(args: argparse.Namespace) -> int:
    return _report(keys.add_members(args.folder, _named(args), args.days), args)


def _revoke(args: argparse.Namespace) -> int:
    return _report(keys.revoke(args.folder, args.name), args)


def _share(args: argparse.Namespace) -> int:
    from gspn_framework_package.team.seal import make_team_key

    make_team_key(args.file)
    print("written: %s" % args.file)
    return 0


def _show(args: argparse.Namespace) -> int:
    return _report(keys.read_team(args.folder), args)


def _named(args: argparse.Namespace) -> List[keys.NewMember]:
    """The members named by the options."""
    members = []
    for role in keys.ROLES:
        for text in getattr(args, role + "s"):
            name, equals, hosts = text.partition("=")
            if role == "router" and not hosts:
                raise UsageError(
                    "router '%s' has no address" % name, hint="--routers %s=HOST" % name
                )
            members.append(keys.NewMember(name, role, tuple(hosts.split(",")) if equals else ()))
    return members


def _report(rows: Sequence[keys.KeyHolder], args: argparse.Namespace) -> int:
    if args.json:
        print(json.dumps({"members": [row._asdict() for row in rows]}))
        return 0
    width = max((len(row.name) for row in rows), default=4)
    for row in rows:
        until = "valid until %s" % row.expires[:10]
        if row.revoked:
            until = "revoked on %s" % row.revoked[:10]
        print("%-*s  %-8s  %s" % (width, row.name, row.role, until))
    return 0

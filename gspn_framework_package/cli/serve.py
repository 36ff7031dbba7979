"""``gspn serve``: serves the page for a folder of nets and plans, or for a team over Zenoh; without
ROS."""

from __future__ import annotations

import argparse
import os
import sys
from typing import Optional

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.interrupts import wait_for
from gspn_framework_package.cli.modules import add_modules
from gspn_framework_package.cli.team_client import access_of, add_way
from gspn_framework_package.model.errors import InputError, UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    parser.add_argument(
        "path",
        nargs="?",
        default=".",
        metavar="FOLDER|NET|PLAN",
        help="the folder to serve; only plans in this folder can be executed (default: .)",
    )
    parser.add_argument(
        "--record",
        metavar="FOLDER",
        help="folder for the event logs of executions (default: runs in the served folder)",
    )
    parser.add_argument(
        "--edit",
        action="store_true",
        help="let the operator edit the plans of the folder in the page, and create new ones",
    )
    parser.add_argument(
        "--history",
        metavar="DIR",
        help="a store of 'gspn history' to show in the page, with replays",
    )
    add_way(
        parser,
        "watch the team that runs PLAN through this router: tls/HOST:7447; with an operator's "
        "keys, or if the team has none, the page can also give orders",
    )
    parser.add_argument(
        "--run",
        dest="run_name",
        default="",
        metavar="NAME",
        help="with --connect: the run to show (default: the first one of this plan to be received)",
    )
    parser.add_argument(
        "--robots",
        type=numbers.robots,
        metavar="N",
        help="with --connect: number of robots to assume until one answers (default: as in "
        "the plan)",
    )
    add_modules(parser)
    add_address_arguments(parser)


def add_address_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of every verb that serves the page."""
    from gspn_framework_package.visualizer.guard import LOOPBACK_NAMES

    parser.add_argument(
        "--port",
        type=int,
        default=8090,
        help="port of the page; 0 for any free port (default: 8090)",
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address to listen on; for any other than the loopback addresses (%s), everybody "
        "needs a token, and both tokens are printed" % ", ".join(sorted(LOOPBACK_NAMES)),
    )
    parser.add_argument(
        "--allow-name",
        action="append",
        default=[],
        metavar="NAME",
        help="another name under which browsers may reach this machine",
    )
    parser.add_argument(
        "--token",
        help="the operator's token, at least 16 characters (default: if --host needs one, it is "
        "generated and printed)",
    )
    parser.add_argument(
        "--viewer-token",
        metavar="TOKEN",
        help="the read-only token (default: if --host needs one, it is generated and printed)",
    )
    parser.add_argument(
        "--token-file",
        metavar="FILE",
        help="a file with the operator's token on its first line and the viewers' on its second "
        "(other users of this machine can see a program's options)",
    )
    parser.add_argument(
        "--viewers", type=int, default=24, help="maximum number of live streams (default: 24)"
    )
    parser.add_argument("--open", action="store_true", help="open a browser too")


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted."""
    from gspn_framework_package.formats.plan_file import PLAN_FILE
    from gspn_framework_package.visualizer.documents import Folder
    from gspn_framework_package.visualizer.fleet_page import FleetPage
    from gspn_framework_package.visualizer.project import Project
    from gspn_framework_package.visualizer.standalone_run import RUNS, StandaloneRun

    if not os.path.exists(args.path):
        raise InputError("the file or folder does not exist", file=args.path)
    if args.connect:
        return _serve_team(args)
    if args.keys or args.run_name or args.robots is not None:
        raise UsageError("--keys, --run and --robots require --connect")
    whole = os.path.realpath(args.path)
    first: Optional[str] = None
    if not os.path.isdir(whole):
        whole, first = os.path.split(whole)
    elif os.path.isfile(os.path.join(whole, PLAN_FILE)):
        first = PLAN_FILE
    folder = Folder(whole)
    if first is not None and not folder.kind(first):
        raise InputError("neither a net, a plan nor a recorded run", file=args.path)
    runs = args.record or os.path.join(folder.root, RUNS)
    fleet = FleetPage(args.history) if args.history is not None else None
    project = Project(
        folder, lambda document: StandaloneRun(document, runs), first, runs, args.edit, fleet
    )
    if first is not None:
        project.open(first)  # report errors here, not in the browser
    return serve(project, args)


def _serve_team(args: argparse.Namespace) -> int:
    """Watch a team over Zenoh."""
    from gspn_framework_package.formats.plan_file import read_plan
    from gspn_framework_package.visualizer.project import project_of_team
    from gspn_framework_package.visualizer.team_watch import TeamWatch
    from gspn_framework_package.visualizer.zenoh_connection import ZenohConnection

    if args.edit or args.record or args.history:
        raise UsageError("--edit, --record and --history apply to a folder, not to --connect")
    plan = read_plan(args.path)
    if args.robots is not None:
        plan = plan.for_robots(args.robots)
    connection = ZenohConnection(access_of(args), args.run_name)
    watch = TeamWatch(plan, connection, args.run_name)
    try:
        return serve(project_of_team(args.path, plan, watch), args)
    finally:
        connection.close()


def serve(project: object, args: argparse.Namespace) -> int:
    """Serve ``project`` at the address of ``args`` until interrupted."""
    from gspn_framework_package.visualizer.guard import OPERATOR, VIEWER, read_tokens
    from gspn_framework_package.visualizer.project import Project
    from gspn_framework_package.visualizer.serving import WebServer

    assert isinstance(project, Project)
    if not 0 <= args.port <= 65535:
        raise UsageError("%d is not a port" % args.port)
    if not 1 <= args.viewers <= 200:
        raise UsageError("%d viewers: the number must be from 1 to 200" % args.viewers)
    token, viewer_token = args.token, args.viewer_token
    if args.token_file is not None:
        if token is not None or viewer_token is not None:
            raise UsageError("--token-file excludes --token and --viewer-token")
        token, viewer_token = read_tokens(args.token_file)
    server = WebServer(
        project, args.host, args.port, args.allow_name, token, args.viewers, viewer_token
    )
    invitations = server.invitations
    print("The page is at %s  (Ctrl-C ends it)" % invitations[OPERATOR])
    if VIEWER in invitations:
        print("Read-only access: %s" % invitations[VIEWER])
    sys.stdout.flush()
    if args.open:
        import webbrowser

        webbrowser.open(invitations[OPERATOR])
    try:
        server.start()
        wait_for(server.ended)
    except KeyboardInterrupt:
        pass
    finally:
        server.stop()
    return 0

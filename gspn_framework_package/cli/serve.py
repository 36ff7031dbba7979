"""``gspn serve``: serves the page for a folder of nets and plans, or for a team over Zenoh; without
ROS."""

from __future__ import annotations

import argparse
import os
import sys
from typing import Optional

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.interrupts import wait_for
from gspn_framework_package.cli.options import (
    MODULES_OPTION,
    Argument,
    Arguments,
    repeated,
)
from gspn_framework_package.cli.team_client import access_of, way_options
from gspn_framework_package.model.errors import InputError, UsageError
from gspn_framework_package.visualizer.guard import LOOPBACK_NAMES, OPERATOR, VIEWER, read_tokens

ADDRESS_OPTIONS: Arguments = {
    Argument("--port", kind=int, default=8090): (
        "port of the page; 0 for any free port (default: 8090)"
    ),
    Argument("--host", default="127.0.0.1"): (
        "address to listen on; for any other than the loopback addresses (%s), everybody needs a "
        "token, and both tokens are printed" % ", ".join(sorted(LOOPBACK_NAMES))
    ),
    repeated("--allow-name", "NAME"): "another name under which browsers may reach this machine",
    Argument("--token"): (
        "the operator's token, at least 16 characters (default: if --host needs one, it is "
        "generated and printed)"
    ),
    Argument("--viewer-token", "TOKEN"): (
        "the read-only token (default: if --host needs one, it is generated and printed)"
    ),
    Argument("--token-file", "FILE"): (
        "a file with the operator's token on its first line and the viewers' on its second (other "
        "users of this machine can see a program's options)"
    ),
    Argument("--viewers", kind=int, default=24): "maximum number of live streams (default: 24)",
    "--open": "open a browser too",
}
"""The options of every verb that serves the page."""

OPTIONS: Arguments = {
    Argument("path", "FOLDER|NET|PLAN", default=".", nargs="?"): (
        "the folder to serve; only plans in this folder can be executed (default: .)"
    ),
    Argument("--record", "FOLDER"): (
        "folder for the event logs of executions (default: runs in the served folder)"
    ),
    "--edit": "let the operator edit the plans of the folder in the page, and create new ones",
    Argument("--history", "DIR"): "a store of 'gspn history' to show in the page, with replays",
    **way_options(
        "watch the team that runs PLAN through this router: tls/HOST:7447; with an operator's "
        "keys, or if the team has none, the page can also give orders"
    ),
    Argument("--run", "NAME", default="", dest="run_name"): (
        "with --connect: the run to show (default: the first one of this plan to be received)"
    ),
    Argument("--robots", "N", numbers.robots): (
        "with --connect: number of robots to assume until one answers (default: as in the plan)"
    ),
    **MODULES_OPTION,
    **ADDRESS_OPTIONS,
}


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

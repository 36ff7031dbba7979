"""``gspn replay``: serves the page for a recorded run."""

from __future__ import annotations

import argparse
import os

from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.cli.serve import ADDRESS_OPTIONS, serve
from gspn_framework_package.model.errors import InputError

OPTIONS: Arguments = {
    Argument("log", "LOG"): "an event log (.jsonl), or a rosbag (.bag)",
    Argument("--plan"): "the plan of a rosbag (an event log contains its own)",
    **ADDRESS_OPTIONS,
}


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted."""
    from gspn_framework_package.formats.plan_file import read_plan
    from gspn_framework_package.visualizer.bag_replay import BagReplay, plans_of
    from gspn_framework_package.visualizer.documents import Folder
    from gspn_framework_package.visualizer.project import Project
    from gspn_framework_package.visualizer.replay import Replay
    from gspn_framework_package.visualizer.session import Session

    if not os.path.isfile(args.log):
        raise InputError("the file does not exist", file=args.log)
    title = os.path.basename(args.log)
    project = Project()
    if args.log.endswith(".bag"):
        given = read_plan(args.plan) if args.plan else None
        folder = Folder(os.path.dirname(os.path.realpath(args.log)))
        bag = BagReplay(args.log, plans_of(folder, given))
        project.show(Session("replay", bag.document(title), bag))
    else:
        replay = Replay(args.log)
        project.show(Session("replay", replay.document(title), replay))
    return serve(project, args)

"""``gspn replay``: serves the page for a recorded run."""

from __future__ import annotations

import argparse
import os
from functools import partial
from typing import TYPE_CHECKING, Sequence

from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.cli.serve import ADDRESS_OPTIONS, serve
from gspn_framework_package.model.errors import InputError, LogError, UsageError

if TYPE_CHECKING:
    from gspn_framework_package.visualizer.poses import PoseTrack

OPTIONS: Arguments = {
    Argument("log", "LOG"): "an event log (.jsonl), or a rosbag (.bag)",
    Argument("--plan"): "the plan of a rosbag (an event log contains its own)",
    Argument("--poses", "FILE"): (
        "where the robots of an event log were: a rosbag of that time, or a recording of the world"
    ),
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
    if args.poses and args.log.endswith(".bag"):
        raise UsageError("--poses: a rosbag has its own poses", hint="leave --poses out")
    title = os.path.basename(args.log)
    project = Project()
    if args.log.endswith(".bag"):
        given = read_plan(args.plan) if args.plan else None
        folder = Folder(os.path.dirname(os.path.realpath(args.log)))
        bag = BagReplay(args.log, plans_of(folder, given))
        project.show(Session("replay", bag.document(title), bag))
    else:
        replay = Replay(args.log, partial(recorded_poses, args.poses) if args.poses else None)
        project.show(Session("replay", replay.document(title), replay))
    return serve(project, args)


def recorded_poses(path: str, names: Sequence[str], began: float) -> PoseTrack:
    """Where robots were, from a rosbag or a recording of the world.

    :param began: when the run began (seconds since 1970).
    :raises GspnError: the file cannot be read, or has no poses of these robots.
    """
    from gspn_framework_package.visualizer.bag_replay import bag_track
    from gspn_framework_package.visualizer.poses import PoseTrack

    if path.endswith(".bag"):
        track = bag_track(path, names, began)
    else:
        from gspn_framework_package.world.recording import read_recording

        recording = read_recording(path)
        track = PoseTrack()
        track.room = recording.room.as_json()
        for wall, (_, poses) in zip(recording.wall, recording.moments):
            if wall >= began:
                seen = zip(recording.robots, poses)
                track.add(
                    wall - began,
                    {name: {"pose": [p.x, p.y, p.yaw]} for name, p in seen if name in names},
                )
    if not track:
        raise LogError("has no poses of the robots of this run", file=path)
    return track

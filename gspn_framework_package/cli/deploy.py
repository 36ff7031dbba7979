"""``gspn deploy``: deploys another plan to a running team without stopping it."""

from __future__ import annotations

import argparse
import json
import os
from typing import TYPE_CHECKING, Any, Dict, List, Tuple

from gspn_framework_package.cli.history_options import HISTORY_OPTIONS, read_mapping
from gspn_framework_package.cli.limits import ON_OPTION
from gspn_framework_package.cli.options import (
    MODULES_OPTION,
    Argument,
    Arguments,
    repeated,
)
from gspn_framework_package.cli.team_client import TEAM_OPTIONS, team_client
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import Plan

if TYPE_CHECKING:
    from gspn_framework_package.cli.on_history import HistoryComparison

OPTIONS: Arguments = {
    Argument("plan", "NEW_PLAN"): "the plan that the team should follow",
    repeated("--map", "OLD=NEW"): (
        "a place or transition of the present net and its name in the new one; OLD= drops the "
        "tokens of a resource place"
    ),
    Argument("--folder", "FOLDER"): (
        "folder where every robot finds the functions of the new plan (default: the folder of "
        "NEW_PLAN); '' for the robots' original folder"
    ),
    Argument("--wait", "S", float, 30.0): (
        "seconds within which the robots must check the plan (default %(default)g)"
    ),
    Argument("--replay", "HISTORY", nargs="+"): (
        "first play recorded runs on NEW_PLAN, and do not deploy it if it is worse than the plan "
        "that they followed: event logs, folders of them, or stores of a fleet's history"
    ),
    **HISTORY_OPTIONS,
    **ON_OPTION,
    "--force": "with --replay: deploy the plan even if it is worse",
    "--stage-only": "have the robots check the plan, and leave it staged",
    Argument("--standalone", "PLAN", nargs="?", const=""): (
        "deploy to one of your 'gspn run' processes on this machine; if there are several, name "
        "its first or present plan, or its process id with --run"
    ),
    **TEAM_OPTIONS,
    **MODULES_OPTION,
}

EPILOG = (
    "Exit codes: 0 the team follows the plan, 1 it continues as before, for the reason in the "
    "output (with --replay: also because the plan is worse), 2 not a plan."
)


def run(args: argparse.Namespace) -> int:
    """Check the plan, and have it staged and adopted; return 0 if the team follows it, otherwise
    1."""
    from gspn_framework_package.execution.plan_change import stage_of
    from gspn_framework_package.formats.plan_file import read_plan
    from gspn_framework_package.ros.check_all import check_all
    from gspn_framework_package.team.verdict import obey

    mapping = read_mapping(args.map)
    plan = read_plan(args.plan)
    if args.standalone is not None and args.stage_only:
        raise UsageError("--stage-only needs a team: a run without ROS adopts a plan or refuses it")
    more: Dict[str, Any] = {}
    if args.replay:
        found = _on_history(args, plan, mapping)
        more["replay"] = found.to_json()
        if found.worse and not args.force:
            return _report(args, False, "%s; --force deploys it anyway" % found.verdict, **more)
    if args.standalone is not None:
        return _into_run(args, plan, mapping, more)  # because its own verdict decides
    obey(check_all(plan), plan)
    from gspn_framework_package.team.deploy_team import deploy_to_team

    client = team_client(args)

    def order(command: str, text: str) -> Tuple[bool, str]:
        return client.order(command, "", text, args.run_name)

    def statuses() -> List[Dict[str, Any]]:
        return [s for s in client.statuses().values() if s and args.run_name in ("", s["run"])]

    entry = stage_of(plan, mapping, _folder(args, plan))
    outcome = deploy_to_team(order, statuses, entry, stage_only=args.stage_only, wait=args.wait)
    return _report(
        args, outcome.done, outcome.message, stage=outcome.stage, votes=dict(outcome.votes), **more
    )


def _on_history(args: argparse.Namespace, plan: Plan, mapping: Dict[str, str]) -> HistoryComparison:
    """Play the recorded runs on the plan."""
    from gspn_framework_package.analysis.executors import open_executor
    from gspn_framework_package.cli.on_history import history_in_arguments, require_aim
    from gspn_framework_package.cli.progress import ProgressLine

    require_aim(plan, args.reward)
    with open_executor(args.on) as executor, ProgressLine() as progress:
        found = history_in_arguments(args, plan, args.replay, mapping, progress, executor)
    if not args.json:
        print("\n".join(found.lines()))
    return found


def _into_run(
    args: argparse.Namespace, plan: Plan, mapping: Dict[str, str], more: Dict[str, Any]
) -> int:
    """Have a run without ROS switch to the plan. ``more``: further fields for ``--json``."""
    from gspn_framework_package.execution import control_socket
    from gspn_framework_package.formats.plan_file import PLAN_FILE

    file = args.standalone
    if file and os.path.isdir(file):
        file = os.path.join(file, PLAN_FILE)
    run = control_socket.chosen_run(control_socket.running_plans(), file, args.run_name)
    folder = args.folder and os.path.abspath(args.folder)
    request = control_socket.DeployRequest(
        os.path.abspath(plan.file or args.plan), mapping, folder, args.wait
    )
    answer = control_socket.ask_to_deploy(run, request)
    return _report(args, answer["done"], answer["message"], process=run.process, **more)


def _report(args: argparse.Namespace, done: bool, message: str, **more: Any) -> int:
    """Print the outcome; returns the exit code."""
    if args.json:
        print(json.dumps({"order": "deploy", "done": done, "message": message, **more}))
    else:
        print("%s: %s" % ("done" if done else "not done", message))
    return 0 if done else 1


def _folder(args: argparse.Namespace, plan: Plan) -> str:
    if args.folder is None:
        return os.path.abspath(plan.folder) if plan.folder else ""
    return os.path.abspath(args.folder) if args.folder else ""

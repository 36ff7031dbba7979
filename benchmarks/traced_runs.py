"""Runs real teams, and has TLC play their logs on the specification of the agreement.

``python3 -m benchmarks.traced_runs --runs 100`` (needs ROS, eclipse-zenoh, and what
``scripts/check_spec --install`` installs)

In turn on ROS and over Zenoh, with and without keys, in full and in partial synchronisation: two or
three robots with actions of a tenth of a second, which are paused and resumed, or of which one is
killed and started again with its log. Exit codes: 0 the specification allows every step, 1 it does
not, or a log is not valid, 2 wrong usage.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Optional, Sequence

from agreement import traces
from agreement.specification import why_not
from benchmarks.command import run_command
from benchmarks.harness.master import Master, need_ros
from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.harness.team import RUN, AgentTeam, NodeTeam, Team, why_no_zenoh
from benchmarks.latency import plan_of
from gspn_framework_package.model.errors import ExecutionError, UsageError
from gspn_framework_package.model.plan import Synchronisation

PAUSE = 0.5
"""Seconds that pass between two things that happen to a team."""


def run_team(number: int, folder: Path) -> Path:
    """Run a team, and copy its logs to a folder of its own; returns that.

    :param number: says which team, and what happens to it.
    :raises ExecutionError: the team does not do what it should, or a log breaks a rule.
    """
    source = random.Random(number)
    mode = (Synchronisation.FULL, Synchronisation.PARTIAL)[number % 2]
    plan = plan_of("light", source.choice((2, 3)), mode)
    ros = number // 2 % 2 == 0
    team: Team = NodeTeam(plan) if ros else AgentTeam(plan, keys=source.random() < 0.5)
    with team:
        team.wait_for_moves(number=2, since=0.0)
        for _ in range(source.randint(1, 3)):
            what = source.choice(("wait", "pause", "kill", "kill"))
            if what == "pause":
                for order in ("pause", "resume"):
                    problem = team.order(order)
                    if problem:
                        raise ExecutionError("%s: %s" % (order, problem), file=team.folder)
                    team.pass_time(PAUSE)
            elif what == "kill":
                robot = source.choice(team.robots)
                team.programs.kill(robot)
                team.start(robot)
                team.wait_for_moves([robot])
            team.pass_time(PAUSE)
        team.end()
        violation = team.verdict().violation
        if violation:
            raise ExecutionError("rule %d: %s" % violation, file=team.folder)
        kind = "%s_%s_%d" % ("ros" if ros else "zenoh", mode.value, len(team.robots))
        return Path(shutil.copytree(Path(team.folder) / RUN, folder / ("%s_%d" % (kind, number))))


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run and check; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=100, metavar="N", help="how many (100)")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="the first one (0)")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep the logs in this folder")
    args = parser.parse_args(arguments)
    need_ros()
    problem = why_no_zenoh() or why_not()
    if problem:
        raise UsageError(problem)
    end_cleanly_on_signal()
    with tempfile.TemporaryDirectory() as scratch, Master():
        folder, found = args.keep or Path(scratch), []
        for number in range(args.first, args.first + args.runs):
            found.append(run_team(number, folder))
            print("traced_runs: %s" % found[-1].name, file=sys.stderr, flush=True)
        return traces.main(["--logs", *map(str, found)])


if __name__ == "__main__":
    run_command("traced_runs", main)

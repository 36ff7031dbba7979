"""The command: runs the demonstration, and prints a row for each fault and attack."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from typing import Any, Callable, Dict, List, Optional, Sequence

from benchmarks.anywhere.attacks import ATTACKS, FLOOD_TIME
from benchmarks.anywhere.report import (
    Row,
    attack_row,
    orders_in,
    slowed,
    strangers_in,
)
from benchmarks.anywhere.team import AnywhereTeam
from benchmarks.harness.master import why_no_ros
from benchmarks.harness.network import why_impossible
from benchmarks.harness.rules import partition
from benchmarks.harness.team import why_no_zenoh
from benchmarks.machine import describe_machine, machine_line, table
from gspn_framework_package.model.errors import GspnError

HOLD = 5.0
"""Seconds for which a link is cut, or the router away."""

CALM = 15.0
"""Seconds for which the speed of the team is measured before the faults."""

LIBRARIES = ("rospy", "eclipse-zenoh", "cryptography")

Tell = Callable[[str], None]


class Demonstration:
    """Runs the faults and attacks on one team, in sequence.

    :param team: runs.
    :param tell: called with a line about each step.

    :ivar rows: the results so far.
    """

    def __init__(self, team: AnywhereTeam, tell: Tell) -> None:
        self.team = team
        self.rows: List[Row] = []
        self._tell = tell
        self._speed = 0.0

    def run(self, attacks: Sequence[str] = tuple(ATTACKS)) -> None:
        """Everything; the rows say what came of it."""
        self._step("start", "three machines, two NATs, a router; robots with and without ROS",
                   self._start)  # fmt: skip
        self._step("a robot with ROS is killed", "SIGKILL, restarted", lambda: self._kill("ros"))
        self._step("a robot without ROS is killed", "SIGKILL, restarted",
                   lambda: self._kill("agent"))  # fmt: skip
        self._step("a ROS master is killed", "restarted when all have gone on", self._kill_master)
        self._step("a link is cut", "nat_b for %g s" % HOLD, self._cut)
        self._step("a NAT gets another address", "nat_b: its connections are lost", self._move)
        self._step("the router is killed", "restarted after %g s" % HOLD, self._kill_router)
        for name in attacks:
            if name == "revoked":
                self._step("keys are revoked", "gspn keys revoke; the router notices",
                           self._revoke)  # fmt: skip
            self._attack(name)
        self._step("the page", "watches over the router, with a watcher's keys", self._watched)
        self._step("the logs", "pause; compare, replay, gspn verify", self._finish)

    def _step(self, subject: str, done: str, work: Callable[[], Any]) -> None:
        """One row; ``work`` returns the outcome and the seconds."""
        self._tell("%s: %s ..." % (subject, done))
        try:
            outcome, seconds = work()
            row = Row(subject, done, outcome, seconds, True)
        except GspnError as error:
            row = Row(subject, done, str(error), None, False)
        self._add(row)

    def _add(self, row: Row) -> None:
        self.rows.append(row)
        self._tell("  %s%s" % ("" if row.ok else "FAILED: ", row.outcome))

    # -- the faults --------------------------------------------------------------------------------

    def _start(self) -> Any:
        took = self.team.goes_on()
        self._speed = self.team.speed(*self.team.pass_time(CALM))
        return "all move, %.1f slots/s" % self._speed, took

    def _kill(self, kind: str) -> Any:
        team = self.team
        victim = next(r for r in team.robots if team.layout.kind_of[r] == kind and r != "robot_1")
        rest = [robot for robot in team.robots if robot != victim]
        team.programs.kill(victim)
        team.goes_on(rest, 2)
        began = time.monotonic()
        team.start(victim)
        team.goes_on()
        return "the others went on; %s is back" % victim, time.monotonic() - began

    def _kill_master(self) -> Any:
        team = self.team
        machine = next(machine.name for machine in team.machines if machine.has_master)
        team.programs.kill(team.master_of(machine))
        took = team.goes_on()
        team.start_master(machine)
        team.goes_on()
        return "all went on without it", took

    def _cut(self) -> Any:
        team = self.team
        away = team.layout.alone_behind("nat_b")
        rest = [robot for robot in team.robots if robot not in away]
        network = team.network
        network.cut(partition([[n for n in network.nodes if n != "nat_b"], ["nat_b"]]))
        cut_at = time.monotonic()
        network.verify()
        team.goes_on(rest)
        team.pass_time(HOLD, cut_at)
        settled = cut_at + 1.0  # what was on its way has been written by then
        lone = [robot for robot in away if team.read()[robot].of("slot", settled)]
        network.heal()
        took = team.goes_on()
        network.verify()
        if lone:
            raise _wrong("%s decided slots alone" % ", ".join(lone))
        return "the others went on, %s decided nothing alone" % ", ".join(away), took

    def _move(self) -> Any:
        self.team.network.move("nat_b")
        return "connected again", self.team.goes_on()

    def _kill_router(self) -> Any:
        team = self.team
        team.programs.kill(team.hub)
        killed_at = time.monotonic()
        team.pass_time(HOLD, killed_at)
        lone = [robot for robot in team.robots if team.read()[robot].of("slot", killed_at + 1.0)]
        team.start_router()
        took = team.goes_on()
        if lone:
            raise _wrong("%s decided slots alone" % ", ".join(lone))
        return "nobody decided anything meanwhile; all found it again", took

    # -- the attacks -------------------------------------------------------------------------------

    def _revoke(self) -> Any:
        self.team.revoke()
        return "all others go on", self.team.goes_on()

    def _attack(self, name: str) -> None:
        attack = ATTACKS[name]
        self._tell("%s: %s ..." % (name, attack.what))
        team = self.team
        begin = time.monotonic()
        try:
            found = team.attack(name)
            ended = time.monotonic()
            took = team.goes_on()
            # robots move once a second: a shorter time would count chance
            enough = max(ended, begin + FLOOD_TIME)
            team.pass_time(enough - begin, begin)
            wrong = [slowed(team.speed(begin, enough), self._speed)]
            logs = list(team.read().values())
            strangers = strangers_in(logs, team.robots)
            wrong.append("the logs hold entries of %s" % ", ".join(strangers) if strangers else "")
            orders = orders_in(logs, begin)
            wrong.append("the team was ordered: %s" % ", ".join(orders) if orders else "")
            wrong = [text for text in wrong if text]
            self._add(attack_row(name, attack.what, attack.failed(found), found, wrong, took))
        except GspnError as error:
            self._add(Row(name, attack.what, str(error), None, False))

    # -- the end -----------------------------------------------------------------------------------

    def _watched(self) -> Any:
        before = self.team.watched()
        self.team.wait(lambda: self.team.watched() > before, "a firing that is seen")
        return "saw %d firings, and new ones" % self.team.watched(), None

    def _finish(self) -> Any:
        found = self.team.finish()
        return "%d firings in %d slots, all valid" % (found.firings, found.slots), None


def _wrong(text: str) -> GspnError:
    return GspnError(text)


def why_not() -> str:
    """Why the demonstration cannot run on this machine; "" if it can."""
    return why_no_ros() or why_no_zenoh() or why_impossible()


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run it; returns 0: all as it must be, 1: something was not, 2: not possible here, or wrong
    usage."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.anywhere",
        description="A team on three machines behind two NATs, with and without ROS: faults, and "
        "each attack of docs/security.md (needs root and ROS).",
        epilog="Exit codes: 0 all as it must be, 1 not so, 2 not possible on this machine, or "
        "wrong usage.",
    )
    parser.add_argument(
        "--attack", action="append", choices=list(ATTACKS), help="only this one (repeatable)"
    )
    parser.add_argument("--keep", action="store_true", help="keep logs and output, and say where")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    reason = why_not()
    if reason:
        print("not possible here: %s" % reason, file=sys.stderr)
        return 2
    # so that everything is cleaned up
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    rows: List[Row] = []
    load = os.getloadavg()[0]
    try:
        with AnywhereTeam() as team:
            show = Demonstration(team, lambda line: print(line, file=sys.stderr, flush=True))
            rows = show.rows
            show.run(args.attack or list(ATTACKS))
            team.keep = args.keep or not all(row.ok for row in rows)
    except GspnError as error:
        rows.append(Row("the team", "", str(error), None, False))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    _print(rows, load, args.json)
    return 0 if all(row.ok for row in rows) else 1


def _print(rows: Sequence[Row], load: float, as_json: bool) -> None:
    machine: Dict[str, str] = describe_machine(LIBRARIES)
    machine["load"] = "%.1f to %.1f" % (load, os.getloadavg()[0])
    if as_json:
        print(json.dumps({"machine": machine, "rows": [row.to_json() for row in rows]}, indent=1))
        return
    print(machine_line(machine) + "\n")
    head = ["fault or attack", "what was done", "outcome", "recovery [s]", "as it must be"]
    cells = [(r.subject, r.done, r.outcome, r.seconds, r.ok) for r in rows]
    print(table(head, cells))

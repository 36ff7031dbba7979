"""Outages: all machines of a team are restarted, after an orderly end or a loss of power.

Run by :mod:`.main` (``--outages ROUNDS``), so many rounds in one team. That the machines were
restarted is told to the nodes by another id of their boot; a loss of power is SIGKILL to all at
once, after which every log is cut somewhere behind what had been synced. In turn:

- the team rests, and ends in order: it goes on where it was;
- the team rests, its logs are synced, and the power fails: it goes on where it was;
- the power fails while it works: what was synced is there, and it goes on;
- the power fails, and one machine stays off: the others wait and say so, until the operator has
  them go on; then the last one comes back.
"""

from __future__ import annotations

import json
import os
import random
import signal
from collections import Counter
from typing import Any, Callable, Dict, List, Sequence

from agreement.world import changes_members
from benchmarks.faults.team import LaunchedTeam, require
from benchmarks.log_tail import LogTail
from gspn_framework_package.execution.event_log import BOOT_ID, read_log
from gspn_framework_package.model.plan import Synchronisation

MOVES = 3
"""Moves of each robot that show that the team goes on."""


class Outages:
    """One team, whose machines are restarted again and again.

    :param tell: is told each step, for progress.
    """

    def __init__(
        self,
        robots: int,
        mode: Synchronisation,
        rounds: int,
        seed: int,
        tell: Callable[[str], None],
    ) -> None:
        self._random = random.Random(seed)
        self._rounds, self._tell = rounds, tell
        self.injected: Counter[str] = Counter()
        self._boots = 0
        self._boot()
        self.team = LaunchedTeam(robots, mode, 0.0)

    def _boot(self) -> None:
        self._boots += 1
        os.environ[BOOT_ID] = "boot %d of %d" % (self._boots, os.getpid())

    def run(self) -> None:
        """Restart the machines.

        :raises ExecutionError: the team does not go on, or lacks what was synced.
        """
        steps = [self._end_in_order, self._fail_at_rest, self._fail_at_work]
        if len(self.team.first) > 1:
            steps.append(self._one_stays_off)
        self.team.wait_for_moves(self.team.first, MOVES)
        for _ in range(self._rounds):
            for step in steps:
                what = step()
                self._tell(what)
                self.injected[what] += 1
        del os.environ[BOOT_ID]

    # -- what happens ------------------------------------------------------------------------------

    def _end_in_order(self) -> str:
        before = self._rest()
        self._signal_all(signal.SIGTERM)
        self._start_anew(self.team.first)
        self._is_as_before(before)
        return "ended in order"

    def _fail_at_rest(self) -> str:
        before = self._rest()
        self.team.wait_until(
            lambda: all(
                s["synced_length"] >= s["log_length"] for s in self.team.statuses().values()
            ),
            "all logs to be synced",
        )
        self._fail()
        self._start_anew(self.team.first)
        self._is_as_before(before)
        return "power failed at rest"

    def _fail_at_work(self) -> str:
        self._work_on()
        kept = self._fail()
        self._start_anew(self.team.first)
        self._goes_on(kept)
        return "power failed at work"

    def _one_stays_off(self) -> str:
        team = self.team
        self._work_on()
        kept = self._fail()
        off, *here = self._random.sample(team.first, len(team.first))
        self._start_anew(here)
        team.wait_until(
            lambda: all(
                s["stuck"] and s["missing"] == [off] and off in s["waits_for"]
                for s in team.statuses().values()
            ),
            "all robots to say that they miss %s" % off,
        )
        team.wait_until(lambda: team.order("trust", "", here[0]), "the team to go on without one")
        team.wait_for_moves(here, MOVES)
        del kept[off]  # given up
        self._goes_on(kept, here)
        team.start(off)
        team.wait_for_moves(team.first, MOVES)
        return "one stayed off"

    # -- steps -------------------------------------------------------------------------------------

    def _rest(self) -> List[Any]:
        """Pause the team; returns where everybody and everything is, and what everybody knows."""
        self.team.rest()
        return self._where()

    def _work_on(self) -> None:
        """Wait until all that was done so far is on the disk, and then for more."""
        team = self.team
        length = max(team.read(name).length for name in team.first)
        team.wait_until(
            lambda: all(s["synced_length"] >= length for s in team.statuses().values()),
            "all logs to be synced",
        )
        team.wait_for_moves(team.first, self._random.randint(1, MOVES))

    def _where(self) -> List[Any]:
        status = next(iter(self.team.statuses().values()))
        robots = [[r["robot"], r["place"], r["visit"]] for r in status["robots"]]
        return [status["marking"], robots, status["paused"]]

    def _is_as_before(self, before: List[Any]) -> None:
        team = self.team
        team.wait_until(
            team.is_complete,
            "all robots to be in the team again",
        )
        team.wait_until(lambda: self._where() == before, "the team to be where it was")
        team.wait_until(lambda: team.order("resume", ""), "the team to resume")
        team.wait_for_moves(team.first, MOVES)

    def _goes_on(self, kept: Dict[str, str], robots: Sequence[str] = ()) -> None:
        """Check that robots go on, and that the logs hold every slot that was synced."""
        self.team.wait_for_moves(robots or self.team.first, MOVES)
        for name in robots or self.team.first:
            log = read_log(self.team.log_file(name))
            held = {r["hash"] for r in log.records if r["kind"] == "slot"}
            for other, last in kept.items():
                require(last in held, "%s lacks a slot that %s had synced" % (name, other))

    def _signal_all(self, number: int) -> None:
        for name in self.team.first:
            self.team.signal(name, number)
        for name in self.team.first:
            self.team.await_death(name)

    def _start_anew(self, names: Sequence[str]) -> None:
        self._boot()
        for name in names:
            self.team.start(name)

    def _fail(self) -> Dict[str, str]:
        """The power fails; returns the hash of the last slot that each robot had synced."""
        self._signal_all(signal.SIGKILL)
        return {name: last for name in self.team.first for last in [self._lose_end(name)] if last}

    def _lose_end(self, name: str) -> str:
        """Cut a log somewhere behind what was synced; returns the hash of the last synced slot."""
        path = self.team.log_file(name)
        with open(path, "rb+") as file:
            data = file.read()
            synced = _on_disk(data)
            file.truncate(self._random.choice([synced, self._random.randint(synced, len(data))]))
        self.team.logs[name] = LogTail(path)
        kept = [json.loads(line) for line in data[:synced].splitlines()]
        return next((str(r["hash"]) for r in reversed(kept) if r["kind"] == "slot"), "")


ALWAYS_SYNCED = ("header", "life", "outage", "reset", "peer", "forced", "closed")


def _on_disk(data: bytes) -> int:
    """How many bytes of a log are on the disk: up to where it says so, and up to the records after
    which its writer waited."""
    size = known = 0
    for line in data.splitlines(keepends=True):
        if not line.endswith(b"\n"):
            break
        size += len(line)
        record = json.loads(line)
        if record["kind"] == "synced":
            known = max(known, record["bytes"])
        elif record["kind"] in ALWAYS_SYNCED or "torn" in record or changes_members(record):
            known = size
    return known

"""Repeated operator interventions in a team that cannot recover by itself: a robot that is off is
evicted by force, and comes back; the only remaining robot continues alone, and the others return
with more of the log than it knows; so many robots lose their logs that no quorum remembers."""

from __future__ import annotations

import signal
import time
from collections import Counter
from typing import List

from benchmarks.faults.each_in_turn import GRACE, HELD_UP, MOVES, Tell
from benchmarks.faults.team import FaultyTeam, require
from gspn_framework_package.model.plan import Synchronisation


class Operators:
    """Does each of these to one team, and checks each time that it continues as it must.

    :param rounds: how many times.
    :param tell: called with a description of each step.

    :ivar injected: how often each was done.
    """

    def __init__(self, robots: int, mode: Synchronisation, rounds: int, tell: Tell) -> None:
        self._rounds, self._tell = rounds, tell
        self.injected: Counter[str] = Counter()
        self.team = FaultyTeam(robots, mode, evict_after=0.0)  # only the operator evicts robots

    def run(self) -> None:
        """Do everything, then wait until the team is at rest.

        :raises ExecutionError: the team did not continue as it must.
        """
        team = self.team
        team.wait(team.is_complete, "the start")
        team.wait_for_moves(team.robots, MOVES)
        for number in range(self._rounds):
            for step in (self._restart_after_force, self._return_with_more, self._lose_logs):
                began = time.monotonic()
                what = step(number)
                require(not team.ended(), "the nodes of %s have ended" % ", ".join(team.ended()))
                self.injected[what] += 1
                self._tell("%d: %s, %.1f s" % (number + 1, what, time.monotonic() - began))
        team.rest()

    # -- what is done ------------------------------------------------------------------------------

    def _restart_after_force(self, number: int) -> str:
        """A robot dies, is evicted by force and joins again. Another one restarts and is left alone
        for a while: it must no longer count quorums without the first."""
        team = self.team
        names = self._turned(number)
        restarted, dead = names[0], names[-1]
        team.programs.kill(dead)
        self._force(restarted, [dead])
        self._start(dead)
        began = time.monotonic()
        team.programs.kill(restarted)
        self._start(restarted)
        others = names[1:]
        for name in others:
            team.programs.signal(name, signal.SIGSTOP)
        alone = time.monotonic()
        time.sleep(GRACE + HELD_UP)
        slots = [record["slot"] for record in team.read()[restarted].of("slot", alone + GRACE)]
        for name in others:
            team.programs.signal(name, signal.SIGCONT)
        require(not slots, "%s decided the slots %s alone" % (restarted, slots))
        require(
            bool(self._missing("evict", [dead], restarted, began)), "%s was evicted again" % dead
        )
        team.wait_for_moves(names, MOVES)
        return "restarted after an eviction by force"

    def _return_with_more(self, number: int) -> str:
        """All robots but one die, and that one knows least. By the operator's order it continues
        alone, and restarts. Then the others return with log entries that it never received; they
        have to give these up, and join."""
        team = self.team
        names = self._turned(number)
        left, others = names[0], names[1:]
        length = team.read()[left].length
        team.programs.signal(left, signal.SIGSTOP)
        began = time.monotonic()
        time.sleep(GRACE)  # with full synchronisation the others, a quorum, continue
        for name in others:
            team.programs.kill(name)
        ahead = max(team.read()[name].length for name in others) - length
        team.programs.signal(left, signal.SIGCONT)
        self._force(left, others)
        team.wait_for_moves([left], MOVES)
        team.programs.kill(left)
        self._start(left)
        for name in others:
            team.start(name)
        # do not wait for moves: until they heard of the restart, they continued where they were
        team.wait(lambda: not self._missing("join", others, left, began), "the others to join anew")
        team.wait_for_moves(names, MOVES)
        self._tell("%s were up to %d slots ahead of %s" % (", ".join(others), ahead, left))
        return "returned after the rest went on alone"

    def _lose_logs(self, number: int) -> str:
        """A quorum loses its logs. No robot may decide anything, and all report why, until the
        operator switches those robots off, asserts that they are off, and restarts them."""
        team = self.team
        names = self._turned(number)
        quorum = len(names) // 2 + 1
        forgetful, remembering = names[:quorum], names[quorum:]
        for name in forgetful:
            team.programs.kill(name)
        known = max(team.read()[name].length for name in names)
        for name in forgetful:
            team.lose_log(name)
        for name in forgetful:
            team.start(name)
        team.wait(
            lambda: all(status["stuck"] for status in team.statuses().values()),
            "all robots to say that they are stuck",
        )
        time.sleep(HELD_UP)
        for name in names:
            length = team.read()[name].length
            require(
                length <= known,
                "%s decided up to slot %d, where only %d were known" % (name, length, known),
            )
        for name in forgetful:
            team.programs.kill(name)
        self._force(remembering[0], forgetful)
        for name in forgetful:
            team.start(name)
        team.wait_for_moves(names, MOVES)
        return "lost the logs of a quorum"

    # -- steps -------------------------------------------------------------------------------------

    def _turned(self, number: int) -> List[str]:
        """The robots, rotated so that each round begins with a different one."""
        names = self.team.robots
        at = number % len(names)
        return names[at:] + names[:at]

    def _start(self, name: str) -> None:
        """Restart a robot, and wait until it moves."""
        began = time.monotonic()
        self.team.start(name)
        self.team.wait_for_moves([name], MOVES, began)

    def _missing(self, kind: str, robots: List[str], at: str, since: float) -> List[str]:
        """The ``robots`` about which the log of robot ``at`` has no entry of this kind after time
        ``since``."""
        entries = self.team.read()[at].entries(kind, since)
        found = {entry["robot"] for entry in entries}
        return [name for name in robots if name not in found]

    def _force(self, at: str, robots: List[str]) -> None:
        """Assert at a robot that others are off, until they are evicted."""
        began = time.monotonic()
        team = self.team

        def evicted() -> bool:
            missing = self._missing("evict", robots, at, began)
            for name in missing:
                team.order("force_evict", name, at)
            return not missing

        team.wait(evicted, "the eviction of %s" % ", ".join(robots))

"""Faults for every robot of a team in turn: it is killed in mid-plan, in the middle of a log write,
and between a write and the messages that depend on it, and restarted each time; then it is stopped
until after its eviction. Finally the ROS master is killed and restarted, a robot joins (and is
killed while it writes the first line of its log), and the first robot leaves."""

from __future__ import annotations

import random
import signal
import statistics
import time
from collections import Counter
from typing import Any, Callable, Dict, List

from benchmarks.faults import dying_node
from benchmarks.faults.team import FaultyTeam, require
from benchmarks.harness.master import Master
from gspn_framework_package.execution.agreement.quorum import is_quorum
from gspn_framework_package.model.plan import Synchronisation

EVICT_AFTER = 8.0
"""Eviction time (s): long enough to restart a robot before it counts as lost."""

MOVES = 3
"""Number of moves that every robot must make before the next fault."""

CONNECTED = 15
"""Moves after which a robot is connected to all its action servers, and no longer needs the
master."""

GRACE = 1.0
"""Seconds after a fault in which pending records may still be written."""

HELD_UP = 3.0
"""How long (s) a team without a quorum is observed beyond the eviction time."""

Tell = Callable[[str], None]


class EachInTurn:
    """Injects all these faults into one team, and checks each time that it continues as it must.

    :param tell: called with a description of each step.

    :ivar injected: how often each fault was injected.
    :ivar torn: the kinds of the records whose writes were cut, and how often.
    :ivar unsent: the kinds of the records after which nothing more was sent, and how often.
    :ivar back: seconds from the restart of each killed robot's node to its first goal.
    :ivar woken: seconds from the end of each stop to the first goal.
    """

    def __init__(
        self,
        master: Master,
        robots: int,
        mode: Synchronisation,
        source: random.Random,
        tell: Tell,
    ) -> None:
        self._master, self._source, self._tell = master, source, tell
        self.injected: Counter[str] = Counter()
        self.torn: Counter[str] = Counter()
        self.unsent: Counter[str] = Counter()
        self.back: List[float] = []
        self.woken: List[float] = []
        self.team = FaultyTeam(robots, mode, EVICT_AFTER)

    def run(self) -> None:
        """Inject every fault, then wait until the team is at rest.

        :raises ExecutionError: the team did not continue as it must.
        """
        self.team.wait(self.team.is_complete, "the start")
        self.team.wait_for_moves(self.team.robots, MOVES)
        for fault, kill in (
            ("killed", self._anywhere),
            ("killed in a write", self._in_a_write),
            ("killed before a send", self._before_a_send),
        ):
            for name in self.team.robots:
                self._kill(name, fault, kill)
        for name in self.team.robots:
            self._stop_beyond_eviction(name)
        self._restart_master()
        self._join("late")
        self._leave(self.team.robots[0])
        self._tell("pause")
        self.team.rest()

    def details(self) -> Dict[str, Any]:
        """The records that were cut or not sent, and how long robots were away (s)."""
        return {
            "torn": dict(self.torn),
            "unsent": dict(self.unsent),
            "back_median_s": round(statistics.median(self.back), 1) if self.back else None,
            "back_max_s": round(max(self.back), 1) if self.back else None,
            "woken_median_s": round(statistics.median(self.woken), 1) if self.woken else None,
            "woken_max_s": round(max(self.woken), 1) if self.woken else None,
        }

    # -- faults ------------------------------------------------------------------------------------

    def _anywhere(self, name: str) -> str:
        self.team.programs.kill(name)
        return ""

    def _in_a_write(self, name: str) -> str:
        kind = self.team.kill_at_write(name, dying_node.CUT)
        self.torn[kind] += 1
        return " (%s)" % kind

    def _before_a_send(self, name: str) -> str:
        kind = self.team.kill_at_write(name, dying_node.UNSENT)
        self.unsent[kind] += 1
        return " (%s)" % kind

    def _kill(self, name: str, fault: str, kill: Callable[[str], str]) -> None:
        """Kill a robot with ``kill``, restart it, and check that it resumes its visit."""
        time.sleep(self._source.uniform(0.0, 0.3))  # at a random point of its action
        how = kill(name)
        self.injected[fault] += 1
        goals = self.team.read()[name].of("goal")
        began = time.monotonic()
        self.team.start(name)
        self.team.wait_for_moves(self.team.present(), MOVES, began)
        again = self.team.read()[name].of("goal", began)[0]
        self.back.append(again["mono"] - began)
        evicted = any(self.team.entries("evict", name, began))
        require(
            again["incarnation"] > goals[-1]["incarnation"], "%s has its old incarnation" % name
        )
        resumed = again["visit"] - goals[-1]["visit"] in (0, 1)
        require(
            evicted or resumed,
            "%s came back at visit %d after %d" % (name, again["visit"], goals[-1]["visit"]),
        )
        if evicted:
            self.injected["evicted before it was back"] += 1
        self._tell("%s %s%s, back after %.1f s" % (name, fault, how, self.back[-1]))

    def _stop_beyond_eviction(self, name: str) -> None:
        """Send SIGSTOP; the others evict the robot and continue, or wait if they are no quorum.
        Then send SIGCONT."""
        others = [n for n in self.team.present() if n != name]
        members = self.team.statuses()[others[0]]["members"]
        stopped, evicted = time.monotonic(), 0.0
        self.team.programs.signal(name, signal.SIGSTOP)
        if is_quorum(others, members):
            self.team.wait(
                lambda: any(self.team.entries("evict", name, stopped)), "the eviction of " + name
            )
            evicted = time.monotonic()
            self.team.wait_for_moves(others, MOVES, evicted)
            self.injected["stopped beyond its eviction"] += 1
            what = "evicted after %.1f s" % (evicted - stopped)
        else:
            time.sleep(EVICT_AFTER + HELD_UP)
            for other in others:
                slots = [r["slot"] for r in self.team.read()[other].of("slot", stopped + GRACE)]
                require(not slots, "%s decided slots %s without a quorum" % (other, slots))
            self.injected["stopped, the rest no quorum"] += 1
            what = "the rest waited"
        old = self.team.read()[name].of("goal")[-1]["incarnation"]
        woken = time.monotonic()
        self.team.programs.signal(name, signal.SIGCONT)

        def goals() -> List[Dict[str, Any]]:
            later = self.team.read()[name].of("goal", woken)
            return [goal for goal in later if goal["incarnation"] > old or not evicted]

        self.team.wait(lambda: len(goals()) >= MOVES, "%s to go on" % name)
        self.team.wait_for_moves(others, MOVES, woken)
        self.woken.append(goals()[0]["mono"] - woken)
        self._tell("%s stopped, %s; back after %.1f s" % (name, what, self.woken[-1]))

    def _restart_master(self) -> None:
        self.team.wait_for_moves(self.team.present(), CONNECTED)
        self._master.kill()
        self.team.wait_for_moves(self.team.present(), MOVES)
        self._master.start()
        self.injected["master killed"] += 1
        self.team.wait(self.team.is_complete, "all nodes to register with the new master")
        self.team.wait_for_moves(self.team.present(), MOVES)
        self._tell("the master killed, and started again")

    def _join(self, name: str) -> None:
        self.team.start(name, "p1", dying_node.AT_ONCE)
        self.team.await_death(name)
        self.torn[self.team.last_written(name)] += 1
        self.injected["killed in its first write"] += 1
        began = time.monotonic()
        self.team.start(name, "p1")
        self.team.wait_for_moves([*self.team.robots, name], MOVES, began)
        self.injected["joined"] += 1
        self._tell("%s killed in its very first write, then joined" % name)

    def _leave(self, name: str) -> None:
        self.team.gone.append(name)
        self.team.wait(lambda: not self.team.order("leave", name), "%s to leave" % name)
        self.team.await_death(name)
        self.injected["left"] += 1
        self.team.wait_for_moves(self.team.present(), MOVES)
        self._tell("%s has left" % name)

"""Outages: all machines of a team are restarted, after an orderly end or a loss of power.

Run by :mod:`.main` (``--outages ROUNDS``), so many rounds in one team. That the machines were
restarted is told to the nodes by another id of their boot; a loss of power is SIGKILL to all at
once, after which every log is cut somewhere behind what had been synced. In turn:

- the team rests, and ends in order: it continues where it stopped, with its tasks and data;
- the team rests, its logs are synced, and the power fails: it continues where it stopped, likewise;
- the power fails while it works: it goes on from what was synced;
- the power fails, and one machine stays off: the others wait and say so, until the operator has
  them go on; then the last one comes back.
"""

from __future__ import annotations

import json
import os
import random
import signal
from collections import Counter
from typing import Any, Callable, Dict, List, Mapping, Sequence, Tuple

from agreement.world import changes_members
from benchmarks.faults.team import FaultyTeam, require
from benchmarks.harness.log_tail import LogTail
from gspn_framework_package.execution.event_log import EventLog, read_log
from gspn_framework_package.execution.log_damage import BOOT_ID
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.verifier.merge import Merged
from gspn_framework_package.execution.verifier.slot_check import BrokenRuleError
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.plan import Plan, RobotSpec, Synchronisation

MOVES = 3
"""Moves of each robot that show that the team continues."""

NOTING = "benchmarks.load.noting"

Position = Tuple[int, str]
"""The number of a slot, and its hash, which covers all slots up to it."""


def couriers() -> Plan:
    """Robots fetch an order where there is one, and bring it away; each action writes data."""
    net = (
        NetBuilder("couriers")
        .place("Home", 1)
        .place("Shop")
        .place("Way")
        .place("Orders", capacity=20)
        .exponential("order", rate=1, outputs="Orders")
        .exponential("go", rate=1, inputs="Home", outputs="Shop")
        .immediate("fetch", inputs=["Shop", "Orders"], outputs="Way")
        .immediate("return", inputs="Shop", outputs="Home")
        .exponential("bring", rate=1, inputs="Way", outputs="Home")
        .build()
    )
    return Plan(
        net,
        name="couriers",
        actions={"Shop": None, **{p: FunctionAction(NOTING, p) for p in ("Home", "Way")}},
        resource_places=frozenset(["Orders"]),
        robots=(RobotSpec("robot_1", "Home"),),
        spawn=("Home",),
        events={"order": EventSource("/orders", "std_msgs/String", json="data")},
        tasks=Tasks(("Orders",), ("bring",)),
        on_evict={"Way": {"Orders": 1}},
    ).validate()


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
        self._tasks = 0
        self.team = FaultyTeam(robots, mode, 0.0, couriers())

    def _boot(self) -> None:
        self._boots += 1
        os.environ[BOOT_ID] = "boot %d of %d" % (self._boots, os.getpid())

    def run(self) -> None:
        """Restart the machines, then wait until the team is at rest.

        :raises ExecutionError: the team does not go on, or lacks what was synced.
        """
        steps = [self._end_in_order, self._fail_at_rest, self._fail_at_work]
        if len(self.team.robots) > 1:
            steps.append(self._one_stays_off)
        self.team.wait_for_moves(self.team.robots, MOVES)
        for _ in range(self._rounds):
            for step in steps:
                what = step()
                self._tell(what)
                self.injected[what] += 1
        self.team.rest()
        del os.environ[BOOT_ID]

    # -- what happens ------------------------------------------------------------------------------

    def _end_in_order(self) -> str:
        before = self._rest()
        self._signal_all(signal.SIGTERM)
        self._start_anew(self.team.robots)
        self._is_as_before(before)
        return "ended in order"

    def _fail_at_rest(self) -> str:
        before = self._rest()
        self.team.wait(
            lambda: all(
                s["synced_length"] >= s["log_length"] for s in self.team.statuses().values()
            ),
            "all logs to be synced",
        )
        self._fail()
        self._start_anew(self.team.robots)
        self._is_as_before(before)
        return "power failed at rest"

    def _fail_at_work(self) -> str:
        self._work_on()
        kept = self._fail()
        self._start_anew(self.team.robots)
        self._goes_on(kept)
        return "power failed at work"

    def _one_stays_off(self) -> str:
        team = self.team
        self._work_on()
        kept = self._fail()
        off, *here = self._random.sample(team.robots, len(team.robots))
        self._start_anew(here)
        team.wait(
            lambda: all(
                s["stuck"] and s["missing"] == [off] and off in s["waits_for"]
                for s in team.statuses().values()
            ),
            "all robots to say that they miss %s" % off,
        )
        team.wait(lambda: not team.order("trust", "", here[0]), "the team to continue without one")
        team.wait_for_moves(here, MOVES)
        del kept[off]  # given up
        self._goes_on(kept, here)
        team.start(off)
        team.wait_for_moves(team.robots, MOVES)
        return "one stayed off"

    # -- steps -------------------------------------------------------------------------------------

    def _rest(self) -> List[Any]:
        """Give the team tasks, and pause it; returns where everybody and everything is."""
        self._submit()
        self.team.rest()
        return self._where()

    def _work_on(self) -> None:
        """Wait until all that was done so far is on the disk, and then for more."""
        team = self.team
        length = max(team.read()[name].length for name in team.robots)
        team.wait(
            lambda: all(s["synced_length"] >= length for s in team.statuses().values()),
            "all logs to be synced",
        )
        self._submit()
        team.wait_for_moves(team.robots, self._random.randint(1, MOVES))

    def _submit(self) -> None:
        """Give every robot a few tasks."""
        for name in self.team.robots:
            for _ in range(MOVES):
                self._tasks += 1
                task = json.dumps({"transition": "order", "id": "o%d" % self._tasks})
                self.team.wait(
                    lambda: not self.team.order("submit", at=name, argument=task),  # noqa: B023
                    "%s to take a task" % name,
                )

    def _where(self) -> List[Any]:
        status = next(iter(self.team.statuses().values()))
        robots = [[r["robot"], r["place"], r["visit"]] for r in status["robots"]]
        where = [status["marking"], robots, status["paused"]]
        return [where, *(cargo(read_log(self.team.log_file(name))) for name in self.team.robots)]

    def _is_as_before(self, before: List[Any]) -> None:
        team = self.team
        team.wait(
            team.is_complete,
            "all robots to be in the team again",
        )
        team.wait(lambda: self._where() == before, "the team to be where it was")
        team.wait(lambda: not team.order("resume"), "the team to resume")
        team.wait_for_moves(team.robots, MOVES)

    def _goes_on(self, kept: Mapping[str, Position], robots: Sequence[str] = ()) -> None:
        """Check that robots continue, and from every slot that was synced."""
        robots = robots or self.team.robots
        self.team.wait_for_moves(robots, MOVES)
        check_kept([read_log(self.team.log_file(name)) for name in robots], kept)

    def _signal_all(self, number: int) -> None:
        for name in self.team.robots:
            self.team.programs.signal(name, number)
        for name in self.team.robots:
            self.team.await_death(name)

    def _start_anew(self, names: Sequence[str]) -> None:
        self._boot()
        for name in names:
            self.team.start(name)

    def _fail(self) -> Dict[str, Position]:
        """The power fails; returns the last slot that each robot had synced, if any."""
        self._signal_all(signal.SIGKILL)
        return {name: last for name in self.team.robots for last in self._lose_end(name)}

    def _lose_end(self, name: str) -> List[Position]:
        """Cut a log somewhere behind what was synced; returns the last synced slot, if any."""
        path = self.team.log_file(name)
        with open(path, "rb+") as file:
            data = file.read()
            synced = _on_disk(data)
            file.truncate(self._random.choice([synced, self._random.randint(synced, len(data))]))
        self.team.logs[name] = LogTail(path)
        kept = [json.loads(line) for line in data[:synced].splitlines()]
        return [(r["slot"], r["hash"]) for r in kept if r["kind"] == "slot"][-1:]


def cargo(log: EventLog) -> List[Any]:
    """The tasks and data at the end of a log."""
    state: Any = None
    for slot in replay(log):
        state = slot.state
    queues = {p: [task.id for task in queue] for p, queue in state.queues.items() if queue}
    known = {t: sorted(tasks) for t, tasks in state.known.items()}
    robots = {r.name: [r.data, r.task and r.task.id] for r in state.robots.values()}
    return [queues, [task.id for _, task in state.submitted], known, state.data, robots]


def check_kept(logs: Sequence[EventLog], kept: Mapping[str, Position]) -> None:
    """Check that logs go on from slots that were synced before an outage. A log holds a slot itself
    or, where its robot was behind and took a snapshot, a later point of the same hash chain.

    :param kept: robot -> the slot that it had synced.
    :raises ExecutionError: a log ends before such a slot, or the logs have another one or none in
        its place, or contradict each other.
    """
    try:
        agreed = Merged(logs).slots
    except BrokenRuleError as error:
        raise ExecutionError("rule %d: %s" % (error.rule, error.text)) from None
    for other, (slot, last) in kept.items():
        what = "slot %d, which %s had synced" % (slot, other)
        require(slot in agreed and agreed[slot]["hash"] == last, "the logs lack " + what)
        for log in logs:
            ends = [r["slot"] for r in log.records if r["kind"] in ("slot", "snapshot")]
            require(ends[-1:] >= [slot], "%s lacks %s" % (log.robot, what))


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

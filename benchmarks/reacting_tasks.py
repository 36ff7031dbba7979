"""Whether every task is done once, and every interrupt has one winner, while the nodes of a team
fail: the part *tasks* of :mod:`.reacting`.

Orders come in on a topic, which all robots hear, and events interrupt the robots that deliver them.
Meanwhile robots are killed, or stopped (SIGSTOP) for some seconds, or the network between them, the
ROS master and the sender is cut. At the end all is whole again, the last orders are delivered, and
the logs are looked at.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import sys
import time
from collections import Counter
from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Sequence, Tuple

from benchmarks.faults.team import FaultyTeam, require
from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.harness.rules import Cuts, one_way, partition
from benchmarks.harness.team import MASTER, PATIENCE
from benchmarks.netns.experiment import partition_experiment
from benchmarks.plans import BRIEF
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.verifier import Verdict
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import (
    Plan,
    RobotSpec,
    Synchronisation,
    Timing,
)

FAULTS = ("kills", "pauses", "cuts")
EVICT_AFTER = 3.0
SENDER = "sender"
"""The node of the network from which orders and events come."""

FIRST = 3.0
"""Seconds until the first fault."""

BETWEEN = (2.0, 4.0)
"""Shortest and longest time from the end of a fault to the next, in seconds."""

BRIEFEST = 0.5
"""Seconds that the shortest fault lasts; the longest leads to evictions."""

MODULE = "benchmarks.reacting_tasks"

Row = Dict[str, Any]

COLUMNS: Tuple[str, ...] = (
    "faults",
    "mode",
    "robots",
    "seconds",
    "all_done_after",
    "tasks",
    "done_once",
    "lost",
    "twice",
    "dropped",
    "interrupts",
    "races",
    "two_winners",
    "number_of_faults",
    "evictions",
    "tracebacks",
    "logs",
)


def courier_plan(robots: int) -> Plan:
    """Robots wait for orders and deliver them; an event lets one begin its delivery anew."""
    net = (
        NetBuilder("courier")
        .place("Wait", robots)
        .place("Deliver")
        .place("Orders", capacity=20)
        .exponential("order", rate=1, outputs="Orders")
        .immediate("take", inputs=["Wait", "Orders"], outputs="Deliver")
        .exponential("delivered", rate=1, inputs="Deliver", outputs="Wait")
        .exponential("bump", rate=1, inputs="Deliver", outputs="Deliver")
        .build()
    )
    return Plan(
        net,
        name="courier",
        actions={"Wait": None, "Deliver": FunctionAction(BRIEF, "Deliver")},
        resource_places=frozenset(["Orders"]),
        robots=tuple(RobotSpec("robot_%d" % n, "Wait") for n in range(1, robots + 1)),
        events={
            "order": EventSource("/orders", "std_msgs/String", json="data"),
            "bump": EventSource("bump", "std_msgs/Empty", resume=True),
        },
        tasks=Tasks(("Orders",), ("delivered",)),
        on_evict={"Deliver": {"Orders": 1}},
        on_failure={"*": FailureRule.retry(1000)},
        timing=Timing(EVICT_AFTER),
    ).validate()


# -- orders and events -----------------------------------------------------------------------------


def publisher(topic: str, message: Any, connections: int = 1) -> Any:
    """A publisher that has its subscribers. :raises ExecutionError: they do not come."""
    import rospy

    found = rospy.Publisher(topic, message, queue_size=1000, tcp_nodelay=True)
    deadline = time.monotonic() + PATIENCE
    while found.get_num_connections() < connections:
        if time.monotonic() > deadline:
            raise ExecutionError("nobody subscribes to %s" % topic)
        time.sleep(0.02)
    return found


class OrderSender:
    """Publishes orders and events in turn; needs a node, and a team that listens.

    :param robots: who listens.
    :param seed: of the robots that events interrupt.

    :ivar sent: the ids of the orders.
    """

    def __init__(self, robots: Sequence[str], seed: int) -> None:
        from std_msgs.msg import Empty, String

        self.sent: List[str] = []
        self._random = random.Random(seed)
        self._string = String
        self._orders = publisher("/orders", String, len(robots))
        self._bumps = [publisher("/%s/bump" % name, Empty) for name in robots]

    def run(self, seconds: float, rate: float, meanwhile: Callable[[], None]) -> None:
        """Publish ``rate`` messages a second for ``seconds``, and call ``meanwhile`` after each."""
        began = time.monotonic()
        for tick in range(int(seconds * rate)):
            time.sleep(max(0.0, began + tick / rate - time.monotonic()))
            if tick % 2:
                self._random.choice(self._bumps).publish()
            else:
                self.sent.append("order %d" % len(self.sent))
                order = {"id": self.sent[-1], "number": len(self.sent)}
                self._orders.publish(self._string(json.dumps(order)))
            meanwhile()

    def close(self) -> None:
        """Publish nothing any more."""
        for found in (self._orders, *self._bumps):
            found.unregister()


# -- what the logs say -----------------------------------------------------------------------------


class LoggedTasks(NamedTuple):
    """What the agreed log of a team says about its tasks and interrupts.

    :ivar done: task -> how often it was done.
    :ivar dropped: task -> how often it was dropped.
    :ivar races: how many visits both a result and an event, or several events, wanted to end.
    :ivar two_winners: how many visits were ended more than once.
    """

    done: Counter[str]
    dropped: Counter[str]
    interrupts: int
    evictions: int
    races: int
    two_winners: int


def outcome(logs: Iterable[Iterable[Record]]) -> LoggedTasks:
    """What the slots of all logs together say.

    :param logs: the records of each robot's log. A robot that has joined may lack slots.
    """
    merged = {r["slot"]: r for records in logs for r in records if r["kind"] == "slot"}
    ended: Dict[str, Counter[str]] = {"done": Counter(), "dropped": Counter()}
    kinds: Counter[str] = Counter()
    wanted: Counter[Tuple[str, int, int]] = Counter()
    left: Counter[Tuple[str, int, int]] = Counter()
    for slot in sorted(merged):
        for entry in merged[slot]["entries"]:
            kinds[entry["entry"]] += 1
            if entry["entry"] in ("done", "interrupt"):
                wanted[entry["robot"], entry["incarnation"], entry["visit"]] += 1
        for firing in merged[slot]["firings"]:
            if firing["transition"] in ("delivered", "bump"):
                left[firing["robot"], firing["incarnation"], firing["visit"]] += 1
            for task, _, target in firing.get("tasks", ()):
                if target in ended:
                    ended[target][task] += 1
    return LoggedTasks(
        ended["done"],
        ended["dropped"],
        kinds["interrupt"],
        kinds["evict"],
        sum(count > 1 for count in wanted.values()),
        sum(count > 1 for count in left.values()),
    )


def make_row(sent: Sequence[str], found: LoggedTasks, verdict: Verdict) -> Row:
    """The figures of a run: what was ordered, and what became of it."""
    return {
        "tasks": len(sent),
        "done_once": sum(found.done[task] == 1 for task in sent),
        "lost": sum(not found.done[task] for task in sent),
        "twice": sum(count > 1 for count in found.done.values()),
        "dropped": sum(found.dropped.values()),
        "interrupts": found.interrupts,
        "races": found.races,
        "two_winners": found.two_winners,
        "evictions": found.evictions,
        "logs": "rule %d: %s" % verdict.violation if verdict.violation else "valid",
    }


def is_well(row: Row) -> bool:
    """Whether a row shows that each task was done once, and that nothing else went wrong."""
    return (
        row["tasks"] > 0
        and row["done_once"] == row["tasks"]
        and not (row["twice"] or row["dropped"] or row["two_winners"] or row["tracebacks"])
        and row["logs"] == "valid"
    )


# -- kills and pauses ------------------------------------------------------------------------------


class Trouble:
    """Kills or stops robots of a team, one fault after the other.

    :param team: the team.
    :param fault: ``kills`` or ``pauses``.
    :param seed: of the robots, and of the times.

    :ivar count: the number of faults so far.
    """

    def __init__(self, team: FaultyTeam, fault: str, seed: int) -> None:
        self._team, self._fault = team, fault
        self._random = random.Random(seed)
        self._down: List[str] = []
        self._until = 0.0
        self._next = time.monotonic() + FIRST
        self.count = 0

    def go_on(self) -> None:
        """Begin or end a fault if it is time."""
        now = time.monotonic()
        if self._down and now >= self._until:
            self.end()
        elif not self._down and now >= self._next:
            # a stop may hit several robots, and more than half of them
            number = self._random.randint(1, len(self._team.robots)) if self._pauses else 1
            self._down = self._random.sample(self._team.robots, number)
            self._until = now + self._random.choice([BRIEFEST, 1.5, EVICT_AFTER + 2.0])
            for name in self._down:
                if self._pauses:
                    self._team.programs.signal(name, signal.SIGSTOP)
                else:
                    self._team.programs.kill(name)
            self.count += 1

    def end(self) -> None:
        """Bring back who is down."""
        for name in self._down:
            if self._pauses:
                self._team.programs.signal(name, signal.SIGCONT)
            else:
                self._team.start(name)
        self._down = []
        self._next = time.monotonic() + self._random.uniform(*BETWEEN)

    @property
    def _pauses(self) -> bool:
        return self._fault == "pauses"


def measure_processes(
    fault: str, robots: int, mode: Synchronisation, seconds: float, rate: float, seed: int
) -> Row:
    """Kill or stop robots while orders come; the figures."""
    with FaultyTeam(robots, mode, EVICT_AFTER, courier_plan(robots)) as team:
        team.wait(team.is_complete, "the start")
        sender, trouble = OrderSender(team.robots, seed), Trouble(team, fault, seed)
        began = time.monotonic()
        sender.run(seconds, rate, trouble.go_on)
        trouble.end()
        published = time.monotonic() - began

        def found() -> LoggedTasks:
            return outcome(log.records for log in team.read().values())

        _wait_for_all(sender.sent, found, seconds)
        drained = time.monotonic() - began
        team.rest()
        sender.close()
        team.end()
        row = make_row(sender.sent, found(), team.verdict(settled=True))
        row.update(number_of_faults=trouble.count, tracebacks=len(team.tracebacks()))
        require(is_well(row), "not as it must be: %s" % row)
    return {**_head(fault, robots, mode, published, drained), **row}


def _head(fault: str, robots: int, mode: Synchronisation, published: float, drained: float) -> Row:
    return {
        "part": "tasks",
        "faults": fault,
        "mode": mode.value,
        "robots": robots,
        "seconds": round(published),
        "all_done_after": round(drained),
    }


def _wait_for_all(sent: Sequence[str], found: Callable[[], LoggedTasks], seconds: float) -> None:
    """Wait until all orders are done. What is missing after that time shows in the figures."""
    deadline = time.monotonic() + PATIENCE + seconds
    while not set(sent) <= set(found().done) and time.monotonic() < deadline:
        time.sleep(1.0)


# -- cuts ------------------------------------------------------------------------------------------


def random_cut(robots: Sequence[str], source: random.Random) -> Cuts:
    """A cut between the robots, the master and the sender: one robot alone, or with the sender; a
    few robots, with the master; a robot that does not hear, or is not heard; the sender alone; or
    everybody alone."""
    others = list(robots)
    victim = others.pop(source.randrange(len(others)))
    few = source.sample(list(robots), (len(robots) - 1) // 2)
    rest = [name for name in robots if name not in few]
    kind = source.randrange(7)
    if kind == 0:
        return partition([[victim], [MASTER, SENDER, *others]])
    if kind == 1:
        return partition([[victim, SENDER], [MASTER, *others]])
    if kind == 2:
        return partition([[MASTER, *few], [SENDER, *rest]])
    if kind == 3:
        return one_way([MASTER, SENDER, *others], [victim])
    if kind == 4:
        return one_way([victim], [MASTER, SENDER, *others])
    if kind == 5:
        return partition([[SENDER], [MASTER, *robots]])
    return partition([[SENDER], [MASTER], *([name] for name in robots)])


def measure_cuts(robots: int, mode: Synchronisation, seconds: float, rate: float, seed: int) -> Row:
    """Cut the network while orders come; the figures.

    :raises ExecutionError: not possible here, or the team did what it must not.
    """
    source = random.Random(seed)
    cuts = 0
    plan = courier_plan(robots)
    with partition_experiment(
        mode.value, plan=plan, others=[SENDER], evict_after=EVICT_AFTER
    ) as lab:

        def said() -> str:
            return lab.programs.output(SENDER)

        words = ["--seconds", str(seconds), "--rate", str(rate), "--seed", str(seed)]
        words += ["--robots", *lab.robots]
        words = [sys.executable, "-m", MODULE, *words]
        lab.programs.start(SENDER, words, "", lab.environment(SENDER))
        lab.wait(lambda: "begun" in said(), "the first order", PATIENCE)
        began = time.monotonic()
        lab.pass_time(FIRST)
        while "sent" not in said():
            lab.cut(random_cut(lab.robots, source))
            cuts += 1
            lab.pass_time(source.choice([BRIEFEST, 1.5, EVICT_AFTER + 2.0]))
            lab.heal()
            lab.pass_time(source.uniform(*BETWEEN))
        published = time.monotonic() - began
        sent = ["order %d" % n for n in range(int(said().rsplit("sent", 1)[1]))]

        def found() -> LoggedTasks:
            return outcome(log.records for log in lab.read().values())

        _wait_for_all(sent, found, seconds)
        drained = time.monotonic() - began
        lab.rest()
        row = make_row(sent, found(), lab.verdict(settled=True))
        tracebacks = sum("Traceback" in lab.programs.output(name) for name in lab.robots)
        row.update(number_of_faults=cuts, tracebacks=tracebacks)
        lab.require(is_well(row), "not as it must be: %s" % row)
    return {**_head("cuts", robots, mode, published, drained), **row}


def measure_tasks(
    fault: str, robots: int, mode: Synchronisation, seconds: float, rate: float, seed: int
) -> Row:
    """Let orders and events come for ``seconds``, together ``rate`` a second, while a kind of fault
    hits the team; then wait until all is done, and look at the logs.

    :raises ExecutionError: the team does not start, or does what it must not.
    """
    if fault == "cuts":
        return measure_cuts(robots, mode, seconds, rate, seed)
    return measure_processes(fault, robots, mode, seconds, rate, seed)


def main() -> int:
    """Be the process that sends orders and events, and stays until it is ended: what is under way
    in its connections arrives after a cut."""
    import rospy

    parser = argparse.ArgumentParser(description="The sender of orders and events.")
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--robots", nargs="+", required=True)
    args = parser.parse_args()
    end_cleanly_on_signal()
    rospy.init_node("sender", anonymous=True)
    sender = OrderSender(args.robots, args.seed)
    print("begun", flush=True)
    sender.run(args.seconds, args.rate, lambda: None)
    print("sent %d" % len(sender.sent), flush=True)
    rospy.spin()
    return 0


if __name__ == "__main__":
    sys.exit(main())

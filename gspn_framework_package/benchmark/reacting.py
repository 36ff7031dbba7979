"""How fast a team reacts to events, what a flood of messages costs, and whether every task is done
once although robots are killed.

``python3 -m gspn_framework_package.benchmark.reacting`` (needs ROS)

- *interrupts*: robots are at work; a message on the topic of one robot's event interrupts it. The
  time from the call of ``publish`` to the callback of the action server that is told to cancel,
  both in this process: so it contains two topics and the agreement of the team.
- *flood*: the processor time of a robot's node whose event has a topic with 1,000 messages a
  second, none of which changes the condition; without them; and that of a process that only
  subscribes to such a topic.
- *tasks*: tasks come in on a topic, events interrupt the robots that deliver them, and robots are
  killed and restarted. At the end every task must be done exactly once by the log, and the history
  checker looks at all logs.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import queue
import random
import signal
import statistics
import subprocess
import sys
import time
from collections import Counter
from typing import Any, Callable, Dict, Iterator, List, Optional, Sequence, Tuple

import psutil

from gspn_framework_package.benchmark.faults.team import (
    BRIEF,
    PATIENCE,
    LaunchedTeam,
    RestartableMaster,
)
from gspn_framework_package.benchmark.machine import describe_machine, machine_line, table
from gspn_framework_package.benchmark.processes import cpu_seconds
from gspn_framework_package.benchmark.team_run import need_ros
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.model.action import EXEC_GSPN, FunctionAction, ServerAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import ExecutionError, GspnError
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.plan import Plan, RobotSpec, Synchronisation

PARTS = ("interrupts", "flood", "tasks")
FLOOD = 1000
"""Messages a second."""
EVICT_AFTER = 3.0
MODULE = "gspn_framework_package.benchmark.reacting"

Row = Dict[str, Any]


def guard_plan(robots: int) -> Plan:
    """Robots work until an event interrupts them; then they begin anew."""
    net = (
        NetBuilder("guard")
        .place("Work", robots)
        .exponential("finish", rate=1, inputs="Work", outputs="Work")
        .exponential("low", rate=1, inputs="Work", outputs="Work")
        .build()
    )
    return Plan(
        net,
        name="guard",
        actions={"Work": ServerAction(EXEC_GSPN, "work")},
        robots=tuple(RobotSpec("robot_%d" % n, "Work") for n in range(1, robots + 1)),
        events={
            "low": EventSource("battery", "std_msgs/Float32", "data < 0.2", edge=True),
        },
    ).validate()


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
    ).validate()


class WorkServer:
    """The action server of a robot's work, in this process.

    :ivar goals: gets an item for each goal.
    :ivar cancelled: gets the monotonic time at which each goal was told to end.
    """

    def __init__(self, namespace: str) -> None:
        import actionlib

        from gspn_framework_package.msg import ExecGSPNAction

        self.goals: queue.Queue[None] = queue.Queue()
        self.cancelled: queue.Queue[float] = queue.Queue()
        self._held: List[Any] = []  # actionlib forgets goals that nobody holds
        self._server = actionlib.ActionServer(
            namespace + "/work", ExecGSPNAction, self._begin, self._end, auto_start=False
        )
        self._server.start()

    def _begin(self, goal: Any) -> None:
        self._held.append(goal)
        goal.set_accepted()
        self.goals.put(None)

    def _end(self, goal: Any) -> None:
        self.cancelled.put(time.monotonic())
        goal.set_canceled()


@contextlib.contextmanager
def launched(robots: int, mode: Synchronisation, plan: Plan) -> Iterator[LaunchedTeam]:
    """A team that is ended, and whose files are removed, at the end of the block."""
    team = LaunchedTeam(robots, mode, EVICT_AFTER, plan)
    try:
        yield team
    finally:
        team.end()
        team.discard()


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


# -- interrupts ------------------------------------------------------------------------------------


def measure_interrupts(robots: int, mode: Synchronisation, samples: int) -> Row:
    """Interrupt one robot after the other; the latencies (ms)."""
    from std_msgs.msg import Float32

    source = random.Random(1)
    names = ["robot_%d" % n for n in range(1, robots + 1)]
    servers = {name: WorkServer("/" + name) for name in names}
    values: List[float] = []
    with launched(robots, mode, guard_plan(robots)) as team:
        for server in servers.values():
            server.goals.get(timeout=PATIENCE)
        batteries = {name: publisher("/%s/battery" % name, Float32) for name in names}
        team.wait_until(team.is_complete, "the start")
        for number in range(samples):
            name = names[number % robots]
            began = time.monotonic()
            batteries[name].publish(0.1)
            values.append((servers[name].cancelled.get(timeout=PATIENCE) - began) * 1000)
            servers[name].goals.get(timeout=PATIENCE)
            batteries[name].publish(0.9)
            time.sleep(source.uniform(0.02, 0.12))
        for found in batteries.values():
            found.unregister()
    values.sort()
    return {
        "part": "interrupts",
        "mode": mode.value,
        "robots": robots,
        "samples": samples,
        "median_ms": round(statistics.median(values), 1),
        "p99_ms": round(values[int(len(values) * 0.99)], 1),
        "max_ms": round(values[-1], 1),
    }


# -- flood -----------------------------------------------------------------------------------------


def measure_flood(window: float) -> Row:
    """The processor time of a node whose event's topic floods, in percent of a core."""
    server = WorkServer("/robot_1")
    with launched(1, Synchronisation.FULL, guard_plan(1)) as team, contextlib.ExitStack() as stack:
        server.goals.get(timeout=PATIENCE)
        time.sleep(3.0)
        log = team.log_file("robot_1")
        node = psutil.Process(team.pid("robot_1"))
        without = _share(node, window)
        size = os.path.getsize(log)
        stack.enter_context(_child("--publish", "/robot_1/battery"))
        listener = stack.enter_context(_child("--listen", "/robot_1/battery"))
        time.sleep(3.0)
        with_flood = _share(node, window)
        return {
            "part": "flood",
            "messages_per_s": FLOOD,
            "cpu_without": round(100 * without, 1),
            "cpu_with": round(100 * with_flood, 1),
            "cpu_of_a_mere_subscriber": round(
                100 * _share(psutil.Process(listener.pid), window), 1
            ),
            "log_bytes_written": os.path.getsize(log) - size,
        }


def _share(process: psutil.Process, window: float) -> float:
    """The share of a core that a process uses for ``window`` seconds."""
    before, began = cpu_seconds([process])[process.pid], time.monotonic()
    time.sleep(window)
    return (cpu_seconds([process])[process.pid] - before) / (time.monotonic() - began)


@contextlib.contextmanager
def _child(*words: str) -> Iterator[Any]:
    process = subprocess.Popen(
        [sys.executable, "-m", MODULE, *words], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def _publish(topic: str) -> None:
    """Be the process that floods a topic."""
    import rospy
    from std_msgs.msg import Float32

    rospy.init_node("flood", anonymous=True)
    found = publisher(topic, Float32)
    due = time.monotonic()
    while not rospy.is_shutdown():
        found.publish(0.5)
        due += 1 / FLOOD
        time.sleep(max(0.0, due - time.monotonic()))


def _listen(topic: str) -> None:
    """Be a process that only subscribes to a topic."""
    import rospy
    from std_msgs.msg import Float32

    rospy.init_node("mere_subscriber", anonymous=True)
    rospy.Subscriber(topic, Float32, lambda message: None, tcp_nodelay=True)
    rospy.spin()


# -- tasks -----------------------------------------------------------------------------------------


def measure_tasks(robots: int, mode: Synchronisation, seconds: float, rate: float) -> Row:
    """Let tasks and events come for ``seconds``, together ``rate`` a second, while robots are
    killed; then wait until all is done, and look at the logs."""
    from std_msgs.msg import Empty, String

    source = random.Random(2)
    with launched(robots, mode, courier_plan(robots)) as team:
        team.wait_until(team.is_complete, "the start")
        orders = publisher("/orders", String, robots)
        bumps = [publisher("/%s/bump" % name, Empty) for name in team.first]
        sent: List[str] = []
        kills, restart_at, victim = 0, 0.0, ""
        began = time.monotonic()
        kill_at = began + 3.0
        for tick in range(int(seconds * rate)):
            time.sleep(max(0.0, began + tick / rate - time.monotonic()))
            if tick % 2:
                source.choice(bumps).publish()
            else:
                sent.append("order %d" % len(sent))
                orders.publish(json.dumps({"id": sent[-1], "number": len(sent)}))
            now = time.monotonic()
            if victim and now >= restart_at:
                team.start(victim)
                victim, kill_at = "", now + source.uniform(3.0, 6.0)
            elif not victim and now >= kill_at:
                victim = source.choice(team.first)
                restart_at = now + source.choice([0.0, 1.0, EVICT_AFTER + 2.0])
                team.kill(victim)
                kills += 1
        if victim:
            team.start(victim)
        published = time.monotonic() - began
        ended = ended_tasks(team)
        deadline = time.monotonic() + PATIENCE + seconds
        while sum(ended["done"].values()) < len(sent) and time.monotonic() < deadline:
            time.sleep(2.0)
            ended = ended_tasks(team)
        drained = time.monotonic() - began
        team.rest()
        ended = ended_tasks(team)
        evictions = sum(1 for e in _entries(team) if e["entry"] == "evict")
        interrupts = sum(1 for e in _entries(team) if e["entry"] == "interrupt")
        team.end()
        violation = team.verdict().violation
        tracebacks = team.tracebacks()
    done = ended["done"]
    return {
        "part": "tasks",
        "mode": mode.value,
        "robots": robots,
        "seconds": round(published),
        "all_done_after": round(drained),
        "tasks": len(sent),
        "done_once": sum(1 for task in sent if done[task] == 1),
        "lost": sum(1 for task in sent if not done[task]),
        "twice": sum(1 for count in done.values() if count > 1),
        "dropped": sum(ended["dropped"].values()),
        "interrupts": interrupts,
        "kills": kills,
        "evictions": evictions,
        "tracebacks": len(tracebacks),
        "logs": "rule %d: %s" % violation if violation else "valid",
    }


def ended_tasks(team: LaunchedTeam) -> Dict[str, Counter[str]]:
    """How often each task has ended, by the longest log: those that are done, and those that were
    dropped."""
    found: Dict[str, Counter[str]] = {"done": Counter(), "dropped": Counter()}
    for record in _slots(team):
        for firing in record["firings"]:
            for task, _, target in firing.get("tasks", ()):
                if target in found:
                    found[target][task] += 1
    return found


def _entries(team: LaunchedTeam) -> Iterator[Dict[str, Any]]:
    for record in _slots(team):
        yield from record["entries"]


def _slots(team: LaunchedTeam) -> List[Dict[str, Any]]:
    """The slots of the log that is the longest of those that know all of them."""
    known: List[Dict[int, Dict[str, Any]]] = [
        {r["slot"]: r for r in read_log(team.log_file(name)).records if r["kind"] == "slot"}
        for name in team.first
    ]
    merged: Dict[int, Dict[str, Any]] = {}
    for slots in known:
        merged.update(slots)
    return [merged[slot] for slot in sorted(merged)]


# -- the command -----------------------------------------------------------------------------------

COLUMNS: Dict[str, Tuple[str, ...]] = {
    "interrupts": ("mode", "robots", "samples", "median_ms", "p99_ms", "max_ms"),
    "flood": (
        "messages_per_s",
        "cpu_without",
        "cpu_with",
        "cpu_of_a_mere_subscriber",
        "log_bytes_written",
    ),
    "tasks": (
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
        "kills",
        "evictions",
        "tracebacks",
        "logs",
    ),
}


def is_well(row: Row) -> bool:
    """Whether a row of the tasks shows that each was done once, and nothing else went wrong."""
    return row["part"] != "tasks" or (
        row["done_once"] == row["tasks"]
        and not (row["twice"] or row["dropped"] or row["tracebacks"])
        and row["logs"] == "valid"
    )


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, and print tables or JSON; returns 1 if a task was lost or done twice, or a log is
    not valid."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--part", choices=PARTS, nargs="+", default=PARTS)
    parser.add_argument("--robots", type=int, default=5, metavar="N")
    parser.add_argument("--mode", choices=[m.value for m in Synchronisation])
    parser.add_argument("--samples", type=int, default=300, metavar="N", help="interrupts (300)")
    parser.add_argument(
        "--seconds", type=float, default=60.0, metavar="S", help="how long tasks come (60)"
    )
    parser.add_argument(
        "--rate", type=float, default=20.0, metavar="N", help="tasks and events a second (20)"
    )
    parser.add_argument(
        "--window", type=float, default=10.0, metavar="S", help="seconds to measure a flood (10)"
    )
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--publish", metavar="TOPIC", help=argparse.SUPPRESS)
    parser.add_argument("--listen", metavar="TOPIC", help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    need_ros()
    if args.publish or args.listen:
        (_publish if args.publish else _listen)(args.publish or args.listen)
        return 0
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that the running team is ended
    modes = [Synchronisation(args.mode)] if args.mode else list(Synchronisation)
    work: List[Tuple[str, Callable[[], Row]]] = []
    for part in args.part:
        if part == "flood":
            work.append((part, lambda: measure_flood(args.window)))
            continue
        for mode in modes:
            if part == "interrupts":
                name, values = measure_interrupts, (args.robots, mode, args.samples)
                work.append((part, lambda v=values, f=name: f(*v)))  # type: ignore[misc]
            else:
                given = (args.robots, mode, args.seconds, args.rate)
                work.append((part, lambda v=given: measure_tasks(*v)))  # type: ignore[misc]
    rows: List[Row] = []
    master = RestartableMaster()
    master.start()
    interrupted = False
    try:
        import rospy

        rospy.init_node("reacting", anonymous=True, disable_signals=True)
        for part, measure in work:
            print("reacting: %s ..." % part, file=sys.stderr, flush=True)
            rows.append(measure())
    except KeyboardInterrupt:
        print("reacting: interrupted", file=sys.stderr)
        interrupted = True
    finally:
        master.kill()
    if args.json:
        print(json.dumps({"machine": describe_machine(), "rows": rows}))
    else:
        for part in PARTS:
            found = [row for row in rows if row["part"] == part]
            if found:
                head = [c.replace("_", " ") for c in COLUMNS[part]]
                print(table(head, [[row[c] for c in COLUMNS[part]] for row in found]), end="\n\n")
        print(machine_line())
    if not all(map(is_well, rows)):
        return 1
    return 130 if interrupted else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except GspnError as error:
        print("reacting: error: %s" % error, file=sys.stderr)
        sys.exit(error.exit_code)

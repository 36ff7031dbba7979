"""How fast a team reacts to events, what a flood of messages costs, and whether every task is done
once although robots are killed or stopped, or the network is cut.

``python3 -m benchmarks.reacting`` (needs ROS)

- *interrupts*: robots are at work; a message on the topic of one robot's event interrupts it. The
  time from the call of ``publish`` to the callback of the action server that has to cancel,
  both in this process: so it contains two topics and the agreement of the team.
- *flood*: the processor time of a robot's node whose event has a topic with 1,000 messages a
  second, none of which changes the condition; without them; and that of a process that only
  subscribes to such a topic.
- *tasks*: tasks come in on a topic, events interrupt the robots that deliver them, and robots are
  killed and restarted, or stopped, or cut off from each other (which needs root). At the end every
  task must be done exactly once by the log, no visit may have ended twice, and the history checker
  looks at all logs (see :mod:`.reacting_tasks`).
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import random
import statistics
import sys
import time
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import psutil

from benchmarks.command import run_command
from benchmarks.faults.team import FaultyTeam
from benchmarks.harness.master import Master, need_ros
from benchmarks.harness.processes import cpu_seconds, end_cleanly_on_signal
from benchmarks.harness.team import PATIENCE
from benchmarks.machine import describe_machine, machine_line, table
from benchmarks.netns.main import why_not
from benchmarks.reacting_tasks import COLUMNS as TASK_COLUMNS
from benchmarks.reacting_tasks import EVICT_AFTER, FAULTS, measure_tasks, publisher
from gspn_framework_package.model.action import EXEC_GSPN, ServerAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import ExecutionError, UsageError
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.plan import Plan, RobotSpec, Synchronisation

PARTS = ("interrupts", "flood", "tasks")
FLOOD = 1000
"""Messages a second."""
MODULE = "benchmarks.reacting"

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


class WorkServer:
    """The action server of a robot's work, in this process.

    :ivar goals: gets an item for each goal.
    :ivar cancelled: gets the monotonic time at which each goal was cancelled.
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


# -- interrupts ------------------------------------------------------------------------------------


def measure_interrupts(robots: int, mode: Synchronisation, samples: int) -> Row:
    """Interrupt one robot after the other; the latencies (ms)."""
    from std_msgs.msg import Float32

    source = random.Random(1)
    names = ["robot_%d" % n for n in range(1, robots + 1)]
    servers = {name: WorkServer("/" + name) for name in names}
    values: List[float] = []
    with FaultyTeam(robots, mode, EVICT_AFTER, guard_plan(robots)) as team:
        for server in servers.values():
            server.goals.get(timeout=PATIENCE)
        batteries = {name: publisher("/%s/battery" % name, Float32) for name in names}
        team.wait(team.is_complete, "the start")
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
    with FaultyTeam(1, Synchronisation.FULL, EVICT_AFTER, guard_plan(1)) as team:
        server.goals.get(timeout=PATIENCE)
        time.sleep(3.0)
        log = team.log_file("robot_1")
        node = psutil.Process(team.programs.pid("robot_1"))
        without = _share(node, window)
        size = os.path.getsize(log)
        for what in ("publish", "listen"):
            words = [sys.executable, "-m", MODULE, "--" + what, "/robot_1/battery"]
            team.programs.start(what, words)
        listener = psutil.Process(team.programs.pid("listen"))
        time.sleep(3.0)
        with_flood = _share(node, window)
        return {
            "part": "flood",
            "messages_per_s": FLOOD,
            "cpu_without": round(100 * without, 1),
            "cpu_with": round(100 * with_flood, 1),
            "cpu_of_a_mere_subscriber": round(100 * _share(listener, window), 1),
            "log_bytes_written": os.path.getsize(log) - size,
        }


def _share(process: psutil.Process, window: float) -> float:
    """The share of a core that a process uses for ``window`` seconds."""
    before, began = cpu_seconds([process])[process.pid], time.monotonic()
    time.sleep(window)
    return (cpu_seconds([process])[process.pid] - before) / (time.monotonic() - began)


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
    "tasks": TASK_COLUMNS,
}


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, and print tables or JSON; returns 1 if a task was lost or done twice, or a log is
    not valid."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--part", choices=PARTS, nargs="+", default=PARTS)
    parser.add_argument("--robots", type=int, default=5, metavar="N")
    parser.add_argument("--mode", choices=[m.value for m in Synchronisation])
    parser.add_argument("--samples", type=int, default=300, metavar="N", help="interrupts (300)")
    parser.add_argument(
        "--faults",
        choices=FAULTS,
        nargs="+",
        default=["kills", "pauses"],
        help="what happens while tasks come (kills pauses); cuts of the network need root",
    )
    parser.add_argument(
        "--seconds", type=float, default=60.0, metavar="S", help="how long tasks come (60)"
    )
    parser.add_argument(
        "--rate", type=float, default=20.0, metavar="N", help="tasks and events a second (20)"
    )
    parser.add_argument("--seed", type=int, default=2, metavar="N", help="of the faults (2)")
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
    reason = why_not() if "tasks" in args.part and "cuts" in args.faults else ""
    if reason:
        raise UsageError("the network cannot be cut here: %s" % reason)
    end_cleanly_on_signal()
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
                for fault in args.faults:
                    given = (fault, args.robots, mode, args.seconds, args.rate, args.seed)
                    told = "%s, %s, %s" % (part, fault, mode.value)
                    work.append((told, lambda v=given: measure_tasks(*v)))  # type: ignore[misc]
    rows: List[Row] = []
    interrupted = failed = False
    try:
        with Master():
            import rospy

            rospy.init_node("reacting", anonymous=True, disable_signals=True)
            for part, measure in work:
                print("reacting: %s ..." % part, file=sys.stderr, flush=True)
                try:
                    rows.append(measure())
                except ExecutionError as error:
                    print("reacting: error: %s" % error, file=sys.stderr)
                    failed = True
    except KeyboardInterrupt:
        print("reacting: interrupted", file=sys.stderr)
        interrupted = True
    if args.json:
        print(json.dumps({"machine": describe_machine(), "rows": rows}))
    else:
        for part in PARTS:
            found = [row for row in rows if row["part"] == part]
            if found:
                head = [c.replace("_", " ") for c in COLUMNS[part]]
                print(table(head, [[row[c] for c in COLUMNS[part]] for row in found]), end="\n\n")
        print(machine_line())
    if failed:
        return 1
    return 130 if interrupted else 0


if __name__ == "__main__":
    run_command("reacting", main)

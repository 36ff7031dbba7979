"""The warehouse with the whole system: ``python3 -m benchmarks.warehouse``.

It runs ``warehouse.launch``: robots that drive in the simulated room, execution nodes that agree on
every firing, customers who order, batteries that run down, and a person who walks in. A robot is
killed (SIGKILL) after a third of the time, while it fetches something; it is evicted, and comes
back after half of the time. Another robot joins after two thirds. At the end nobody orders any
more, and the team delivers what is left. Then the robots' logs are read: every order has to be done
exactly once.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading
import time
from collections import Counter
from typing import Any, Dict, List, Optional, Sequence

from benchmarks.harness.master import Master, need_ros
from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.harness.team import launch_words
from benchmarks.machine import describe_machine, machine_line
from benchmarks.room_report import verdict_text
from gspn_framework_package.execution.event_log import EventLog, log_files, read_log
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.model.errors import ExecutionError

LIBRARIES = ("numpy", "scipy", "pybullet", "rospy", "actionlib")

START = 120.0
"""Seconds of wall time within which the first robot must have moved."""

DRAIN = 15 * 60.0
"""Seconds of world time that the team has to deliver what is left."""

KILLED = "robot_2"
RUN = "warehouse"


class ShopWatcher:
    """Listens to a run: the orders, the receipts, and where the robots are."""

    def __init__(self) -> None:
        import rospy
        from std_msgs.msg import String

        from gspn_framework_package.msg import FiredTransition

        self._lock = threading.Lock()
        self._world: Dict[str, Any] = {"time": 0.0}
        self._places: Dict[str, str] = {}
        self.report: Dict[str, Any] = {}
        self.ordered: Dict[str, float] = {}
        """Order -> when it was first sent (s of world time)."""
        self.receipts: Dict[str, float] = {}
        """Order -> when it was handed over (s of world time)."""
        self.messages: Counter[str] = Counter()
        """Messages on ``/orders`` and on ``/delivered``."""
        self.fired: Counter[str] = Counter()
        rospy.Subscriber("/world/state", String, self._on_state, queue_size=1)
        rospy.Subscriber("/world/referee", String, self._on_report, queue_size=1)
        rospy.Subscriber("/orders", String, self._on_order, queue_size=1000)
        rospy.Subscriber("/delivered", String, self._on_receipt, queue_size=1000)
        rospy.Subscriber("/fired_transitions", FiredTransition, self._on_firing, queue_size=1000)

    def _on_state(self, message: Any) -> None:
        with self._lock:
            self._world = json.loads(message.data)

    def _on_report(self, message: Any) -> None:
        with self._lock:
            self.report = json.loads(message.data)

    def _on_order(self, message: Any) -> None:
        with self._lock:
            self.messages["orders"] += 1
            self.ordered.setdefault(json.loads(message.data)["id"], self._world["time"])

    def _on_receipt(self, message: Any) -> None:
        with self._lock:
            self.messages["delivered"] += 1
            self.receipts.setdefault(message.data, self._world["time"])

    def _on_firing(self, message: Any) -> None:
        with self._lock:
            self.fired[message.transition] += 1
            for robot, target in zip(message.robots, message.robot_places):
                self._places[robot] = target

    @property
    def time(self) -> float:
        """Seconds of world time."""
        with self._lock:
            return float(self._world["time"])

    def poses(self) -> Dict[str, List[float]]:
        """Robot -> its true pose ``[x, y, yaw]`` in the world (m, rad)."""
        with self._lock:
            return {name: state["pose"] for name, state in self._world["robots"].items()}

    def place(self, robot: str) -> str:
        """The place that a robot is in, as far as it has moved."""
        with self._lock:
            return self._places.get(robot, "")

    @property
    def undelivered(self) -> int:
        """How many orders were sent, but not handed over."""
        with self._lock:
            return len(set(self.ordered) - set(self.receipts))


def fates(log: EventLog) -> Dict[str, Counter[str]]:
    """What became of the tasks of a log: ``done``, ``dropped`` and ``given back`` -> task -> how
    often; and ``came`` -> task -> 1."""
    found: Dict[str, Counter[str]] = {
        what: Counter() for what in ("came", "done", "dropped", "given back")
    }
    for step in replay(log):
        for firing in step.firings:
            for move in firing.tasks:
                if not move.source:
                    found["came"][move.id] += 1
                if move.target in ("done", "dropped"):
                    found[move.target][move.id] += 1
                elif move.source.startswith("robot ") and move.target.startswith("place "):
                    found["given back"][move.id] += 1
    return found


def measure(robots: int, minutes: float, factor: float, seed: int) -> Dict[str, Any]:
    """One run.

    :param robots: size of the team at the start; one more joins.
    :param minutes: world time during which customers order (min).
    :param factor: the requested real-time factor.
    :param seed: of the orders and of the person.
    :raises UsageError: ROS is missing.
    :raises ExecutionError: the team does not start, or ends by itself.
    """
    need_ros()
    with Master() as master:
        import rospy

        rospy.init_node("bench_warehouse", anonymous=True, disable_signals=True)
        watcher = ShopWatcher()
        words = launch_words(
            "warehouse.launch",
            robots=robots,
            bodies=robots + 1,
            orders_for=minutes * 60,
            real_time_factor=factor,
            seed=seed,
            run=RUN,
        )
        master.programs.start(RUN, words)
        try:
            result = _watch(watcher, master, robots, minutes)
        finally:
            master.programs.stop(RUN, KILLED, "joins")
            rospy.signal_shutdown("measured")
        logs = [read_log(path) for path in log_files([os.path.join(master.folder, "gspn", RUN)])]
    longest = max(logs, key=lambda log: len(log.records))
    tasks, verdict = fates(longest), verify(logs)
    orders = set(watcher.ordered)
    done = {task: tasks["done"][task] for task in orders}
    waits = [watcher.receipts[task] - watcher.ordered[task] for task in watcher.receipts]
    return {
        **result,
        "orders": len(orders),
        "order_messages": watcher.messages["orders"],
        "done_once": sum(count == 1 for count in done.values()),
        "done_twice": sum(count > 1 for count in done.values()),
        "not_done": sum(count == 0 for count in done.values()),
        "dropped": sum(tasks["dropped"].values()),
        "given_back_on_the_way": sum(tasks["given back"].values()),
        "receipts": watcher.messages["delivered"],
        "mean_seconds_to_deliver": round(sum(waits) / len(waits), 1) if waits else None,
        "longest_seconds_to_deliver": round(max(waits), 1) if waits else None,
        "stopped_by_the_person": sum(
            count for name, count in watcher.fired.items() if name.split(".")[-1] == "person"
        ),
        "charged": watcher.fired["charged"],
        "slots": verdict.slots,
        "verdict": verdict_text(verdict),
        **{
            key: watcher.report.get(key)
            for key in (
                "distance",
                "contacts_between_robots",
                "contacts_with_solids",
                "visits_of_people",
                "contacts_with_people",
                "nearest_to_people",
            )
        },
    }


def _watch(
    watcher: ShopWatcher,
    master: Master,
    robots: int,
    minutes: float,
) -> Dict[str, Any]:
    """Follow a run to its end: kill a robot, bring it back, let another join."""
    begin, seconds = time.monotonic(), minutes * 60
    plan = os.path.join(plans_folder(), "warehouse", "room.json")
    killed: Optional[float] = None
    returned: Optional[float] = None
    joined: Optional[float] = None
    while watcher.time < seconds or watcher.undelivered:
        now = watcher.time
        master.programs.check()
        if not watcher.fired and time.monotonic() - begin > START:
            said = master.programs.said(RUN)
            raise ExecutionError("nothing fired within %g s" % START, hint=said)
        if now > seconds + DRAIN:
            break
        if killed is None and now > seconds / 3 and watcher.place(KILLED) == "Fetch":
            os.kill(master.process_of("/%s/executor" % KILLED), signal.SIGKILL)
            killed = now
        elif killed and returned is None and now > max(seconds / 2, killed + 60):
            number = int(KILLED.split("_")[1])
            words = launch_words("robot.launch", plan=plan, number=number, robots=robots, run=RUN)
            master.programs.start(KILLED, words)
            returned = now
        elif joined is None and now > seconds * 2 / 3:
            name = "robot_%d" % (robots + 1)
            words = launch_words(
                "robot.launch", plan=plan, robot=name, place="Parked", robots=robots, run=RUN
            )
            master.programs.start("joins", words)
            joined = now
        time.sleep(0.2)
    wall = time.monotonic() - begin
    return {
        "robots": robots,
        "minutes": round(watcher.time / 60, 1),
        "real_time_factor": round(watcher.time / wall, 2),
        "killed_at": killed,
        "returned_at": returned,
        "joined_at": joined,
    }


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark; returns 0: every order was done exactly once, and nobody touched the
    person; 1: otherwise."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.warehouse", description="The warehouse with the whole system."
    )
    parser.add_argument("--robots", type=int, default=4, help="robots at the start (4)")
    parser.add_argument("--minutes", type=float, default=30.0, help="world time of a run (30)")
    parser.add_argument("--factor", type=float, default=1.0, help="real-time factor (1)")
    parser.add_argument("--seed", type=int, default=0, help="of the orders and of the person (0)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    end_cleanly_on_signal()
    result = measure(args.robots, args.minutes, args.factor, args.seed)
    machine = describe_machine(LIBRARIES)
    if args.json:
        print(json.dumps({"machine": machine, "result": result}, indent=2))
    else:
        print(machine_line(machine) + "\n")
        for name, value in result.items():
            print("%-28s %s" % (name.replace("_", " "), value))
    once = result["orders"] > 0 and result["done_once"] == result["orders"]
    wrong = result["dropped"] > 0 or result["contacts_with_people"] or result["verdict"] != "valid"
    return int(not once or bool(wrong))


if __name__ == "__main__":
    sys.exit(main())

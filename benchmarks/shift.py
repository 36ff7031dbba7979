"""A shift in the warehouse: ``python3 -m benchmarks.shift``.

It runs ``warehouse.launch`` with four robots that drive in the simulated room. The customers order
more than the robots can bring. Besides come urgent orders, orders for one robot, orders that nobody
wants any more after a while, and orders that are cancelled, half of them in a robot's hands. Every
ten minutes a pause stops the team. A robot is killed (SIGKILL) with an order in its hands; it is
evicted, and comes back. At the end nobody orders any more, and the team does what is left.

Then the robots' logs are read: every order has to end exactly once, done, cancelled or late. Urgent
ones have to wait less than half as long for a robot as the others, nobody may touch anything, and
no robot may move from one second after a stop on.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import signal
import statistics
import sys
import time
from collections import Counter
from functools import partial
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Set, Tuple

import gspn
from benchmarks.harness.master import Master, need_ros
from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.harness.team import launch_words
from benchmarks.machine import describe_machine, machine_line
from benchmarks.room_report import verdict_text
from benchmarks.warehouse import LIBRARIES, START, ShopWatcher
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import EventLog, log_files, read_log
from gspn_framework_package.execution.firing import TaskEnded
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.model.errors import ExecutionError, GspnError
from gspn_framework_package.world.room import Pose
from gspn_framework_package.world.shop import CustomerOrder, load_settings

AN_HOUR = {"urgent": 20, "assigned": 5, "window": 10, "cancelled": 10}
"""Kind of order -> how many come in an hour, besides those of the customers."""

WINDOW = 60.0
"""Seconds of world time after which an order with a window is late."""

PAUSE_EVERY, PAUSE = 600.0, 15.0
"""Seconds of world time between two pauses, and how long they are."""

DRAIN = 45 * 60.0
"""Seconds of world time that the team has to do what is left."""

MOVED = 0.01
"""Metres that a robot that stands does not move."""

KILLED = "robot_2"
RUN = "shift"


class Fates(NamedTuple):
    """What a log says of the orders: ``ended``, order -> how it ended, as often as it did; and
    ``waits``, order -> seconds of wall time from its coming in to its first robot."""

    ended: Dict[str, List[str]]
    waits: Dict[str, float]


def fates(log: EventLog) -> Fates:
    """What became of the orders of a log."""
    ended: Dict[str, List[str]] = {}
    came: Dict[str, float] = {}
    waits: Dict[str, float] = {}
    for step in replay(log):
        now = float(step.record["wall"])
        for entry in step.entries:
            if isinstance(entry, log_entries.Submit):
                came.setdefault(entry.id, now)
        for firing in step.firings:
            for move in firing.tasks:
                if move.target.startswith("robot "):
                    waits.setdefault(move.id, now - came.get(move.id, now))
        for command in step.commands:
            if isinstance(command, TaskEnded):
                ended.setdefault(command.id, []).append(command.outcome)
    return Fates(ended, waits)


class Shift:
    """The orders about a running warehouse.

    :param seconds: how long there are new ones (s of world time).
    :param factor: seconds of world time in a second.
    """

    def __init__(
        self, watcher: ShopWatcher, master: Master, robots: int, seconds: float, factor: float
    ) -> None:
        self.watcher, self._master, self._robots = watcher, master, robots
        self._factor = factor
        key = os.path.join(master.folder, "gspn", RUN, "team.key")
        self._team = gspn.Team(run=RUN, key_file=key)
        self._shelves = load_settings(_file("shop.yaml"))["shelves"]
        self.submitted: Counter[str] = Counter()
        """Kind of order -> how many were submitted."""
        self.refused: List[str] = []
        """Orders that the team did not carry out, with the reason."""
        self.moved: List[float] = []
        """For each stop, how far a robot moved at most from one second after it on (m)."""
        self.killed = self.returned = 0.0
        self._to_cancel: List[str] = []
        self._due = self._planned(seconds)

    def _planned(self, seconds: float) -> List[Tuple[float, Callable[[], None]]]:
        due: List[Tuple[float, Callable[[], None]]] = []
        for kind, an_hour in AN_HOUR.items():
            number = max(2, round(an_hour * seconds / 3600))
            for k in range(number):
                due.append(((k + 0.5) * seconds / number, partial(self._one, kind, k)))
        pauses = int(seconds / PAUSE_EVERY)
        due += [((k + 0.9) * PAUSE_EVERY, self._stop_and_go_on) for k in range(pauses)]
        return sorted(due, key=lambda item: item[0])

    def _one(self, kind: str, number: int) -> None:
        """Submit an order of a kind."""
        shelf = sorted(self._shelves)[number % len(self._shelves)]
        name = "%s_%d" % (kind, number + 1)
        data = CustomerOrder(name, shelf, Pose(*self._shelves[shelf])).to_json()
        del data["id"]  # which is an argument of its own
        until = math.ceil(time.time() + WINDOW / self._factor)
        kinds: Dict[str, Dict[str, Any]] = {
            "urgent": {"priority": 5},
            "assigned": {"to": "robot_%d" % (1 if number % 2 else self._robots)},
            "window": {"priority": -1, "until": until},
            "cancelled": {},
        }
        self._order(self._team.submit, "order", id=name, data=data, **kinds[kind])
        self.submitted[kind] += 1
        if kind == "cancelled" and number % 2:
            self._cancel(name)
        elif kind == "cancelled":
            self._to_cancel.append(name)

    def _order(self, order: Callable[..., Any], *words: Any, **more: Any) -> None:
        try:
            order(*words, **more)
        except GspnError as error:
            self.refused.append(str(error))

    def _cancel(self, name: str) -> None:
        with contextlib.suppress(GspnError):  # it may be done by now, which the logs tell
            self._team.cancel(name)

    def _stop_and_go_on(self) -> None:
        """Stop the team, look whether a robot moves, and let it go on."""
        self._order(self._team.pause, stop=True)
        begin = self.watcher.time
        self._wait_until(begin + 1.0)
        stood = self.watcher.poses()
        self._wait_until(begin + PAUSE)
        now = self.watcher.poses()
        self.moved.append(max(math.dist(stood[name][:2], now[name][:2]) for name in stood))
        self._order(self._team.resume)

    def _wait_until(self, when: float) -> None:
        while self.watcher.time < when:
            self._master.programs.check()
            time.sleep(0.02)

    def step(self, seconds: float) -> None:
        """Do what is due."""
        now = self.watcher.time
        while self._due and self._due[0][0] <= now:
            self._due.pop(0)[1]()
        tasks = self._tasks() if self._to_cancel or not self.killed else []
        for task in tasks:
            if task["id"] in self._to_cancel and task["robot"]:
                self._to_cancel.remove(task["id"])
                self._cancel(task["id"])
            if not self.killed and now > seconds / 3 and task["robot"] == KILLED:
                os.kill(self._master.process_of("/%s/executor" % KILLED), signal.SIGKILL)
                self.killed = now
        if self.killed and not self.returned and now > max(seconds / 2, self.killed + 60):
            words = launch_words(
                "robot.launch",
                plan=_file("room.json"),
                number=int(KILLED.split("_")[1]),
                robots=self._robots,
                run=RUN,
            )
            self._master.programs.start(KILLED, words)
            self.returned = now

    def _tasks(self) -> List[Dict[str, Any]]:
        try:
            return list(self._team.tasks()["tasks"])
        except GspnError:
            return []  # a robot that dies does not answer

    def is_over(self, seconds: float) -> bool:
        """Whether everything was ordered and nothing is left to do."""
        late = self.watcher.time > seconds and not self._due
        return late and not self._tasks()

    def close(self) -> None:
        """End the connection with the team."""
        self._team.close()


def measure(robots: int, minutes: float, factor: float, seed: int) -> Dict[str, Any]:
    """One shift.

    :param minutes: world time during which there are new orders (min).
    :param factor: the requested real-time factor.
    :param seed: of the customers' orders and of the person.
    :raises UsageError: ROS is missing.
    :raises ExecutionError: the team does not start, or ends by itself.
    """
    need_ros()
    seconds = minutes * 60
    with Master() as master:
        import rospy

        rospy.init_node("bench_shift", anonymous=True, disable_signals=True)
        watcher = ShopWatcher()
        words = launch_words(
            "warehouse.launch",
            robots=robots,
            orders_for=seconds,
            real_time_factor=factor,
            seed=seed,
            run=RUN,
        )
        begin = time.monotonic()
        master.programs.start(RUN, words)
        try:
            while not watcher.fired:
                master.programs.check()
                if time.monotonic() - begin > START:
                    said = master.programs.said(RUN)
                    raise ExecutionError("nothing fired within %g s" % START, hint=said)
                time.sleep(0.2)
            shift = Shift(watcher, master, robots, seconds, factor)
            while not shift.is_over(seconds) and watcher.time < seconds + DRAIN:
                master.programs.check()
                shift.step(seconds)
                time.sleep(0.2)
            reached = watcher.time / (time.monotonic() - begin)
            shift.close()
        finally:
            master.programs.stop(RUN, KILLED)
            rospy.signal_shutdown("measured")
        logs = [read_log(path) for path in log_files([os.path.join(master.folder, "gspn", RUN)])]
    found, verdict = fates(max(logs, key=lambda log: len(log.records))), verify(logs)
    return {
        "robots": robots,
        "minutes": round(watcher.time / 60, 1),
        "real_time_factor": round(reached, 2),
        "killed_at": round(shift.killed, 1),
        "returned_at": round(shift.returned, 1),
        **_of_orders(found, set(watcher.ordered), shift.submitted, reached),
        "stops": len(shift.moved),
        "most_moved_after_a_stop": max(shift.moved, default=0.0),
        "refused": shift.refused,
        "verdict": verdict_text(verdict),
        **{
            key: watcher.report.get(key)
            for key in (
                "distance",
                "contacts_between_robots",
                "contacts_with_solids",
                "visits_of_people",
                "contacts_with_people",
            )
        },
    }


def _of_orders(
    found: Fates, customers: Set[str], submitted: Counter[str], factor: float
) -> Dict[str, Any]:
    """What became of the orders, by kind, and how long they waited (s of world time)."""
    names = {
        kind: ["%s_%d" % (kind, k + 1) for k in range(number)] for kind, number in submitted.items()
    }
    ordered = {"customers": sorted(customers), **names}
    every = [order for orders in ordered.values() for order in orders]
    outcomes = {
        kind: dict(Counter(found.ended.get(order, ["open"])[0] for order in orders))
        for kind, orders in ordered.items()
    }
    waits = {
        kind: [factor * found.waits[order] for order in ordered[kind] if order in found.waits]
        for kind in ("urgent", "customers")
    }
    return {
        "orders": len(every),
        "ended_once": sum(len(found.ended.get(order, [])) == 1 for order in every),
        "outcomes": outcomes,
        **{
            "mean_wait_of_%s" % kind: round(statistics.mean(seconds), 1) if seconds else None
            for kind, seconds in waits.items()
        },
    }


def faults(result: Dict[str, Any]) -> List[str]:
    """What went wrong in a shift, for people."""
    found = []
    if result["ended_once"] != result["orders"]:
        found.append("not every order ended exactly once")
    allowed = {"window": {"done", "late"}, "cancelled": {"done", "cancelled"}}
    for kind, outcomes in result["outcomes"].items():
        if set(outcomes) - allowed.get(kind, {"done"}):
            found.append("orders of the kind '%s' ended as %s" % (kind, outcomes))
    if "cancelled" not in result["outcomes"]["cancelled"]:
        found.append("no order was cancelled")
    if not 2 * result["mean_wait_of_urgent"] < result["mean_wait_of_customers"]:
        found.append("urgent orders did not wait less than half as long")
    if result["most_moved_after_a_stop"] > MOVED:
        found.append("a robot moved after a stop")
    if any(number for key, number in result.items() if key.startswith("contacts")):
        found.append("something was touched")
    if result["refused"]:
        found.append("the team refused orders")
    if not result["returned_at"]:
        found.append("no robot was killed and came back")
    if result["verdict"] != "valid":
        found.append("the logs are not valid")
    return found


def _file(name: str) -> str:
    return os.path.join(plans_folder(), "warehouse", name)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark; returns 0: nothing went wrong; 1: otherwise."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.shift", description="A shift in the warehouse."
    )
    parser.add_argument("--robots", type=int, default=4, help="robots (4)")
    parser.add_argument("--minutes", type=float, default=60.0, help="world time of the shift (60)")
    parser.add_argument("--factor", type=float, default=1.0, help="real-time factor (1)")
    parser.add_argument("--seed", type=int, default=0, help="of the orders and of the person (0)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    end_cleanly_on_signal()
    result = measure(args.robots, args.minutes, args.factor, args.seed)
    wrong = faults(result)
    machine = describe_machine(LIBRARIES)
    if args.json:
        print(json.dumps({"machine": machine, "result": result, "faults": wrong}, indent=2))
    else:
        print(machine_line(machine) + "\n")
        for name, value in result.items():
            print("%-28s %s" % (name.replace("_", " "), value))
        print("\n" + ("; ".join(wrong) or "nothing went wrong"))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())

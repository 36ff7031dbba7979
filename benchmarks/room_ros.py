"""The critical room with the whole system: ``patrol.launch``, observed from outside (see
:mod:`.room`)."""

from __future__ import annotations

import json
import os
import re
import signal
import threading
import time
from typing import Any, Dict, List, Optional, Tuple

from benchmarks.harness.master import Master, need_ros
from benchmarks.harness.processes import cost_of, descendants
from benchmarks.harness.team import launch_words
from benchmarks.room_report import figures, verdict_text
from gspn_framework_package.execution.event_log import EventLog, log_files, read_log
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.world.referee import EntryOrder
from gspn_framework_package.world.room import Room
from gspn_framework_package.world.room_file import load_room

START = 120.0
"""Seconds within which the first robot must have driven."""

PATROL, AGAIN = "patrol", "again"
"""The programs of a run: all, and the node that comes back."""

_CHECK = re.compile(r"Go_Check_(\w+)$")
_PLACE = re.compile(r"(Check_Temperature|Alarm|Decide)_(\w+)$")


class Watcher:
    """Listens to a patrol: the referee's report, and the checks that the plan grants."""

    def __init__(self, room: Room) -> None:
        import rospy
        from std_msgs.msg import String

        from gspn_framework_package.msg import FiredTransition

        self._lock = threading.Lock()
        self._room = room
        self.report: Dict[str, Any] = {}
        self.world: Dict[str, Any] = {"time": 0.0}
        self.firings: Dict[Tuple[int, int], Tuple[str, str]] = {}
        self.rule_broken = 0
        rospy.Subscriber("/world/referee", String, self._on_report, queue_size=1)
        rospy.Subscriber("/world/state", String, self._on_state, queue_size=1)
        rospy.Subscriber("/fired_transitions", FiredTransition, self._on_firing, queue_size=1000)

    def _on_report(self, message: Any) -> None:
        report = json.loads(message.data)
        with self._lock:
            self.report = report

    def _on_state(self, message: Any) -> None:
        world = json.loads(message.data)
        with self._lock:
            self.world = world

    def _on_firing(self, message: Any) -> None:
        inside: Dict[str, int] = {}
        for place, count in zip(message.places, message.counts):
            match = _PLACE.search(place)
            if match is not None and match.group(1) != "Decide":
                inside[match.group(2)] = inside.get(match.group(2), 0) + count
        with self._lock:
            self.firings[(message.slot, message.index)] = (message.transition, message.robot)
            self.rule_broken += any(count > 1 for count in inside.values())

    @property
    def time(self) -> float:
        """Seconds of world time."""
        with self._lock:
            return float(self.world["time"])

    def is_between(self, robot: str) -> bool:
        """Whether a robot is driving, and in no location."""
        with self._lock:
            seen = self.world.get("robots", {}).get(robot)
        if seen is None or seen["status"] != "driving":
            return False
        x, y, _ = seen["pose"]
        return all(place.area.distance((x, y)) > 0.2 for place in self._room.locations.values())

    def entries(self, robot: str) -> Tuple[int, int]:
        """The number of locations entered so far: by a robot, and by all others together."""
        with self._lock:
            tallies = self.report.get("robots", {})
        own = int(tallies[robot]["entries"]) if robot in tallies else 0
        return own, sum(int(tally["entries"]) for tally in tallies.values()) - own

    def grants(self) -> List[Tuple[str, str]]:
        """The robot and the location of each check that the plan granted, in the order of the
        log."""
        with self._lock:
            fired = [self.firings[position] for position in sorted(self.firings)]
        found = [(robot, _CHECK.search(transition)) for transition, robot in fired]
        return [(robot, match.group(1)) for robot, match in found if match is not None]


class Loss:
    """Kills the execution node of one robot in mid-patrol, and restarts it later.

    The node is killed (SIGKILL) in the second third of the run, while the robot is between two
    locations, so that its body obstructs the others; it returns in the last third.

    :param robot: the robot that is lost, the second of the team.
    """

    def __init__(self, robot: str, minutes: float, command: List[str]) -> None:
        self.robot, self._end = robot, minutes * 60
        self._command = command
        self.killed: Optional[Tuple[float, int, int]] = None
        self.returned: Optional[Tuple[float, int, int]] = None

    def poll(self, watcher: Watcher, master: Master) -> None:
        """Kill or restart the node if it is time."""
        if self.killed is None and watcher.time > self._end / 3 and watcher.is_between(self.robot):
            os.kill(master.process_of("/%s/executor" % self.robot), signal.SIGKILL)
            self.killed = (watcher.time, *watcher.entries(self.robot))
        elif self.killed and self.returned is None and watcher.time > self._end * 2 / 3:
            master.programs.start(AGAIN, self._command)
            self.returned = (watcher.time, *watcher.entries(self.robot))

    def report(self, watcher: Watcher) -> Dict[str, Any]:
        """When the robot was lost, and how many locations were entered before, during and after the
        loss."""
        if self.killed is None or self.returned is None:
            raise ExecutionError(
                "%s was never between two locations" % self.robot, hint="give more minutes"
            )
        last = watcher.entries(self.robot)
        return {
            "robot": self.robot,
            "lost_at": self.killed[0],
            "returned_at": self.returned[0],
            "entries_of_others_meanwhile": self.returned[2] - self.killed[2],
            "own_entries_meanwhile": self.returned[1] - self.killed[1],
            "entries_of_others_after": last[1] - self.returned[2],
            "own_entries_after": last[0] - self.returned[1],
        }


def measure_ros(
    room: str, robots: int, seed: int, minutes: float, factor: float, lose: bool = False
) -> Dict[str, Any]:
    """One run of the whole system.

    :param room: the room file.
    :param robots: size of the team.
    :param seed: only names the run: the plan makes the random draws, and the machine determines how
      the threads interleave.
    :param minutes: world time (min).
    :param factor: the requested real-time factor.
    :param lose: whether to kill a robot in mid-patrol and restart it: :class:`Loss`.
    :raises UsageError: ROS is missing.
    :raises ExecutionError: the team does not start, or ends by itself.
    """
    need_ros()
    path = os.path.join(plans_folder(), "patrol", "room.json")
    plan = read_plan(path).for_robots(robots)
    names = [robot.name for robot in plan.robots]
    with Master() as master:
        import rospy

        rospy.init_node("bench_room", anonymous=True, disable_signals=True)
        watcher = Watcher(load_room(room))
        run = "room_%d" % seed
        again = launch_words("robot.launch", plan=path, number=2, robots=robots, run=run)
        loss = Loss(names[1], minutes, again) if lose else None
        words = launch_words(
            "patrol.launch",
            robots=robots,
            world=os.path.abspath(room),
            real_time_factor=factor,
            run=run,
        )
        master.programs.start(PATROL, words)
        try:
            result = _watch(watcher, plan, seed, minutes, master, loss)
        finally:
            master.programs.stop(PATROL, AGAIN)
            rospy.signal_shutdown("measured")
        return {**result, **read_logs(os.path.join(master.folder, "gspn", run))}


def read_logs(folder: str) -> Dict[str, Any]:
    """The findings from the robots' own logs of a run: whether they are consistent and valid
    (``gspn verify``), and failed actions."""
    logs = [read_log(path) for path in log_files([folder])]
    verdict = verify(logs)
    # each robot's log has all of them, up to its own end
    failed = {
        tuple(entry[key] for key in ("robot", "incarnation", "visit", "attempt"))
        for log in logs
        for record in log.records
        for entry in record.get("entries", ())
        if entry["entry"] == "failed"
    }
    return {
        "failed_actions": len(failed),
        "policy_misses": count_policy_misses(max(logs, key=lambda log: len(log.records))),
        "log_violations": int(verdict.violation is not None),
        "verdict": verdict_text(verdict),
        "slots": verdict.slots,
    }


def count_policy_misses(event_log: EventLog) -> int:
    """How many transitions of a log were drawn by their weights because no row of the policy
    matched."""
    net, policy = event_log.plan.net, event_log.plan.policy.bind(event_log.plan.net)
    misses = 0
    for step in replay(event_log):
        for firing in step.firings:
            if firing.drawn is not None:
                before = list(firing.marking)
                t = net.transition_index[firing.transition]
                for place, change in net.effect(t):
                    before[place] -= change
                misses += not policy.matches(before, net.inputs[t][0][0])
    return misses


def _watch(
    watcher: Watcher,
    plan: Any,
    seed: int,
    minutes: float,
    master: Master,
    loss: Optional[Loss],
) -> Dict[str, Any]:
    begin = time.monotonic()
    first: Optional[Tuple[float, float, float]] = None
    # count from the first firing: the start-up of the team is reported separately
    while first is None or watcher.time < first[1] + minutes * 60:
        master.programs.check()
        if first is None and watcher.firings:
            cost = cost_of(descendants(master.programs.pid(PATROL)))
            first = (time.monotonic(), watcher.time, cost.cpu_seconds)
        if first is None and time.monotonic() - begin > START:
            said = master.programs.said(PATROL)
            raise ExecutionError("nothing fired within %g s" % START, hint=said)
        if loss is not None:
            loss.poll(watcher, master)
        time.sleep(0.2)
    cost = cost_of(descendants(master.programs.pid(PATROL)))
    wall, simulated = time.monotonic() - first[0], watcher.time - first[1]
    order = EntryOrder()
    for robot in plan.robots:
        match = _PLACE.search(robot.place)
        if match is not None:
            order.grant(robot.name, match.group(2))
    for robot_name, location in watcher.grants():
        order.grant(robot_name, location)
    for moment, robot_name, location in watcher.report["entry_log"]:
        order.enter(robot_name, location, moment)
    lost = {"loss": loss.report(watcher)} if loss is not None else {}
    return {
        **lost,
        "robots": len(plan.robots),
        "seed": seed,
        **figures(watcher.report),
        "overtakings": len(order.out_of_turn),
        "rule_broken_in_marking": watcher.rule_broken,
        "firings": len(watcher.firings),
        "start_seconds": first[0] - begin,
        "real_time_factor": simulated / wall,
        "cpu_seconds_per_minute": (cost.cpu_seconds - first[2]) / (simulated / 60),
        "memory_mb": cost.pss_mb,
        "processes": cost.processes,
    }

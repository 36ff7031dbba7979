"""Observes a team from outside: the places of the robots, the firings and their rate."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from typing import Deque, Dict, List, NamedTuple, Sequence, Tuple

import rospy
from std_msgs.msg import String

from gspn_framework_package.msg import FiredTransition
from gspn_framework_package.ros.messages import FIRED_TOPIC
from gspn_framework_package.team.message_filter import json_object

_ACTIVITY_FIELDS = {"run", "place", "state", "visit", "waits_for", "ended", "fault"}


class Doing(NamedTuple):
    """The activity of a robot, according to its last message."""

    place: str
    state: str
    visit: int
    waits_for: str


class TeamMonitor:
    """Observes a team; its methods may be called from any thread.

    It subscribes to ``/fired_transitions`` (gspn_framework_package/FiredTransition) and, for each
    robot, ``NAMESPACE/activity`` (std_msgs/String). The robots neither know about it nor wait for
    it.

    :param robots: (name, namespace, initial place) of each robot.
    :param run: name of the run; other runs are ignored.

    :ivar ended: why the run is over, according to its robots; "" while it is running.
    :ivar fault: whether it ended because of a fault.
    """

    def __init__(self, robots: Sequence[Tuple[str, str, str]], run: str) -> None:
        self._lock = threading.Lock()
        self._run = run
        self.doing: Dict[str, Doing] = {
            name: Doing(place, "", 0, "not heard of yet") for name, _, place in robots
        }
        self.transitions: Counter[str] = Counter()
        self.moves: Counter[str] = Counter()
        self.marking: Dict[str, int] = {}
        self.firings = 0
        self.ended = ""
        self.fault = False
        self._recent: Deque[Tuple[float, str]] = deque(maxlen=1000)
        self._times: Deque[float] = deque()
        rospy.Subscriber(FIRED_TOPIC, FiredTransition, self._on_fired, tcp_nodelay=True)
        for name, namespace, _ in robots:
            topic = rospy.names.ns_join(namespace, "activity")
            rospy.Subscriber(topic, String, self._on_activity, callback_args=name)

    def _on_fired(self, message: FiredTransition) -> None:
        if message.run != self._run:
            return
        now = time.monotonic()
        moved = ", ".join("%s to %s" % pair for pair in zip(message.robots, message.robot_places))
        with self._lock:
            self.firings += 1
            self.transitions[message.transition] += 1
            self._times.append(now)
            self._recent.append((now, message.transition + (": " + moved if moved else "")))
            if not message.private_move:
                self.marking = dict(zip(message.places, message.counts))
            for robot, place in zip(message.robots, message.robot_places):
                self.moves[robot] += 1
                before = self.doing.get(robot, Doing("", "", 0, ""))
                self.doing[robot] = before._replace(place=place, waits_for="")

    def _on_activity(self, message: String, name: str) -> None:
        shown = json_object(message.data)
        if shown is None or not _ACTIVITY_FIELDS <= set(shown):
            return  # not a message of an execution node
        with self._lock:
            if shown["run"] != self._run:
                return
            self.doing[name] = Doing(
                shown["place"], shown["state"], shown["visit"], shown["waits_for"]
            )
            self.ended = shown["ended"] or self.ended
            self.fault = self.fault or bool(shown["fault"])

    def rate(self, seconds: float = 5.0) -> float:
        """Firings per second over the last ``seconds``."""
        with self._lock:
            limit = time.monotonic() - seconds
            while self._times and self._times[0] < limit:
                self._times.popleft()
            return len(self._times) / seconds

    def recent(self, since: float) -> List[Tuple[float, str]]:
        """The firings after the monotonic time ``since`` (at most the last 1,000): (time, the
        transition and the moves)."""
        with self._lock:
            return [item for item in self._recent if item[0] > since]

    def snapshot(self) -> Dict[str, Doing]:
        """The activity of each robot, by name."""
        with self._lock:
            return dict(self.doing)

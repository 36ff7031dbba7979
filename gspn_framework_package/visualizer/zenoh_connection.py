"""The page's connection to a team over Zenoh."""

from __future__ import annotations

import sys
import threading
import time
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Set

from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.operator_client import UnreachableError
from gspn_framework_package.team.zenoh_operator import ZenohLine, robot_at
from gspn_framework_package.team.zenoh_session import TeamAccess, key_of
from gspn_framework_package.team.zenoh_watch import Sights, ZenohWatch
from gspn_framework_package.visualizer.live_comparison import Departures

QUIET = 30.0
"""Seconds for which the same line is not printed again."""

_MOST_ROBOTS = 10_000


class FiredFields(NamedTuple):
    """A firing as a robot publishes it (see
    :func:`~gspn_framework_package.execution.team_messages.firing_fields`); a
    :class:`~gspn_framework_package.visualizer.fired_follower.FiredMessage`."""

    plan: str
    run: str
    transition: str
    robot: str
    visit: int
    robots: List[str]
    robot_places: List[str]
    places: List[str]
    counts: List[int]
    slot: int
    index: int  # type: ignore[assignment]  # hides tuple.index, unused
    private_move: bool
    details: str


_TYPES = {
    **dict.fromkeys(("plan", "run", "transition", "robot", "details"), str),
    **dict.fromkeys(("visit", "slot", "index"), int),
    "private_move": bool,
}
_LISTS = {"robots": str, "robot_places": str, "places": str, "counts": int}


def read_fired(fields: Dict[str, Any]) -> Optional[FiredFields]:
    """The firing in a JSON object from the network; None if it is not one."""
    single = all(type(fields.get(name)) is kind for name, kind in _TYPES.items())
    listed = single and all(
        isinstance(fields.get(name), list) and all(type(value) is kind for value in fields[name])
        for name, kind in _LISTS.items()
    )
    return FiredFields(*(fields[name] for name in FiredFields._fields)) if listed else None


_ACTIVITY = {
    "robot": str,
    "run": str,
    "plan": str,
    "state": str,
    "waits_for": str,
    "needs_operator": bool,
    "finished": bool,
    "fault": bool,
}


def is_activity(fields: Dict[str, Any]) -> bool:
    """Whether a JSON object from the network reports what a robot does."""
    return (
        all(isinstance(fields.get(name), kind) for name, kind in _ACTIVITY.items())
        and isinstance(fields.get("ended", 0), (str, type(None)))
        and isinstance(fields.get("feedback", []), (list, type(None)))
    )


class ZenohConnection:
    """A :class:`~gspn_framework_package.visualizer.team_connection.TeamConnection` over Zenoh;
    a robot's address is the beginning of its keys. Without keys, or with those of an operator, the
    page gives orders.

    :param access: the access to the team.
    :param run: the run to watch; "" for all.
    :raises GspnError: there is no session with the team.

    :ivar orders: whether the page may give orders.
    """

    says = "a team of robots on Zenoh"
    where = "of this network"

    def __init__(self, access: TeamAccess, run: str = "") -> None:
        self._endpoints = ", ".join(access.connect)
        self._seen: Callable[..., None] = lambda *_: None
        self._lock = threading.Lock()
        self._found: Set[str] = set()
        self._reported: Dict[str, float] = {}
        self._watch = ZenohWatch(access, run, Sights(self._on_fired, self._on_activity))
        self.orders = self._watch.operator.gives_orders

    def open(self, seen: Callable[..., None]) -> None:
        """See :class:`TeamConnection`."""
        self._seen = seen

    def close(self) -> None:
        """See :class:`TeamConnection`."""
        self._watch.close()

    def find(self) -> Set[str]:
        """See :class:`TeamConnection`."""
        if not self._watch.operator.connected:
            raise UnreachableError("%s does not answer; trying again" % self._endpoints)
        self._watch.ask_activity()
        with self._lock:
            return set(self._found)

    def line(self, seconds: float) -> ZenohLine:
        """See :class:`TeamConnection`."""
        return ZenohLine(self._watch.operator, seconds)

    def label(self, address: str) -> str:
        """See :class:`TeamConnection`."""
        return robot_at(address)

    def why_unheard(self) -> str:
        """See :class:`TeamConnection`."""
        return " through %s" % self._endpoints

    def report(self, text: str) -> None:
        """See :class:`TeamConnection`."""
        now = time.monotonic()
        if now - self._reported.get(text, -QUIET) >= QUIET:
            self._reported = {t: at for t, at in self._reported.items() if now - at < QUIET}
            self._reported[text] = now
            print(text, file=sys.stderr, flush=True)

    def report_departures(self, plan: Plan, run: str, found: Departures) -> None:
        """See :class:`TeamConnection`."""
        for alarm in found.new:
            self.report("the run departs from the plan: %s" % alarm.describe())

    def _on_fired(self, robot: str, fields: Dict[str, Any]) -> None:
        fired = read_fired(fields)
        if fired is None:
            self.report("the page: a firing of %s cannot be read" % robot)
        else:
            self._seen("fired", fired)

    def _on_activity(self, robot: str, fields: Dict[str, Any]) -> None:
        if not is_activity(fields) or fields["robot"] != robot:
            if set(fields) != {"run"}:  # a robot that has started but done nothing yet
                self.report("the page: the activity of %s cannot be read" % robot)
            return
        address = key_of(fields["run"], robot)
        with self._lock:
            if len(self._found) < _MOST_ROBOTS:
                self._found.add(address)
        self._seen("activity", address, fields)

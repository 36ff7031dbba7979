"""Follows a team by ``fired_transitions`` alone. Firings may arrive late, twice, out of order or
not at all. This module does not use ROS: live and recorded (rosbag) messages come as
:class:`FiredMessage`.

In full synchronisation a message carries the marking that the whole team agrees on: a firing is
accepted if it leads from the marking shown to the one it carries. In partial synchronisation each
robot only knows its own marking: a firing is accepted if it ends the visit that its robot is known
to be in. A firing that does not fit waits briefly for the missing ones; after that, the team must
be asked.
"""

from __future__ import annotations

import json
from typing import (
    Any,
    Collection,
    Dict,
    FrozenSet,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    Tuple,
)

from gspn_framework_package.execution.displayed_data import cause_text
from gspn_framework_package.execution.enabled_set import EnabledSet
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.model.plan import Plan, Synchronisation
from gspn_framework_package.visualizer.board import Board, Event, RobotMove, fire_event, mark_event

GAP_PATIENCE = 0.25
"""Seconds for which a firing that does not fit waits for the missing ones."""

_WAITING = 500
"""Largest number of waiting firings; if there are more, the team is asked."""


class FiredMessage(Protocol):
    """A message of ``fired_transitions`` (gspn_framework_package/FiredTransition), live or from a
    bag."""

    plan: str
    run: str
    transition: str
    robot: str
    visit: int
    robots: Sequence[str]
    robot_places: Sequence[str]
    places: Sequence[str]
    counts: Sequence[int]
    slot: int
    index: int
    private_move: bool


class _Heard(NamedTuple):
    """A message, and when it was received: in seconds, on any monotonic clock."""

    message: FiredMessage
    at: float


class RobotSeen(NamedTuple):
    """Where a robot is: its place (index), and its visit if known."""

    place: int
    visit: Optional[int] = None


class TeamSeen(NamedTuple):
    """A robot's answer about the team: the marking and the robots after log slot ``slots - 1``;
    robots that are ``gone`` have no token in the net."""

    marking: Marking
    robots: Mapping[str, RobotSeen]
    slots: int
    gone: FrozenSet[str] = frozenset()


def team_seen(plan: Plan, newest: Dict[str, Any], answers: List[Dict[str, Any]]) -> TeamSeen:
    """Answers of robots about their team.

    :param newest: the answer of the robot whose log is longest.
    :param answers: those of all. In partial synchronisation, each knows only itself for certain.
    """
    robots: Dict[str, RobotSeen] = {}
    for answer in [newest] + answers:
        for robot in answer["robots"]:
            own = robot["robot"] == answer["robot"]
            known = robots.get(robot["robot"])
            if known is None or own or (known.visit or 0) < robot["visit"]:
                place = plan.net.place_index.get(robot["place"], -1)
                robots[robot["robot"]] = RobotSeen(place, int(robot["visit"]))
    marking = plan.net.marking(newest["marking"])
    gone = frozenset(r["robot"] for r in newest["robots"] if Phase.of_state(r["state"]).gone)
    if plan.synchronisation is not Synchronisation.FULL:
        counts = [
            n if p.name in plan.resource_places else 0 for p, n in zip(plan.net.places, marking)
        ]
        for name, seen in robots.items():
            if seen.place >= 0 and name not in gone:
                counts[seen.place] += 1
        marking = tuple(counts)
    return TeamSeen(marking, robots, int(newest["log_length"]), gone)


class FiredFollower:
    """Turns the messages of a team into events; see the module.

    :param plan: the plan that the team runs.
    :ivar gone: robots that no longer have a token in the net.
    :ivar lost_track: the team should be asked, and the answer passed to :meth:`adopt`.
    """

    def __init__(self, plan: Plan) -> None:
        self.net: Net = plan.net
        self.full = plan.synchronisation is Synchronisation.FULL
        self.lost_track = False
        self._enabled = EnabledSet(plan.net, plan.net.initial_marking, by_priority=False)
        self.robots: Dict[str, RobotSeen] = {
            r.name: RobotSeen(plan.net.place_number(r.place), 1) for r in plan.robots
        }
        self._waiting: List[_Heard] = []
        self._last: Tuple[int, int] = (-1, -1)
        self.gone: FrozenSet[str] = frozenset()

    @property
    def marking(self) -> Marking:
        """The marking shown."""
        return self._enabled.marking

    def board(self, status: Mapping[str, object], heard: Collection[str] = ()) -> Board:
        """The board before the first message: the initial marking of the plan.

        :param heard: the robots known to take part; those unknown to the plan are ignored.
        """
        board = Board(len(self.net.transitions), self.marking, self._enabled.now, status)
        for name, seen in self.robots.items():
            if name not in heard:
                continue
            board.robots[name] = {
                "name": name,
                "place": seen.place,
                "phase": Phase.UNHEARD.value,
                "since": 0.0,
            }
        return board

    def take(self, news: FiredMessage, heard: float) -> List[Event]:
        """Process a message; return its events for the hub, none while it has to wait.

        :param heard: when it arrived, in seconds on any monotonic clock.
        """
        if news.transition not in self.net.transition_index:
            return []
        waits = any(_same(news, other.message) for other in self._waiting)
        if not waits and not self._is_old(news):
            self._waiting.append(_Heard(news, heard))
        return self.retry(heard)

    def retry(self, now: float) -> List[Event]:
        """Accept the waiting firings that fit now; note whether any has waited too long."""
        events: List[Event] = []
        self._waiting.sort(key=lambda w: (w.message.slot, w.message.index, w.message.visit))
        again = True
        while again:
            again = False
            for number, (news, _) in enumerate(self._waiting):
                old = self._is_old(news)
                if old or self._fits(news):
                    del self._waiting[number]
                    if not old:
                        events.append(self._fire(news))
                    again = True
                    break
        late = any(now - waiting.at > GAP_PATIENCE for waiting in self._waiting)
        self.lost_track = self.lost_track or late or len(self._waiting) > _WAITING
        return events

    def is_behind(self, team: TeamSeen) -> bool:
        """Whether the answer of the team is ahead of the state shown."""
        if self.full:
            return team.slots - 1 > self._last[0] and team.marking != self.marking
        known = {name: seen.visit or 0 for name, seen in self.robots.items()}
        further = {
            n: seen.visit - known.get(n, -1)
            for n, seen in team.robots.items()
            if seen.visit is not None
        }
        if any(steps > 0 for steps in further.values()):
            return True
        # a firing that only moves counters belongs to no robot's visit
        return not any(further.values()) and team.marking != self.marking

    def meet(self, robots: Mapping[str, RobotSeen]) -> None:
        """Set the robots of the team; known ones stay where they are shown."""
        self.robots = {name: self.robots.get(name, seen) for name, seen in robots.items()}

    def adopt(self, team: TeamSeen, why: str) -> List[Event]:
        """Adopt a robot's answer about the team, and apply the messages received since."""
        self.lost_track = False
        self._last = max(self._last, (team.slots - 1, 1 << 60))
        self.robots = dict(team.robots)
        self.gone = team.gone
        events: List[Event] = []
        if team.marking != self.marking:
            events.append(self._whole(team.marking, why))
        return events + self.retry(0.0)

    def give_up(self, why: str) -> List[Event]:
        """Continue from the latest waiting message, with a note: no robot can be asked."""
        events: List[Event] = []
        self.lost_track = False
        if not self._waiting:
            return events
        news, rest = self._waiting[0].message, self._waiting[1:]
        before = list(self._carried(news) if self.full else self.marking)
        if self.full:
            for p, change in self.net.effect(self.net.transition_index[news.transition]):
                before[p] -= change
        else:
            self.robots[news.robot] = self.robots.get(news.robot, RobotSeen(-1))._replace(
                visit=news.visit
            )
            for p, change in self.net.effect(self.net.transition_index[news.transition]):
                before[p] = max(before[p], -change)
        if min(before) < 0:
            self._waiting = rest
            return events
        if tuple(before) != self.marking:
            events.append(self._whole(tuple(before), why))
        self._waiting = rest
        events.append(self._fire(news))
        return events + self.retry(0.0)

    # -- parts -------------------------------------------------------------------------------------

    def _is_old(self, news: FiredMessage) -> bool:
        if news.private_move:
            seen = self.robots.get(news.robot)
            return seen is not None and seen.visit is not None and news.visit < seen.visit
        return (news.slot, news.index) <= self._last

    def _fits(self, news: FiredMessage) -> bool:
        t = self.net.transition_index[news.transition]
        if any(self.marking[p] + change < 0 for p, change in self.net.effect(t)):
            return False
        if self.full:
            return self._after(t) == self._carried(news)
        seen = self.robots.get(news.robot)
        return seen is None or seen.visit is None or not news.robot or news.visit == seen.visit

    def _after(self, t: int) -> Marking:
        after = list(self.marking)
        for p, change in self.net.effect(t):
            after[p] += change
        return tuple(after)

    def _carried(self, news: FiredMessage) -> Marking:
        counts = dict(zip(news.places, news.counts))
        return tuple(counts.get(place.name, 0) for place in self.net.places)

    def _fire(self, news: FiredMessage) -> Event:
        t = self.net.transition_index[news.transition]
        change = self._enabled.move_to(self._after(t))
        moves: List[RobotMove] = []
        for robot, name in zip(news.robots, news.robot_places):
            target = self.net.place_index.get(name)
            if target is None:
                continue
            seen = self.robots.get(robot)
            moves.append((robot, seen.place if seen and seen.place >= 0 else None, target))
            visit = None
            if robot == news.robot:
                visit = news.visit + 1
            elif seen is not None and seen.visit is not None:
                visit = seen.visit + 1
            self.robots[robot] = RobotSeen(target, visit)
        if not news.private_move:
            self._last = max(self._last, (news.slot, news.index))
        why, tasks = _details(news)
        fired = fire_event(self.net, t, change, news.robot, moves, why=why, tasks=tasks)
        return {**fired, "s": [news.slot, news.index]}

    def _whole(self, marking: Sequence[int], why: str) -> Event:
        self._enabled.move_to(marking)
        return mark_event(self._enabled, why)


def _details(news: FiredMessage) -> Tuple[str, List[List[str]]]:
    """The cause and the tasks of a firing; none if the message lacks these details (as in bags of
    earlier versions) or they cannot be read."""
    try:
        details: Any = json.loads(getattr(news, "details", "") or "{}")
        tasks = (
            [[str(end) for end in (i, source, target)] for i, source, target in details["tasks"]]
            if "tasks" in details
            else []
        )
        return cause_text(details.get("cause", {})), tasks
    except (ValueError, TypeError, AttributeError, RecursionError):
        return "", []


def _same(a: FiredMessage, b: FiredMessage) -> bool:
    if a.private_move or b.private_move:
        return (a.private_move, a.robot, a.visit) == (b.private_move, b.robot, b.visit)
    return (a.slot, a.index) == (b.slot, b.index)

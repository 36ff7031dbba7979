"""The state that the page shows at one moment, and the events that change it.

An *event* is a JSON object that a source passes to the hub; ``k`` is its kind:

``fire``
    Transition ``tr`` (index) fired. ``d``: pairs (place index, change of its token count); ``m``:
    moves (robot, from, to) by place index, None for "from nowhere" and "to nowhere"; ``en``,
    ``dis``: the transitions that became enabled and disabled; ``who``: the robot that requested
    it; ``s``: (slot, index) in the log, if the run has one; ``why``: the cause of the event that
    fired it, a text; ``tk``: the tasks that it moved, as (id, from, to).
``undo``
    Like ``fire``, for a firing that was undone.
``mark``
    Replaces the whole ``marking`` and ``enabled`` (reset, clear, resynchronisation); ``why`` gives
    the reason. With ``restart``, the time and the firing counts start again from zero; with
    ``back``, a reset or a clear was undone, and ``counts`` are those from before the reset.
``robots``
    ``r``: the robots that changed (objects with ``name``); ``gone``: the names of robots that left.
``data``
    The data of the ``team`` and the tasks that are ``waiting`` outside, if they changed, and the
    ``queues`` that changed (see :mod:`~gspn_framework_package.execution.displayed_data`).
``plan``
    The team follows another plan from here on: the one with number ``plan`` and name ``name``. The
    plan given to the page has number 0. ``places`` and ``transitions`` map the old indices to the
    new ones (None: removed); ``marking``, ``enabled`` and the number of transitions, ``size``, are
    those of the new net.
``note``
    ``text`` for people, with a ``level`` (info, warning, fault); about ``robot``, if given.
``status``
    The fields of the status that changed: ``run`` (the name of the run shown, "" if there is none
    or it is unknown so far), ``running``, ``paused``, ``ended`` (the reason, None until then),
    ``finished``, ``stalled``, ``fault`` (whether the run ended because something broke).

The hub adds ``n`` (number, from 1), unless the source gave it, ``t`` (seconds since the
beginning), and ``p``, the number of the plan whose indices the event uses, unless that is 0.
"""

from __future__ import annotations

from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution.enabled_set import Change, EnabledSet
from gspn_framework_package.execution.phase import ENTERED
from gspn_framework_package.execution.plan_change import NewNames
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

Event = Dict[str, Any]
"""See the module."""

RobotMove = Tuple[str, Optional[int], Optional[int]]
"""(robot, from, to) by place index; None for "from nowhere" and "to nowhere"."""

NOTES_KEPT = 50
"""How many of the latest notes a board carries, so that late viewers see them."""

OF_VISIT: Mapping[str, Any] = {"held": {}, "resumed_from": 0}
"""Fields of a robot that belong to its visit, and their values in a new visit."""

_SINCE = ("place", "phase")
"""A robot's ``since`` is the time at which one of these fields last changed."""


def enter(robot: Dict[str, Any], place: int) -> None:
    """Update the entry of a robot that enters a place (index)."""
    robot.update(place=place, phase=ENTERED.value, why="")
    robot.update({key: value for key, value in OF_VISIT.items() if key in robot})


def fire_event(
    net: Net,
    t: int,
    change: Change,
    who: str = "",
    moves: Sequence[RobotMove] = (),
    back: bool = False,
    why: str = "",
    tasks: Sequence[Sequence[str]] = (),
) -> Event:
    """The event for a firing of transition ``t``, or for its undoing.

    :param change: the resulting change of the enabled transitions.
    :param who: the robot that requested it.
    :param moves: (robot, from, to), see the module.
    :param back: the firing was undone.
    :param why: the cause of the event that fired it.
    :param tasks: the tasks that it moved, see the module.
    """
    event: Event = {
        "k": "undo" if back else "fire",
        "tr": t,
        "who": who,
        "d": [[p, -count if back else count] for p, count in net.effect(t)],
        "m": [list(move) for move in moves],
        "en": list(change.added),
        "dis": list(change.removed),
    }
    if why:
        event["why"] = why
    if tasks:
        event["tk"] = [list(move) for move in tasks]
    return event


def data_event(known: Dict[str, Any], reported: Mapping[str, Any]) -> List[Event]:
    """The events for changes in a team's data and tasks; none if nothing changed.

    :param known: what was reported before; updated.
    :param reported: the present ``team``, ``queues`` and ``waiting``.
    """
    event: Event = {}
    for key in ("team", "waiting"):
        if reported[key] != known.get(key, type(reported[key])()):
            event[key] = known[key] = reported[key]
    queues = known.setdefault("queues", {})
    # a queue that is not reported is empty
    now = {**dict.fromkeys(queues, []), **reported["queues"]}
    changed = {place: tasks for place, tasks in now.items() if tasks != queues.get(place, [])}
    if changed:
        queues.update(changed)
        event["queues"] = changed
    return [{"k": "data", **event}] if event else []


def mark_event(enabled: EnabledSet, why: str) -> Event:
    """The event that replaces the marking and the enabled transitions by those of ``enabled``."""
    return {
        "k": "mark",
        "marking": list(enabled.marking),
        "enabled": sorted(enabled.now),
        "why": why,
    }


def note_event(level: str, text: str, robot: str = "") -> Event:
    """The event for a note; see the module."""
    return {"k": "note", "level": level, "robot": robot, "text": text}


def first_status(run: str, running: bool) -> Dict[str, Any]:
    """The status of a run of which nothing more is known; see the module."""
    return {
        "run": run,
        "running": running,
        "paused": False,
        "ended": None,
        "finished": False,
        "stalled": "",
        "fault": False,
    }


def renumbered(place: Optional[int], places: Sequence[Optional[int]]) -> int:
    """The new number of a robot's place; -1 if it has none in the new net.

    :param places: the new number of each place.
    """
    new = places[place] if place is not None and place >= 0 else None
    return -1 if new is None else new


def plan_event(number: int, old: Plan, new: Plan, numbers: NewNames, enabled: EnabledSet) -> Event:
    """The event for a change to another plan.

    :param number: the number of ``new``.
    :param numbers: maps the nodes of ``old`` to those of ``new``.
    :param enabled: the marking of the net of ``new``.
    """
    return {
        **mark_event(enabled, ""),
        "k": "plan",
        "plan": number,
        "name": new.name,
        "places": [numbers.place_number(p) for p in range(len(old.net.places))],
        "transitions": [numbers.transition_number(t) for t in range(len(old.net.transitions))],
        "size": len(new.net.transitions),
    }


class Board:
    """The state after the events so far.

    :param transitions: the number of transitions of the net.
    :param marking: token counts in the order of the places.
    :param enabled: indices of the enabled transitions.
    :param status: see the module.
    """

    def __init__(
        self,
        transitions: int,
        marking: Sequence[int],
        enabled: Iterable[int] = (),
        status: Mapping[str, Any] = {},
    ) -> None:
        self.n = 0
        self.t = 0.0
        self.plan = 0
        """Number of the plan that the team follows; 0 for the one given to the page."""
        self.marking: List[int] = list(marking)
        self.enabled: Set[int] = set(enabled)
        self.counts: List[int] = [0] * transitions
        self.robots: Dict[str, Dict[str, Any]] = {}
        self.data: Dict[str, Any] = {}
        self.notes: List[Event] = []
        self.status: Dict[str, Any] = dict(status)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Board:
        """Read a board from its JSON object."""
        board = cls(0, data["marking"], data["enabled"], data["status"])
        board.n, board.t, board.plan = data["n"], data["t"], data.get("plan", 0)
        board.counts = list(data["counts"])
        board.robots = {robot["name"]: dict(robot) for robot in data["robots"]}
        board.data = dict(data.get("data", {}))
        board.notes = list(data["notes"])
        return board

    def copy(self) -> Board:
        """Return an independent copy."""
        board = Board(0, self.marking, self.enabled, self.status)
        board.n, board.t, board.plan = self.n, self.t, self.plan
        board.counts = list(self.counts)
        board.robots = {name: dict(robot) for name, robot in self.robots.items()}
        board.data = dict(self.data)
        board.notes = list(self.notes)
        return board

    def admit(self, event: Event) -> None:
        """Number the next event of the run, and update the board by it."""
        event["n"] = self.n + 1
        self.apply(event)
        if self.plan:
            event["p"] = self.plan

    def apply(self, event: Event) -> None:
        """Update the board by one event."""
        self.n = event["n"]
        self.t = event["t"]
        kind = event["k"]
        if kind in ("fire", "undo"):
            for p, change in event["d"]:
                self.marking[p] += change
            self.counts[event["tr"]] += 1 if kind == "fire" else -1
            self.enabled.update(event["en"])
            self.enabled.difference_update(event["dis"])
            for name, _, target in event["m"]:
                if target is None:
                    self.robots.pop(name, None)
                else:
                    robot = self.robots.setdefault(name, {"name": name})
                    enter(robot, target)
                    robot["since"] = event["t"]
        elif kind == "mark":
            self.marking = list(event["marking"])
            self.enabled = set(event["enabled"])
            if event.get("restart"):
                self.counts = [0] * len(self.counts)
            if "counts" in event:
                self.counts = list(event["counts"])
        elif kind == "plan":
            self._change_plan(event)
        elif kind == "robots":
            for robot in event["r"]:
                known = self.robots.setdefault(robot["name"], {})
                if any(robot.get(key, known.get(key)) != known.get(key) for key in _SINCE):
                    known["since"] = event["t"]
                known.update(robot)
            for name in event.get("gone", ()):
                self.robots.pop(name, None)
        elif kind == "data":
            self.data.update({key: event[key] for key in ("team", "waiting") if key in event})
            if "queues" in event:
                self.data["queues"] = {**self.data.get("queues", {}), **event["queues"]}
        elif kind == "note":
            self.notes = self.notes[-NOTES_KEPT + 1 :] + [event]
        elif kind == "status":
            self.status.update(event["status"])

    def _change_plan(self, event: Event) -> None:
        """Continue with the net of another plan: surviving elements keep their firings and
        robots."""
        self.plan = event["plan"]
        self.marking = list(event["marking"])
        self.enabled = set(event["enabled"])
        counts, self.counts = self.counts, [0] * event["size"]
        for t, new in enumerate(event["transitions"]):
            if new is not None:
                self.counts[new] += counts[t]
        self.robots = {
            name: {**robot, "place": renumbered(robot.get("place"), event["places"])}
            for name, robot in self.robots.items()
        }

    def to_json(self) -> Dict[str, Any]:
        """The board as a JSON object."""
        return {
            "n": self.n,
            "t": self.t,
            "marking": list(self.marking),
            "enabled": sorted(self.enabled),
            "counts": list(self.counts),
            "robots": list(self.robots.values()),
            "notes": list(self.notes),
            "status": dict(self.status),
            **({"data": dict(self.data)} if self.data else {}),
            **({"plan": self.plan} if self.plan else {}),
        }

"""The tasks of a run according to its log: which ones arrived, and where they are.

This was written independently of the token game and shares no code with it (see
:mod:`.slot_check`).
"""

from __future__ import annotations

import hashlib
import json
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.model.plan import Plan

REMEMBERED_TASKS = 10_000
"""Number of task ids per transition that count as known."""

MOST_OUTSIDE = 10_000
"""Maximum number of tasks waiting for a transition; further tasks do not count."""

TaskMoves = List[Tuple[str, str, str]]
"""(id, from where, to where), as a firing records them."""


class LoggedTask:
    """A task, or a token of a queue without a task (``id`` "")."""

    def __init__(
        self,
        task_id: str = "",
        data: Optional[Mapping[str, Any]] = None,
        priority: int = 0,
        robot: str = "",
        times: Tuple[int, int] = (0, 0),
        until: int = 0,
    ) -> None:
        self.id = task_id
        self.data: Dict[str, Any] = dict(data or {})
        self.priority = priority
        self.robot = robot
        """The only robot that may take it, or a capability that such a robot has; "" for any."""
        self.at, self.every = times
        self.until = until
        self.came = 0
        """How many repetitions of it have come in."""


class Cargo:
    """The tasks of a team: outside, in queues, with robots.

    :param inputs: transition -> place -> weight.
    :param outputs: likewise.
    """

    def __init__(
        self,
        plan: Plan,
        inputs: Mapping[str, Mapping[str, int]],
        outputs: Mapping[str, Mapping[str, int]],
    ) -> None:
        self._inputs, self._outputs = inputs, outputs
        self.entrances = set(plan.submissions)
        self._ends = set(plan.tasks.done)
        self._orders = plan.tasks.order
        self._able = {robot.name: robot.capabilities for robot in plan.robots}
        self.queues: Dict[str, List[LoggedTask]] = {
            place: [
                LoggedTask() for _ in range(plan.net.places[plan.net.place_number(place)].tokens)
            ]
            for place in plan.tasks.queues
        }
        self.carried: Dict[str, LoggedTask] = {}
        """Robot -> its task."""
        self.outside: List[Tuple[str, LoggedTask]] = []
        """(transition, task) of tasks that arrived and still wait outside the net, those of the
        highest priority first, the oldest of them before the others."""
        self._known: Dict[str, List[str]] = {}
        self._known_set: Set[Tuple[str, str]] = set()

    def follow(
        self,
        plan: Plan,
        inputs: Mapping[str, Mapping[str, int]],
        outputs: Mapping[str, Mapping[str, int]],
        called: Mapping[str, str],
        heirs: Sequence[Tuple[str, str]],
        marking: Mapping[str, int],
    ) -> None:
        """Switch to another plan.

        :param called: previous name of a place or transition -> its name in this plan, if it
            differs.
        :param heirs: (previous resource place, the one that takes over its tokens).
        :param marking: the previous marking.
        """
        queues = self.queues
        self._inputs, self._outputs = inputs, outputs
        self.entrances, self._ends = set(plan.submissions), set(plan.tasks.done)
        self._orders = plan.tasks.order
        self._able = {robot.name: robot.capabilities for robot in plan.robots}
        self.queues = {place: [] for place in plan.tasks.queues}
        for place in set(self.queues) - {heir for _, heir in heirs}:
            tokens = plan.net.places[plan.net.place_number(place)].tokens
            self.queues[place] = [LoggedTask() for _ in range(tokens)]
        for place, heir in heirs:
            if heir in self.queues:
                self.queues[heir] += queues.get(
                    place, [LoggedTask() for _ in range(marking[place])]
                )
                self._in_order(heir)
        self.outside = [(called.get(t, t), task) for t, task in self.outside]
        known, self._known, self._known_set = self._known, {}, set()
        for t, ids in known.items():
            t = called.get(t, t)
            if t in plan.net.transition_index:
                mine = self._known.setdefault(t, [])
                mine += [i for i in ids if (t, i) not in self._known_set]
                self._known_set.update((t, i) for i in ids)

    # -- entries -----------------------------------------------------------------------------------

    def comes(self, entry: log_entries.Submit, gone: Sequence[str] = ()) -> str:
        """Handle an arriving task. A task that arrived before does not count, unless it was
        submitted again after its robot was gone.

        :param gone: the names of robots that are gone.
        :returns: the id of the task that it replaces; "" if none.
        """
        key = entry.transition, entry.id
        comes_again = False
        if key in self._known_set:
            ways = [t for t, task_id in self._known_set if task_id == entry.id]
            holders = [r for r in gone if r in self.carried and self.carried[r].id == entry.id]
            comes_again = entry.again and len(ways) == 1 and bool(holders)
            if not comes_again:
                return ""
        if entry.transition not in self.entrances:
            return ""
        if len(self.outside) >= MOST_OUTSIDE and MOST_OUTSIDE <= sum(
            t == entry.transition for t, _ in self.outside
        ):
            return ""
        replaced = entry.replaces if self.find(entry.replaces)[0] else ""
        ids = self._known.setdefault(entry.transition, [])
        if comes_again:
            del self.carried[holders[0]]
            ids.remove(entry.id)
        ids.append(entry.id)
        self._known_set.add(key)
        if replaced == entry.replaces:  # otherwise it is not taken: what it replaces has ended
            self._waits(entry)
        waits = {task.id for t, task in self.outside if t == entry.transition}
        for old in [i for i in ids if i not in waits][: max(0, len(ids) - REMEMBERED_TASKS)]:
            ids.remove(old)
            self._known_set.discard((entry.transition, old))
        return replaced

    def _waits(self, entry: log_entries.Submit) -> None:
        self.outside.append(
            (
                entry.transition,
                LoggedTask(
                    entry.id,
                    entry.data,
                    entry.priority,
                    entry.to,
                    (entry.at, entry.every),
                    entry.until,
                ),
            )
        )
        self._in_order()

    def _in_order(self, place: str = "") -> None:
        """Put the tasks of a queue, or those outside, in order; equal ones stay as they are."""
        by = self._orders.get(place, "priority")
        if place and by == "deadline":
            ends = [task.until for task in self.queues[place]]
            never = max(ends, default=0) + 1
            self.queues[place].sort(key=lambda task: (task.until or never, -task.priority))
        elif place and by == "priority":
            self.queues[place].sort(key=lambda task: -task.priority)
        elif place:
            return
        else:
            self.outside.sort(key=lambda item: -item[1].priority)

    def due(self, entry: log_entries.TaskDue) -> None:
        """Handle the moment at which a task is to come in."""
        kind, t = self.find(entry.id)
        if kind != "outside":
            return
        item = next(item for item in self.outside if item[1].id == entry.id)
        task = item[1]
        if task.at != entry.at:
            return
        self.outside.remove(item)
        self.outside.append(item)
        if not task.every:
            task.at = 0
        else:
            while task.at <= max(entry.now, entry.at):
                task.at += task.every
            task.came += 1
            name = "%s-%d" % (task.id, task.came)
            if (t, name) not in self._known_set:
                self._known_set.add((t, name))
                self._known.setdefault(t, []).append(name)
                one = LoggedTask(name, task.data, task.priority, task.robot)
                self.outside.append((t, one))
        self._in_order()

    def find(self, task_id: str) -> Tuple[str, str]:
        """Where the task with an id is: (``robot``, its name), (``place``, its name), (``outside``,
        the transition), or empty if there is none, or several."""
        there = [("robot", r) for r, task in self.carried.items() if task.id == task_id]
        there += [("place", p) for p, q in self.queues.items() for t in q if t.id == task_id]
        there += [("outside", t) for t, task in self.outside if task.id == task_id]
        return there[0] if len(there) == 1 and task_id else ("", "")

    def remove(self, task_id: str) -> None:
        """Remove a task, wherever it is."""
        self.carried = {r: task for r, task in self.carried.items() if task.id != task_id}
        for place, queue in self.queues.items():
            self.queues[place] = [task for task in queue if task.id != task_id]
        self.outside = [(t, task) for t, task in self.outside if task.id != task_id]

    def prioritise(self, task_id: str, priority: int) -> None:
        """Give a task another priority; it goes behind those that have it already."""
        kind, where = self.find(task_id)
        if kind == "robot":
            self.carried[where].priority = priority
        elif kind == "place":
            task = next(task for task in self.queues[where] if task.id == task_id)
            task.priority = priority
            if self._orders.get(where) != "arrival":
                self.queues[where].remove(task)
                self.queues[where].append(task)
                self._in_order(where)
        elif kind == "outside":
            item = next(item for item in self.outside if item[1].id == task_id)
            item[1].priority = priority
            self.outside.remove(item)
            self.outside.append(item)
            self._in_order()

    def returned(self, robot: str, place: str, tokens: int) -> None:
        """Return tokens of a queue from a robot that is gone; the first of them is its task."""
        if place in self.queues:
            task = self.carried.pop(robot, None) or LoggedTask()
            fillers = [LoggedTask() for _ in range(tokens - 1)]
            self.queues[place] = [task, *fillers, *self.queues[place]]
            self._in_order(place)

    def are_there(self, t: str, robot: str) -> bool:
        """Whether the queues have the tasks that ``t`` takes, not counting those for other robots.

        :param robot: the robot that it moves; "" if it moves several.
        """
        return all(
            sum(self._may_have(task, robot) for task in self.queues[p]) >= n
            for p, n in self._inputs[t].items()
            if p in self.queues
        )

    # -- firings -----------------------------------------------------------------------------------

    def enter(self, t: str) -> Optional[LoggedTask]:
        """Take the oldest task waiting for ``t``."""
        for number, (transition, task) in enumerate(self.outside):
            if transition == t and not task.at:
                del self.outside[number]
                return task
        return None

    def pass_on(
        self, t: str, movers: Sequence[Tuple[str, bool]], incoming: Optional[LoggedTask]
    ) -> TaskMoves:
        """Move the tasks of a firing; returns how the firing should record it.

        :param movers: (robot, whether it stays in the net), in the order of the record.
        :param incoming: the task that arrives with it.
        """
        if not self.queues and incoming is None:
            return []
        moves: TaskMoves = []
        if t in self._ends:
            for robot, _ in movers:
                if robot in self.carried:
                    moves.append((self.carried.pop(robot).id, "robot " + robot, "done"))
        room = [p for p, n in self._outputs[t].items() if p in self.queues for _ in range(n)]
        given: List[Tuple[LoggedTask, str]] = []
        for robot, _ in movers:
            if robot in self.carried and len(given) < len(room):
                given.append((self.carried.pop(robot), "robot " + robot))
        taken: List[Tuple[LoggedTask, str]] = []
        for p, n in self._inputs[t].items():
            for _ in range(n if p in self.queues else 0):
                task = self._first_for([robot for robot, _ in movers], p)
                self.queues[p].remove(task)
                taken.append((task, "place " + p))
        if incoming is not None:
            taken.append((incoming, ""))
        loads: Iterator[Tuple[LoggedTask, str]] = iter([*given, *taken])
        for p in room:
            task, source = next(loads, (LoggedTask(), ""))
            self.queues[p].append(task)
            self._in_order(p)
            moves.append((task.id, source, "place " + p))
        for robot, stays in movers:
            if not stays and robot in self.carried:
                moves.append((self.carried.pop(robot).id, "robot " + robot, "dropped"))
        left = list(loads)
        staying = [robot for robot, stays in movers if stays]
        empty_handed = [robot for robot in staying if robot not in self.carried]
        takers = empty_handed + [robot for robot in staying if robot in self.carried]
        for (task, source), robot in zip(left, takers):
            if robot in self.carried:
                moves.append((self.carried[robot].id, "robot " + robot, "dropped"))
            self.carried[robot] = task
            moves.append((task.id, source, "robot " + robot))
        for task, source in left[len(takers) :]:
            over = t in self._ends or not source
            moves.append((task.id, source, "done" if over else "dropped"))
        return [move for move in moves if move[0]]

    def _may_have(self, task: LoggedTask, robot: str) -> bool:
        """Whether a task is for everybody, for this robot, or for robots with a capability that it
        has."""
        return task.robot in ("", robot, *self._able.get(robot, ()))

    def _first_for(self, movers: Sequence[str], place: str) -> LoggedTask:
        """The first task of a queue that is not for a robot other than the one that moves."""
        alone = movers[0] if len(movers) == 1 else ""
        theirs = (t for t in self.queues[place] if not movers or self._may_have(t, alone))
        return next(theirs, self.queues[place][0])


def recorded_moves(firing: Record) -> TaskMoves:
    """The task movements that a firing records."""
    return [(str(i), str(a), str(b)) for i, a, b in firing.get("tasks", ())]


def digest(data: Mapping[str, Any]) -> str:
    """A digest of the data that an action reads (full name -> value)."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]

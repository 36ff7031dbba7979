"""Tasks as a team has them: their data, where they are, and how they ended."""

from __future__ import annotations

import math
from typing import Any, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution.log_entries import NOTHING
from gspn_framework_package.model.data import check_values
from gspn_framework_package.model.event import BY_ARRIVAL, BY_DEADLINE
from gspn_framework_package.model.net import Net


class Task(NamedTuple):
    """A task with its data (name -> JSON value); ``id`` is "" for a token without a task.

    ``priority``, ``since``, ``until``, ``to``, ``at`` and ``every`` are those of its
    :class:`~gspn_framework_package.execution.log_entries.Submit`; ``attempts`` counts how often a
    robot took it.
    """

    id: str = ""
    data: Mapping[str, Any] = NOTHING
    priority: int = 0
    since: int = 0
    attempts: int = 0
    until: int = 0
    to: str = ""
    at: int = 0
    every: int = 0

    def to_json(self) -> List[Any]:
        """The task as a JSON value: its id, its data, and, if there are any, the other fields that
        are not 0."""
        more = {key: getattr(self, key) for key in _OF_TASKS if getattr(self, key)}
        return [self.id, dict(self.data), *([more] if more else [])]

    @classmethod
    def from_json(cls, data: Any) -> Task:
        """Parse a task. :raises ValueError, DataError: the JSON value is not a task."""
        name, values, *rest = data
        more = rest[0] if len(rest) == 1 else {}
        if not isinstance(name, str) or len(rest) > 1 or not set(more) <= set(_OF_TASKS):
            raise ValueError("not a task: %.80r" % (data,))
        if any(type(more[key]) is not type(cls._field_defaults[key]) for key in more):
            raise ValueError("a field of a task has another type: %.80r" % (more,))
        return cls(name, check_values(values, None), **more)


_OF_TASKS = ("priority", "since", "attempts", "until", "to", "at", "every")


class FoundTask(NamedTuple):
    """A task that is not done, and where it is: with ``robot``, in the queue ``place``, or outside
    the net, waiting for the transition ``before``."""

    task: Task
    robot: str = ""
    place: Optional[int] = None
    before: Optional[int] = None

    def where(self, net: Net) -> str:
        """Where it is, in words."""
        if self.place is not None:
            return "in " + net.places[self.place].name
        if self.before is not None:
            return "before " + net.transitions[self.before].name
        return "with " + self.robot


class EndedTask(NamedTuple):
    """A task that the team no longer has: ``outcome`` is one of :data:`OUTCOMES_OF_TASKS`, and
    ``why`` says more, for people."""

    id: str
    outcome: str
    why: str

    @property
    def text(self) -> str:
        """How it ended, in words."""
        return "it was %s (%s)" % (self.outcome, self.why)


TASK_DONE, TASK_CANCELLED, TASK_LATE, TASK_LOST = "done", "cancelled", "late", "lost"
OUTCOMES_OF_TASKS = (TASK_DONE, TASK_CANCELLED, TASK_LATE, TASK_LOST)
"""How a task ends: it was done, an operator cancelled it, it still waited when its time was over,
or it was dropped undone."""

ENDED_TASKS = 100
"""Number of ended tasks that a team remembers, the newest."""


def rank(task: Task, order: str) -> Tuple[float, ...]:
    """The rank of a task in a queue: lower ranks are first.

    :param order: one of :data:`~gspn_framework_package.model.event.QUEUE_ORDERS`.
    """
    if order == BY_ARRIVAL:
        return ()
    if order == BY_DEADLINE:
        return (task.until or math.inf, -task.priority)
    return (-task.priority,)


def queued(queue: Sequence[Task], task: Task, order: str, *, first: bool = False) -> List[Task]:
    """A queue with another task, behind those with at most its rank.

    :param order: see :func:`rank`.
    :param first: whether it goes before others of its rank, as one that returns does.
    """
    own = rank(task, order)
    ranks = enumerate(rank(other, order) for other in queue)
    at = next((i for i, other in ranks if other > own or (first and other == own)), len(queue))
    return [*queue[:at], task, *queue[at:]]


TASKS_NAMED = 10
"""Maximum number of tasks that a message names."""


def first_of(tasks: Sequence[str]) -> str:
    """The first tasks of several, for a message."""
    more = ", ..." if len(tasks) > TASKS_NAMED else ""
    return ", ".join(tasks[:TASKS_NAMED]) + more

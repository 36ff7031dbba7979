"""Entries of the event log: the external events that determine the whole run.

Entries that an operator can order have ``by``, the giver of the order, which robots record from
version 3 of the protocol on.

An entry is a value; ``to_json`` and ``from_json`` convert it to a JSON object and back. The field
``visit`` grows by one with each move of a robot, so a stale or repeated ``Done`` is recognised and
has no effect.
"""

from __future__ import annotations

import collections.abc
import json
import uuid
from types import MappingProxyType
from typing import Any, Dict, Mapping, NamedTuple, Tuple, Type, Union

from gspn_framework_package.model.data import check_values, why_not_kept
from gspn_framework_package.model.errors import DataError, LogError

NOTHING: Mapping[str, Any] = MappingProxyType({})
"""No data."""

ID_LIMIT = 200
"""Maximum length of the id of a task, in characters."""

PRIORITY_LIMIT = 1_000_000
"""Largest priority of a task; the least is its negative."""

WHY_LIMIT = 2_000
"""Maximum length of the reason why a robot cannot follow a plan, in characters."""


GIVER_LIMIT = 200
"""Maximum length of the name of an operator, in characters."""


class Giver(NamedTuple):
    """The giver of an order. ``proof``: how the name was authenticated (``certificate``, ``team
    key``); "" if not at all."""

    name: str = ""
    proof: str = ""


NOBODY = Giver()
"""No operator, or an unknown one."""


class Start(NamedTuple):
    """The run begins with this team: ``roster`` holds (robot, place, incarnation); ``witnesses``
    vote but have no token. ``plan`` is the hash of the plan.

    ``draws_ties``: chance decides between robots that could make the same move. In runs that began
    under version 4 of the protocol the first to finish goes first, for as long as they last.
    """

    roster: Tuple[Tuple[str, str, int], ...]
    seed: int
    plan: str
    witnesses: Tuple[str, ...] = ()
    draws_ties: bool = False


class Done(NamedTuple):
    """A robot finished the action of its visit. ``result`` names a transition, or is "" to let the
    policy decide. ``data`` maps names of data to the values that the action wrote."""

    robot: str
    incarnation: int
    visit: int
    result: str = ""
    data: Mapping[str, Any] = NOTHING


class Failed(NamedTuple):
    """An attempt at the action of a visit did not succeed; ``reason`` is one of
    :data:`~gspn_framework_package.model.outcome.FAILURES`."""

    robot: str
    incarnation: int
    visit: int
    attempt: int
    reason: str
    detail: str = ""


class Retry(NamedTuple):
    """The operator orders a robot to try its failed action again."""

    robot: str
    by: Giver = NOBODY


class Fire(NamedTuple):
    """The environment (or the operator on its behalf) fires a transition that moves no robot."""

    transition: str
    by: Giver = NOBODY


class Interrupt(NamedTuple):
    """The event of a transition occurred while a robot was in that visit, and interrupts the
    robot's action. ``cause`` holds the data of the event, e.g. fields of a message."""

    robot: str
    incarnation: int
    visit: int
    transition: str
    cause: Mapping[str, Any] = NOTHING


class Submit(NamedTuple):
    """A task arrives through a transition of the environment. Of several entries with the same
    transition and ``id``, only the first counts, except for an entry marked ``again``, whose robot
    is gone. If the transition is not enabled, the task waits until it is.

    Tasks of a higher ``priority`` come before others where they wait. ``since``: when it was
    submitted; ``until``: when it is late if it still waits (both whole seconds since 1970; 0:
    unknown, never). ``replaces``: the id of the task that it replaces, which is cancelled; if that
    has ended, this one is not taken. "" for none. Only the robot ``to`` may take it; "" for any.
    ``at``: when it comes in (seconds since 1970; 0: now); ``every`` so many seconds, from then on,
    another one like it comes in (0: none does).
    """

    transition: str
    id: str
    data: Mapping[str, Any] = NOTHING
    by: Giver = NOBODY
    again: bool = False
    priority: int = 0
    since: int = 0
    until: int = 0
    replaces: str = ""
    to: str = ""
    at: int = 0
    every: int = 0


class TaskDue(NamedTuple):
    """It is time for the task with this ``id``, which was to come in ``at`` that time; ``now`` is
    the time by the clock of the robot that says so (both seconds since 1970)."""

    id: str
    at: int
    now: int


class CancelTask(NamedTuple):
    """The task with this ``id`` is cancelled. If it waits, it is taken out; if a robot carries it,
    its action is cancelled, and the plan says where the robot goes
    (:attr:`~gspn_framework_package.model.event.Tasks.on_cancel`). ``late``: robots cancel it, if it
    still waits, because its time is over."""

    id: str
    by: Giver = NOBODY
    late: bool = False


class GiveBack(NamedTuple):
    """The robot that carries the task with this ``id`` gives it back to its queue, as ``on_evict``
    says for its place, and continues as if the task was cancelled."""

    id: str
    by: Giver = NOBODY


class PrioritiseTask(NamedTuple):
    """The task with this ``id`` gets another priority, and its place among those that wait."""

    id: str
    priority: int = 0
    by: Giver = NOBODY


class Join(NamedTuple):
    """A robot joins, or returns with a higher incarnation.

    A new robot starts in ``place``. A robot that was lost or had left returns to its last place
    with the next visit. A robot that only restarted keeps its place and visit, and its action
    starts again as the next attempt. ``log`` is the id of the robot's present log. A witness that
    lost its log also joins again, to regain its vote."""

    robot: str
    incarnation: int
    place: str = ""
    log: str = ""


class Leave(NamedTuple):
    """A robot leaves the team voluntarily and takes its token with it. The last member of a team
    cannot leave."""

    robot: str
    by: Giver = NOBODY


class Evict(NamedTuple):
    """A robot is declared lost; its token is counted as lost. ``forced`` means that the operator
    asserted that the robot is off, so its vote was not required. The last member of a team cannot
    be evicted."""

    robot: str
    incarnation: int
    forced: bool = False
    by: Giver = NOBODY


class SetPlace(NamedTuple):
    """The operator puts a robot into a place; its action there starts.

    With ``returns``, its task returns to the queue if robots carry no tasks in ``place``. Entries
    without it, of earlier versions, leave the task with the robot."""

    robot: str
    place: str
    by: Giver = NOBODY
    returns: bool = True


class Pause(NamedTuple):
    """Until ``Resume``, the robot joins no firing; if ``robot`` is "" (the team), nothing fires.
    Running actions continue. With ``stop`` they are cancelled, and none starts; those that are not
    done start again on ``Resume``."""

    robot: str = ""
    by: Giver = NOBODY
    stop: bool = False


class Resume(NamedTuple):
    """The ``Pause`` of a robot, or of the team (""), ends."""

    robot: str = ""
    by: Giver = NOBODY


class Stop(NamedTuple):
    """The operator ends the run."""

    reason: str = "stopped by the operator"
    by: Giver = NOBODY


class StagePlan(NamedTuple):
    """The operator proposes a new plan for the running team; a newer stage replaces it. ``plan`` is
    the whole new plan, as in a header, and ``digest`` its hash
    (:func:`~gspn_framework_package.execution.plan_change.digest_of`). ``mapping`` maps names of
    places and transitions in the present net to their names in the new one; "" for a resource place
    whose tokens are dropped. ``folder`` holds the plan's functions; "" for the folder at the
    start."""

    plan: Mapping[str, Any]
    digest: str
    mapping: Mapping[str, str] = NOTHING
    folder: str = ""
    by: Giver = NOBODY


class Staged(NamedTuple):
    """A member has loaded and checked the staged plan with this number. ``why`` says why it cannot
    follow it; "" if it can."""

    robot: str
    incarnation: int
    stage: int
    why: str = ""


class Adopt(NamedTuple):
    """The team follows the staged plan with this number from here on. Has no effect unless every
    member can follow the plan and the state of the team fits it."""

    stage: int
    by: Giver = NOBODY


class Unstage(NamedTuple):
    """The staged plan with this number is withdrawn."""

    stage: int
    reason: str = "given up by the operator"
    by: Giver = NOBODY


ABOUT_TASKS = (CancelTask, GiveBack, PrioritiseTask)
TaskOrder = Union[CancelTask, GiveBack, PrioritiseTask]
"""The orders about a task that the team has."""

Ordered = Union[
    Retry,
    Fire,
    Submit,
    TaskOrder,
    Leave,
    Evict,
    SetPlace,
    Pause,
    Resume,
    Stop,
    StagePlan,
    Adopt,
    Unstage,
]
"""The entries that an operator can order."""

Entry = Union[Ordered, Start, Done, TaskDue, Failed, Interrupt, Join, Staged]


def _plain_types(kind: type) -> Dict[str, type]:
    """The types of an entry's plain fields; rosters and witnesses are checked separately."""
    plain: Dict[str, type] = {"str": str, "int": int, "bool": bool}
    named = {name: getattr(t, "__forward_arg__", t) for name, t in kind.__annotations__.items()}
    return {name: plain[t] for name, t in named.items() if t in plain}


_KINDS: Dict[str, Type[Entry]] = {
    "start": Start,
    "done": Done,
    "failed": Failed,
    "retry": Retry,
    "fire": Fire,
    "interrupt": Interrupt,
    "submit": Submit,
    "task_due": TaskDue,
    "cancel": CancelTask,
    "give_back": GiveBack,
    "prioritise": PrioritiseTask,
    "join": Join,
    "leave": Leave,
    "evict": Evict,
    "set_place": SetPlace,
    "pause": Pause,
    "resume": Resume,
    "stop": Stop,
    "stage": StagePlan,
    "staged": Staged,
    "adopt": Adopt,
    "unstage": Unstage,
}

_OPEN = ("data", "cause", "plan", "mapping")
"""Fields that hold JSON objects of any content."""

_BOUNDED = frozenset((*_OPEN, "digest", "why", "id", "by", "priority", "replaces", "to"))
"""Fields that are checked for more than their type."""


_LATER = (
    "again",
    "returns",
    "draws_ties",
    "priority",
    "since",
    "until",
    "replaces",
    "to",
    "every",
    "late",
    "stop",
)
"""Fields that entries of earlier versions lack."""


class _Form(NamedTuple):
    """How entries of a kind are written and read; computed once for speed, since every message and
    every line of a log holds entries."""

    name: str
    """The kind, as it is written."""
    keys: Tuple[str, ...]
    """``entry`` and the names of the fields."""
    types: Tuple[Tuple[str, type], ...]
    """The plain fields and their types."""
    open: Tuple[str, ...]
    """Fields that are written only if they are not empty."""
    ordered: bool
    """Whether an operator can order it, so that it has ``by``, which is written if known."""
    later: Tuple[str, ...]
    """Those of :data:`_LATER` that it has."""


def _form(name: str, kind: Type[Entry]) -> _Form:
    fields = kind._fields
    return _Form(
        name,
        ("entry", *fields),
        tuple(_plain_types(kind).items()),
        tuple(key for key in _OPEN if "Mapping" in str(kind.__annotations__.get(key))),
        "by" in fields,
        tuple(key for key in _LATER if key in fields),
    )


_FORMS = {kind: _form(name, kind) for name, kind in _KINDS.items()}


def to_json(entry: Entry) -> Dict[str, Any]:
    """The entry as a JSON object: its kind under ``entry``, and its fields; ``data``, ``cause``,
    ``mapping`` and ``by`` only if they are not empty, those in :data:`_LATER` if they are true, or
    are not 0."""
    kind = type(entry)
    form = _FORMS[kind]
    fields: Dict[str, Any] = dict(zip(form.keys, (form.name, *entry)))
    for key in form.open:
        value = fields[key]
        if value is NOTHING:  # of most entries, so not looked up among the mappings
            del fields[key]
        elif isinstance(value, collections.abc.Mapping):
            if value:
                fields[key] = dict(value)
            else:
                del fields[key]
    if form.ordered:
        if any(fields["by"]):
            fields["by"] = list(fields["by"])
        else:
            del fields["by"]
    for key in form.later:
        if not fields[key]:
            del fields[key]
    if kind is Submit and not fields["at"]:
        del fields["at"]
    return fields


def checked(entry: Entry) -> Entry:
    """A copy of the entry as every reader of the log will see it.

    :raises LogError: readers would reject it: its data, cause or id is not JSON, or too long.
    """
    try:
        return from_json(json.loads(json.dumps(to_json(entry))))
    except (TypeError, ValueError, RecursionError) as error:
        raise LogError("not a log entry: its data or cause is not JSON (%s)" % error) from None


def from_json(data: Any) -> Entry:
    """Parse an entry. :raises LogError: the JSON object is not an entry."""
    try:
        kind = _KINDS[data["entry"]]
        fields = dict(data)
        del fields["entry"]
        if kind is Start:
            fields["roster"] = tuple((str(r), str(p), int(i)) for r, p, i in fields["roster"])
            fields["witnesses"] = tuple(map(str, fields.get("witnesses", ())))
        elif kind is SetPlace:
            fields.setdefault("returns", False)
        form = _FORMS[kind]
        for name, expected in form.types:
            if name in fields and type(fields[name]) is not expected:
                raise ValueError("'%s' is not of type %s" % (name, expected.__name__))
        if not _BOUNDED.isdisjoint(fields):
            _check_bounds(fields)
        return kind(**fields)
    except (KeyError, TypeError, ValueError, DataError) as error:
        raise LogError("not a log entry: %.200r (%s)" % (data, error)) from None


def new_task_id(source: str) -> str:
    """Make an id for a task that has none: ``source`` and some random digits."""
    return "%s-%s" % (source, uuid.uuid4().hex[:12])


def task_id(task: Any) -> str:
    """The id of a task, given as text or a whole number. :raises DataError: it is not an id."""
    if isinstance(task, bool) or not isinstance(task, (str, int)):
        raise DataError("the id of a task is text or a whole number, not %.100r" % (task,))
    if len(str(task)) > ID_LIMIT:
        raise DataError("the id of a task is longer than %d characters" % ID_LIMIT)
    return str(task)


def make_prioritise(task: Any, priority: int) -> PrioritiseTask:
    """Make the entry that gives a task another priority. :raises DataError: it cannot be one."""
    _check_priority(priority)
    return PrioritiseTask(task_id(task), priority)


def _check_priority(priority: int) -> None:
    if abs(priority) > PRIORITY_LIMIT:
        raise DataError(
            "the priority of a task is between %d and %d" % (-PRIORITY_LIMIT, PRIORITY_LIMIT)
        )


def make_submit(
    transition: str,
    task: Any,
    data: Mapping[str, Any],
    priority: int = 0,
    until: int = 0,
    replaces: Any = "",
    to: str = "",
    at: int = 0,
    every: int = 0,
) -> Submit:
    """Make the entry for a task from outside.

    :param task: the id of the task, text or a whole number; "" if it has none yet.
    :param data: name -> JSON value, without scopes: the names belong to the task.
    :param priority: tasks with a higher one come before others where they wait.
    :param until: when it is late if it still waits (seconds since 1970; 0: never).
    :param replaces: the id of the task that it replaces; "" for none.
    :param to: the only robot that may take it; "" for any.
    :param at: when it comes in (seconds since 1970; 0: now).
    :param every: every so many seconds from then on, another one like it comes in; 0: none does.
    :raises DataError: the id, the data or the priority cannot be stored.
    """
    name = task_id(task)
    _check_priority(priority)
    for key in check_values(data):
        if "." in key or key == "id":
            raise DataError(
                "'%.100s' is not a valid name for a task's data" % key,
                hint="write the name without a scope: 'pose' is read as task.pose, and task.id is "
                "the id",
            )
    other = task_id(replaces)
    if other and other == name:
        raise DataError("a task cannot replace itself; submit it under another id")
    if len(to) > ID_LIMIT:
        raise DataError("the name of a robot is longer than %d characters" % ID_LIMIT)
    if every and not at:
        raise DataError("a task that comes in again and again needs the time of its first one (at)")
    found = Submit(transition, name, dict(data), priority=priority, until=until, replaces=other)
    return found._replace(to=to, at=at, every=every)


def _check_bounds(fields: Dict[str, Any]) -> None:
    """:raises ValueError, DataError: data, a cause or an id is not of the right form or size."""
    if "data" in fields:
        fields["data"] = check_values(fields["data"])
    if "cause" in fields:
        cause = fields["cause"]
        why = why_not_kept(cause) if isinstance(cause, dict) else "is not an object"
        if why:
            raise ValueError("its cause %s" % why)
    if "mapping" in fields:
        mapping = fields["mapping"]
        if not isinstance(mapping, dict) or not all(isinstance(v, str) for v in mapping.values()):
            raise ValueError("its mapping does not map names to names")
    if "by" in fields:
        by = fields["by"]
        if not isinstance(by, list) or [type(text) for text in by] != [str, str]:
            raise ValueError("its field 'by' is not a name and a proof")
        if max(map(len, by)) > GIVER_LIMIT or not any(by):
            raise ValueError("its field 'by' has no name of at most %d characters" % GIVER_LIMIT)
        fields["by"] = Giver(*by)
    if "digest" in fields and not isinstance(fields["plan"], dict):
        raise ValueError("its plan is not an object")
    if len(fields.get("why", "")) > WHY_LIMIT:
        raise ValueError("its reason is longer than %d characters" % WHY_LIMIT)
    if len(fields.get("id", "")) > ID_LIMIT:
        raise ValueError("its id is longer than %d characters" % ID_LIMIT)
    for key in ("replaces", "to"):
        if len(fields.get(key, "")) > ID_LIMIT:
            raise ValueError("its field '%s' is longer than %d characters" % (key, ID_LIMIT))
    if "priority" in fields:
        _check_priority(fields["priority"])

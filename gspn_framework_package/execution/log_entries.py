"""Entries of the event log: the outside facts from which a whole run follows.

An entry is a value; ``to_json`` and ``from_json`` turn it into a JSON object and back. The field
``visit`` grows by one at each move of a robot, so a stale or repeated ``Done`` can be recognised
and has no effect.
"""

from __future__ import annotations

from typing import Any, Dict, NamedTuple, Tuple, Type, Union

from gspn_framework_package.model.errors import LogError


class Start(NamedTuple):
    """The run begins with this team: ``roster`` holds (robot, place, incarnation), ``witnesses``
    vote but have no token."""

    roster: Tuple[Tuple[str, str, int], ...]
    seed: int
    plan: str
    witnesses: Tuple[str, ...] = ()


class Done(NamedTuple):
    """A robot finished the action of its visit. ``result``: a transition, or "" for "the policy
    decides"."""

    robot: str
    incarnation: int
    visit: int
    result: str = ""


class Failed(NamedTuple):
    """An attempt at the action of a visit did not succeed; ``reason`` is one of
    :data:`FAILURES`."""

    robot: str
    incarnation: int
    visit: int
    attempt: int
    reason: str
    detail: str = ""


FAILURES = (
    "aborted",
    "rejected",
    "preempted",
    "lost",
    "timeout",
    "no server",
    "server died",
    "bad result",
)


class Retry(NamedTuple):
    """The operator orders a robot to try its failed action again."""

    robot: str


class Fire(NamedTuple):
    """The environment (or the operator in its name) fires a transition that moves no robot."""

    transition: str


class Join(NamedTuple):
    """A robot joins, or comes back with a higher incarnation. ``place`` counts for one that was
    never here; one that was lost or had left returns to its last place with the next visit; one
    that only restarted keeps place and visit, and its action is started again as the next
    attempt. ``log`` is the id of the log that it now keeps. A
    witness that lost its log joins again too, for its vote."""

    robot: str
    incarnation: int
    place: str = ""
    log: str = ""


class Leave(NamedTuple):
    """A robot leaves the team voluntarily, and takes its token along. The last member of a team
    stays."""

    robot: str


class Evict(NamedTuple):
    """A robot counts as lost; its token goes to the account of the lost. ``forced``: the
    operator asserted that it is off, and its vote was not asked for. The last member of a team
    stays."""

    robot: str
    incarnation: int
    forced: bool = False


class SetPlace(NamedTuple):
    """The operator puts a robot into a place; its action there starts."""

    robot: str
    place: str


class Pause(NamedTuple):
    """Nothing fires (``robot`` "" means the team), or the robot joins no firing, until
    ``Resume``."""

    robot: str = ""


class Resume(NamedTuple):
    """Ends a ``Pause`` of the team ("") or of a robot."""

    robot: str = ""


class Stop(NamedTuple):
    """The operator ends the run."""

    reason: str = "stopped by the operator"


Entry = Union[Start, Done, Failed, Retry, Fire, Join, Leave, Evict, SetPlace, Pause, Resume, Stop]


def _plain_types(kind: type) -> Dict[str, type]:
    """The types of an entry's fields; a roster is looked at by itself."""
    plain: Dict[str, type] = {"str": str, "int": int, "bool": bool}
    named = {name: getattr(t, "__forward_arg__", t) for name, t in kind.__annotations__.items()}
    return {name: plain[t] for name, t in named.items() if t in plain}


_KINDS: Dict[str, Type[Entry]] = {
    "start": Start,
    "done": Done,
    "failed": Failed,
    "retry": Retry,
    "fire": Fire,
    "join": Join,
    "leave": Leave,
    "evict": Evict,
    "set_place": SetPlace,
    "pause": Pause,
    "resume": Resume,
    "stop": Stop,
}
_NAMES = {kind: name for name, kind in _KINDS.items()}
_TYPES = {kind: _plain_types(kind) for kind in _KINDS.values()}


def to_json(entry: Entry) -> Dict[str, Any]:
    """The entry as a JSON object: its kind under ``entry``, beside its fields."""
    return {"entry": _NAMES[type(entry)], **entry._asdict()}


def from_json(data: Any) -> Entry:
    """The entry of a JSON object. :raises LogError: not one."""
    try:
        kind = _KINDS[data["entry"]]
        fields = {key: value for key, value in data.items() if key != "entry"}
        if kind is Start:
            fields["roster"] = tuple((str(r), str(p), int(i)) for r, p, i in fields["roster"])
            fields["witnesses"] = tuple(map(str, fields.get("witnesses", ())))
        for name, expected in _TYPES[kind].items():
            if name in fields and type(fields[name]) is not expected:
                raise ValueError("'%s' is not of type %s" % (name, expected.__name__))
        return kind(**fields)
    except (KeyError, TypeError, ValueError) as error:
        raise LogError("not a log entry: %.200r (%s)" % (data, error)) from None

"""The messages of the protocol: a class for each, with its meaning, its sender, and its answers.

Messages of peers are untrusted input. :func:`parse_envelope` rejects wrong types, values out of
bounds and other versions of the protocol, with the reason; a replica drops such a message and
continues. A message is a JSON object: the fields of :class:`Envelope`, its ``kind``, and the fields
of its body.
"""

from __future__ import annotations

from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple, Type, Union

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.ledger import Item
from gspn_framework_package.model.errors import LogError

PROTOCOL_VERSION = 6
"""Version of the protocol; replicas of different versions cannot communicate."""

MOST_ITEMS = 10_000
"""Maximum number of items in a message; more than in a batch, because a robot sends everything that
waits there."""

MOST_SLOTS = 1_000
"""Maximum number of slots in a message."""

MOST_ROBOTS = 10_000
"""Maximum number of robots named in a message."""

LONGEST_NAME = 1_000
"""Maximum length of a name, an id or a hash."""

LARGEST_NUMBER = 2**53
"""The largest number; every JSON reader reads it exactly."""


Torn = Dict[str, Tuple[str, ...]]
"""Robots whose logs lost their ends in a power loss and that were not readmitted since -> the ids
of their log and of the logs that it continues."""


class Batch(NamedTuple):
    """A proposed value. It is parsed once, on arrival, and passed on unchanged."""

    items: List[Item]
    data: List[Any]
    """The items as JSON values."""

    def changes_members(self) -> bool:
        """Whether the batch may change the members, or whose votes count."""
        kinds = (log_entries.Join, log_entries.Leave, log_entries.Evict)
        return any(isinstance(item.entry, kinds) for item in self.items)

    @classmethod
    def of(cls, items: List[Item]) -> Batch:
        """Make a batch of items."""
        return cls(items, [item.to_json() for item in items])

    @classmethod
    def from_json(cls, data: List[Any]) -> Batch:
        """Parse a batch. :raises LogError: an item is invalid."""
        return cls([Item.from_json(item) for item in data], data)


class MessageError(Exception):
    """A message does not belong to this protocol; the text says why."""


# -- fields ----------------------------------------------------------------------------------------


def _field(data: Dict[str, Any], name: str) -> Any:
    try:
        return data[name]
    except KeyError:
        raise MessageError("'%s' is missing" % name) from None


def _text(data: Dict[str, Any], name: str) -> str:
    return _name_of(_field(data, name), name)


def _name_of(value: Any, name: str) -> str:
    if not isinstance(value, str) or len(value) > LONGEST_NAME:
        raise MessageError("'%s' is not a string of at most %d characters" % (name, LONGEST_NAME))
    return value


def _texts(data: Dict[str, Any], names: Sequence[str]) -> List[str]:
    """Read several strings in one call, for speed: every message has them."""
    found = []
    for name in names:
        value = data.get(name)
        if type(value) is not str or len(value) > LONGEST_NAME:
            value = _text(data, name)
        found.append(value)
    return found


def _numbers(data: Dict[str, Any], names: Sequence[str]) -> List[int]:
    """Read several numbers in one call; see :func:`_texts`."""
    found = []
    for name in names:
        value = data.get(name)
        if type(value) is not int or not 0 <= value <= LARGEST_NUMBER:
            value = _number(data, name)
        found.append(value)
    return found


def _number(data: Dict[str, Any], name: str) -> int:
    return _number_of(_field(data, name), name)


def _number_of(value: Any, name: str) -> int:
    if type(value) is not int or not 0 <= value <= LARGEST_NUMBER:
        raise MessageError("'%s' is not a whole number from 0 to 2^53" % name)
    return value


def _flag(data: Dict[str, Any], name: str) -> bool:
    value = _field(data, name)
    if not isinstance(value, bool):
        raise MessageError("'%s' is neither true nor false" % name)
    return value


def _list(value: Any, name: str, most: int) -> List[Any]:
    if not isinstance(value, list) or len(value) > most:
        raise MessageError("'%s' is not a list of at most %d values" % (name, most))
    return value


def _object(data: Dict[str, Any], name: str) -> Dict[str, Any]:
    value = _field(data, name)
    if not isinstance(value, dict) or len(value) > MOST_ROBOTS:
        raise MessageError("'%s' is not an object of at most %d values" % (name, MOST_ROBOTS))
    for key in value:
        _name_of(key, name)
    return value


def _names(data: Dict[str, Any], name: str) -> Tuple[str, ...]:
    return tuple(_name_of(v, name) for v in _list(_field(data, name), name, MOST_ROBOTS))


def _torn(data: Dict[str, Any], name: str) -> Torn:
    if name not in data:
        return {}
    torn = _object(data, name)
    return {robot: _names(torn, robot) for robot in torn}


def _ballot(value: Any) -> Ballot:
    if not isinstance(value, list) or len(value) != 3:
        raise MessageError("'ballot' is not [number, robot, log]")
    counter, robot, log_id = value
    return Ballot(
        _number_of(counter, "ballot"), _name_of(robot, "ballot"), _name_of(log_id, "ballot")
    )


def _items(value: Any, name: str, *, start: bool = False) -> List[Item]:
    try:
        items = [Item.from_json(i) for i in _list(value, name, MOST_ITEMS)]
    except LogError as error:
        raise MessageError("'%s' holds something that is %s" % (name, error)) from None
    for entry, origin, _ in items:
        if (
            not 0 <= origin.incarnation <= LARGEST_NUMBER
            or not 0 <= origin.number <= LARGEST_NUMBER
        ):
            raise MessageError("'%s' holds an entry whose origin is out of bounds" % name)
        if isinstance(entry, log_entries.Start) and not start:
            raise MessageError("'%s' holds a second start of the run" % name)
        if isinstance(entry, log_entries.Join) and entry.robot != origin.robot:
            raise MessageError(
                "in '%s', %s joins on behalf of %s" % (name, origin.robot, entry.robot)
            )
    return items


def _batch(value: Any, *, start: bool = False) -> Batch:
    return Batch(_items(value, "batch", start=start), value)


def _counts(data: Dict[str, Any], name: str) -> Dict[str, int]:
    return {robot: _number_of(count, name) for robot, count in _object(data, name).items()}


def _greets(data: Dict[str, Any], name: str) -> Dict[str, Seen]:
    greets = {}
    for robot, seen in _object(data, name).items():
        if len(_list(seen, name, 3)) != 3:
            raise MessageError("'greets' does not hold [log, incarnation, records]")
        log, incarnation, records = seen
        greets[robot] = Seen(
            _name_of(log, name), _number_of(incarnation, name), _number_of(records, name)
        )
    return greets


def _accepted(data: Dict[str, Any], name: str) -> Optional[Tuple[Ballot, Batch]]:
    accepted = _field(data, name)
    if accepted is None:
        return None
    if len(_list(accepted, name, 2)) != 2:
        raise MessageError("'accepted' is not [ballot, batch]")
    return _ballot(accepted[0]), _batch(accepted[1])


# -- messages --------------------------------------------------------------------------------------


class Seen(NamedTuple):
    """A greeting: what the sender of a hello remembers about a robot: the robot's log, and how
    many records it had in incarnation ``incarnation``."""

    log: str
    incarnation: int
    records: int


class Hello(NamedTuple):
    """Announces the sender. Sent to everybody at every heartbeat; more often, and in answer to
    hellos, before the sender takes part.

    ``begin``: how many records the sender's log had when this incarnation began, which reveals a
    truncated log. ``active``: whether the sender takes part. ``joining``: whether the team must
    first admit it. ``first``: hash of the first slot. ``silent``: the robots that the sender does
    not hear. ``off``: robot -> incarnation, for robots that an operator asserted to be off.
    ``cast_out``: robot -> slot of its last forced eviction. ``greets``: what the sender knows of
    robots that wait for it, or that may not know it themselves.
    """

    begin: int
    active: bool
    joining: bool
    first: str
    silent: Tuple[str, ...]
    off: Dict[str, int]
    cast_out: Dict[str, int]
    greets: Dict[str, Seen]


class Proposals(NamedTuple):
    """Entries that the sender wants in the log. Sent repeatedly to the leader (by a robot without a
    ``vote``, to any member) until they are in the log."""

    items: List[Item]
    vote: bool


class Prepare(NamedTuple):
    """First phase, from a proposer to the members: promise to accept nothing below ``ballot`` from
    ``slot`` on. ``frozen``: no robot makes a local transition until the slot is decided. ``torn``:
    the slot needs the votes of all members, and those of these robots count. Answered by
    :class:`Promise`, :class:`Nack`, or by helping whichever robot is behind."""

    slot: int
    ballot: Ballot
    frozen: bool
    torn: Torn = {}


class Promise(NamedTuple):
    """The answer to :class:`Prepare`: what the sender has ``accepted`` (ballot and batch) in that
    slot so far, and the proposals that wait at the sender. Without a ``vote`` it only reports what
    the sender knows."""

    slot: int
    ballot: Ballot
    vote: bool
    accepted: Optional[Tuple[Ballot, Batch]]
    items: List[Item]


class Accept(NamedTuple):
    """Second phase, from a proposer to the members: accept ``batch`` in ``slot``. From a leader it
    also means that its previous batch under the same ballot was chosen. ``torn`` as in
    :class:`Prepare`. Answered by :class:`Accepted` or :class:`Nack`."""

    slot: int
    ballot: Ballot
    batch: Batch
    torn: Torn = {}


class Accepted(NamedTuple):
    """A vote, sent to the proposer and, in a small team, to the robots whose proposals are in the
    batch. ``items``: proposals waiting at the sender that the batch does not hold."""

    slot: int
    ballot: Ballot
    items: List[Item]


class Nack(NamedTuple):
    """A refusal: the sender has promised ``ballot``, which is higher. The proposer gives way."""

    slot: int
    ballot: Ballot


class Pull(NamedTuple):
    """Reports that the sender's log is shorter. Answered by :class:`Learn`."""


class Chosen(NamedTuple):
    """Reports that the batch accepted under ``ballot`` is chosen in ``slot``."""

    slot: int
    ballot: Ballot


class Learn(NamedTuple):
    """Reports decisions. A proposer reports to the others that a slot is ``chosen``. A robot that
    is behind gets ``slots`` from ``at`` on as (ballot, batch, previous hash), or a ``snapshot`` if
    those slots are no longer kept."""

    chosen: Optional[Chosen] = None
    at: int = 0
    slots: Tuple[Tuple[Ballot, Batch, str], ...] = ()
    snapshot: Optional[Dict[str, Any]] = None

    def to_json(self) -> Dict[str, Any]:
        """The fields as a JSON object."""
        if self.chosen is not None:
            return {"slot": self.chosen.slot, "ballot": list(self.chosen.ballot)}
        if self.snapshot is not None:
            return {"snapshot": self.snapshot}
        return {
            "at": self.at,
            "slots": [[list(ballot), batch.data, before] for ballot, batch, before in self.slots],
        }

    @classmethod
    def from_json(cls, data: Dict[str, Any]) -> Learn:
        """Parse a JSON object. :raises MessageError: it is malformed."""
        if "snapshot" in data:
            snapshot = data["snapshot"]
            if not isinstance(snapshot, dict):
                raise MessageError("'snapshot' is not an object")
            _number(snapshot, "slot")
            return cls(snapshot=snapshot)
        if "slots" in data:
            slots = []
            at = _number(data, "at")
            for number, slot in enumerate(_list(data["slots"], "slots", MOST_SLOTS), at):
                if len(_list(slot, "slots", 3)) != 3:
                    raise MessageError("'slots' does not hold [ballot, batch, hash]")
                batch = _batch(slot[1], start=number == 0)
                slots.append((_ballot(slot[0]), batch, _name_of(slot[2], "slots")))
            return cls(at=at, slots=tuple(slots))
        return cls(Chosen(_number(data, "slot"), _ballot(_field(data, "ballot"))))


_READ: Dict[str, Callable[[Dict[str, Any], str], Any]] = {
    **dict.fromkeys(("slot", "begin"), _number),
    **dict.fromkeys(("active", "joining", "frozen", "vote"), _flag),
    **dict.fromkeys(("off", "cast_out"), _counts),
    "first": _text,
    "silent": _names,
    "greets": _greets,
    "ballot": lambda data, name: _ballot(_field(data, name)),
    "batch": lambda data, name: _batch(_field(data, name)),
    "items": lambda data, name: _items(_field(data, name), name),
    "accepted": _accepted,
    "torn": _torn,
}
"""Field of a body -> what reads it from a JSON object."""

_WRITE: Dict[str, Callable[[Any], Any]] = {
    "silent": list,
    "greets": lambda greets: {robot: list(seen) for robot, seen in greets.items()},
    "ballot": list,
    "batch": lambda batch: batch.data,
    "items": lambda items: [item.to_json() for item in items],
    "accepted": lambda accepted: accepted and [list(accepted[0]), accepted[1].data],
}
"""Field of a body -> what makes a JSON value of it; the others are JSON values."""


def _body_to_json(body: Body) -> Dict[str, Any]:
    if isinstance(body, Learn):
        return body.to_json()
    found = {}
    for name, value in zip(body._fields, body):
        if name in _WRITE:
            found[name] = _WRITE[name](value)
        elif value or name != "torn":
            found[name] = value
    return found


def _read_body(kind: Type[Any], data: Dict[str, Any]) -> Any:
    """:raises MessageError: it is malformed."""
    if kind is Learn:
        return Learn.from_json(data)
    return kind(*(_READ[name](data, name) for name in kind._fields))


Body = Union[Hello, Proposals, Prepare, Promise, Accept, Accepted, Nack, Pull, Learn]

_KINDS: Dict[str, Type[Any]] = {
    "hello": Hello,
    "event": Proposals,
    "prepare": Prepare,
    "promise": Promise,
    "accept": Accept,
    "accepted": Accepted,
    "nack": Nack,
    "pull": Pull,
    "learn": Learn,
}
_KIND_OF = {body: kind for kind, body in _KINDS.items()}


class Envelope(NamedTuple):
    """The sender's data that every message carries, and the body.

    ``team``: run and plan. ``log``: id of the sender's log, and ``records`` its number of records;
    ``length`` and ``hash``: of the agreed log as far as the sender knows it. ``torn``: if the
    sender's log lost its end in a power loss and the sender was not readmitted since, the ids of
    the logs that this one continues.
    """

    sender: str
    team: str
    log: str
    incarnation: int
    records: int
    length: int
    hash: str
    body: Any
    torn: Tuple[str, ...] = ()

    def to_json(self) -> Dict[str, Any]:
        """The message as a JSON object."""
        torn = {"goes_on_from": self.torn} if self.torn else {}
        return {
            "version": PROTOCOL_VERSION,
            "kind": _KIND_OF[type(self.body)],
            "from": self.sender,
            "team": self.team,
            "log": self.log,
            "incarnation": self.incarnation,
            "records": self.records,
            "length": self.length,
            "hash": self.hash,
            **torn,
            **_body_to_json(self.body),
        }


def parse_envelope(data: Any) -> Envelope:
    """Parse a message.

    :raises MessageError: the message does not belong to this version of the protocol.
    """
    if not isinstance(data, dict):
        raise MessageError("the message is not a JSON object")
    version = data.get("version", 1)
    if version != PROTOCOL_VERSION:
        raise MessageError(
            "the message has version %.20r of the protocol instead of %d"
            % (version, PROTOCOL_VERSION)
        )
    kind = data.get("kind")
    body = _KINDS.get(kind) if isinstance(kind, str) else None
    if body is None:
        raise MessageError("unknown kind of message '%.50s'" % (kind,))
    sender, team, log, chain = _texts(data, ("from", "team", "log", "hash"))
    incarnation, records, length = _numbers(data, ("incarnation", "records", "length"))
    torn = _names(data, "goes_on_from") if "goes_on_from" in data else ()
    about = _read_body(body, data)
    return Envelope(sender, team, log, incarnation, records, length, chain, about, torn)

"""The output of the token game: firings, and commands to the executor of the actions."""

from __future__ import annotations

from typing import Any, Dict, NamedTuple, Optional, Tuple, Union

from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.net import Marking, Net


class Move(NamedTuple):
    """A token with an identity moves: ``source`` None for one that was created, ``target`` None for
    one that was destroyed (Void, thesis 4.1.2); ``visit`` is the number of the visit that
    begins."""

    robot: str
    source: Optional[str]
    target: Optional[str]
    visit: int


class Firing(NamedTuple):
    """A transition fired, at position (``slot``, ``index``) of the log.

    ``robot`` is the one whose request it was ("" if none asked), with its ``visit`` and
    ``incarnation``; ``moves`` lists all robots that moved, ``marking`` is the result, ``drawn`` the
    position at which the policy chose this transition (None if it did not).
    """

    slot: int
    index: int  # type: ignore[assignment]  # hides tuple.index, unused
    transition: str
    robot: str
    incarnation: int
    visit: int
    moves: Tuple[Move, ...]
    marking: Marking
    drawn: Optional[Tuple[int, int]] = None


class StartAction(NamedTuple):
    """Start the action of ``place`` for this visit, after ``delay`` seconds; ``attempt`` counts
    from 1."""

    robot: str
    place: str
    incarnation: int
    visit: int
    attempt: int
    delay: float = 0.0


class CancelAction(NamedTuple):
    """Whatever ``robot`` is doing for visits up to ``visit`` is void: cancel it."""

    robot: str
    visit: int


class Fault(NamedTuple):
    """Something went wrong that a person should know; ``robot`` "" where it concerns no robot."""

    robot: str
    message: str


class Ended(NamedTuple):
    """The run is over; ``finished`` distinguishes a run that came to its own end from one that was
    stopped."""

    reason: str
    finished: bool


Command = Union[StartAction, CancelAction, Fault, Ended]


def firing_to_json(firing: Firing, net: Net) -> Dict[str, Any]:
    """The firing as a JSON object, the marking by place names without the empty places."""
    data = firing._asdict()
    data["marking"] = net.named(firing.marking, zeros=False)
    data["moves"] = [list(m) for m in firing.moves]
    data["drawn"] = list(firing.drawn) if firing.drawn else None
    return data


def firing_from_json(data: Dict[str, Any], net: Net) -> Firing:
    """The firing of a JSON object. :raises LogError: not one."""
    try:
        fields = {key: data[key] for key in Firing._fields}
        fields["marking"] = net.marking(data["marking"])
        fields["moves"] = tuple(Move(*m) for m in data["moves"])
        fields["drawn"] = tuple(data["drawn"]) if data["drawn"] else None
        return Firing(**fields)
    except (KeyError, TypeError, ValueError) as error:
        raise LogError("not a firing: %.200r (%s)" % (data, error)) from None

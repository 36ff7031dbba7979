"""What carries the messages of a robot's replica to the other robots, and its facts to whoever
watches.

The host of a replica knows this interface only. :mod:`gspn_framework_package.ros.links` carries
over the topics and services of ROS.

A carrier may lose, repeat, delay and reorder messages: the agreement copes with all of it. It must
not invent any. A carrier that knows which robot sent a message drops one that names another sender
(:func:`sender_of`).
"""

from __future__ import annotations

from typing import Any, Callable, Dict, List, NamedTuple, Protocol

from gspn_framework_package.execution.agreement.interface import Message, Send


class OperatorRequest(NamedTuple):
    """What an operator asks of a robot: an order, or a question such as ``status``."""

    command: str
    """The name of the order or question, as in the service ``Command``."""
    robot: str = ""
    """The robot that the order concerns; "": the one that is asked, or the team."""
    argument: str = ""
    run: str = ""
    """The run that is meant; "": whatever run the robot is in."""


class Operator(NamedTuple):
    """Who gives an order."""

    name: str = ""
    """"" if nobody said."""
    proof: str = ""
    """What shows that it is so: ``certificate``, ``team key`` (somebody who has it says so), or
    nothing."""


class OperatorAnswer(NamedTuple):
    """The answer to an :class:`OperatorRequest`."""

    success: bool
    message: str
    """For ``status``, a JSON object; else a sentence."""


class NotTaken(NamedTuple):
    """What came in and was not taken: from whom, why, and how often."""

    robot: str
    """The robot or operator that it came from, as far as the carrier knows."""
    why: str
    times: int


class Handlers(NamedTuple):
    """What a carrier calls, from any thread."""

    received: Callable[[Message], None]
    """Takes each protocol message for this robot; returns at once."""
    command: Callable[[OperatorRequest, Operator], OperatorAnswer]
    """Answers an operator. It may take some seconds, because an order waits until it is in the log.
    It raises ExecutionError if the robot is too busy to answer."""


class Carrier(Protocol):
    """Carries the messages of one robot. The host's worker thread calls all methods."""

    @property
    def sent(self) -> int:
        """How many messages the robot has sent; one to several robots counts once."""

    def send(self, sends: List[Send]) -> None:
        """Send protocol messages to the robots that they name; does not wait for anybody."""

    def publish_firings(self, firings: List[Dict[str, Any]]) -> None:
        """Publish firings that this robot decided in one slot, or local transitions of its own.

        :param firings: the fields of each, see
            :func:`~gspn_framework_package.execution.team_messages.firing_fields`.
        """

    def is_watched(self) -> bool:
        """Whether somebody may watch the activity now. While nobody does, it is published less
        often."""

    def publish_activity(self, activity: Dict[str, Any]) -> None:
        """Publish what the robot does; whoever begins to watch later sees the last one.

        :param activity: a JSON object.
        """

    def refusals(self) -> List[NotTaken]:
        """What came in so far and was not taken."""

    def is_team_watched(self) -> bool:
        """Whether somebody wants :meth:`publish_team` now."""

    def publish_team(self, marking: Dict[str, Any], team: Dict[str, Any]) -> None:
        """Publish the marking and the state of the whole team, as this robot's log has them.

        :param marking: see
            :func:`~gspn_framework_package.execution.team_messages.marking_fields`.
        :param team: see :func:`~gspn_framework_package.execution.team_messages.team_fields`.
        """

    def close(self) -> None:
        """Send nothing more, and release everything."""


def sender_of(message: Message) -> str:
    """The robot that a protocol message says it comes from; "" if it does not say."""
    sender = message.get("from")
    return sender if isinstance(sender, str) else ""

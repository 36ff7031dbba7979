"""The interface of a carrier, which sends the messages of a robot's replica to the other robots and
publishes its firings and activity for watchers.

A replica's host knows only this interface. :mod:`gspn_framework_package.ros.links` implements it
with topics and services of ROS.

A carrier may lose, repeat, delay and reorder messages: the agreement tolerates that. It must never
invent one. A carrier that knows which robot sent a message drops the message if it names another
sender (:func:`sender_of`).
"""

from __future__ import annotations

from typing import Any, Callable, Dict, List, NamedTuple, Protocol

from gspn_framework_package.execution.agreement.interface import Message, Send


class OperatorRequest(NamedTuple):
    """A request of an operator to a robot: an order, or a question such as ``status``."""

    command: str
    """The name of the order or question (see ``docs/commands.md``)."""
    robot: str = ""
    """The robot that the order concerns; "" for the receiving robot or the whole team."""
    argument: str = ""
    run: str = ""
    """The run that is meant; "" for whatever run the robot is in."""


class Operator(NamedTuple):
    """The sender of an order."""

    name: str = ""
    """"" if unknown."""
    proof: str = ""
    """How the name was authenticated: ``certificate``, ``team key`` (claimed by somebody who has
    the key), or "" for not at all."""


class OperatorAnswer(NamedTuple):
    """The answer to an :class:`OperatorRequest`."""

    success: bool
    message: str
    """A JSON object for ``status``, otherwise a sentence."""


class NotTaken(NamedTuple):
    """Incoming messages that were refused: from whom, why, and how often."""

    robot: str
    """The robot or operator that sent them, as far as the carrier knows."""
    why: str
    times: int


class Handlers(NamedTuple):
    """Callbacks of a carrier, called from any thread."""

    received: Callable[[Message], None]
    """Takes each protocol message for this robot; returns at once."""
    command: Callable[[OperatorRequest, Operator], OperatorAnswer]
    """Answers an operator. May take some seconds, because an order waits until it is in the log.
    Raises ExecutionError if the robot is too busy to answer."""


class Carrier(Protocol):
    """Carries the messages of one robot. The host's worker thread calls all methods."""

    @property
    def sent(self) -> int:
        """How many messages the robot has sent; a message to several robots counts once."""

    def send(self, sends: List[Send]) -> None:
        """Send protocol messages to the robots that they name, without waiting for delivery."""

    def publish_firings(self, firings: List[Dict[str, Any]]) -> None:
        """Publish firings that this robot decided in one slot, or its own local transitions.

        :param firings: the fields of each, see
            :func:`~gspn_framework_package.execution.team_messages.firing_fields`.
        """

    def publish_task(self, task: Dict[str, Any]) -> None:
        """Publish that a task has ended, with a slot that this robot decided.

        :param task: see :func:`~gspn_framework_package.execution.team_messages.task_fields`.
        """

    def is_watched(self) -> bool:
        """Whether anybody may be watching the activity now. It is published less often while nobody
        is."""

    def publish_activity(self, activity: Dict[str, Any]) -> None:
        """Publish what the robot does; later subscribers receive the last activity.

        :param activity: a JSON object.
        """

    def refusals(self) -> List[NotTaken]:
        """The incoming messages that have been refused so far."""

    def is_team_watched(self) -> bool:
        """Whether anybody uses :meth:`publish_team` now."""

    def publish_team(self, marking: Dict[str, Any], team: Dict[str, Any]) -> None:
        """Publish the marking and the state of the whole team according to this robot's log.

        :param marking: see
            :func:`~gspn_framework_package.execution.team_messages.marking_fields`.
        :param team: see :func:`~gspn_framework_package.execution.team_messages.team_fields`.
        """

    def close(self) -> None:
        """Stop sending, and release all resources."""


def sender_of(message: Message) -> str:
    """The robot that a protocol message names as its sender; "" if it names none."""
    sender = message.get("from")
    return sender if isinstance(sender, str) else ""

"""Checks messages of other nodes before a robot processes them."""

from __future__ import annotations

import time
from typing import List, Mapping, Optional, Tuple

from gspn_framework_package.execution.agreement.interface import Message
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.ros.transport.shared_reader import hold_up
from gspn_framework_package.team.carrier import NotTaken, Operator, OperatorRequest, sender_of
from gspn_framework_package.team.message_filter import LARGEST_MESSAGE, MessageFilter, json_object
from gspn_framework_package.team.orders import is_question
from gspn_framework_package.team.seal import ORDER, SEALED, NotSealedError, Seal, is_sealed

BRAKE = 0.05
"""Seconds for which a connection is not read after it delivered a refused message. The sender then
blocks or loses messages, at no cost to the robot."""

ASKED, ANSWERED = "asked", "answered"
"""The purpose of a message in a service call."""

_Header = Optional[Mapping[str, str]]
"""The header of the connection on which a message arrived."""


def said(namespace: str, service_uri: str) -> str:
    """The purpose of a message on a topic, including its sender's address."""
    return "said\n%s\n%s" % (namespace, service_uri)


NO_KEY = "this robot has no team key: give the order without one"
"""Why a sealed order is refused by a team without a key."""


class InboundMessages:
    """Checks the incoming messages of one robot on ROS; may be called on any thread.

    A sender is identified by the robot that it claims to be and the node whose connection delivered
    the message.

    :param is_open: whether the robots of the team communicate over ROS; if not, all messages are
        refused.
    :param seal: seals with the key of the team; None if it has none.
    """

    def __init__(self, is_open: bool = True, seal: Optional[Seal] = None) -> None:
        self._is_open = is_open
        self._seal = seal
        self._filter = MessageFilter(LARGEST_MESSAGE)

    def sealed(self, to: str, body: str, purpose: str) -> str:
        """Seal a message of this robot for sending.

        :param to: the receiving robot; "" is everybody.
        :param purpose: :data:`ASKED`, :data:`ANSWERED` or :func:`said`.
        """
        return body if self._seal is None else self._seal.close(to, body, purpose)

    def read(
        self, text: str, connection: _Header, purpose: str, claimed: str = ""
    ) -> Optional[Message]:
        """The protocol message in a text; None if it is refused.

        Call this on the thread that reads the connection: it slows down a connection that delivers
        refused messages.

        :param claimed: the supposed sender; "" if only the message names one.
        """
        who = _named(claimed, connection)
        admitted = self._filter.admits(who, len(text), time.monotonic())
        if admitted:
            try:
                return self._open(text, purpose, claimed)
            except NotSealedError as error:
                self._filter.refuse(who, error.why)
        hold_up(BRAKE)
        return None

    def pass_by(self, text: str, connection: _Header) -> None:
        """Skip a message of another run, or to another robot, on a shared topic. A connection that
        delivers more of them than a robot sends is slowed down.

        Call this on the thread that reads the connection.
        """
        who = _named("others", connection)
        if not self._filter.admits(who, len(text), time.monotonic(), "others"):
            hold_up(BRAKE)

    def _open(self, text: str, purpose: str, claimed: str) -> Message:
        """:raises NotSealedError: it is refused."""
        if not self._is_open:
            raise NotSealedError("the team does not communicate over ROS")
        senders = {claimed} - {""}
        if self._seal is not None:
            sender, text = self._seal.open(text, purpose, claimed)
            senders.add(sender)
        elif is_sealed(text):
            raise NotSealedError("sealed with a team key, which this robot does not have")
        message = json_object(text)
        if message is None:
            raise NotSealedError("not a JSON object")
        senders.add(sender_of(message))
        if len(senders) > 1 or "" in senders:
            raise NotSealedError("in the name of another robot")
        return message

    def order(
        self, request: OperatorRequest, connection: _Header
    ) -> Tuple[OperatorRequest, Operator]:
        """Read an operator's order or question, and its sender.

        :raises RefusedError: this robot does not accept it.
        """
        who = _named("", connection)
        if request.command != SEALED:
            if self._seal is not None and not is_question(request):
                self._filter.refuse(who, "an order without the key of the team")
                raise RefusedError(
                    "this team takes only orders with its key: --team-key-file FILE, or start it "
                    "with key:=none"
                )
            return request, Operator(who)
        if self._seal is None:
            raise RefusedError(NO_KEY)
        try:
            opened = self._seal.open_order(request.argument, ORDER)
        except NotSealedError as error:
            self._filter.refuse(who, error.why)
            raise RefusedError("refused: %s" % error.why) from None
        fields = json_object(opened.body) or {}
        texts = [fields.get(name) for name in OperatorRequest._fields]
        if not all(isinstance(text, str) for text in texts):
            self._filter.refuse(who, "an unreadable order")
            raise RefusedError("refused: not an order")
        return OperatorRequest(*map(str, texts)), Operator(opened.sender, "team key")

    def refusals(self) -> List[NotTaken]:
        """The messages refused so far."""
        return self._filter.refusals()


def _named(claimed: str, connection: _Header) -> str:
    node = "node %s" % (connection or {}).get("callerid", "without a name")
    return "%.50s (%.100s)" % (claimed, node) if claimed else node[:100]

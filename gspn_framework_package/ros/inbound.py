"""Checks what other nodes send to a robot before anybody works on it."""

from __future__ import annotations

import time
from typing import List, Mapping, Optional, Tuple

from gspn_framework_package.execution.agreement.interface import Message
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.team.carrier import NotTaken, Operator, OperatorRequest, sender_of
from gspn_framework_package.team.message_filter import LARGEST_MESSAGE, MessageFilter, json_object
from gspn_framework_package.team.orders import is_question
from gspn_framework_package.team.seal import ORDER, SEALED, NotSealedError, Seal, is_sealed

BRAKE = 0.05
"""Seconds for which a connection is not read after it brought a message that is refused. Whoever
sends then waits or loses messages, and the robot has no work with them."""

ASKED, ANSWERED = "asked", "answered"
"""What a message in a service call is."""

_Header = Optional[Mapping[str, str]]
"""The header of the connection on which a message arrived."""


def said(namespace: str, service_uri: str) -> str:
    """What a message on a topic is, and how its sender is reached."""
    return "said\n%s\n%s" % (namespace, service_uri)


class InboundMessages:
    """The inbound of one robot on ROS; may be called on any thread.

    A sender is named by the robot that it says it is, and by the node on whose connection it came.

    :param is_open: whether the robots of the team talk over ROS; if not, nothing is taken.
    :param seal: seals with the key of the team; None if it has none.
    """

    def __init__(self, is_open: bool = True, seal: Optional[Seal] = None) -> None:
        self._is_open = is_open
        self._seal = seal
        self._filter = MessageFilter(LARGEST_MESSAGE)

    def sealed(self, to: str, body: str, purpose: str) -> str:
        """A message of this robot as it leaves.

        :param to: the receiving robot; "" is everybody.
        :param purpose: :data:`ASKED`, :data:`ANSWERED` or :func:`said`.
        """
        return body if self._seal is None else self._seal.close(to, body, purpose)

    def read(
        self, text: str, connection: _Header, purpose: str, claimed: str = ""
    ) -> Optional[Message]:
        """The protocol message in a text; None if it is refused.

        Call it on the thread that reads the connection: it brakes one that brings what is refused.

        :param claimed: the robot that is said to have sent it; "": only the message says so.
        """
        who = _named(claimed, connection)
        admitted = self._filter.admits(who, len(text), time.monotonic())
        if admitted:
            try:
                return self._open(text, purpose, claimed)
            except NotSealedError as error:
                self._filter.refuse(who, error.why)
        time.sleep(BRAKE)
        return None

    def pass_by(self, text: str, connection: _Header) -> None:
        """A message of another run, or to another robot, came on a topic that all read. Nobody
        looks at it; a connection that brings more of them than a robot sends is braked.

        Call it on the thread that reads the connection.
        """
        who = _named("others", connection)
        if not self._filter.admits(who, len(text), time.monotonic(), "others"):
            time.sleep(BRAKE)

    def _open(self, text: str, purpose: str, claimed: str) -> Message:
        """:raises NotSealedError: it is refused."""
        if not self._is_open:
            raise NotSealedError("the team does not talk over ROS")
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
        """What is ordered or asked, and by whom.

        :raises RefusedError: this robot does not take it.
        """
        who = _named("", connection)
        if request.command != SEALED:
            if self._seal is not None and not is_question(request):
                self._filter.refuse(who, "an order without the key of the team")
                raise RefusedError("this team takes orders with its key only: --team-key-file FILE")
            return request, Operator(who)
        if self._seal is None:
            raise RefusedError("this robot has no team key: give the order without one")
        try:
            opened = self._seal.open_order(request.argument, ORDER)
        except NotSealedError as error:
            self._filter.refuse(who, error.why)
            raise RefusedError("not taken: %s" % error.why) from None
        fields = json_object(opened.body) or {}
        texts = [fields.get(name) for name in OperatorRequest._fields]
        if not all(isinstance(text, str) for text in texts):
            self._filter.refuse(who, "an order that cannot be read")
            raise RefusedError("not taken: not an order")
        return OperatorRequest(*map(str, texts)), Operator(opened.sender, "team key")

    def refusals(self) -> List[NotTaken]:
        """What was not taken so far."""
        return self._filter.refusals()


def _named(claimed: str, connection: _Header) -> str:
    node = "node %s" % (connection or {}).get("callerid", "without a name")
    return "%.50s (%.100s)" % (claimed, node) if claimed else node[:100]

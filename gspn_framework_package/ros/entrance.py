"""Checks what other nodes send to a robot before anybody works on it."""

from __future__ import annotations

import time
from typing import List, Mapping, Optional

from gspn_framework_package.execution.agreement.interface import Message
from gspn_framework_package.team.carrier import NotTaken, sender_of
from gspn_framework_package.team.gate import LARGEST_MESSAGE, MessageGate, json_object

BRAKE = 0.05
"""Seconds for which a connection is not read after a message too many came on it. Whoever sends
then waits or loses messages, and the robot has no work with them."""


class Entrance:
    """The entrance of one robot on ROS; may be called on any thread.

    A sender is named by the robot that it says it is, and by the node on whose connection it came.

    :param is_open: whether the robots of the team talk over ROS; if not, nothing is taken.
    """

    def __init__(self, is_open: bool = True) -> None:
        self._is_open = is_open
        self._gate = MessageGate(LARGEST_MESSAGE)

    def read(
        self, text: str, connection: Optional[Mapping[str, str]], claimed: str = ""
    ) -> Optional[Message]:
        """The protocol message in a text; None if it is refused.

        Call it on the thread that reads the connection: it brakes one that brings too much.

        :param connection: the header of the connection that it came on.
        :param claimed: the robot that is said to have sent it; "": only the message says so.
        """
        who = self._named(claimed, connection)
        if not self._gate.admits(who, len(text), time.monotonic()):
            time.sleep(BRAKE)
            return None
        if not self._is_open:
            self._gate.refuse(who, "the team does not talk over ROS")
            return None
        message = json_object(text)
        if message is None:
            self._gate.refuse(who, "not a JSON object")
            return None
        sender = sender_of(message)
        if not sender or claimed not in ("", sender):
            self._gate.refuse(who, "in the name of another robot")
            return None
        return message

    def refusals(self) -> List[NotTaken]:
        """What was not taken so far."""
        return self._gate.refusals()

    @staticmethod
    def _named(claimed: str, connection: Optional[Mapping[str, str]]) -> str:
        node = "node %s" % (connection or {}).get("callerid", "without a name")
        return "%.50s (%.100s)" % (claimed, node) if claimed else node[:100]

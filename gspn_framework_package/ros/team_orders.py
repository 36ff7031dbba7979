"""Builds the requests of an operator's program to the service ``command`` of a robot."""

from __future__ import annotations

import getpass
import json
from typing import Dict, Optional

from gspn_framework_package.srv import CommandRequest
from gspn_framework_package.team.carrier import OperatorRequest
from gspn_framework_package.team.seal import ORDER, SEALED, Seal, TeamKey


class TeamOrders:
    """Builds orders in the name of the user who runs this program, sealed if the team has a key.

    :param key: the key of the team; None if it has none.
    :param program: the program that gives the orders, added to the user's name; "" for none.
    """

    def __init__(self, key: Optional[TeamKey] = None, program: str = "") -> None:
        self._key = key
        self._name = _user() + (" (%s)" % program if program else "")
        self._seals: Dict[str, Seal] = {}

    def request(self, to: str, command: str, robot: str, argument: str, run: str) -> CommandRequest:
        """Build the request for an order.

        :param to: the robot that receives the order; the others must not carry it out.
        :param robot: the robot that the order concerns.
        """
        if self._key is None:
            return CommandRequest(command, robot, argument, run)
        if run not in self._seals:
            self._seals[run] = Seal(self._key, run, self._name)
        body = json.dumps(OperatorRequest(command, robot, argument, run)._asdict())
        return CommandRequest(SEALED, "", self._seals[run].close(to, body, ORDER), run)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError, ImportError):  # a container may lack an entry for the user
        return "operator"

"""Checks what comes in from the network before anybody works on it."""

from __future__ import annotations

import json
import threading
from typing import Any, Dict, List, NoReturn, Optional, Tuple, Union

from gspn_framework_package.execution.agreement.interface import Message
from gspn_framework_package.team.carrier import NotTaken, sender_of

LARGEST_MESSAGE = 4 * 1024 * 1024
"""Bytes of a message; larger ones are dropped. A robot that missed a thousand slots is taught in
messages far smaller than this."""

FASTEST = 3000.0
"""Messages a second that are taken from one robot, and at once from one that was quiet. A leader at
its fastest sends fewer. One that goes on sending more is not heard at all until it is slower."""

COUNTS_ONCE = 8192
"""Bytes. A larger message counts as several."""

_MOST_SENDERS = 1000
_MOST_REASONS = 1000
_LONGEST_NUMBER = 30


class MessageFilter:
    """Lets a message in that has the right size, form and sender, and comes at a bearable rate; may
    be called on any thread.

    Whether it is a message of the protocol is for the replica to say, which names the sender of one
    that is not.

    :param largest: bytes of a message.
    :param fastest: messages a second that are taken from one robot in one channel, and at once.
    """

    def __init__(self, largest: int, fastest: float = FASTEST) -> None:
        self._largest, self._fastest = largest, fastest
        self._lock = threading.Lock()
        self._refused: Dict[Tuple[str, str], int] = {}
        self._buckets: Dict[Tuple[str, str], Tuple[float, float]] = {}

    def admits(self, robot: str, size: int, now: float, channel: str = "") -> bool:
        """Whether to look at a message at all.

        :param robot: who sent it.
        :param size: in bytes.
        :param now: a monotonic clock, in seconds.
        :param channel: where it came; each robot has a limit in each.
        """
        if size > self._largest:
            self.refuse(robot, "too large")
            return False
        sender = (robot, channel)
        with self._lock:
            if sender not in self._buckets and len(self._buckets) >= _MOST_SENDERS:
                sender = ("", "")  # all others together
            tokens, before = self._buckets.get(sender, (self._fastest, now))
            tokens = min(self._fastest, tokens + (now - before) * self._fastest)
            let_in = tokens >= 1.0
            tokens -= max(1.0, size / COUNTS_ONCE)
            self._buckets[sender] = (max(-self._fastest, tokens), now)
        if not let_in:
            self.refuse(robot, "too many messages")
        return let_in

    def read(self, robot: str, body: bytes) -> List[Message]:
        """The messages in a body, which are one or a list of several; without what is refused."""
        messages = [self._own(robot, message) for message in _json_values(body)]
        return [message for message in messages if message is not None]

    def _own(self, robot: str, message: Any) -> Optional[Message]:
        if not isinstance(message, dict):
            self.refuse(robot, "not a JSON object")
            return None
        if sender_of(message) != robot:
            self.refuse(robot, "in the name of another robot")
            return None
        return message

    def refuse(self, robot: str, why: str) -> None:
        """Count something that was not taken."""
        with self._lock:
            name = (robot[:100], why)
            if name not in self._refused and len(self._refused) >= _MOST_REASONS:
                name = ("others", why)
            self._refused[name] = self._refused.get(name, 0) + 1

    def refusals(self) -> List[NotTaken]:
        """What was refused so far."""
        with self._lock:
            return [NotTaken(robot, why, n) for (robot, why), n in sorted(self._refused.items())]


def _number(digits: str) -> int:
    if len(digits) > _LONGEST_NUMBER:  # reading a long one takes time that grows with its square
        raise ValueError("a number of %d digits" % len(digits))
    return int(digits)


def _no_number(text: str) -> NoReturn:
    raise ValueError("%s is not JSON" % text)


_DECODER = json.JSONDecoder(parse_int=_number, parse_constant=_no_number)


def json_object(body: Union[str, bytes]) -> Optional[Dict[str, Any]]:
    """The JSON object in a text of an untrusted sender; None if there is none."""
    value = _json_value(body)
    return value if isinstance(value, dict) else None


def json_objects(body: Union[str, bytes]) -> List[Dict[str, Any]]:
    """The JSON objects in a text of an untrusted sender, which is one or a list of several."""
    return [value for value in _json_values(body) if isinstance(value, dict)]


def _json_values(body: Union[str, bytes]) -> List[Any]:
    value = _json_value(body)
    return value if isinstance(value, list) else [value]


def _json_value(body: Union[str, bytes]) -> Any:
    try:
        return _DECODER.decode(body if isinstance(body, str) else body.decode("utf-8"))
    except (ValueError, RecursionError):
        return None

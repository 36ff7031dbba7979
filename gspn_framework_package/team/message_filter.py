"""Checks incoming messages before anything else processes them."""

from __future__ import annotations

import json
import threading
from typing import Any, Dict, List, NoReturn, Optional, Tuple, Union

from gspn_framework_package.execution.agreement.interface import Message
from gspn_framework_package.team.carrier import NotTaken, sender_of

LARGEST_MESSAGE = 4 * 1024 * 1024
"""Maximum size of a message in bytes; larger messages are dropped. Even a robot that missed a
thousand slots catches up with messages far smaller than this."""

FASTEST = 3000.0
"""Messages accepted from one robot per second, and also in one burst. Even a leader at full speed
sends fewer. A robot that keeps sending more is ignored until it slows down."""

COUNTS_ONCE = 8192
"""Size in bytes above which a message counts as several."""

_MOST_SENDERS = 1000
_MOST_REASONS = 1000
_LONGEST_NUMBER = 30


class MessageFilter:
    """Accepts messages that have an acceptable size, form, sender and rate; may be called on any
    thread.

    The replica checks whether a message belongs to the protocol, and reports the sender if it does
    not.

    :param largest: bytes of a message.
    :param fastest: messages accepted from one robot in one channel per second, and in one burst.
    """

    def __init__(self, largest: int, fastest: float = FASTEST) -> None:
        self._largest, self._fastest = largest, fastest
        self._lock = threading.Lock()
        self._refused: Dict[Tuple[str, str], int] = {}
        self._buckets: Dict[Tuple[str, str], Tuple[float, float]] = {}

    def admits(self, robot: str, size: int, now: float, channel: str = "") -> bool:
        """Whether to read a message at all.

        :param robot: the sender.
        :param size: in bytes.
        :param now: a monotonic clock, in seconds.
        :param channel: the channel of the message; each robot has a limit in each channel.
        """
        if size > self._largest:
            self.refuse(robot, "too large")
            return False
        sender = (robot, channel)
        with self._lock:
            if sender not in self._buckets and len(self._buckets) >= _MOST_SENDERS:
                sender = ("", "")  # all further senders share a limit
            tokens, before = self._buckets.get(sender, (self._fastest, now))
            tokens = min(self._fastest, tokens + (now - before) * self._fastest)
            let_in = tokens >= 1.0
            tokens -= max(1.0, size / COUNTS_ONCE)
            self._buckets[sender] = (max(-self._fastest, tokens), now)
        if not let_in:
            self.refuse(robot, "too many messages")
        return let_in

    def read(self, robot: str, body: bytes) -> List[Message]:
        """The messages in a body, which holds one message or a list; refused messages are left
        out."""
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
        """Count a refused message."""
        with self._lock:
            name = (robot[:100], why)
            if name not in self._refused and len(self._refused) >= _MOST_REASONS:
                name = ("others", why)
            self._refused[name] = self._refused.get(name, 0) + 1

    def refusals(self) -> List[NotTaken]:
        """The messages refused so far."""
        with self._lock:
            return [NotTaken(robot, why, n) for (robot, why), n in sorted(self._refused.items())]


def _number(digits: str) -> int:
    if (
        len(digits) > _LONGEST_NUMBER
    ):  # the time to parse a number grows with the square of its length
        raise ValueError("a number of %d digits" % len(digits))
    return int(digits)


def _no_number(text: str) -> NoReturn:
    raise ValueError("%s is not JSON" % text)


_DECODER = json.JSONDecoder(parse_int=_number, parse_constant=_no_number)


def json_object(body: Union[str, bytes]) -> Optional[Dict[str, Any]]:
    """Parse a JSON object from an untrusted sender; None if the text is not one."""
    value = _json_value(body)
    return value if isinstance(value, dict) else None


def json_objects(body: Union[str, bytes]) -> List[Dict[str, Any]]:
    """Parse one JSON object, or a list of them, from an untrusted sender."""
    return [value for value in _json_values(body) if isinstance(value, dict)]


def _json_values(body: Union[str, bytes]) -> List[Any]:
    value = _json_value(body)
    return value if isinstance(value, list) else [value]


def _json_value(body: Union[str, bytes]) -> Any:
    try:
        return _DECODER.decode(body if isinstance(body, str) else body.decode("utf-8"))
    except (ValueError, RecursionError):
        return None

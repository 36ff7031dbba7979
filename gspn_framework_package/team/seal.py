"""Authenticates the messages of a team with a shared key, for carriers that do not identify
senders.

A sealed text is a line with a code (HMAC-SHA256 under the key, over the run and all that follows),
the session of the sender, a number, a time, the sender and the addressee; then the body::

    gspn1 CODE SESSION NUMBER MILLISECONDS SENDER ADDRESSEE
    BODY

Protection against replayed messages: a *session* is one life of a sender's process, with a random
name. Numbers grow within a session and addressee, and each is accepted once; a number
:data:`WINDOW` behind the latest is too late. A receiver accepts a session that it does not know
only if the message is at most :data:`FRESH` seconds old. It thus refuses older sessions, and
recordings made before it restarted. For a receiver that has just started, more recent recordings
are the same as delayed messages, which the agreement tolerates. Orders may not be delayed: an order
must be fresh, is accepted once, and must be younger than the receiver's process. Where the sender's
clock is ahead, the receiver cannot tell whether an order is older than its process by less than
that.

Anybody with the key can pose as any robot: the key keeps outsiders out, but identifies no sender.
"""

from __future__ import annotations

import hmac
import os
import threading
import time
from collections import OrderedDict
from functools import lru_cache
from typing import Callable, Dict, NamedTuple, Tuple
from urllib.parse import quote, unquote

from gspn_framework_package.formats.source import open_file
from gspn_framework_package.model.errors import KeysError
from gspn_framework_package.team.keys import check_private, write_private

WINDOW = 64
"""How many messages of one session may arrive out of order."""

FRESH = 30.0
"""Maximum age in seconds of an order and of the first message of a session. Clocks may differ by as
much."""

MAGIC = "gspn1"
"""The first word of a sealed text."""

ORDER = "order"
"""The purpose of an operator's order."""

SEALED = "sealed"
"""The command of a request whose argument is a sealed order."""

_SESSIONS = 8
"""Number of sessions remembered for one sender: its restarts, and processes of the same name."""

_KEY_BYTES = 32
_LONGEST_LINE = 4096
_ALL_SEEN = (1 << WINDOW) - 1


class NotSealedError(Exception):
    """A text is refused; ``sender`` is the sender that it claims, if any."""

    def __init__(self, why: str, sender: str = "") -> None:
        super().__init__(why)
        self.why = why
        self.sender = sender


class TeamKey:
    """A secret shared by all robots and operators of a team; never printed.

    :param secret: at least 32 bytes.
    """

    def __init__(self, secret: bytes) -> None:
        self._secret = secret

    def code(self, text: str) -> str:
        """The code of a text under this key, in hexadecimal digits."""
        data = text.encode("utf-8", "surrogatepass")
        return hmac.digest(self._secret, data, "sha256").hex()


def make_team_key(path: str) -> None:
    """Create a key, in a new file that only its owner can read.

    :raises KeysError: the file exists already, or cannot be written.
    """
    try:
        write_private(path, os.urandom(_KEY_BYTES).hex().encode() + b"\n")
    except FileExistsError:
        raise KeysError("already exists; nothing was written", file=path) from None
    except OSError as error:
        raise KeysError("cannot be written (%s)" % error.strerror, file=path) from None


def read_team_key(path: str) -> TeamKey:
    """Read the key in a file.

    :raises KeysError: the file holds no key, or other users can read it.
    """
    hint = "create one with 'gspn keys shared FILE'"
    check_private(path, hint)
    try:
        with open_file(path) as file:
            secret = bytes.fromhex(file.read(1024).decode("ascii").strip())
    except OSError as error:
        raise KeysError("cannot be read (%s)" % error.strerror, file=path) from None
    except ValueError:
        raise KeysError("is not a team key", file=path, hint=hint) from None
    if len(secret) < _KEY_BYTES:
        raise KeysError(
            "a team key has at least %d hexadecimal digits" % (2 * _KEY_BYTES), file=path, hint=hint
        )
    return TeamKey(secret)


class Unsealed(NamedTuple):
    """An authenticated text, and who sealed it."""

    sender: str
    body: str


class _Line(NamedTuple):
    session: str
    number: int
    time: float
    sender: str
    to: str


class _Numbers:
    """The numbers received in one stream, which begins with the first one received; smaller numbers
    count as received."""

    def __init__(self, first: int) -> None:
        self._newest, self._seen = first, _ALL_SEEN

    def why_not(self, number: int) -> str:
        """Record a number. Returns why it is refused, "" if it is not."""
        ahead = number - self._newest
        if ahead > 0:
            self._seen = ((self._seen << min(ahead, WINDOW)) | 1) & _ALL_SEEN
            self._newest = number
            return ""
        if -ahead >= WINDOW:
            return "too late"
        if self._seen >> -ahead & 1:
            return "a repeated message"
        self._seen |= 1 << -ahead
        return ""


class Seal:
    """Seals and opens the texts of one robot or operator; may be used on any thread.

    :param key: the key of the team.
    :param run: the name of the run; texts of other runs are refused.
    :param name: the name of the robot or operator that seals.
    :param clock: seconds since 1970.
    """

    def __init__(
        self, key: TeamKey, run: str, name: str, clock: Callable[[], float] = time.time
    ) -> None:
        self._key, self._run, self._name, self._clock = key, run, name, clock
        self._session = os.urandom(8).hex()
        self._started = _milliseconds(clock())
        self._lock = threading.Lock()
        self._sent: Dict[str, int] = {}
        self._heard: Dict[str, OrderedDict[str, Dict[str, _Numbers]]] = {}
        self._orders: OrderedDict[Tuple[str, int], float] = OrderedDict()

    def close(self, to: str, body: str, purpose: str) -> str:
        """Seal a text.

        :param to: the addressee; "" for everybody.
        :param purpose: what the text is, and any accompanying values that must not be changed.
        """
        with self._lock:
            number = self._sent[to] = self._sent.get(to, 0) + 1
        line = "%s %d %d %s %s" % (
            self._session,
            number,
            _milliseconds(self._clock()),
            _word(self._name),
            _word(to),
        )
        return "%s %s %s\n%s" % (MAGIC, self._code(purpose, line, body), line, body)

    def open(self, text: str, purpose: str, claimed: str = "") -> Unsealed:
        """Open a message that was sealed for us or for everybody.

        :param purpose: the purpose with which it was sealed.
        :param claimed: the supposed sender; "" if unknown.
        :raises NotSealedError: it was not, or it was received before.
        """
        line, body = self._verified(text, purpose)
        if claimed not in ("", line.sender):  # before its number is recorded as received
            raise NotSealedError("in the name of another robot", line.sender)
        now = self._clock()
        with self._lock:
            sessions = self._heard.setdefault(line.sender, OrderedDict())
            streams = sessions.get(line.session, {})
            if line.to in streams:
                sessions.move_to_end(line.session)
                why = streams[line.to].why_not(line.number)
            else:
                why = _age(now - line.time) if abs(now - line.time) > FRESH else ""
                if not why:
                    streams[line.to] = _Numbers(line.number)
                    sessions[line.session] = streams
                    while len(sessions) > _SESSIONS:
                        sessions.popitem(last=False)
        if why:
            raise NotSealedError(why, line.sender)
        return Unsealed(line.sender, body)

    def open_order(self, text: str, purpose: str) -> Unsealed:
        """Open an order that was sealed for us.

        :param purpose: the purpose with which it was sealed.
        :raises NotSealedError: it was not, it is too old, or it was received before.
        """
        line, body = self._verified(text, purpose)
        now = self._clock()
        if line.to != self._name:
            raise NotSealedError("an order for another robot", line.sender)
        if abs(now - line.time) > FRESH:
            raise NotSealedError(_age(now - line.time), line.sender)
        if 1000 * line.time < self._started:
            raise NotSealedError("an order from before this robot started", line.sender)
        with self._lock:
            while self._orders and next(iter(self._orders.values())) < now - 4 * FRESH:
                self._orders.popitem(last=False)
            if (line.session, line.number) in self._orders:
                raise NotSealedError("a repeated order", line.sender)
            self._orders[line.session, line.number] = now
        return Unsealed(line.sender, body)

    def _verified(self, text: str, purpose: str) -> Tuple[_Line, str]:
        first, newline, body = text.partition("\n")
        words = first.split(" ") if newline and len(first) <= _LONGEST_LINE else []
        if len(words) != 7 or words[0] != MAGIC:
            raise NotSealedError("without the key of the team")
        line = first.split(" ", 2)[2]
        given = words[1].encode("utf-8", "surrogatepass")
        if not hmac.compare_digest(self._code(purpose, line, body).encode(), given):
            raise NotSealedError("not sealed with the key of this team and run")
        sender, to = _name(words[5]), _name(words[6])
        if to not in ("", self._name):
            raise NotSealedError("a message for another robot", sender)
        try:
            return _Line(words[2], int(words[3]), int(words[4]) / 1000.0, sender, to), body
        except (ValueError, OverflowError):
            raise NotSealedError("its number or time is not a number", sender) from None

    def _code(self, purpose: str, line: str, body: str) -> str:
        return self._key.code(
            "%d:%s%d:%s%s\n%s" % (len(self._run), self._run, len(purpose), purpose, line, body)
        )


def is_sealed(text: str) -> bool:
    """Whether a text looks sealed."""
    return text.startswith(MAGIC + " ")


def _milliseconds(seconds: float) -> int:
    return int(1000 * seconds)


def _age(seconds: float) -> str:
    return "%.0f s old by our clock; it was recorded earlier, or the clocks differ" % seconds


@lru_cache(maxsize=4096)
def _word(name: str) -> str:
    """Encode a name as one word that is never empty."""
    return quote(name + ".", safe="")


@lru_cache(maxsize=4096)
def _name(word: str) -> str:
    return unquote(word)[:-1]

"""The hub of one open net: takes events from one source, and gives them to any number of viewers.

Viewers have a cursor each and the hub has no queue for any of them: a bounded ring of the recent
events serves all. A viewer whose cursor has fallen out of the ring, or that comes from another
*epoch* (another run, another server process), gets a whole snapshot. So a stalled viewer costs
nothing, and every viewer learns of its gaps.
"""

from __future__ import annotations

import json
import re
import secrets
import threading
import time
from collections import deque
from typing import Any, Deque, Dict, List, NamedTuple, Optional, Tuple

from gspn_framework_package.visualizer.board import Board, Event

RING = 20_000
"""Events kept: what viewers can catch up on, and how far back the scrubber reaches in a live
run."""

NEWS = 1000
"""Most events in one message to a viewer: one that has stalled holds a message of that size, and no
more."""

KEYFRAME = 500
"""A board is kept every so many events, so that any moment in the ring is found at once."""


class Cursor(NamedTuple):
    """Where a viewer is: it has seen the events of ``epoch`` up to number ``n``, and the latest
    values up to ``latest``."""

    epoch: str
    n: int
    latest: int = 0

    @classmethod
    def parse(cls, text: Optional[str]) -> Optional[Cursor]:
        """The cursor written as ``epoch:n`` or ``epoch:n:latest``; None for anything else."""
        parts = (text or "").split(":")
        if len(parts) in (2, 3) and all(re.fullmatch("[0-9]{1,17}", p) for p in parts[1:]):
            return cls(parts[0], int(parts[1]), int(parts[2]) if len(parts) == 3 else 0)
        return None

    def __str__(self) -> str:
        return "%s:%d:%d" % self


class News(NamedTuple):
    """What a viewer lacks, as JSON text, and its new cursor."""

    text: str
    cursor: Cursor


class KeptEvents:
    """Events that are kept somewhere else than in the ring, and are there whole."""

    def board_at(self, n: int) -> Board:
        """The board after event ``n``."""
        raise NotImplementedError

    def events(self, after: int, to: int) -> List[Event]:
        """The events numbered above ``after`` and up to ``to``."""
        raise NotImplementedError


class Hub:
    """See the module. All methods may be called from any thread.

    :param mode: what the page calls what it shows: SIMULATE, LIVE or REPLAY.
    :param board: the state at the beginning; the hub owns it from now on.
    :param ring: how many events are kept.
    """

    def __init__(self, mode: str, board: Board, ring: int = RING) -> None:
        self._condition = threading.Condition()
        self._ring_size = ring
        self.closed: Optional[str] = None
        """Why nothing will come any more; None while something may."""
        self.viewers = 0
        """How many streams follow it."""
        self.restart(mode, board)

    def restart(
        self,
        mode: str,
        board: Board,
        info: Optional[Dict[str, Any]] = None,
        ring: Optional[int] = None,
        history: Optional[KeptEvents] = None,
    ) -> None:
        """Begin a new epoch: another run, or another mode. Everybody gets a snapshot.

        :param info: what else the page should know of this run (its clock, its length, its name).
        :param ring: another number of events to keep.
        :param history: where the events are looked up. Viewers then get the number of events,
            rather than each event.
        """
        with self._condition:
            self._history = history
            self._ring_size = ring or self._ring_size
            self.mode = mode
            self.info = dict(info or {})
            self.epoch = secrets.token_hex(6)
            self._board = board
            self._events: Deque[Event] = deque()
            self._texts: Deque[str] = deque()
            self._oldest = board.copy()
            self._keyframes: Deque[Board] = deque()
            self._started = time.monotonic()
            self._latest: Dict[str, Tuple[int, str]] = {}
            self._latest_number = 0
            self._last_event = time.monotonic()
            self._condition.notify_all()

    # -- the source's side -------------------------------------------------------------------------

    def publish(self, *events: Event) -> None:
        """Take in events, in order."""
        with self._condition:
            for event in events:
                event["n"] = self._board.n + 1
                if "t" not in event:
                    event["t"] = round(time.monotonic() - self._started, 4)
                self._board.apply(event)
                self._events.append(event)
                self._texts.append(json.dumps(event, separators=(",", ":")))
                if event["n"] % KEYFRAME == 0:
                    self._keyframes.append(self._board.copy())
                if len(self._events) > self._ring_size:
                    self._oldest.apply(self._events.popleft())
                    self._texts.popleft()
            while self._keyframes and self._keyframes[0].n <= self._oldest.n:
                self._keyframes.popleft()
            self._last_event = time.monotonic()
            self._condition.notify_all()

    def advance(self, board: Board) -> None:
        """The history reaches as far as ``board`` now, which the hub owns from now on."""
        with self._condition:
            self._board = board
            self._condition.notify_all()

    def set_latest(self, key: str, value: Any) -> None:
        """Tell the latest value of something that has no history: feedback of an action, the robots
        in the room."""
        text = json.dumps(value, separators=(",", ":"))
        with self._condition:
            known = self._latest.get(key)
            if known is None or known[1] != text:
                self._latest_number += 1
                self._latest[key] = (self._latest_number, text)
                self._condition.notify_all()

    def change_info(self, **info: Any) -> None:
        """Change what the page knows of this run; published as a latest value."""
        # one step: nobody sees the change before it counts as news, nor half of two changes
        with self._condition:
            self.info.update(info)
            self.set_latest("info", self.info)

    def came(self, change: int = 1) -> None:
        """A stream begins to follow, or (-1) has ended."""
        with self._condition:
            self.viewers += change

    # -- the viewers' side -------------------------------------------------------------------------

    def wait(self, cursor: Optional[Cursor], timeout: float) -> bool:
        """Wait until there is something that ``cursor`` lacks; False when there is not, after
        ``timeout`` seconds."""
        with self._condition:
            return self._condition.wait_for(
                lambda: self.closed is not None or self._has_news(cursor), timeout
            )

    def close(self, why: str = "it was closed") -> None:
        """Nothing will come any more: wake all that wait."""
        with self._condition:
            self.closed = self.closed or why
            self._condition.notify_all()

    def _has_news(self, cursor: Optional[Cursor]) -> bool:
        return (
            cursor is None
            or cursor.epoch != self.epoch
            or cursor.n < self._board.n
            or cursor.latest < self._latest_number
        )

    def news(self, cursor: Optional[Cursor]) -> News:
        """What ``cursor`` lacks: events if they are all still there (the first :data:`NEWS` of
        them, and the word that there are ``more``), a snapshot otherwise."""
        with self._condition:
            now = Cursor(self.epoch, self._board.n, self._latest_number)
            fresh = (
                cursor is None
                or cursor.epoch != self.epoch
                or not (0 if self._history is not None else self._oldest.n) <= cursor.n <= now.n
            )
            since = 0 if fresh or cursor is None else cursor.latest
            latest = ",".join(
                "%s:%s" % (json.dumps(key), text)
                for key, (number, text) in self._latest.items()
                if number > since
            )
            if fresh or cursor is None:
                body = '"snapshot":%s' % json.dumps(self._snapshot(), separators=(",", ":"))
            elif self._history is not None:
                head = {"n": now.n, "t": self._board.t, "status": self._board.status}
                body = '"head":%s' % json.dumps(head, separators=(",", ":"))
            else:
                first = len(self._texts) - (now.n - cursor.n)
                new = [self._texts[i] for i in range(first, min(first + NEWS, len(self._texts)))]
                body = '"events":[%s]' % ",".join(new)
                if cursor.n + len(new) < now.n:
                    now = now._replace(n=cursor.n + len(new))
                    body += ',"more":true'
            return News('{"cursor":"%s",%s,"latest":{%s}}' % (now, body, latest), now)

    def _snapshot(self) -> Dict[str, Any]:
        return {
            "epoch": self.epoch,
            "mode": self.mode,
            "info": self.info,
            "oldest": self._oldest.n,
            "board": self._board.to_json(),
            "age": round(time.monotonic() - self._last_event, 3) if self._events else None,
            "clock": round(time.monotonic() - self._started, 3),
        }

    def board(self) -> Board:
        """A copy of the present board."""
        with self._condition:
            return self._board.copy()

    def status(self) -> Dict[str, Any]:
        """The status of the present board."""
        with self._condition:
            return dict(self._board.status)

    def board_at(self, n: int) -> Board:
        """The board after event ``n``; the nearest there is, where ``n`` has left the ring or has
        not come yet."""
        history = self._history
        if history is not None:
            return history.board_at(n)
        with self._condition:
            n = max(self._oldest.n, min(n, self._board.n))
            base = self._oldest
            for keyframe in self._keyframes:
                if keyframe.n > n:
                    break
                base = keyframe
            events = self._slice(base.n, n)
            board = base.copy()
        for event in events:
            board.apply(event)
        return board

    def events(self, after: int, to: int, limit: int = 5000) -> List[Event]:
        """The events numbered above ``after`` and up to ``to``, as far as the ring has them, at
        most the last ``limit``."""
        history = self._history
        with self._condition:
            to = min(to, self._board.n)
            if history is None:
                return self._slice(max(after, to - limit), to)
        return history.events(max(after, to - limit), to)

    def _slice(self, after: int, to: int) -> List[Event]:
        first = max(0, after - self._oldest.n)
        last = max(0, min(to, self._board.n) - self._oldest.n)
        return [self._events[i] for i in range(first, last)]

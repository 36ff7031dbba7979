"""The hub of one open net: passes the events of one source to any number of viewers.

Each viewer has a cursor. The hub keeps no queue per viewer: one bounded ring of recent events
serves all. A viewer whose cursor has fallen out of the ring, or belongs to another *epoch* (another
run, another server process), gets a complete snapshot. So a stalled viewer costs nothing, and no
viewer misses events without noticing.
"""

from __future__ import annotations

import json
import re
import secrets
import threading
import time
from collections import deque
from typing import Any, Callable, Deque, Dict, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.model.compact_json import compact
from gspn_framework_package.visualizer.board import Board, Event
from gspn_framework_package.visualizer.poses import PoseTrack

RING = 20_000
"""Number of events kept, which limits how far viewers can catch up and how far back the scrubber
reaches in a live run."""

NEWS = 1000
"""Largest number of events in one message to a viewer, which bounds the memory for a stalled
viewer."""

KEYFRAME = 500
"""Number of events between two stored boards, which give fast access to any moment in the ring."""


class Cursor(NamedTuple):
    """The position of a viewer: it has seen the events of ``epoch`` up to number ``n``, and the
    latest values up to number ``latest``."""

    epoch: str
    n: int
    latest: int = 0

    @classmethod
    def parse(cls, text: Optional[str]) -> Optional[Cursor]:
        """Read a cursor written as ``epoch:n`` or ``epoch:n:latest``; None for anything else."""
        parts = (text or "").split(":")
        if len(parts) in (2, 3) and all(re.fullmatch("[0-9]{1,17}", p) for p in parts[1:]):
            return cls(parts[0], int(parts[1]), int(parts[2]) if len(parts) == 3 else 0)
        return None

    def __str__(self) -> str:
        return "%s:%d:%d" % self


Tap = Callable[[Sequence[Event]], None]
"""See :meth:`Hub.tap`."""


class News(NamedTuple):
    """The data that a viewer is missing, as JSON text, and its new cursor."""

    text: str
    cursor: Cursor


class KeptEvents:
    """A complete history of events, kept outside the ring."""

    def board_at(self, n: int) -> Board:
        """The board after event ``n``."""
        raise NotImplementedError

    def events(self, after: int, to: int) -> List[Event]:
        """The events numbered above ``after`` and up to ``to``."""
        raise NotImplementedError


class Hub:
    """The hub of one open net; see the module. All methods may be called from any thread.

    :param mode: the page's name for what it shows: SIMULATE, LIVE or REPLAY.
    :param board: the initial state; the hub owns it from now on.
    :param ring: how many events are kept.
    """

    def __init__(self, mode: str, board: Board, ring: int = RING) -> None:
        self._condition = threading.Condition()
        self._ring_size = ring
        self.closed: Optional[str] = None
        """Why no more events will come; None while the hub is open."""
        self.viewers = 0
        """Number of streams that follow the hub."""
        self.restart(mode, board)

    def restart(
        self,
        mode: str,
        board: Board,
        info: Optional[Dict[str, Any]] = None,
        ring: Optional[int] = None,
        history: Optional[KeptEvents] = None,
        track: Optional[PoseTrack] = None,
    ) -> None:
        """Begin a new epoch: another run, or another mode. Every viewer gets a snapshot.

        :param mode: as for the hub.
        :param board: the initial state; the hub owns it from now on.
        :param info: further facts about this run for the page (its clock, its length, its name).
        :param ring: a new number of events to keep; None: as before.
        :param history: the store in which events are looked up. Viewers then get the number of
            events instead of each event.
        :param track: where the robots of a recorded run were.
        """
        with self._condition:
            self._history = history
            self._recorded, self._track = track, track or PoseTrack()
            self._ring_size = ring or self._ring_size
            self._tap: Optional[Tap] = None
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
            if track:
                self.set_latest("world", {"robots": track.first()})
                if track.room is not None:
                    self.set_latest("room", track.room)
            self._condition.notify_all()

    # -- the source's side -------------------------------------------------------------------------

    def publish(self, *events: Event) -> None:
        """Add events, in order."""
        with self._condition:
            for event in events:
                if "t" not in event:
                    event["t"] = round(time.monotonic() - self._started, 4)
                self._board.admit(event)
                self._events.append(event)
                self._texts.append(compact(event))
                if event["n"] % KEYFRAME == 0:
                    self._keyframes.append(self._board.copy())
                if len(self._events) > self._ring_size:
                    self._oldest.apply(self._events.popleft())
                    self._texts.popleft()
            while self._keyframes and self._keyframes[0].n <= self._oldest.n:
                self._keyframes.popleft()
            self._last_event = time.monotonic()
            self._condition.notify_all()

            if self._tap is not None:
                self._tap(events)

    def tap(self, take: Tap) -> None:
        """Call ``take`` with all further events of this epoch, in order; it replaces an earlier
        callback and must return at once."""
        with self._condition:
            self._tap = take

    def untap(self, take: Tap) -> None:
        """Stop calling ``take``."""
        with self._condition:
            if self._tap == take:
                self._tap = None

    def clock(self) -> float:
        """Seconds since this epoch began, the clock of its events."""
        with self._condition:
            return time.monotonic() - self._started

    def advance(self, board: Board) -> None:
        """Record that the history now reaches up to ``board``, which the hub owns from now on."""
        with self._condition:
            self._board = board
            self._condition.notify_all()

    def set_latest(self, key: str, value: Any) -> None:
        """Publish the latest value of something that has no history, such as the feedback of an
        action or the robots in the room."""
        text = compact(value)
        with self._condition:
            known = self._latest.get(key)
            if known is None or known[1] != text:
                self._latest_number += 1
                self._latest[key] = (self._latest_number, text)
                self._condition.notify_all()

    def show_world(self, world: Dict[str, Any]) -> None:
        """Publish where the robots are, and keep it for the time line."""
        self.set_latest("world", world)
        with self._condition:
            self._track.add(time.monotonic() - self._started, world.get("robots", {}))

    def change_info(self, **info: Any) -> None:
        """Change the facts about this run; they are published as a latest value."""
        # atomic: viewers never see an unpublished change or half of two changes
        with self._condition:
            self.info.update(info)
            self.set_latest("info", self.info)

    def came(self, change: int = 1) -> None:
        """Count a stream that begins to follow, or (-1) that has ended."""
        with self._condition:
            self.viewers += change

    # -- the viewers' side -------------------------------------------------------------------------

    def wait(self, cursor: Optional[Cursor], timeout: float) -> bool:
        """Wait until there is something newer than ``cursor``, or the hub is closed; return False
        if neither happens within ``timeout`` seconds."""
        with self._condition:
            return self._condition.wait_for(
                lambda: self.closed is not None or self._has_news(cursor), timeout
            )

    def close(self, why: str = "it was closed") -> None:
        """Close the hub, for the reason ``why``, and wake all waiting viewers."""
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
        """Everything newer than ``cursor``: events if the ring still holds all of them (the first
        :data:`NEWS`, marked ``more`` if there are further ones), a snapshot otherwise."""
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
                body = '"snapshot":%s' % compact(self._snapshot())
            elif self._history is not None:
                head = {"n": now.n, "t": self._board.t, "status": self._board.status}
                body = '"head":%s' % compact(head)
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
        """A copy of the current board."""
        with self._condition:
            return self._board.copy()

    def status(self) -> Dict[str, Any]:
        """The status of the current board."""
        with self._condition:
            return dict(self._board.status)

    def board_at(self, n: int) -> Board:
        """The board after event ``n``, or the nearest one available if ``n`` has left the ring or
        lies in the future."""
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
        """The events numbered above ``after`` and up to ``to`` that are available, at most the last
        ``limit``."""
        history = self._history
        with self._condition:
            to = min(to, self._board.n)
            if history is None:
                return self._slice(max(after, to - limit), to)
        return history.events(max(after, to - limit), to)

    def event_at(self, t: float) -> Optional[int]:
        """The number of the last event up to ``t`` seconds after the beginning; None if a recording
        has not been read that far."""
        with self._condition:
            low = self._oldest.n if self._history is None else 0
            high = self._board.n
            if self.info.get("loading") and t > self._board.t:
                return None
        while low < high:
            middle = (low + high + 1) // 2
            found = self.events(middle - 1, middle)
            if found and found[0]["t"] > t:
                high = middle - 1
            else:
                low = middle
        return low

    def poses_around(self, t: float) -> Dict[str, Any]:
        """Where the robots were around ``t`` seconds after the beginning: see
        :meth:`~gspn_framework_package.visualizer.poses.PoseTrack.around`."""
        with self._condition:
            if self._recorded is not None:
                return self._track.around(t)
            return self._track.around(t, time.monotonic() - self._started)

    def _slice(self, after: int, to: int) -> List[Event]:
        first = max(0, after - self._oldest.n)
        last = max(0, min(to, self._board.n) - self._oldest.n)
        return [self._events[i] for i in range(first, last)]

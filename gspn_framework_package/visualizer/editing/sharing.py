"""Several people who edit one plan: who they are, and which state of it is the latest.

The state that they share is the plan's draft or, without one, its files; its version names it. A
page that sends a state also sends the version that it is based on. One that is based on an earlier
version is refused, with the present state, so that the page merges the two and sends the result.
"""

from __future__ import annotations

import json
import threading
import time
from dataclasses import dataclass, field
from typing import Any, Dict, Iterator, List, Optional, Tuple

from gspn_framework_package.model.errors import LimitError, RefusedError, UsageError
from gspn_framework_package.visualizer.streams import PING, Streams

MOST_EDITORS = 32
"""Largest number of pages that edit one plan."""

ABSENT = 20.0
"""Seconds without a sign of a page after which it has left."""

GATHERED = 0.1
"""Seconds during which a stream gathers changes into one message."""

MOST_SELECTED = 200
LONGEST_KEY = 300


class OutdatedError(RefusedError):
    """The sent state is based on an earlier version. ``theirs``: the present one, as the page reads
    it."""

    def __init__(self, theirs: Dict[str, Any]) -> None:
        super().__init__(
            "somebody else has changed the plan meanwhile: nothing was stored",
            hint="merge your changes with theirs",
        )
        self.theirs = theirs


@dataclass
class _Editor:
    """A page that edits a plan: the ``number`` by which the others refer to it, and what is
    selected."""

    number: int
    seen: float
    streams: int = 0
    selection: List[str] = field(default_factory=list)
    at: Optional[List[float]] = None


@dataclass
class _Room:
    """A plan that is edited: its latest version, and the pages; ``news`` counts the changes."""

    version: str = ""
    news: int = 0
    editors: Dict[str, _Editor] = field(default_factory=dict)


class SharedPlans:
    """The plans that are edited at present, by their files."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._rooms: Dict[str, _Room] = {}

    def come(
        self, path: str, page: object, version: str, fields: Dict[str, Any], stream: bool = False
    ) -> None:
        """Note that a page shows a plan.

        :param version: the plan's present version.
        :param fields: ``selection``, keys of elements, and ``at``, the pointer in the drawing.
        :param stream: whether it opens a stream, which calls :meth:`leave` at its end.
        :raises GspnError: the fields are malformed, or too many pages edit the plan.
        """
        if not isinstance(page, str) or not 1 <= len(page) <= 80:
            raise UsageError("'page' is missing")
        selection, at = _selection(fields.get("selection", [])), _spot(fields.get("at"))
        with self._condition:
            room = self._rooms.setdefault(path, _Room())
            self._forget_absent(room)
            known = room.editors.get(page)
            if known is None:
                if len(room.editors) >= MOST_EDITORS:
                    raise LimitError("%d pages edit this plan already" % MOST_EDITORS)
                numbers = {editor.number for editor in room.editors.values()}
                known = _Editor(next(n for n in range(1, 100) if n not in numbers), 0.0)
                room.editors[page] = known
                room.news += 1
            known.seen = time.monotonic()
            known.streams += stream
            if (known.selection, known.at) != (selection, at) and fields:
                known.selection, known.at = selection, at
                room.news += 1
            self._put(room, version)

    def leave(self, path: str, page: object, entirely: bool = False) -> None:
        """Note that a stream of a page has ended; with its last one, the page has left the plan.

        :param entirely: the page has left, whatever becomes of its streams.
        """
        with self._condition:
            room = self._rooms.get(path)
            if room is None or not isinstance(page, str) or page not in room.editors:
                return
            editor = room.editors[page]
            editor.streams -= 1
            if entirely or editor.streams <= 0:
                del room.editors[page]
                room.news += 1
                self._condition.notify_all()
            if not room.editors:
                del self._rooms[path]

    def changed(self, path: str, version: str) -> None:
        """Note that a plan has a new version."""
        with self._condition:
            room = self._rooms.get(path)
            if room is not None:
                self._put(room, version)

    def _put(self, room: _Room, version: str) -> None:
        if room.version != version:
            room.version = version
            room.news += 1
        self._condition.notify_all()

    def others(self, path: str, page: object) -> int:
        """How many other pages edit a plan."""
        with self._condition:
            room = self._rooms.get(path, _Room())
            self._forget_absent(room)
            return sum(other != page for other in room.editors)

    def told(self, path: str) -> Dict[str, Any]:
        """What the pages that show a plan receive: its version, and who edits it."""
        with self._condition:
            return self._told(self._rooms.get(path, _Room()))

    def _told(self, room: _Room) -> Dict[str, Any]:
        self._forget_absent(room)
        return {
            "version": room.version,
            "editors": [
                {"page": page, "number": e.number, "selection": e.selection, "at": e.at}
                for page, e in room.editors.items()
            ],
        }

    def wait(
        self, path: str, page: str, seen: int, timeout: float
    ) -> Optional[Tuple[int, Dict[str, Any]]]:
        """Wait until there is news after the one counted ``seen``; None if there is none."""
        with self._condition:
            room = self._rooms.setdefault(path, _Room())
            self._condition.wait_for(lambda: room.news != seen, timeout)
            if page in room.editors:
                room.editors[page].seen = time.monotonic()
            return (room.news, self._told(room)) if room.news != seen else None

    @staticmethod
    def _forget_absent(room: _Room) -> None:
        limit = time.monotonic() - ABSENT
        for page in [page for page, editor in room.editors.items() if editor.seen < limit]:
            del room.editors[page]
            room.news += 1


class EditorStream:
    """The messages to a page that edits a plan; the page has left when it is closed."""

    def __init__(
        self, plans: SharedPlans, path: str, page: str, streams: Streams, peer: str
    ) -> None:
        self._plans, self._path, self._page = plans, path, page
        self._streams, self._peer = streams, peer
        self._messages = self._run()
        self._open = True

    def _run(self) -> Iterator[bytes]:
        yield b"retry: 1000\n\n"
        seen = -1
        while not self._streams.closing:
            found = self._plans.wait(self._path, self._page, seen, PING)
            if found is None:
                yield b"event: ping\ndata: {}\n\n"
                continue
            seen, told = found
            yield b"data: %s\n\n" % json.dumps(told).encode()
            time.sleep(GATHERED)

    def __iter__(self) -> Iterator[bytes]:
        return self._messages

    def close(self) -> None:
        """Called by the web server when the page has disconnected."""
        if self._open:
            self._open = False
            self._plans.leave(self._path, self._page)
            self._streams.give_back(self._peer)


def _selection(keys: object) -> List[str]:
    if not isinstance(keys, list) or not all(isinstance(key, str) for key in keys):
        raise UsageError("'selection' is not a list of keys")
    return [key[:LONGEST_KEY] for key in keys[:MOST_SELECTED]]


def _spot(at: object) -> Optional[List[float]]:
    if at is None:
        return None
    if not isinstance(at, list) or len(at) != 2 or not all(type(v) in (int, float) for v in at):
        raise UsageError("'at' is not a point")
    return [float(v) for v in at]

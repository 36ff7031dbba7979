"""The newest slots of the log, for those who are behind."""

from __future__ import annotations

from collections import deque
from typing import Any, Deque, List, Optional, Tuple

KEPT = 2000
"""Slots that are kept in memory; who is further behind gets a snapshot."""

CHUNK = 200
"""Slots sent at a time."""


class History:
    """Slots as (ballot, batch), in order, and the hash chain before each."""

    def __init__(self) -> None:
        self._first = 0
        self._slots: Deque[Tuple[List[Any], List[Any], str]] = deque()

    def clear(self, first: int) -> None:
        """Begin anew at slot ``first``."""
        self._first = first
        self._slots.clear()

    def add(self, slot: int, ballot: List[Any], batch: List[Any], before: str) -> None:
        """Keep a slot; ``before`` is the end of the hash chain before it."""
        if slot != self._first + len(self._slots):
            self.clear(slot)
        self._slots.append((ballot, batch, before))
        if len(self._slots) > KEPT:
            self._slots.popleft()
            self._first += 1

    def since(self, slot: int) -> Optional[List[Any]]:
        """Some slots from ``slot`` on as [ballot, batch, hash chain before it]; None where they are
        not kept any more."""
        if slot < self._first:
            return None
        at = slot - self._first
        return [list(self._slots[i]) for i in range(at, min(at + CHUNK, len(self._slots)))]

    def hash_before(self, slot: int) -> Optional[str]:
        """The end of the hash chain before ``slot``, None where it is not kept."""
        at = slot - self._first
        return self._slots[at][2] if 0 <= at < len(self._slots) else None

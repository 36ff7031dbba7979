"""The newest slots of the log, for robots that are only a little behind and need no snapshot.

A collection owned by :mod:`~gspn_framework_package.execution.agreement.replication`; calls no other
part.
"""

from __future__ import annotations

from collections import deque
from typing import Deque, Optional, Tuple

from gspn_framework_package.execution.agreement.messages import Batch
from gspn_framework_package.execution.agreement.quorum import Ballot

Slot = Tuple[Ballot, Batch, str]
"""The ballot under which a slot was decided, its batch, and the hash chain before it."""


class RecentSlots:
    """The newest slots, in order.

    :param kept: how many slots are kept; a robot that is further behind gets a snapshot.
    :param chunk: how many slots are sent at a time.
    """

    def __init__(self, kept: int, chunk: int) -> None:
        self._kept = kept
        self._chunk = chunk
        self._first = 0
        self._slots: Deque[Slot] = deque()

    def clear(self, first: int) -> None:
        """Start over at slot ``first``."""
        self._first = first
        self._slots.clear()

    def add(self, slot: int, ballot: Ballot, batch: Batch, before: str) -> None:
        """Add a slot; ``before`` is the end of the hash chain before it."""
        if slot != self._first + len(self._slots):
            self.clear(slot)
        self._slots.append((ballot, batch, before))
        if len(self._slots) > self._kept:
            self._slots.popleft()
            self._first += 1

    def since(self, slot: int) -> Optional[Tuple[Slot, ...]]:
        """Some slots from ``slot`` on; None if they are no longer kept."""
        if slot < self._first:
            return None
        at = slot - self._first
        return tuple(self._slots[i] for i in range(at, min(at + self._chunk, len(self._slots))))

    def hash_before(self, slot: int) -> Optional[str]:
        """The end of the hash chain before ``slot``; None if it is not kept."""
        at = slot - self._first
        return self._slots[at][2] if 0 <= at < len(self._slots) else None

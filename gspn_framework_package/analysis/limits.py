"""How far an analysis may go, and who counts: no search runs without an end, and where one stops it
says so."""

from __future__ import annotations

from typing import NamedTuple, Optional

from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError

STATE_LIMIT = 2_000_000
"""Markings that are visited when nothing else is said."""

LARGE_NET = 10_000
"""Places and transitions from which on fewer markings are visited when nothing else is said: each
takes longer."""

TREE_LIMIT = 50_000
"""Nodes that a coverability tree may have when nothing else is said."""

STRUCTURE_LIMIT = 2_000_000
"""Elementary steps of each search for invariants, siphons or traps when nothing else is said: a
second or two."""

SECONDS = 300.0
"""Longest time (s) of each part of an analysis when nothing else is said."""

MEMORY = 4 << 30
"""Bytes that the result of each part may take when nothing else is said."""


class Limits(NamedTuple):
    """The limits of one analysis.

    :ivar states: markings to visit at most; None: see :func:`states_of`.
    :ivar tree: nodes of a coverability tree at most.
    :ivar structure: elementary steps of each search for invariants, siphons and traps at most.
    :ivar seconds: longest time (s) of each part.
    :ivar memory: bytes that a state space or a coverability tree may take at most.
    """

    states: Optional[int] = None
    tree: int = TREE_LIMIT
    structure: int = STRUCTURE_LIMIT
    seconds: float = SECONDS
    memory: int = MEMORY


def states_of(nodes: int) -> int:
    """The markings to visit at most in a net of so many places and transitions, when nothing else
    is said."""
    return STATE_LIMIT if nodes <= LARGE_NET else max(STATE_LIMIT * LARGE_NET // nodes, 20_000)


class Effort:
    """Counts the elementary steps of one search.

    :param limit: how many there may be.
    :param watch: asked now and then whether to stop.

    >>> effort = Effort(100)
    >>> effort.spend(60, "rows")
    >>> effort.spend(60, "rows")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    gspn_framework_package.model.errors.LimitError: too much work: more than 100 steps...
    """

    def __init__(self, limit: int, watch: Optional[Watch] = None) -> None:
        self._limit = limit
        self._watch = watch or Watch()
        self._asked = 0
        self.steps = 0

    def spend(self, steps: int, what: str, found: str = "") -> None:
        """Count ``steps`` more.

        :param what: what the search deals with, for the progress line.
        :param found: what it has found so far, for the error.
        :raises LimitError: those were too many.
        :raises CancelledError: the watch said so.
        """
        self.steps += steps
        if self.steps > self._limit:
            raise LimitError(
                "too much work: more than %s steps%s"
                % (format(self._limit, ","), found and "; " + found),
                hint="raise --limit-structure",
            )
        if self.steps - self._asked >= 10_000:
            self._asked = self.steps
            self._watch.step(what, self.steps)

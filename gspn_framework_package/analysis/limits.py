"""Limits of an analysis, and the counter that enforces them: every search terminates and reports
whether it stopped early."""

from __future__ import annotations

from typing import NamedTuple, Optional

from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError

STATE_LIMIT = 2_000_000
"""Default limit on the markings visited."""

LARGE_NET = 10_000
"""Number of places and transitions above which the default limits on markings and steps decrease,
since each takes longer."""

TREE_LIMIT = 50_000
"""Default limit on the nodes of a coverability tree."""

STRUCTURE_LIMIT = 2_000_000
"""Default limit on the elementary steps of each search for invariants, siphons or traps: one or two
seconds of work."""

DEFAULT_SECONDS = 300.0
"""Default time limit (s) of each part of an analysis."""

DEFAULT_MEMORY = 4 << 30
"""Default limit on the size (bytes) of the result of each part."""


class Limits(NamedTuple):
    """The limits of one analysis.

    :ivar states: largest number of markings to visit; None: see :func:`states_of`.
    :ivar tree: largest number of nodes of a coverability tree.
    :ivar structure: largest number of elementary steps of each search for invariants, siphons and
        traps; None: see :func:`structure_of`.
    :ivar seconds: longest time (s) of each part.
    :ivar memory: largest size (bytes) of a state space or a coverability tree.
    """

    states: Optional[int] = None
    tree: int = TREE_LIMIT
    structure: Optional[int] = None
    seconds: float = DEFAULT_SECONDS
    memory: int = DEFAULT_MEMORY


def states_of(nodes: int) -> int:
    """The default limit on markings for a net with ``nodes`` places and transitions."""
    return STATE_LIMIT if nodes <= LARGE_NET else max(STATE_LIMIT * LARGE_NET // nodes, 20_000)


def structure_of(nodes: int) -> int:
    """The default limit on the steps of each search for a net with ``nodes`` places and
    transitions. A search without branches takes five or six per node."""
    if nodes <= LARGE_NET:
        return STRUCTURE_LIMIT
    return min(max(STRUCTURE_LIMIT // 2, 8 * nodes), STRUCTURE_LIMIT)


class Effort:
    """Counts the elementary steps of one search.

    :param limit: largest number of steps.
    :param watch: consulted at intervals, and may stop the search.

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

    def afford(self, steps: int, found: str = "") -> None:
        """Check that ``steps`` more are within the limit, without counting them.

        :param found: what the search has found so far, for the error message.
        :raises LimitError: they exceed it.
        """
        if self.steps + steps > self._limit:
            raise LimitError(
                "too much work: more than %s steps%s"
                % (format(self._limit, ","), found and "; " + found),
                hint="raise --limit-structure",
            )

    def spend(self, steps: int, what: str, found: str = "") -> None:
        """Count ``steps`` more.

        :param what: what the search is counting, for the progress line.
        :param found: what it has found so far, for the error message.
        :raises LimitError: the limit is exceeded.
        :raises CancelledError: the watch cancelled the search.
        """
        self.steps += steps
        if self.steps > self._limit:
            self.afford(0, found)
        if self.steps - self._asked >= 10_000:
            self._asked = self.steps
            self._watch.step(what, self.steps)

"""The state space of a net: its reachable markings and the firings between them.

>>> from gspn_framework_package.model.builder import NetBuilder
>>> net = (NetBuilder().place("a", tokens=2).place("b")
...        .exponential("go", inputs="a", outputs="b").exponential("back", inputs="b", outputs="a").build())
>>> space = explore(net)
>>> len(space), space.arcs, space.complete
(3, 4, True)
>>> space.path_to(2)
['go', 'go']
"""

from __future__ import annotations

import importlib.util
import sys
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np

from gspn_framework_package.analysis import numpy_engine
from gspn_framework_package.analysis.exploration import (
    Cancel,
    FieldOverflowError,
    Progress,
    RawGraph,
    Watch,
)
from gspn_framework_package.analysis.invariants import invariant_bounds
from gspn_framework_package.analysis.packing import PackedNet, starting_widths
from gspn_framework_package.model.condition import Condition, parse_condition
from gspn_framework_package.model.errors import LimitError, UsageError
from gspn_framework_package.model.net import Marking, Net

STATE_LIMIT = 2_000_000
"""States that an exploration may find when nothing else is said."""

ENGINES = ("auto", "numpy", "numba")

_SMALL = 100_000
"""Up to this many states numpy is done before numba's machine code is even loaded."""

_FEW_ROUNDS = 5_000
"""Rounds that numpy is given for them, a second or so: it is slow where the graph is deep and narrow."""

_INVARIANT_EFFORT = 2_000
"""Candidate invariants worth looking at for the sake of narrow fields."""


class Step(NamedTuple):
    """One firing of a witness: the transition, and the marking after it."""

    transition: str
    marking: Dict[str, int]


class StateSpace:
    """Reachable markings and firings, as arrays; made by :func:`explore`.

    States are numbered from 0, the initial marking, in breadth-first order.

    :ivar net: the net.
    :ivar untimed: whether immediate transitions had no precedence.
    :ivar offsets: int array of ``len(self) + 1``: the arcs of state ``s`` are ``offsets[s]`` to ``offsets[s + 1]``.
    :ivar targets: int array: the state that each arc leads to.
    :ivar transitions: int array: the number of the transition of each arc.
    :ivar explored: the successors of this many states are known.
    :ivar engine: what explored it, ``numpy`` or ``numba``.
    """

    def __init__(self, packed: PackedNet, graph: RawGraph, *, untimed: bool, engine: str) -> None:
        self.net = packed.net
        self.untimed = untimed
        self.engine = engine
        self.offsets = graph.offsets
        self.targets = graph.targets
        self.explored = graph.explored
        self._packed = packed
        self._states = graph.states
        order = packed.order.astype(graph.labels.dtype)
        in_file_order = bool((np.diff(packed.order) > 0).all())
        self.transitions = graph.labels if in_file_order else order[graph.labels]
        self._parents: Optional[Any] = None

    def __len__(self) -> int:
        return len(self._states)

    @property
    def arcs(self) -> int:
        """How many firings there are between the states."""
        return len(self.targets)

    @property
    def complete(self) -> bool:
        """Whether these are all reachable markings: the limit was not met."""
        return self.explored == len(self)

    @property
    def memory(self) -> int:
        """Bytes that the arrays take."""
        return int(self._states.nbytes + self.offsets.nbytes + self.targets.nbytes + self.transitions.nbytes)

    def require_complete(self, question: str) -> None:
        """:raises LimitError: the limit on states was met, so that ``question`` is not decided."""
        if not self.complete:
            raise LimitError(
                "%s: not decided within %d states" % (question, len(self)),
                hint="raise the limit, or ask about a smaller net",
            )

    # -- markings ---------------------------------------------------------------------------------------

    def marking(self, state: int) -> Marking:
        """The marking of one state."""
        return tuple(self._packed.unpack(self._states[state : state + 1])[0].tolist())

    def named(self, state: int) -> Dict[str, int]:
        """The marking of one state as place -> count, without the empty places."""
        return self.net.named(self.marking(state), zeros=False)

    def markings(self, states: Any = None) -> Any:
        """Markings as an int64 array, one row a state, one column a place; of all states, or of those numbered
        (or sliced, or masked) by ``states``."""
        return self._packed.unpack(self._states if states is None else self._states[states])

    def column(self, place: int) -> Any:
        """Token counts of place number ``place`` in every state, as an int64 array."""
        return self._packed.column(self._states, place)

    def find(self, marking: Union[Sequence[int], Mapping[str, int]]) -> Optional[int]:
        """The number of the state with that marking (in place order, or place -> count), or None."""
        counts = self.net.marking(marking) if isinstance(marking, Mapping) else tuple(marking)
        if not self._packed.fits(counts):
            return None
        found = np.flatnonzero((self._states == self._packed.pack(counts)).all(axis=1))
        return int(found[0]) if len(found) else None

    def holds(self, condition: Union[str, Condition]) -> Any:
        """In which states a condition holds, as a boolean array; ``deadlock`` may be part of it.

        :raises ExpressionError: it cannot be read.
        """
        if isinstance(condition, str):
            condition = self.condition(condition)
        result = np.empty(len(self), dtype=bool)
        dead = self.is_dead if condition.labels else None
        for begin in range(0, len(self), 1 << 17):
            part = slice(begin, begin + (1 << 17))
            labels = {} if dead is None else {"deadlock": dead[part]}
            result[part] = condition.holds_in(self.markings(part), labels)
        return result

    def condition(self, text: str) -> Condition:
        """A condition on the markings of this net; ``deadlock`` may be part of it."""
        return parse_condition(text, [p.name for p in self.net.places], ["deadlock"])

    # -- kinds of states --------------------------------------------------------------------------------

    @property
    def is_dead(self) -> Any:
        """Boolean array: no transition is enabled (known of explored states only)."""
        dead = np.diff(self.offsets) == 0
        dead[self.explored :] = False
        return dead

    @property
    def is_vanishing(self) -> Any:
        """Boolean array: an immediate transition is enabled, so no time is spent there."""
        timed = np.array([t.timed for t in self.net.transitions] or [True])
        result = np.zeros(len(self), dtype=bool)
        has_arcs = np.flatnonzero(np.diff(self.offsets))
        result[has_arcs] = ~timed[self.transitions[self.offsets[has_arcs]]]
        return result

    @property
    def deadlocks(self) -> Any:
        """Numbers of the states in which no transition is enabled."""
        return np.flatnonzero(self.is_dead)

    # -- arcs -------------------------------------------------------------------------------------------

    @property
    def sources(self) -> Any:
        """int array: the state that each arc leaves."""
        return np.repeat(np.arange(len(self), dtype=self.targets.dtype), np.diff(self.offsets))

    def successors(self, state: int) -> List[Tuple[str, int]]:
        """Pairs (transition, state) of one state."""
        part = slice(self.offsets[state], self.offsets[state + 1])
        return [(self.transition_name(t), int(s)) for t, s in zip(self.transitions[part], self.targets[part])]

    def transition_name(self, transition: int) -> str:
        """The name of transition number ``transition``."""
        return self.net.transitions[transition].name

    def path_to(self, state: int) -> List[str]:
        """Names of the transitions of a shortest firing sequence from the initial marking to ``state``."""
        return [self.transition_name(t) for t, _ in self._way_to(state)]

    def witness(self, state: int) -> List[Step]:
        """The same with the marking after each firing."""
        return [Step(self.transition_name(t), self.named(s)) for t, s in self._way_to(state)]

    def _way_to(self, state: int) -> List[Tuple[int, int]]:
        if self._parents is None:
            # The arc that discovered a state is the first that leads to it.
            parents = np.full(len(self), -1, dtype=np.int64)
            parents[self.targets[::-1]] = np.arange(self.arcs - 1, -1, -1)
            self._parents = parents
        way = []
        while state:
            arc = int(self._parents[state])
            way.append((int(self.transitions[arc]), state))
            state = int(np.searchsorted(self.offsets, arc, side="right")) - 1
        return way[::-1]

    def __repr__(self) -> str:
        return "<StateSpace of %s: %d states, %d arcs%s>" % (
            self.net.name or "a net",
            len(self),
            self.arcs,
            "" if self.complete else ", not complete",
        )


def explore(
    net: Net,
    *,
    limit: int = STATE_LIMIT,
    engine: str = "auto",
    untimed: bool = False,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    bounds: Optional[Sequence[Optional[int]]] = None,
) -> StateSpace:
    """Find the reachable markings.

    :param limit: stop soon after this many states are known; the result then is not ``complete``.
    :param engine: ``numpy``, ``numba``, or ``auto``: numba for large state spaces, where it is installed.
    :param untimed: let immediate transitions have no precedence over others, nor priorities among themselves: what
        the robots of a plan, which take time in decision places too, can reach.
    :param progress: told the number of states now and then.
    :param cancel: asked now and then.
    :param bounds: of each place, the most tokens it can hold (None: unknown), if the caller knows; otherwise
        the P-invariants are asked. A bound that is too low costs time, never correctness.
    :raises CancelledError: ``cancel`` said so.
    :raises UsageError: the engine is not there.
    """
    if engine not in ENGINES:
        raise UsageError("there is no engine '%s'" % engine, hint="choose among %s" % ", ".join(ENGINES))
    if limit < 1:
        raise UsageError("a limit of %d states makes no sense" % limit, hint="give a number of at least 1")
    if bounds is None:
        bounds = invariant_bounds(net, _INVARIANT_EFFORT)
    watch = Watch(progress, cancel)
    widths = starting_widths(net, bounds)
    while True:
        packed = PackedNet(net, widths, by_priority=not untimed)
        try:
            graph, name = _run(packed, limit, watch, engine)
            return StateSpace(packed, graph, untimed=untimed, engine=name)
        except FieldOverflowError as overflow:
            widths = packed.wider(overflow.bits)


def _run(packed: PackedNet, limit: int, watch: Watch, engine: str) -> Tuple[RawGraph, str]:
    if engine == "numpy" or (engine == "auto" and not numba_is_there()):
        return numpy_engine.explore(packed, limit, watch), "numpy"
    if engine == "auto" and "numba" not in sys.modules:
        graph = numpy_engine.explore(packed, min(limit, _SMALL), watch, rounds=_FEW_ROUNDS)
        if graph.explored == len(graph.states) or len(graph.states) > limit:
            return graph, "numpy"
    try:
        from gspn_framework_package.analysis import numba_engine
    except ImportError as error:
        raise UsageError("the engine numba is not there: %s" % error, hint="install numba, or choose numpy") from None
    return numba_engine.explore(packed, limit, watch), "numba"


def numba_is_there() -> bool:
    """Whether numba is installed (it is not imported for that)."""
    return importlib.util.find_spec("numba") is not None

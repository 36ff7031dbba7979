"""The state space of a net: its reachable markings and the firings between them.

>>> from gspn_framework_package.model.builder import NetBuilder
>>> net = (NetBuilder().place("a", tokens=2).place("b")
...        .exponential("go", inputs="a", outputs="b")
...        .exponential("back", inputs="b", outputs="a").build())
>>> space = explore(net)
>>> len(space), space.arcs, space.complete
(3, 4, True)
>>> space.path_to(2)
['go', 'go']
"""

from __future__ import annotations

import math
import time
from typing import (
    TYPE_CHECKING,
    Dict,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices, Selection
from gspn_framework_package.analysis.compiling import numba_is_there
from gspn_framework_package.analysis.limits import STATE_LIMIT
from gspn_framework_package.analysis.state_space import numpy_engine, sparse_engine
from gspn_framework_package.analysis.state_space.exploration import (
    Allowance,
    RawGraph,
    in_wide_fields,
)
from gspn_framework_package.analysis.state_space.marking_store import (
    Columns,
    PackedStore,
    SparseStore,
)
from gspn_framework_package.analysis.state_space.packing import PackedNet, Packing
from gspn_framework_package.analysis.structure.invariants import invariant_bounds
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.condition import Condition, parse_condition
from gspn_framework_package.model.errors import LimitError, UsageError
from gspn_framework_package.model.net import Marking, Net

if TYPE_CHECKING:
    from gspn_framework_package.analysis.symmetry.symmetry import Symmetry

ENGINES = ("auto", "numpy", "numba", "sparse")

_SPARSE = 1 << 15
"""If all transitions together need more machine words than this, markings are explored one at a
time, as differences."""

_SMALL = 60_000
"""Up to this many states, numpy takes no longer than loading numba's machine code and exploring
with it, which then goes on where numpy stopped."""

_FEW_ROUNDS = 300
"""Largest number of rounds of that attempt with numpy (0.06 s): numpy is slow if the graph
is deep and narrow."""

_loaded: Set[int] = set()
"""The numbers of words of a marking for which this process has loaded numba's machine code."""

INVARIANT_EFFORT = 100_000
"""Largest number of steps of the search for invariants that serves to narrow the fields."""


class WitnessStep(NamedTuple):
    """One firing of a witness: the transition, and the marking after it."""

    transition: str
    marking: Dict[str, int]


class StateSpace:
    """Reachable markings and firings, as arrays; made by :func:`explore`.

    States are numbered from 0, the initial marking, in breadth-first order.

    :ivar untimed: whether immediate transitions had no precedence.
    :ivar offsets: int array of ``len(self) + 1``: the arcs of state ``s`` are ``offsets[s]`` to
      ``offsets[s + 1]``.
    :ivar targets: int array: the state that each arc leads to.
    :ivar transitions: int array: the number of the transition of each arc.
    :ivar explored: the number of states whose successors are known.
    :ivar engine: the engine that explored it: ``numpy``, ``numba`` or ``sparse``.
    :ivar store: the markings.
    :ivar shortage: if it is not complete, the exhausted resource: the option to raise, and its
        value.
    """

    def __init__(
        self,
        net: Net,
        store: Union[PackedStore, SparseStore],
        graph: RawGraph,
        order: Indices,
        *,
        untimed: bool,
        engine: str,
        shortage: Tuple[str, str] = ("", ""),
    ) -> None:
        self.net = net
        self.untimed = untimed
        self.engine = engine
        self.shortage = shortage
        self.store = store
        self.offsets = graph.offsets
        self.targets = graph.targets
        self.explored = graph.explored
        in_file_order = bool((np.diff(order) > 0).all())
        self.transitions = (
            graph.labels if in_file_order else order.astype(graph.labels.dtype)[graph.labels]
        )
        self._parents: Optional[Indices] = None

    def __len__(self) -> int:
        return len(self.store)

    @property
    def arcs(self) -> int:
        """The number of firings between the states."""
        return len(self.targets)

    @property
    def complete(self) -> bool:
        """Whether these are all reachable markings, that is, no limit was reached."""
        return self.explored == len(self)

    @property
    def memory(self) -> int:
        """Size of the arrays in bytes."""
        return int(
            self.store.nbytes + self.offsets.nbytes + self.targets.nbytes + self.transitions.nbytes
        )

    def count(self, states: Union[Indices, Booleans, slice]) -> int:
        """Number of states of the whole space that these ``states`` (numbers, slice or mask)
        represent: one each, unless equal parts were exchanged."""
        return len(np.arange(len(self))[states])

    @property
    def whole_arcs(self) -> int:
        """The number of firings between the states that these states represent."""
        return self.arcs

    def require_complete(self, question: str) -> None:
        """Require completeness. :raises LimitError: a limit was reached, so ``question`` is not
        decided."""
        if not self.complete:
            raise LimitError(
                "not decided within %s" % self.extent, element=question, hint=self.hint
            )

    @property
    def extent(self) -> str:
        """A phrase for messages: what was explored."""
        amount = self.shortage[1]
        return "%d states" % len(self) + (" and %s" % amount if amount else "")

    @property
    def hint(self) -> str:
        """A phrase for messages: what to do if the space is not complete."""
        return "raise %s, or ask about a smaller net" % (self.shortage[0] or "--limit")

    # -- markings ----------------------------------------------------------------------------------

    def marking(self, state: int) -> Marking:
        """The marking of one state."""
        return tuple(self.store.rows(slice(state, state + 1))[0].tolist())

    def named(self, state: int) -> Dict[str, int]:
        """The marking of one state as place -> count, without the empty places."""
        return self.net.named(self.marking(state), zeros=False)

    def markings(self, states: Selection = None) -> Indices:
        """Markings as an int64 array, one row per state and one column per place; of all states, or
        of those selected by ``states`` (numbers, slice or mask)."""
        return self.store.rows(states)

    def column(self, place: int, states: Selection = None) -> Indices:
        """Token counts of place number ``place`` in every state, or in ``states``, as an int64
        array."""
        return self.store.column(place, states)

    def find(self, marking: Union[Sequence[int], Mapping[str, int]]) -> Optional[int]:
        """The number of the state with this marking (in place order, or place -> count), or
        None."""
        counts = self.net.marking(marking) if isinstance(marking, Mapping) else tuple(marking)
        found = self.store.find(counts)
        return int(found[0]) if len(found) else None

    def holds(self, condition: Union[str, Condition]) -> Booleans:
        """Boolean array: the states in which a condition holds; it may contain ``deadlock``.

        :raises ExpressionError: the condition cannot be parsed.
        """
        if isinstance(condition, str):
            condition = self.condition(condition)
        result = np.empty(len(self), dtype=bool)
        dead = self.is_dead if condition.labels else None
        for begin in range(0, len(self), 1 << 17):
            part = slice(begin, min(begin + (1 << 17), len(self)))
            labels = {} if dead is None else {"deadlock": dead[part]}
            columns = Columns(self.store, part)
            result[part] = condition.holds_in_columns(columns, part.stop - part.start, labels)
        return result

    def condition(self, text: str) -> Condition:
        """Parse a condition on the markings of this net; it may contain ``deadlock``."""
        return parse_condition(text, self.net.place_index, ["deadlock"])

    # -- kinds of states ---------------------------------------------------------------------------

    @property
    def is_dead(self) -> Booleans:
        """Boolean array: no transition is enabled (known only for explored states)."""
        dead = np.diff(self.offsets) == 0
        dead[self.explored :] = False
        return dead

    @property
    def is_vanishing(self) -> Booleans:
        """Boolean array: an immediate transition is enabled, so no time is spent there."""
        timed = np.array([t.timed for t in self.net.transitions] or [True])
        result = np.zeros(len(self), dtype=bool)
        has_arcs = np.flatnonzero(np.diff(self.offsets))
        result[has_arcs] = ~timed[self.transitions[self.offsets[has_arcs]]]
        return result

    @property
    def starts(self) -> Booleans:
        """Boolean array: the initial states."""
        found = np.zeros(len(self), dtype=bool)
        found[0] = True
        return found

    def distinct(self, states: Indices) -> Indices:
        """One of ``states`` (numbers, ascending) per marking."""
        return states

    @property
    def deadlocks(self) -> Indices:
        """Numbers of the states in which no transition is enabled."""
        return np.flatnonzero(self.is_dead)

    exchanged: Optional[Symmetry] = None
    """The exchange that grouped the states; None: each state represents only itself."""

    further_steps = 0
    """Number of kinds of steps in which no transition fires; they are numbered after the
    transitions."""

    # -- arcs --------------------------------------------------------------------------------------

    @property
    def sources(self) -> Indices:
        """int array: the state that each arc leaves."""
        return np.repeat(np.arange(len(self), dtype=self.targets.dtype), np.diff(self.offsets))

    def successors(self, state: int) -> List[Tuple[str, int]]:
        """The successors of one state, as pairs (transition, state)."""
        part = slice(self.offsets[state], self.offsets[state + 1])
        return [
            (self.transition_name(t), int(s))
            for t, s in zip(self.transitions[part], self.targets[part])
        ]

    def transition_name(self, transition: int) -> str:
        """The name of transition number ``transition``."""
        return self.net.transitions[transition].name

    def path_to(self, state: int) -> List[str]:
        """The names of the transitions of a shortest firing sequence from the initial marking to
        ``state``."""
        return [self.transition_name(t) for t, _ in self._way_to(state)]

    def witness(self, state: int) -> List[WitnessStep]:
        """The firing sequence of :meth:`path_to`, with the marking after each firing."""
        return [WitnessStep(self.transition_name(t), self.named(s)) for t, s in self._way_to(state)]

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
    memory: float = math.inf,
    seconds: float = math.inf,
) -> StateSpace:
    """Find the reachable markings.

    :param limit: stop soon after this many states are known; the result is then not ``complete``.
    :param engine: ``numpy``, ``numba``, ``sparse``, or ``auto``: sparse for nets of thousands of
        places, numba for large state spaces, if it is installed.
    :param untimed: give immediate transitions no precedence over others, and no priorities among
        themselves: the result covers the markings that the robots of a plan can reach, which also
        spend time in decision places.
    :param progress: receives the number of states at intervals.
    :param cancel: called at intervals; returns whether to stop.
    :param bounds: for each place, the largest number of tokens it can hold (None: unknown), if the
        caller knows them; otherwise they come from the P-invariants. A bound that is too low costs
        time, but not correctness.
    :param memory: stop when the exploration uses more than this many bytes.
    :param seconds: stop after this time (s).
    :raises CancelledError: ``cancel`` returned true.
    :raises UsageError: the engine is not available.
    """
    if engine not in ENGINES:
        raise UsageError(
            "there is no engine '%s'" % engine, hint="choose among %s" % ", ".join(ENGINES)
        )
    if limit < 1:
        raise UsageError(
            "a limit of %d states is not possible" % limit, hint="give a number of at least 1"
        )
    watch = Watch(progress, cancel)
    room = Allowance(memory, time.monotonic() + seconds)

    def space(
        store: Union[PackedStore, SparseStore], graph: RawGraph, order: Indices, name: str
    ) -> StateSpace:
        shortage = room.shortage(len(store), limit, seconds)
        return StateSpace(net, store, graph, order, untimed=untimed, engine=name, shortage=shortage)

    if engine == "sparse" or (engine == "auto" and is_sparse(net)):
        return space(*_run_sparse(net, limit, watch, untimed, room), "sparse")
    if bounds is None:
        bounds = invariant_bounds(net, INVARIANT_EFFORT, watch)

    def run(packed: PackedNet) -> StateSpace:
        graph, name = _run(packed, limit, watch, engine, room)
        assert graph.states is not None  # these engines pack them
        store = PackedStore(Packing(net, packed.widths), graph.states)
        return space(store, graph, packed.order, name)

    return in_wide_fields(net, bounds, run, by_priority=not untimed)


def is_sparse(net: Net) -> bool:
    """Whether the net needs too many machine words: words per marking times transitions."""
    # a word holds 21 fields of 3 bits
    return len(net.transitions) * (len(net.places) // 21 + 1) > _SPARSE


def _run_sparse(
    net: Net, limit: int, watch: Watch, untimed: bool, room: Allowance
) -> Tuple[SparseStore, RawGraph, Indices]:
    graph, store, order = sparse_engine.explore(
        net, limit, watch, by_priority=not untimed, room=room
    )
    return store, graph, order


def _run(
    packed: PackedNet, limit: int, watch: Watch, engine: str, room: Allowance
) -> Tuple[RawGraph, str]:
    if engine == "numpy" or (engine == "auto" and not numba_is_there()):
        return numpy_engine.explore(packed, limit, watch, room=room), "numpy"
    begun = None
    if engine == "auto" and packed.words not in _loaded:
        begun = numpy_engine.explore(
            packed, min(limit, _SMALL), watch, rounds=_FEW_ROUNDS, room=room
        )
        known = len(begun.offsets) - 1
        if begun.explored == known or known > limit or not room.left(0):
            return begun, "numpy"
    try:
        from gspn_framework_package.analysis.state_space import numba_engine
    except ImportError as error:
        raise UsageError(
            "the engine numba is not available: %s" % error, hint="install numba, or choose numpy"
        ) from None
    _loaded.add(packed.words)
    return numba_engine.explore(packed, limit, watch, room=room, begun=begun), "numba"

"""Structural properties of a net: invariants, siphons, traps, classes, conflicts.

>>> from gspn_framework_package.model.builder import NetBuilder
>>> net = (NetBuilder().place("idle", tokens=1).place("busy")
...        .exponential("start", inputs="idle", outputs="busy")
...        .exponential("stop", inputs="busy", outputs="idle").build())
>>> structure = Structure(net)
>>> print(structure.place_invariants[0])
idle + busy = 1
>>> structure.conservative, structure.consistent, structure.classes.state_machine
(True, True, True)
"""

from __future__ import annotations

from functools import cached_property, partial
from typing import (
    Any,
    Callable,
    Dict,
    FrozenSet,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

import numpy as np

from gspn_framework_package.analysis.arrays import Indices
from gspn_framework_package.analysis.graph import components
from gspn_framework_package.analysis.limits import STRUCTURE_LIMIT
from gspn_framework_package.analysis.structure import incidence
from gspn_framework_package.analysis.structure.invariants import (
    Invariant,
    place_invariants,
    transition_invariants,
    transition_surpluses,
    uncovered_place,
    uncovered_transition,
)
from gspn_framework_package.analysis.structure.siphons import (
    Directions,
    PlaceSet,
    largest_set,
    minimal_sets,
    unguarded_siphon,
)
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net


class NetClasses(NamedTuple):
    """The classes that a net belongs to.

    :ivar ordinary: all arc weights are 1.
    :ivar pure: no place is both input and output of a transition.
    :ivar state_machine: ordinary; every transition has one input and one output place.
    :ivar marked_graph: ordinary; every place has one input and one output transition.
    :ivar free_choice: ordinary; a place with several output transitions is the only input of each.
    :ivar extended_free_choice: ordinary; transitions that share an input place have the same input
      places.
    :ivar asymmetric_choice: ordinary; of two places that share an output transition, one has all
        the output transitions of the other.
    :ivar inhibitors: there are inhibitor arcs (which the other classes ignore).
    """

    ordinary: bool
    pure: bool
    state_machine: bool
    marked_graph: bool
    free_choice: bool
    extended_free_choice: bool
    asymmetric_choice: bool
    inhibitors: bool


def classify(net: Net) -> NetClasses:
    """The classes that ``net`` belongs to."""
    numbers = range(len(net.transitions))
    ordinary = all(w == 1 for arcs in net.inputs + net.outputs for _, w in arcs)
    before = [frozenset(p for p, _ in net.inputs[t]) for t in numbers]
    after = [frozenset(p for p, _ in net.outputs[t]) for t in numbers]
    leaving = [frozenset(ts) for ts in net.consumers]
    shared = [ts for ts in net.consumers if len(ts) > 1]
    return NetClasses(
        ordinary=ordinary,
        pure=all(map(frozenset.isdisjoint, before, after)),
        state_machine=ordinary and all(len(before[t]) == 1 == len(after[t]) for t in numbers),
        marked_graph=ordinary
        and all(
            len(net.consumers[p]) == 1 == len(net.producers[p]) for p in range(len(net.places))
        ),
        free_choice=ordinary and all(len(before[t]) == 1 for ts in shared for t in ts),
        extended_free_choice=ordinary
        and all(before[t] == before[ts[0]] for ts in shared for t in ts),
        asymmetric_choice=ordinary
        and all(leaving[p] <= leaving[q] for p, q in _neighbours(before, leaving)),
        inhibitors=any(net.inhibitors),
    )


def _neighbours(
    before: Sequence[FrozenSet[int]], leaving: Sequence[FrozenSet[int]]
) -> Iterator[Tuple[int, int]]:
    """Pairs of places that share an output transition, the one with fewer output transitions first.

    These pairs suffice to decide whether, of any two places that share one, one has all the output
    transitions of the other. Each pair occurs once: a place may have 50,000 output transitions.
    """
    seen: Set[Tuple[int, int]] = set()
    for places in before:
        if len(places) > 1:
            by_size = sorted(places, key=lambda p: (len(leaving[p]), p))
            for pair in zip(by_size, by_size[1:]):
                if pair not in seen:
                    seen.add(pair)
                    yield pair


def conflict_sets(net: Net) -> List[Tuple[str, ...]]:
    """The extended structural conflict sets (Ajmone Marsan et al. 1995): groups of transitions of
    the same kind and priority that can take tokens from each other or inhibit each other, directly
    or through others. Transitions without a conflict are omitted."""
    kinds: Dict[Tuple[bool, int], int] = {}
    kind_of = np.array(
        [
            kinds.setdefault((t.timed, 0 if t.timed else t.priority), len(kinds))
            for t in net.transitions
        ],
        dtype=np.int64,
    )

    def meetings(arcs: incidence.Incidence) -> Indices:
        """For each arc, a number for its place and the kind of its transition."""
        return arcs.places * max(len(kinds), 1) + kind_of[arcs.transitions]

    changes = incidence.effects(net)
    signs = changes.positive
    changed = meetings(changes)
    readers, inhibited = incidence.flatten(net.inputs), incidence.flatten(net.inhibitors)
    read, blocked = meetings(readers), meetings(inhibited)
    taken = np.isin(read, changed[~signs])  # another reader takes tokens
    fed = np.isin(blocked, changed[signs])
    feeding = np.isin(changed, blocked) & signs
    # Transitions in conflict are connected through a node for the conflict.
    ends = readers.transitions[taken], inhibited.transitions[fed], changes.transitions[feeding]
    count = len(net.transitions)
    through = 2 * read[taken], 2 * blocked[fed] + 1, 2 * changed[feeding] + 1
    met, nodes = np.unique(np.concatenate(through), return_inverse=True)
    found = components(count + len(met), *_both_ways(np.concatenate(ends), count + nodes))
    sets: Dict[int, List[int]] = {}
    for t, component in enumerate(found.of[:count].tolist()):
        sets.setdefault(component, []).append(t)
    return [tuple(net.transitions[t].name for t in s) for s in sorted(sets.values()) if len(s) > 1]


def _both_ways(sources: Indices, targets: Indices) -> Tuple[Indices, Indices]:
    return np.concatenate([sources, targets]), np.concatenate([targets, sources])


class Structure:
    """Structural properties of a net, each computed on first use.

    Every property raises LimitError if its search exceeds the limit.
    """

    def __init__(
        self, net: Net, *, limit: int = STRUCTURE_LIMIT, watch: Optional[Callable[[], Watch]] = None
    ) -> None:
        """:param limit: largest number of elementary steps of each search.
        :param watch: creates the watch of a search, which receives progress and may stop the
          search."""
        self.net = net
        self._limit = limit
        self._watch = watch or Watch
        self._known: Dict[str, Any] = {}

    @property
    def place_invariants(self) -> List[Invariant]:
        """The minimal P-invariants."""
        return self._search("P", place_invariants)

    @property
    def transition_invariants(self) -> List[Invariant]:
        """The minimal T-invariants."""
        return self._search("T", transition_invariants)

    @property
    def siphons(self) -> List[PlaceSet]:
        """The minimal siphons."""
        return self._search("siphons", partial(minimal_sets, kind="siphons", arcs=self._arcs))

    @property
    def traps(self) -> List[PlaceSet]:
        """The minimal traps."""
        return self._search("traps", partial(minimal_sets, kind="traps", arcs=self._arcs))

    @property
    def unguarded_siphon(self) -> Optional[PlaceSet]:
        """A siphon without a marked trap; see
        :func:`~gspn_framework_package.analysis.structure.siphons.unguarded_siphon`."""

        def search(net: Net, limit: int, watch: Watch) -> Optional[PlaceSet]:
            try:
                return unguarded_siphon(net, limit, watch, minimal=self.siphons, arcs=self._arcs)
            except LimitError:
                return unguarded_siphon(net, limit, watch, arcs=self._arcs)

        return self._search("unguarded", search)

    @cached_property
    def unmarked_siphon(self) -> Tuple[str, ...]:
        """The places of the largest unmarked siphon: none of them ever gets a token."""
        empty = [place.name for place in self.net.places if not place.tokens]
        return largest_set(self.net, empty, kind="siphons", arcs=self._arcs)

    @cached_property
    def _arcs(self) -> Directions:
        return Directions(self.net)

    @cached_property
    def classes(self) -> NetClasses:
        """The classes that the net belongs to."""
        return classify(self.net)

    @cached_property
    def conflict_sets(self) -> List[Tuple[str, ...]]:
        """See :func:`conflict_sets`."""
        return conflict_sets(self.net)

    @property
    def conservative(self) -> bool:
        """Whether some weighted sum over *all* places is constant, that is, every place is in a
        P-invariant (then the net is bounded)."""
        try:
            covered = {name for i in self.place_invariants for name in i.weights}
        except LimitError:
            if self.strictly_conservative:
                return True
            if uncovered_place(self.net) is not None:
                return False
            raise
        return len(covered) == len(self.net.places)

    @property
    def strictly_conservative(self) -> bool:
        """Whether every firing preserves the number of tokens."""
        return all(
            sum([c for _, c in self.net.effect(t)]) == 0 for t in range(len(self.net.transitions))
        )

    @property
    def consistent(self) -> bool:
        """Whether every transition is in a T-invariant."""
        try:
            covered = {name for i in self.transition_invariants for name in i.weights}
        except LimitError:
            if not any(self._change_of_all):
                return True
            if uncovered_transition(self.net) is not None:
                return False
            raise
        return len(covered) == len(self.net.transitions)

    @property
    def repetitive(self) -> bool:
        """Whether some marking allows every transition to fire infinitely often, that is, there are
        firing counts, all above 0, that lose no token."""
        if all(change >= 0 for change in self._change_of_all):
            return True
        try:
            if self.consistent:
                return True
        except LimitError:
            pass
        surpluses = self._search("repetitive", transition_surpluses)
        covered = {name for row in surpluses for name in row}
        return len(covered) == len(self.net.transitions)

    @property
    def _change_of_all(self) -> List[int]:
        """The tokens that every place gains when each transition fires once."""
        change = [0] * len(self.net.places)
        for t in range(len(self.net.transitions)):
            for p, by in self.net.effect(t):
                change[p] += by
        return change

    def _search(self, key: str, search: Callable[[Net, int, Watch], Any]) -> Any:
        """The result of a search; if it exceeded its limit, the same error is raised each time."""
        if key not in self._known:
            try:
                self._known[key] = search(self.net, self._limit, self._watch())
            except LimitError as error:
                self._known[key] = error
        found = self._known[key]
        if isinstance(found, LimitError):
            raise found
        return found

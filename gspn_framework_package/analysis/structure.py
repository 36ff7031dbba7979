"""What the structure of a net alone says: invariants, siphons, traps, classes, conflicts.

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

from typing import Any, Callable, Dict, List, NamedTuple, Tuple

from gspn_framework_package.analysis.invariants import (
    INVARIANT_LIMIT,
    Invariant,
    place_invariants,
    transition_invariants,
    transition_surpluses,
)
from gspn_framework_package.analysis.siphons import (
    SIPHON_LIMIT,
    PlaceSet,
    minimal_siphons,
    minimal_traps,
)
from gspn_framework_package.model.net import Net


class NetClasses(NamedTuple):
    """The classes a net belongs to.

    :ivar ordinary: all arc weights are 1.
    :ivar pure: no transition takes from and puts into one place.
    :ivar state_machine: ordinary; every transition has one input and one output place.
    :ivar marked_graph: ordinary; every place has one input and one output transition.
    :ivar free_choice: ordinary; a place with several output transitions is the only input of each.
    :ivar extended_free_choice: ordinary; transitions that share an input place have the same input places.
    :ivar asymmetric_choice: ordinary; of two places that share an output transition, one has all the output
        transitions of the other.
    :ivar inhibitors: it has inhibitor arcs (which the other classes do not look at).
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
        pure=all(not before[t] & after[t] for t in numbers),
        state_machine=ordinary and all(len(before[t]) == 1 == len(after[t]) for t in numbers),
        marked_graph=ordinary
        and all(len(net.consumers[p]) == 1 == len(net.producers[p]) for p in range(len(net.places))),
        free_choice=ordinary and all(len(before[t]) == 1 for ts in shared for t in ts),
        extended_free_choice=ordinary and all(before[t] == before[ts[0]] for ts in shared for t in ts),
        asymmetric_choice=ordinary
        and all(
            leaving[p] <= leaving[q] or leaving[q] <= leaving[p] for t in numbers for p in before[t] for q in before[t]
        ),
        inhibitors=any(net.inhibitors),
    )


def conflict_sets(net: Net) -> List[Tuple[str, ...]]:
    """The extended structural conflict sets (Ajmone Marsan et al. 1995): groups of transitions of one kind and
    priority that can take tokens from each other or inhibit each other, directly or through others. Transitions
    without a conflict are left out."""
    groups: Dict[Tuple[bool, int], List[int]] = {}
    for t, transition in enumerate(net.transitions):
        groups.setdefault((transition.timed, 0 if transition.timed else transition.priority), []).append(t)
    found = []
    for members in groups.values():
        parent = {t: t for t in members}

        def root(t: int) -> int:
            while parent[t] != t:  # noqa: B023
                t = parent[t]  # noqa: B023
            return t

        member_set = set(members)
        for p in range(len(net.places)):
            takers = [t for t in net.consumers[p] if t in member_set and dict(net.effect(t)).get(p, 0) < 0]
            readers = [t for t in net.consumers[p] if t in member_set]
            givers = [t for t in net.producers[p] if t in member_set and dict(net.effect(t)).get(p, 0) > 0]
            inhibited = [t for t in members if any(q == p for q, _ in net.inhibitors[t])]
            for some, others in ((takers, readers), (givers, inhibited)):
                for t in some:
                    for other in others:
                        parent[root(other)] = root(t)
        sets: Dict[int, List[int]] = {}
        for t in members:
            sets.setdefault(root(t), []).append(t)
        found += [sorted(s) for s in sets.values() if len(s) > 1]
    return [tuple(net.transitions[t].name for t in s) for s in sorted(found)]


class Structure:
    """Structural properties of a net, each computed when it is asked for first.

    Every property raises LimitError where the search it needs would go beyond its limit.
    """

    def __init__(self, net: Net, *, invariant_limit: int = INVARIANT_LIMIT, siphon_limit: int = SIPHON_LIMIT) -> None:
        self.net = net
        self._invariant_limit = invariant_limit
        self._siphon_limit = siphon_limit
        self._known: Dict[str, Any] = {}

    @property
    def place_invariants(self) -> List[Invariant]:
        """The minimal P-invariants."""
        return self._once("P", lambda: place_invariants(self.net, self._invariant_limit))

    @property
    def transition_invariants(self) -> List[Invariant]:
        """The minimal T-invariants."""
        return self._once("T", lambda: transition_invariants(self.net, self._invariant_limit))

    @property
    def siphons(self) -> List[PlaceSet]:
        """The minimal siphons."""
        return self._once("siphons", lambda: minimal_siphons(self.net, self._siphon_limit))

    @property
    def traps(self) -> List[PlaceSet]:
        """The minimal traps."""
        return self._once("traps", lambda: minimal_traps(self.net, self._siphon_limit))

    @property
    def classes(self) -> NetClasses:
        """The classes it belongs to."""
        return self._once("classes", lambda: classify(self.net))

    @property
    def conflict_sets(self) -> List[Tuple[str, ...]]:
        """See :func:`conflict_sets`."""
        return self._once("conflicts", lambda: conflict_sets(self.net))

    @property
    def conservative(self) -> bool:
        """Whether a weighted sum over *all* places stays the same: every place is in a P-invariant (then the net
        is bounded)."""
        covered = {name for i in self.place_invariants for name in i.weights}
        return len(covered) == len(self.net.places)

    @property
    def strictly_conservative(self) -> bool:
        """Whether every firing keeps the number of tokens."""
        return all(sum(c for _, c in self.net.effect(t)) == 0 for t in range(len(self.net.transitions)))

    @property
    def consistent(self) -> bool:
        """Whether every transition is in a T-invariant."""
        covered = {name for i in self.transition_invariants for name in i.weights}
        return len(covered) == len(self.net.transitions)

    @property
    def repetitive(self) -> bool:
        """Whether some marking allows every transition to fire infinitely often: there are firing counts, all
        above 0, that lose no token."""
        surpluses = self._once("repetitive", lambda: transition_surpluses(self.net, self._invariant_limit))
        covered = {name for row in surpluses for name in row}
        return len(covered) == len(self.net.transitions)

    def _once(self, key: str, compute: Callable[[], Any]) -> Any:
        if key not in self._known:
            self._known[key] = compute()
        return self._known[key]

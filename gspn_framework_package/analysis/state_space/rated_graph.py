"""A reachability graph with numbers on its arcs: rates where time passes, probabilities where it
does not.

It comes from a net's state space (:func:`rate`), or from a plan under its policy
(``plan.space``). The later steps, beginning with the elimination of vanishing markings, treat both
the same.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Callable, Dict, Iterator, NamedTuple, Optional, Tuple, Union

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices, Selection
from gspn_framework_package.analysis.state_space.marking_store import PackedStore, SparseStore
from gspn_framework_package.analysis.state_space.space import StateSpace
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.net import Marking, Net

if TYPE_CHECKING:
    from gspn_framework_package.analysis.symmetry.symmetry import Symmetry


class RatedGraph(NamedTuple):
    """A reachability graph with rates and probabilities. Arcs are sorted by source; state 0 is the
    initial one.

    :ivar net: the net whose markings and transitions these are.
    :ivar vanishing: boolean array, one value per state: whether no time is spent there.
    :ivar sources: int array, one value per arc, like the next three.
    :ivar targets: int array.
    :ivar transitions: int array: numbers of transitions.
    :ivar values: float array: the rate (1/s) of an arc that leaves a tangible state, the
        probability of one that leaves a vanishing state.
    :ivar store: the markings of the states.
    :ivar parts: the parts of places that states distinguish, by name; of a plan as it runs.
    :ivar part_counts: int array, one row per state: number of robots in each of these parts.
    :ivar exchanged: the exchange that grouped its states; None: each state represents only itself.
    """

    net: Net
    vanishing: Booleans
    sources: Indices
    targets: Indices
    transitions: Indices
    values: Floats
    store: Union[PackedStore, SparseStore]
    parts: Tuple[str, ...] = ()
    part_counts: Optional[Indices] = None
    exchanged: Optional[Symmetry] = None

    def __len__(self) -> int:
        return len(self.vanishing)

    def markings(self, states: Selection) -> Indices:
        """The markings of states (numbers) as an int64 array, one row per state."""
        return self.store.rows(states)

    def column(self, place: int, states: Selection = None) -> Indices:
        """The token counts of place number ``place`` in all states, or in ``states``."""
        return self.store.column(place, states)

    def marking(self, state: int) -> Marking:
        """The marking of one state."""
        return tuple(self.markings(np.array([state]))[0].tolist())

    def named_parts(self, state: int) -> Dict[str, int]:
        """The parts of places that hold robots in one state: name -> count."""
        if self.part_counts is None:
            return {}
        return {n: int(c) for n, c in zip(self.parts, self.part_counts[state].tolist()) if c}

    def text(self, state: int) -> str:
        """The marking of one state, for messages."""
        named = self.net.named(self.marking(state), zeros=False)
        return "(%s)" % ", ".join("%s: %d" % item for item in named.items())


def rate(space: StateSpace) -> RatedGraph:
    """The state space with the rates and probabilities that the net defines.

    Exponential transitions have the number of servers given in the net. Immediate ones of the same
    priority share the probability by weight.

    :raises LimitError: the state space is not complete.
    :raises UsageError: it was explored untimed.
    :raises RefusedError: a choice has no weights (weight 0 leaves it to a policy).
    :raises NetError: a rate or weight that depends on the marking is not above 0 in some state.
    """
    space.require_complete("its Markov chain")
    if space.untimed:
        raise RefusedError(
            "an untimed state space has no Markov chain", hint="explore it with untimed=False"
        )
    vanishing = space.is_vanishing
    sources = space.sources
    values = np.empty(space.arcs, dtype=np.float64)
    for t, arcs in _arcs_by_transition(space.transitions):
        transition = space.net.transitions[t]
        if not transition.timed:
            values[arcs] = rate_or_weight(space.net, t, space.store, sources[arcs])
        else:
            values[arcs] = firing_rate(space.net, t, space.store, sources[arcs])
    _normalise(space, vanishing, sources, values)
    return RatedGraph(
        space.net,
        vanishing,
        sources,
        space.targets,
        space.transitions,
        values,
        space.store,
        exchanged=space.exchanged,
    )


def _arcs_by_transition(transitions: Indices) -> Iterator[Tuple[int, Indices]]:
    """The transitions that have arcs, each with the numbers of its arcs."""
    order = np.argsort(transitions, kind="stable")
    numbers, begin = np.unique(transitions[order], return_index=True)
    ends = np.append(begin[1:], len(order))
    for t, first, last in zip(numbers.tolist(), begin.tolist(), ends.tolist()):
        yield t, order[first:last]


def firing_rate(
    net: Net, t: int, store: Union[PackedStore, SparseStore], states: Indices
) -> Union[float, Floats]:
    """The rate (1/s) at which exponential transition number ``t``, which is enabled, fires in each
    of some ``states`` (numbers)."""
    transition = net.transitions[t]
    value = rate_or_weight(net, t, store, states)
    if transition.servers == 1:
        return value
    degree = enabling_degree(net, t, store, states)
    if transition.servers is not None:
        degree = np.minimum(degree, transition.servers)
    return value * degree


def rate_or_weight(
    net: Net, t: int, store: Union[PackedStore, SparseStore], states: Indices
) -> Union[float, Floats]:
    """The rate (1/s, of one server) or the weight of transition number ``t``, which is enabled, in
    each of some ``states`` (numbers).

    :raises NetError: it depends on the marking, and is not above 0 in one of them.
    """
    function = net.functions.get(t)
    if function is None:
        return net.transitions[t].number
    columns = {n: store.column(net.place_index[n], states) for n in function.places}
    values = function.values({n: c.astype(np.float64) for n, c in columns.items()})
    wrong = np.flatnonzero(~(np.isfinite(values) & (values > 0)))
    if len(wrong):
        marking = store.rows(np.asarray(states)[wrong[:1]])[0].tolist()
        net.valid_value(marking, t, float(values[wrong[0]]))
    found: Floats = values
    return found


def enabled_in(net: Net, t: int, column: Callable[[int], Indices], count: int) -> Booleans:
    """Boolean array: which of ``count`` markings enable transition number ``t``.

    :param column: place number -> its token counts in these markings.
    """
    found = np.ones(count, dtype=bool)
    for p, weight in net.inputs[t]:
        found &= column(p) >= weight
    for p, most in net.most_tokens(t):
        found &= (column(p) <= most) if most >= 0 else False
    return found


def enabling_degree(
    net: Net, t: int, store: Union[PackedStore, SparseStore], states: Indices
) -> Indices:
    """The enabling degree of transition number ``t`` in each of ``states`` (numbers)."""
    degree = np.full(len(states), np.iinfo(np.int64).max, dtype=np.int64)
    for p, weight in net.inputs[t]:
        np.minimum(degree, store.column(p, states) // weight, out=degree)
    return degree if net.inputs[t] else np.ones(len(states), dtype=np.int64)


def _normalise(space: StateSpace, vanishing: Booleans, sources: Indices, values: Floats) -> None:
    """Turn the weights of the arcs that leave vanishing states into probabilities."""
    arcs = np.flatnonzero(vanishing[sources])
    if not len(arcs):
        return
    count = np.bincount(sources[arcs], minlength=len(space))
    unweighted = arcs[(values[arcs] == 0) & (count[sources[arcs]] > 1)]
    if len(unweighted):
        state = int(sources[unweighted[0]])
        names = [name for name, _ in space.successors(state)]
        raise RefusedError(
            "no weights decide between %s in %s" % (", ".join(names), _text(space, state)),
            hint="give them weights, or analyse a plan with a policy",
        )
    alone = arcs[count[sources[arcs]] == 1]
    values[alone] = 1.0
    total = np.bincount(sources[arcs], weights=values[arcs], minlength=len(space))
    values[arcs] /= total[sources[arcs]]


def _text(space: StateSpace, state: int) -> str:
    return "(%s)" % ", ".join("%s: %d" % item for item in space.named(state).items())

"""Generalized stochastic Petri nets: the net, its marking and the firing rule (thesis 2.1,
Definition 1).

A :class:`Net` is immutable. It is built by
:class:`~gspn_framework_package.model.builder.NetBuilder` or by a reader of ``formats``; every edit
returns a new net. A *marking* is a tuple of token counts in the order of ``net.places``. It is
hashable and cheap, and the token game, the analysis and the page all use it.

This module has the only firing rule of the package; everything else calls :meth:`Net.is_enabled`
and :meth:`Net.fire`, or is tested to agree with them.
"""

# In one piece: the only firing rule, the values of rates in a marking, and the edits of a net all
# read the same indices, which nothing else may see half built.
from __future__ import annotations

import math
from functools import cached_property
from typing import (
    Dict,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    TypeVar,
    Union,
)

from gspn_framework_package.model.errors import NetError, NotEnabledError, RefusedError
from gspn_framework_package.model.marking_function import (
    MarkingFunction,
    Value,
    is_valid,
)

Marking = Tuple[int, ...]
Point = Tuple[float, float]
MAX_COUNT = 2**53
"""Largest number of tokens, capacity, arc weight, priority or number of servers in a net: every
part of the package, JSON and browsers represent integers up to this one exactly."""

WeightedPlaces = Tuple[Tuple[int, int], ...]
"""Pairs (place index, arc weight), in the order of the arcs in the file."""


class Place(NamedTuple):
    """A place: ``tokens`` is its count in the initial marking; ``capacity`` None means unlimited;
    ``position`` is (x, y) in the units of the drawing, y downwards."""

    name: str
    tokens: int = 0
    capacity: Optional[int] = None
    position: Optional[Point] = None


class Transition(NamedTuple):
    """A transition, immediate (``timed`` false) or exponential.

    ``rate`` (1/s, > 0) applies to exponential transitions only. ``weight`` (>= 0) and ``priority``
    (a larger number takes precedence) apply to immediate ones only; weight 0 marks a *controllable*
    choice, which a policy must make. Both may be functions of the marking, which are above 0
    wherever the transition is enabled; :meth:`Net.value` computes them. ``servers`` is the number
    of servers of an exponential transition, None for infinitely many.
    """

    name: str
    timed: bool = False
    rate: Value = 1.0
    weight: Value = 1.0
    priority: int = 1
    servers: Optional[int] = 1
    position: Optional[Point] = None

    @property
    def function(self) -> Optional[MarkingFunction]:
        """Its rate, or weight, if that depends on the marking."""
        value = self.rate if self.timed else self.weight
        return value if isinstance(value, MarkingFunction) else None

    @property
    def is_controllable(self) -> bool:
        """Whether its weight leaves it to a policy."""
        return not self.timed and self.weight == 0

    @property
    def number(self) -> float:
        """Its rate or weight, where a number is required.

        :raises RefusedError: it depends on the marking.
        """
        value = self.rate if self.timed else self.weight
        if isinstance(value, MarkingFunction):
            raise RefusedError(
                "its %s '%s' depends on the marking, which is not possible here"
                % (_meaning(self), value.text),
                element=_node_name(self),
            )
        return value


_Node = TypeVar("_Node", Place, Transition)


class Arc(NamedTuple):
    """An arc from a place to a transition or vice versa, by name; an ``inhibitor`` arc goes from a
    place to a transition and disables it while the place holds ``weight`` or more tokens.
    ``bends`` are the points of the drawing that it passes on its way."""

    source: str
    target: str
    weight: int = 1
    inhibitor: bool = False
    bends: Tuple[Point, ...] = ()

    @property
    def meaning(self) -> Tuple[str, str, int, bool]:
        """The arc without its drawing."""
        return self[:4]


class Net:
    """An immutable GSPN.

    :param places: the places, in the order of the counts in a marking.
    :param transitions: the transitions, in file order.
    :param arcs: the arcs in file order, which decides where the robots of a transition go. The
        weights of parallel arcs add up; of parallel inhibitor arcs, the lowest weight applies.
    :param name: name for messages and pictures.
    :raises NetError: duplicate or empty names, arcs to nowhere or between two nodes of one kind,
        weights below 1, negative counts, a marking above capacity, rates that are not positive
        numbers, functions of places that the net does not have.
    :ivar functions: number of a transition -> its rate or weight, of those that depend on the
        marking.

    >>> net = Net([Place("P1", 1), Place("P2")], [Transition("T1", timed=True)],
    ...           [Arc("P1", "T1"), Arc("T1", "P2")])
    >>> net.is_enabled(net.initial_marking, 0)
    True
    >>> net.fire(net.initial_marking, 0)
    (0, 1)
    """

    def __init__(
        self,
        places: Iterable[Place],
        transitions: Iterable[Transition],
        arcs: Iterable[Arc] = (),
        name: str = "",
    ) -> None:
        self.name = name
        self.places: Tuple[Place, ...] = tuple(places)
        self.transitions: Tuple[Transition, ...] = tuple(transitions)
        self.arcs: Tuple[Arc, ...] = tuple(arcs)
        self.place_index: Mapping[str, int] = {p[0]: i for i, p in enumerate(self.places)}
        self.transition_index: Mapping[str, int] = {t[0]: i for i, t in enumerate(self.transitions)}
        self._check_nodes()
        self._index_arcs()
        self.initial_marking: Marking = tuple(p.tokens for p in self.places)

    # -- building ----------------------------------------------------------------------------------

    def _check_nodes(self) -> None:
        known = self.place_index.keys() | self.transition_index.keys()
        if (
            len(known) < len(self.places) + len(self.transitions)
            or "" in known
            or not all(isinstance(name, str) for name in known)
        ):
            self._refuse_names()
        for place in self.places:
            _check_place(place)
        for transition in self.transitions:
            _check_transition(transition)
        self.functions: Mapping[int, MarkingFunction] = {
            t: transition.function
            for t, transition in enumerate(self.transitions)
            if transition.function is not None
        }
        for t, function in self.functions.items():
            for name in function.places:
                if name not in self.place_index:
                    raise NetError(
                        "there is no place '%s', which its %s '%s' names"
                        % (name, _meaning(self.transitions[t]), function.text),
                        element=_node_name(self.transitions[t]),
                    )

    def _refuse_names(self) -> None:
        """:raises NetError: names the first node whose name is missing or already taken."""
        seen: Dict[str, str] = {}
        for kind, nodes in (("place", self.places), ("transition", self.transitions)):
            for node in nodes:
                if not isinstance(node.name, str) or not node.name:
                    raise NetError(
                        "a %s has no name" % kind, hint="give every place and transition a name"
                    )
                if node.name in seen:
                    raise NetError(
                        "the name is already taken by a %s" % seen[node.name],
                        element="%s '%s'" % (kind, node.name),
                        hint="names of places and transitions must differ",
                    )
                seen[node.name] = kind

    def _index_arcs(self) -> None:
        inputs: List[Dict[int, int]] = [{} for _ in self.transitions]
        outputs: List[Dict[int, int]] = [{} for _ in self.transitions]
        inhibitors: Dict[int, Dict[int, int]] = {}
        # a place has a number from 0 on, and a transition has ~ its number, which is negative
        numbers = dict(self.place_index)
        numbers.update((name, ~t) for name, t in self.transition_index.items())
        for arc in self.arcs:
            source, target, weight, inhibitor, _ = arc
            if type(weight) is not int or not 0 < weight <= MAX_COUNT:
                _check_weight(arc)
            try:
                first, last = numbers[source], numbers[target]
            except KeyError:
                raise self._arc_error(arc) from None
            if inhibitor and first >= 0 > last:
                lowest = inhibitors.setdefault(~last, {})
                lowest[first] = min(lowest.get(first, weight), weight)
                continue
            if inhibitor or (first >= 0) == (last >= 0):
                raise self._arc_error(arc)
            place, ends = (first, inputs[~last]) if first >= 0 else (last, outputs[~first])
            ends[place] = ends[place] + weight if place in ends else weight
        self.inputs: Tuple[WeightedPlaces, ...] = tuple([tuple(d.items()) for d in inputs])
        self.outputs: Tuple[WeightedPlaces, ...] = tuple([tuple(d.items()) for d in outputs])
        self.inhibitors: Tuple[WeightedPlaces, ...] = tuple(
            [tuple(inhibitors[t].items()) if t in inhibitors else () for t in range(len(inputs))]
        )
        self.consumers = _transitions_at(inputs, len(self.places))
        self.producers = _transitions_at(outputs, len(self.places))
        self._effects: Tuple[WeightedPlaces, ...] = tuple(map(_effect, inputs, outputs))
        self._index_capacities()

    def _index_capacities(self) -> None:
        capacity_of = {
            p: place.capacity for p, place in enumerate(self.places) if place.capacity is not None
        }
        self._capacities: Tuple[Tuple[Tuple[int, int, int], ...], ...] = (
            tuple(
                tuple(
                    (p, change, capacity_of[p])
                    for p, change in effect
                    if change > 0 and p in capacity_of
                )
                for effect in self._effects
            )
            if capacity_of
            else ((),) * len(self.transitions)
        )

    def _arc_error(self, arc: Arc) -> NetError:
        known = set(self.place_index) | set(self.transition_index)
        for end in (arc.source, arc.target):
            if end not in known:
                return NetError(
                    "there is no place or transition '%s'" % end,
                    element=_arc_name(arc),
                    hint="an arc joins a place and a transition of the same net",
                )
        if arc.inhibitor:
            return NetError(
                "an inhibitor arc goes from a place to a transition", element=_arc_name(arc)
            )
        kind = "places" if arc.source in self.place_index else "transitions"
        return NetError("it joins two %s" % kind, element=_arc_name(arc))

    # -- the firing rule ---------------------------------------------------------------------------

    def is_enabled(self, marking: Sequence[int], t: int) -> bool:
        """Whether transition number ``t`` has concession in ``marking``: every input place has
        enough tokens, every inhibitor place has fewer than the weight, and every output place with
        a capacity has room. This ignores priorities; see :meth:`enabled`."""
        for p, weight in self.inputs[t]:
            if marking[p] < weight:
                return False
        for p, weight in self.inhibitors[t]:
            if marking[p] >= weight:
                return False
        limited = self._capacities[t]
        return not limited or all(marking[p] + change <= most for p, change, most in limited)

    def fire(self, marking: Sequence[int], t: int) -> Marking:
        """Return the marking after transition number ``t`` fires in ``marking``.

        :raises NotEnabledError: ``marking`` does not enable it; the message says which place
            prevents it.
        """
        if not self.is_enabled(marking, t):
            raise NotEnabledError(
                "it is not enabled: " + "; ".join(self.why_disabled(marking, t)),
                element="transition '%s'" % self.transitions[t].name,
            )
        after = list(marking)
        for p, change in self._effects[t]:
            after[p] += change
        return tuple(after)

    @property
    def positions(self) -> Dict[str, Point]:
        """Where nodes are in the drawing, by name; without those that have no position."""
        nodes: List[Union[Place, Transition]] = [*self.places, *self.transitions]
        return {node.name: node.position for node in nodes if node.position is not None}

    @cached_property
    def immediate_from(self) -> Tuple[Tuple[int, ...], ...]:
        """The immediate transitions that take from each place."""
        return tuple(
            tuple(t for t in consumers if not self.transitions[t].timed)
            for consumers in self.consumers
        )

    def most_tokens(self, t: int) -> List[Tuple[int, int]]:
        """Return the upper limits of what :meth:`is_enabled` asks: pairs (place, the most tokens in
        it with which transition number ``t`` has concession), first by inhibitor arcs, then by
        capacities. One that adds more than a place can hold has a negative limit."""
        limits = [(p, weight - 1) for p, weight in self.inhibitors[t]]
        return limits + [(p, capacity - change) for p, change, capacity in self._capacities[t]]

    def enabled(self, marking: Sequence[int], *, by_priority: bool = True) -> Tuple[int, ...]:
        """Return the numbers of the enabled transitions. With ``by_priority``, immediate
        transitions take precedence over exponential ones, and of the immediate ones only those of
        the highest priority are enabled."""
        found = tuple(t for t in range(len(self.transitions)) if self.is_enabled(marking, t))
        if not by_priority:
            return found
        immediate = [t for t in found if not self.transitions[t].timed]
        if not immediate:
            return found
        top = max(self.transitions[t].priority for t in immediate)
        return tuple(t for t in immediate if self.transitions[t].priority == top)

    def enabling_degree(self, marking: Sequence[int], t: int) -> int:
        """Return how many times transition ``t`` could fire concurrently in ``marking``, which is
        the number of busy servers if there are infinitely many. An enabled transition without input
        places has degree 1."""
        if not self.is_enabled(marking, t):
            return 0
        return min((marking[p] // weight for p, weight in self.inputs[t]), default=1)

    def effective_rate(self, marking: Sequence[int], t: int) -> float:
        """Return the rate (1/s) at which the exponential transition ``t`` fires in ``marking``: its
        rate times the number of its busy servers."""
        busy = self.busy_servers(marking, t)
        return self.value(marking, t) * busy if busy else 0.0

    def busy_servers(self, marking: Sequence[int], t: int) -> int:
        """Return how many servers of the exponential transition ``t`` are busy in ``marking``."""
        degree, servers = self.enabling_degree(marking, t), self.transitions[t].servers
        return degree if servers is None else min(degree, servers)

    def require_numbers(self, what: str) -> None:
        """Require that no rate or weight depends on the marking.

        :param what: what cannot take one that does, for the message.
        :raises RefusedError: one does.
        """
        for t, function in self.functions.items():
            raise RefusedError(
                "its %s '%s' depends on the marking, which %s cannot take"
                % (_meaning(self.transitions[t]), function.text, what),
                element=_node_name(self.transitions[t]),
            )

    def value(self, marking: Sequence[int], t: int) -> float:
        """Return the rate (1/s, of one server) of the exponential transition ``t``, or the weight
        of an immediate one, in ``marking``, which enables it.

        :raises NetError: it depends on the marking, and is not a number above 0 there.
        """
        function = self.functions.get(t)
        if function is None:
            return self.transitions[t].number
        counts = {name: marking[self.place_index[name]] for name in function.places}
        return self.valid_value(marking, t, function.value(counts))

    def valid_value(self, marking: Sequence[int], t: int, found: float) -> float:
        """Return the value ``found`` of the function of transition ``t`` in ``marking``, which
        enables it.

        :raises NetError: it is not a number above 0.
        """
        if not is_valid(found):
            held = ", ".join("%s: %d" % item for item in self.named(marking, zeros=False).items())
            raise NetError(
                "its %s '%s' is %s in (%s)"
                % (
                    _meaning(self.transitions[t]),
                    self.functions[t].text,
                    "%g" % found if math.isfinite(found) else "not a finite number",
                    held,
                ),
                element=_node_name(self.transitions[t]),
                hint="it must be above 0 wherever the transition is enabled",
            )
        return found

    def why_disabled(self, marking: Sequence[int], t: int) -> List[str]:
        """Return the reasons, in words, why transition ``t`` is not enabled; empty if it is."""
        reasons = []
        for p, weight in self.inputs[t]:
            if marking[p] < weight:
                reasons.append(
                    "%s has %d of %d token%s"
                    % (self.places[p].name, marking[p], weight, "s" if weight > 1 else "")
                )
        for p, weight in self.inhibitors[t]:
            if marking[p] >= weight:
                reasons.append(
                    "%s holds %d and inhibits from %d on"
                    % (self.places[p].name, marking[p], weight)
                )
        for p, change, capacity in self._capacities[t]:
            if marking[p] + change > capacity:
                left = capacity - marking[p]
                reasons.append(
                    "%s is full (capacity %d)" % (self.places[p].name, capacity)
                    if left <= 0
                    else "%s has room for %d of %d more tokens (capacity %d)"
                    % (self.places[p].name, left, change, capacity)
                )
        return reasons

    def effect(self, t: int) -> WeightedPlaces:
        """Return pairs (place index, change of its count) for a firing of ``t``; places whose count
        does not change are left out."""
        return self._effects[t]

    def fires_alone(self, t: int, place: int) -> bool:
        """Return whether one token in place number ``place`` is all that transition number ``t``,
        which takes from there, ever needs."""
        return not self.why_blocked(t, place)

    def why_blocked(self, t: int, place: int) -> str:
        """Return what may disable transition number ``t`` other than the one token in ``place``
        that it takes, for people; empty if nothing can."""
        for p, weight in self.inputs[t]:
            if p != place:
                return "also takes from %s" % self.places[p].name
            if weight > 1:
                return "takes %d tokens" % weight
        for p, _ in self.inhibitors[t]:
            return "has an inhibitor arc from %s" % self.places[p].name
        for p, _, _ in self._capacities[t]:
            return "leads to %s, which has a capacity" % self.places[p].name
        return ""

    def named_by_functions(self) -> Set[str]:
        """Return the names of the places that rates and weights depend on."""
        return {name for function in self.functions.values() for name in function.places}

    def inhibited_by(self) -> Dict[int, List[int]]:
        """Return for each place with inhibitor arcs (by index) the numbers of the transitions that
        they lead to."""
        found: Dict[int, List[int]] = {}
        for t, arcs in enumerate(self.inhibitors):
            for p, _ in arcs:
                found.setdefault(p, []).append(t)
        return found

    # -- look-up -----------------------------------------------------------------------------------

    def place(self, name: str) -> Place:
        """Return the place of that name. :raises NetError: there is none."""
        return self.places[self.place_number(name)]

    def transition(self, name: str) -> Transition:
        """Return the transition of that name. :raises NetError: there is none."""
        return self.transitions[self.transition_number(name)]

    def place_number(self, name: str) -> int:
        """Return the index of a place in markings. :raises NetError: no place has that name."""
        return _number(self.place_index, name, "place")

    def transition_number(self, name: str) -> int:
        """Return the index of a transition. :raises NetError: no transition has that name."""
        return _number(self.transition_index, name, "transition")

    def marking(self, counts: Mapping[str, int]) -> Marking:
        """Return the marking with these counts, and zero elsewhere. :raises NetError: unknown
        place, negative count."""
        marking = [0] * len(self.places)
        for name, count in counts.items():
            if not isinstance(count, int) or count < 0:
                raise NetError(
                    "%r is not a number of tokens" % (count,), element="place '%s'" % name
                )
            marking[self.place_number(name)] = count
        return tuple(marking)

    def named(self, marking: Sequence[int], *, zeros: bool = True) -> Dict[str, int]:
        """Return the marking as place name -> count; empty places are included if ``zeros``."""
        return {name: n for name, n in zip(self.place_index, marking) if n or zeros}

    # -- edits: each returns a new net -------------------------------------------------------------

    def with_place(self, place: Place) -> Net:
        """Return the net with this place added, or replacing the place of the same name."""
        return Net(_put(self.places, place), self.transitions, self.arcs, self.name)

    def with_transition(self, transition: Transition) -> Net:
        """Return the net with this transition added, or replacing the one of the same name."""
        return Net(self.places, _put(self.transitions, transition), self.arcs, self.name)

    def with_arc(self, arc: Arc) -> Net:
        """Return the net with this arc added."""
        return Net(self.places, self.transitions, self.arcs + (arc,), self.name)

    def with_marking(self, marking: Union[Marking, Mapping[str, int]]) -> Net:
        """Return the net with another initial marking: a tuple in place order, or place name ->
        count."""
        counts = self.marking(marking) if isinstance(marking, Mapping) else tuple(marking)
        if len(counts) != len(self.places):
            raise NetError("a marking of %d counts for %d places" % (len(counts), len(self.places)))
        places = [p._replace(tokens=n) for p, n in zip(self.places, counts)]
        return Net(places, self.transitions, self.arcs, self.name)

    def with_rates(self, rates: Mapping[str, Value]) -> Net:
        """Return the net with other rates (1/s): exponential transition -> rate. Other names are
        ignored."""
        transitions = [
            t._replace(rate=_as_value(rates[t.name])) if t.timed and t.name in rates else t
            for t in self.transitions
        ]
        return Net(self.places, transitions, self.arcs, self.name) if rates else self

    def without_places(self, names: Iterable[str]) -> Net:
        """Return the net without these places and their arcs."""
        gone = set(names)
        for name in gone:
            self.place_number(name)
        for t, function in self.functions.items():
            for name in gone.intersection(function.places):
                raise NetError(
                    "its %s '%s' names the place '%s', which is removed"
                    % (_meaning(self.transitions[t]), function.text, name),
                    element=_node_name(self.transitions[t]),
                )
        kept = [p for p, place in enumerate(self.places) if place.name not in gone]
        return self._restricted(kept, gone)

    def _restricted(self, kept: Sequence[int], gone: Set[str]) -> Net:
        """Return the net with only these places. Its indices are derived from those of this net,
        which takes half the time of computing them again."""
        number = [-1] * len(self.places)
        for new, old in enumerate(kept):
            number[old] = new

        def renumbered(rows: Iterable[WeightedPlaces]) -> Tuple[WeightedPlaces, ...]:
            return tuple(
                [tuple([(number[p], n) for p, n in row if number[p] >= 0]) for row in rows]
            )

        net = Net.__new__(Net)
        net.name = self.name
        net.places = tuple([self.places[p] for p in kept])
        net.transitions = self.transitions
        net.functions = self.functions
        net.arcs = tuple([a for a in self.arcs if a[0] not in gone and a[1] not in gone])
        net.place_index = {place.name: p for p, place in enumerate(net.places)}
        net.transition_index = self.transition_index
        net.inputs, net.outputs = renumbered(self.inputs), renumbered(self.outputs)
        net.inhibitors = renumbered(self.inhibitors)
        net.consumers = tuple([self.consumers[p] for p in kept])
        net.producers = tuple([self.producers[p] for p in kept])
        net._effects = renumbered(self._effects)
        net._index_capacities()
        net.initial_marking = tuple([self.initial_marking[p] for p in kept])
        return net

    # -- values ------------------------------------------------------------------------------------

    def _key(self) -> Tuple[object, ...]:
        return self.name, self.places, self.transitions, self.arcs

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Net) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __repr__(self) -> str:
        return "<Net %s: %d places, %d transitions, %d arcs>" % (
            self.name or "without a name",
            len(self.places),
            len(self.transitions),
            len(self.arcs),
        )


def with_places_renamed(transition: Transition, names: Mapping[str, str]) -> Transition:
    """Return the transition for a net whose places have other names: old -> new."""
    function = transition.function
    if function is None:
        return transition
    renamed = function.renamed(names)
    return (
        transition._replace(rate=renamed)
        if transition.timed
        else transition._replace(weight=renamed)
    )


def _put(nodes: Sequence[_Node], node: _Node) -> List[_Node]:
    """Return ``nodes`` with ``node`` replacing the one of the same name, or added at the end."""
    if any(n.name == node.name for n in nodes):
        return [node if n.name == node.name else n for n in nodes]
    return list(nodes) + [node]


def _number(index: Mapping[str, int], name: str, kind: str) -> int:
    try:
        return index[name]
    except KeyError:
        raise NetError("there is no %s '%s'" % (kind, name)) from None


def _arc_name(arc: Arc) -> str:
    return "%s from '%s' to '%s'" % (
        "inhibitor arc" if arc.inhibitor else "arc",
        arc.source,
        arc.target,
    )


def _transitions_at(arcs: Sequence[Iterable[int]], places: int) -> Tuple[Tuple[int, ...], ...]:
    """Return for each place the numbers of the transitions whose ``arcs`` lead to it."""
    found: List[List[int]] = [[] for _ in range(places)]
    for t, ends in enumerate(arcs):
        for p in ends:
            found[p].append(t)
    return tuple(map(tuple, found))


def _effect(taken: Mapping[int, int], put: Mapping[int, int]) -> WeightedPlaces:
    """Return the net change of a firing that takes and puts these tokens."""
    if taken.keys().isdisjoint(put):
        return (*[(p, -weight) for p, weight in taken.items()], *put.items())
    change = {p: put.get(p, 0) - weight for p, weight in taken.items()}
    change.update((p, weight) for p, weight in put.items() if p not in taken)
    return tuple((p, c) for p, c in change.items() if c)


# A net may have 100,000 nodes and more arcs, so the checks build the name of an element only if it
# is invalid.


def _check_weight(arc: Arc) -> None:
    weight = arc.weight
    if not isinstance(weight, int) or isinstance(weight, bool) or weight < 1:
        raise NetError(
            "weight %r is not a whole number of at least 1" % (weight,), element=_arc_name(arc)
        )
    _check_count(weight, "weight", 1, _arc_name(arc))


def _check_place(place: Place) -> None:
    tokens, capacity = place.tokens, place.capacity
    if type(tokens) is not int or not 0 <= tokens <= MAX_COUNT:
        _check_count(tokens, "initial marking", 0, _node_name(place))
    if capacity is None:
        return
    hint = "leave the capacity out for an unlimited place"
    _check_count(capacity, "capacity", 1, _node_name(place), hint)
    if tokens > capacity:
        raise NetError(
            "its initial marking %d is above its capacity %d" % (tokens, capacity),
            element=_node_name(place),
        )


def _check_transition(transition: Transition) -> None:
    _, timed, rate, weight, priority, servers, _ = transition
    if timed and not isinstance(rate, MarkingFunction) and not is_valid(rate):
        raise NetError(
            "its rate %r is not a number above 0" % (rate,), element=_node_name(transition)
        )
    if (
        not timed
        and not isinstance(weight, MarkingFunction)
        and not (math.isfinite(weight) and weight >= 0)
    ):
        raise NetError(
            "its weight %r is not a number of at least 0" % (weight,),
            element=_node_name(transition),
        )
    if type(priority) is not int or not 0 <= priority <= MAX_COUNT:
        _check_count(priority, "priority", 0, _node_name(transition))
    if servers is not None and (type(servers) is not int or not 1 <= servers <= MAX_COUNT):
        hint = "None stands for infinitely many"
        _check_count(servers, "number of servers", 1, _node_name(transition), hint)


def _check_count(
    value: int, what: str, least: int, element: str, hint: Optional[str] = None
) -> None:
    """:raises NetError: the number is not whole, or out of bounds."""
    if not isinstance(value, int) or value < least:
        raise NetError(
            "its %s %r is not a whole number of at least %d" % (what, value, least),
            element=element,
            hint=hint,
        )
    if value > MAX_COUNT:
        raise NetError("its %s is larger than 2**53 (%d)" % (what, MAX_COUNT), element=element)


def _meaning(transition: Transition) -> str:
    return "rate" if transition.timed else "weight"


def _as_value(value: Value) -> Value:
    return value if isinstance(value, MarkingFunction) else float(value)


def _node_name(node: Union[Place, Transition]) -> str:
    return "%s '%s'" % ("place" if isinstance(node, Place) else "transition", node.name)

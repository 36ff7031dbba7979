"""The colours of a high-level PNML net (ISO/IEC 15909-2), and its unfolding: symmetric nets, as in
the Model Checking Contest.

A coloured place becomes one place for each of its colours, called ``PLACE.COLOUR``; a transition
becomes one for each binding of its variables that its guard allows, called ``TRANSITION.VALUES``
with the values in the order in which the variables are declared. Places with only dots, and
transitions without variables, keep their names.

:mod:`.colour_terms` has what sorts, terms and guards are covered.
"""

from __future__ import annotations

import sys
from typing import (
    TYPE_CHECKING,
    Callable,
    Dict,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    NoReturn,
    Optional,
    Sequence,
    Tuple,
)

from gspn_framework_package.formats.colour_terms import (
    DOT,
    Binding,
    Colour,
    ColourGuard,
    ColourTerm,
    ColourTerms,
    Sort,
    constant,
)
from gspn_framework_package.formats.xml_tree import line_of, name_of

if TYPE_CHECKING:
    from lxml import etree

MOST_NODES = 500_000
"""Maximum number of places and transitions of an unfolded net."""

MOST_ARCS = 3_000_000
"""Maximum number of arcs of an unfolded net."""

_MOST_TRIED = 2_000_000
"""Maximum number of bindings that are tried to count those that the guards allow."""


class _ColouredPlace(NamedTuple):
    sort: Sort
    marking: Optional[ColourTerm]
    what: str
    line: int


class _ColouredArc(NamedTuple):
    identifier: Optional[str]
    place: str
    into: bool
    term: ColourTerm
    what: str
    line: int


class _ColouredTransition(NamedTuple):
    guards: List[ColourGuard]
    arcs: List[_ColouredArc]


class UnfoldedArc(NamedTuple):
    """An arc of the unfolded net; its ends are ids."""

    identifier: Optional[str]
    source: str
    target: str
    weight: int
    line: int


class Colours:
    """The colours of a net: sorts, variables, and what places, transitions and arcs say about them.

    Places are added first, then transitions, then arcs; after :meth:`demand_size` they can be
    unfolded.

    :param net: the element with the declarations.
    :param fail: raises the error: (message, element, line, hint).
    :raises GspnError: something is not covered, or names what is not declared.
    """

    def __init__(self, net: etree._Element, fail: Callable[..., NoReturn]) -> None:
        self._fail = fail
        self._terms = ColourTerms(net, fail)
        self._places: Dict[str, _ColouredPlace] = {}
        self._transitions: Dict[str, _ColouredTransition] = {}
        self._left = sys.maxsize  # how many bindings may still be tried

    # -- places, transitions, arcs

    def add_place(self, element: etree._Element) -> None:
        """Add a place, with its sort and marking."""
        identifier = self._begin(element, "place")
        structure = self._terms.structure(element, "type")
        sort = DOT if structure is None else self._terms.sort(structure)
        structure = self._terms.structure(element, "hlinitialMarking")
        marking = None if structure is None else self._terms.term(structure)
        if structure is not None and marking is not None:
            self._terms.demand_sort(structure, marking.sort, sort)
            if marking.variables:
                self._terms.wrong(structure, "its initial marking has a variable")
        what = self._terms.what
        self._places[identifier] = _ColouredPlace(sort, marking, what, line_of(element))

    def add_transition(self, element: etree._Element) -> None:
        """Add a transition, with its guard."""
        identifier = self._begin(element, "transition")
        structure = self._terms.structure(element, "condition")
        guards = [] if structure is None else self._terms.conjuncts(structure)
        self._transitions[identifier] = _ColouredTransition(guards, [])

    def _begin(self, element: etree._Element, kind: str) -> str:
        self._terms.what = name_of(element, kind)
        identifier = element.get("id")
        if not identifier:
            self._terms.wrong(element, "it has no id")
        return identifier

    def add_arc(
        self, element: etree._Element, source: Optional[str], target: Optional[str]
    ) -> None:
        """Add an arc, with its inscription; its ends are ids."""
        self._terms.what = what = name_of(element, "arc")
        into = source in self._places
        place, transition = (source, target) if into else (target, source)
        if place not in self._places or transition not in self._transitions:
            self._terms.wrong(element, "it does not join a place and a transition of the net")
        structure = self._terms.structure(element, "hlinscription")
        sort = self._places[place].sort
        if structure is not None:
            term = self._terms.term(structure)
            self._terms.demand_sort(structure, term.sort, sort)
        elif sort == DOT:
            term = constant(DOT, 0)
        else:
            self._terms.wrong(element, "it has no inscription")
        arc = _ColouredArc(element.get("id"), place, into, term, what, line_of(element))
        self._transitions[transition].arcs.append(arc)

    # -- the unfolded net

    def demand_size(self) -> None:
        """Check the size of the unfolded net before it is made.

        :raises GspnError: it is too large.
        """
        places = sum(place.sort.size for place in self._places.values())
        counted = {name: self._most_bindings(t) for name, t in self._transitions.items()}
        self._left = _MOST_TRIED
        if places + sum(counted.values()) > MOST_NODES:
            for name in sorted(counted, key=lambda name: counted[name]):
                number = sum(1 for _ in self._bindings(name))
                if self._left < 0:
                    break
                counted[name] = number
        self._left = sys.maxsize
        transitions = sum(counted.values())
        arcs = sum(
            counted[name] * sum(arc.term.size for arc in t.arcs)
            for name, t in self._transitions.items()
        )
        if places + transitions > MOST_NODES or arcs > MOST_ARCS:
            self._fail(
                "unfolded, the net has %s places and up to %s transitions and %s arcs"
                % tuple(format(number, ",") for number in (places, transitions, arcs)),
                None,
                None,
                "up to %s nodes and %s arcs are read"
                % (format(MOST_NODES, ","), format(MOST_ARCS, ",")),
            )

    def _most_bindings(self, transition: _ColouredTransition) -> int:
        total = 1
        for name in self._used(transition):
            total *= self._terms.variables[name].size
        return total

    def _used(self, transition: _ColouredTransition) -> List[str]:
        """The variables of a transition, in the order of their declarations."""
        used = [guard.variables for guard in transition.guards]
        used += [arc.term.variables for arc in transition.arcs]
        return [name for name in self._terms.variables if any(name in some for some in used)]

    def contents(self, identifier: str) -> Iterator[Tuple[str, int]]:
        """The places into which a place is unfolded: the suffix of the name, and the tokens."""
        place = self._places[identifier]
        tokens: Dict[Colour, int] = {}
        if place.marking is not None:
            for colour, count in place.marking.many({}):
                tokens[colour] = tokens.get(colour, 0) + count
        for colour, count in tokens.items():
            self._demand_colour(place, colour, count, place.what, place.line)
        for colour in place.sort.colours():
            yield place.sort.text(colour), tokens.get(colour, 0)

    def copies(self, identifier: str) -> Iterator[str]:
        """The transitions that a transition becomes: what is put after its name."""
        names = self._used(self._transitions[identifier])
        for binding in self._bindings(identifier):
            yield self._suffix(names, binding)

    def _suffix(self, names: Sequence[str], binding: Binding) -> str:
        return "".join(self._terms.variables[name].text(binding[name]) for name in names)

    def _bindings(self, identifier: str) -> Iterator[Binding]:
        """The bindings that the guard of a transition allows; the same object each time."""
        transition = self._transitions[identifier]
        names = self._used(transition)
        tests: List[List[Callable[[Binding], bool]]] = [[] for _ in range(len(names) + 1)]
        for guard in transition.guards:  # each as soon as its variables have values
            after = max((names.index(name) + 1 for name in guard.variables), default=0)
            tests[after].append(guard.holds)
        binding: Binding = {}

        def bound(number: int) -> Iterator[Binding]:
            if not all(test(binding) for test in tests[number]):
                return
            if number == len(names):
                yield binding
                return
            for colour in self._terms.variables[names[number]].colours():
                self._left -= 1
                if self._left < 0:
                    return
                binding[names[number]] = colour
                yield from bound(number + 1)

        return bound(0)

    def arcs(self) -> Iterator[UnfoldedArc]:
        """The arcs of the unfolded net.

        :raises GspnError: an arc takes or adds a colour that its place does not have.
        """
        for identifier, transition in self._transitions.items():
            names = self._used(transition)
            for binding in self._bindings(identifier):
                called = identifier + self._suffix(names, binding)
                for (name, into), (weight, arc) in self._weights(transition, binding).items():
                    ends = (name, called) if into else (called, name)
                    yield UnfoldedArc(arc.identifier, *ends, weight, arc.line)

    def _weights(
        self, transition: _ColouredTransition, binding: Binding
    ) -> Mapping[Tuple[str, bool], Tuple[int, _ColouredArc]]:
        """For a binding: unfolded place, and whether the arc leads into the transition -> the
        weight of the arcs together, and one of them."""
        found: Dict[Tuple[str, bool], Tuple[int, _ColouredArc]] = {}
        for arc in transition.arcs:
            place = self._places[arc.place]
            for colour, count in arc.term.many(binding):
                if count:
                    self._demand_colour(place, colour, count, arc.what, arc.line)
                    key = arc.place + place.sort.text(colour), arc.into
                    found[key] = found.get(key, (0, arc))[0] + count, arc
        return found

    # -- errors

    def _demand_colour(
        self, place: _ColouredPlace, colour: Colour, count: int, what: str, line: int
    ) -> None:
        if count < 0:
            self._fail("it takes away more of a colour than there is", what, line, None)
        if not place.sort.has(colour):
            self._fail(
                "%s is no colour of %s" % (colour, place.what),
                what,
                line,
                "its colours are those of its <type>",
            )

"""A fluent way to write a net in Python."""

from __future__ import annotations

from typing import Dict, List, Mapping, Optional, Sequence, Union

from gspn_framework_package.model.marking_function import parse_value
from gspn_framework_package.model.net import Arc, Net, Place, Point, Transition

ArcEnds = Union[str, Sequence[str], Mapping[str, int]]
"""One place, several places (a repeated place adds up), or place -> arc weight."""


class NetBuilder:
    """Builds a :class:`~gspn_framework_package.model.net.Net` step by step; every method returns
    the builder.

    >>> net = (NetBuilder("measure")
    ...        .place("P1", tokens=1).place("P2").place("done")
    ...        .exponential("T1", rate=0.5, inputs="P1", outputs=["P2", "done"])
    ...        .immediate("T2", inputs="P2", outputs="P1")
    ...        .build())
    >>> net
    <Net measure: 3 places, 2 transitions, 5 arcs>
    """

    def __init__(self, name: str = "") -> None:
        self._name = name
        self._places: List[Place] = []
        self._transitions: List[Transition] = []
        self._arcs: List[Arc] = []

    @classmethod
    def of(cls, net: Net) -> NetBuilder:
        """Return a builder that continues with what ``net`` has."""
        builder = cls(net.name)
        builder._places += net.places
        builder._transitions += net.transitions
        builder._arcs += net.arcs
        return builder

    def place(
        self,
        name: str,
        tokens: int = 0,
        capacity: Optional[int] = None,
        position: Optional[Point] = None,
    ) -> NetBuilder:
        """Add a place with its initial ``tokens``; ``capacity`` None means unlimited."""
        self._places.append(Place(name, tokens, capacity, position))
        return self

    def immediate(
        self,
        name: str,
        weight: Union[float, str] = 1.0,
        priority: int = 1,
        inputs: ArcEnds = (),
        outputs: ArcEnds = (),
        inhibitors: ArcEnds = (),
        position: Optional[Point] = None,
    ) -> NetBuilder:
        """Add an immediate transition and its arcs; a larger ``priority`` takes precedence. The
        weight may be an expression over the marking, such as ``"2 * #place"``."""
        value = parse_value(weight) if isinstance(weight, str) else weight
        self._transitions.append(Transition(name, False, 1.0, value, priority, 1, position))
        return self._connect(name, inputs, outputs, inhibitors)

    def exponential(
        self,
        name: str,
        rate: Union[float, str] = 1.0,
        servers: Optional[int] = 1,
        inputs: ArcEnds = (),
        outputs: ArcEnds = (),
        inhibitors: ArcEnds = (),
        position: Optional[Point] = None,
    ) -> NetBuilder:
        """Add an exponential transition (``rate`` in 1/s; ``servers`` None for infinitely many) and
        its arcs. The rate may be an expression over the marking, such as ``"2 * #place"``."""
        value = parse_value(rate) if isinstance(rate, str) else float(rate)
        self._transitions.append(Transition(name, True, value, 1.0, 1, servers, position))
        return self._connect(name, inputs, outputs, inhibitors)

    def arc(self, source: str, target: str, weight: int = 1) -> NetBuilder:
        """Add an arc between a place and a transition."""
        self._arcs.append(Arc(source, target, weight))
        return self

    def inhibitor(self, place: str, transition: str, weight: int = 1) -> NetBuilder:
        """Add an inhibitor arc: ``weight`` or more tokens on ``place`` disable ``transition``."""
        self._arcs.append(Arc(place, transition, weight, inhibitor=True))
        return self

    def build(self) -> Net:
        """Return the net. :raises NetError: see :class:`~gspn_framework_package.model.net.Net`."""
        return Net(self._places, self._transitions, self._arcs, self._name)

    def _connect(
        self, name: str, inputs: ArcEnds, outputs: ArcEnds, inhibitors: ArcEnds
    ) -> NetBuilder:
        self._arcs += [Arc(p, name, w) for p, w in _weights(inputs).items()]
        self._arcs += [Arc(name, p, w) for p, w in _weights(outputs).items()]
        self._arcs += [Arc(p, name, w, True) for p, w in _weights(inhibitors).items()]
        return self


def _weights(places: ArcEnds) -> Mapping[str, int]:
    if isinstance(places, str):
        return {places: 1}
    if isinstance(places, Mapping):
        return places
    weights: Dict[str, int] = {}
    for place in places:
        weights[place] = weights.get(place, 0) + 1
    return weights

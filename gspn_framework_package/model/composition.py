"""Hierarchical composition: replaces a place of a net with a whole net."""

from __future__ import annotations

from typing import Collection, Dict, List, Mapping, Optional

from gspn_framework_package.model.errors import NetError
from gspn_framework_package.model.net import Arc, Net, Place, Point, with_places_renamed


def expand_place(
    net: Net,
    place: str,
    subnet: Net,
    entry: str,
    exit: str,
    prefix: Optional[str] = None,
    *,
    resources: Optional[Collection[str]] = None,
    shared: Mapping[str, str] = {},
) -> Net:
    """Replace ``place`` with ``subnet``, which turns a single activity into a procedure.

    Transitions that put a token on the place now put it on the subnet's ``entry``; transitions
    that took one from the place take it from the subnet's ``exit``. Tokens of the place in the
    initial marking start at the entry. The nodes of the subnet are renamed to ``prefix + name``.
    Nodes and arcs keep their order: the subnet's places take the position of the replaced place,
    and its transitions and arcs come last.

    If every transition of the subnet preserves the number of tokens, the total number of tokens in
    the subnet behaves as the tokens of the place did, except that a token must reach the exit
    before it can leave. The subnet's own ``resources`` (such as a tool for the procedure) are not
    part of that total.

    An inhibitor arc of weight 1 from the place ("while it is occupied") becomes one from every
    place of the subnet that is not such a resource. An inhibitor arc of larger weight is refused,
    because no arc can count tokens across several places; so is a capacity of the place.

    :param place: name of the place to replace.
    :param subnet: the net that replaces it.
    :param entry: name of the subnet's place where tokens enter.
    :param exit: name of the subnet's place where tokens leave; may be the entry.
    :param prefix: prefix of the names of the subnet's nodes; by default ``place`` and a dot.
    :param resources: the places of the subnet that hold its own resources; by default those that
        are marked initially.
    :param shared: resource of the subnet -> place of the net that replaces it; the resource's own
        tokens are omitted.
    :raises NetError: the place, entry or exit does not exist; the entry or exit holds tokens; a
        name is taken; an inhibitor arc or a capacity cannot be carried over.

    >>> from gspn_framework_package.model.builder import NetBuilder
    >>> outer = (NetBuilder().place("Idle", 1).place("Inspect")
    ...          .immediate("start", inputs="Idle", outputs="Inspect")
    ...          .exponential("done", inputs="Inspect", outputs="Idle").build())
    >>> inner = (NetBuilder().place("Approach").place("Look")
    ...          .exponential("arrive", inputs="Approach", outputs="Look").build())
    >>> expanded = expand_place(outer, "Inspect", inner, entry="Approach", exit="Look")
    >>> [p.name for p in expanded.places]
    ['Idle', 'Inspect.Approach', 'Inspect.Look']
    """
    replaced = net.place(place)
    if resources is None:
        resources = [p.name for p in subnet.places if p.tokens]
    _check(net, replaced, subnet, entry, exit, resources, shared)
    start = place + "." if prefix is None else prefix
    inner_names: Dict[str, str] = {n.name: start + n.name for n in subnet.places}
    inner_names.update((n.name, start + n.name) for n in subnet.transitions)
    inner_names.update(shared)
    shift = _shift(replaced.position, subnet.place(entry).position)

    inner_places = _inner_places(subnet, replaced, entry, inner_names, shared)
    places: List[Place] = []
    for outer in net.places:
        places += inner_places if outer.name == place else [outer]

    transitions = list(net.transitions)
    transitions += [
        with_places_renamed(inner, inner_names)._replace(
            name=inner_names[inner.name], position=_moved(inner.position, shift)
        )
        for inner in subnet.transitions
    ]
    occupied = [inner_names[p.name] for p in subnet.places if p.name not in resources]
    arcs = _joined(net, place, inner_names[entry], inner_names[exit], occupied)
    arcs += [_inner_arc(arc, inner_names, shift) for arc in subnet.arcs]
    return Net(places, transitions, arcs, net.name)


def _inner_places(
    subnet: Net, replaced: Place, entry: str, names: Mapping[str, str], shared: Mapping[str, str]
) -> List[Place]:
    """The places of a subnet as the net has them; its entry holds the tokens of the place."""
    shift = _shift(replaced.position, subnet.place(entry).position)
    places = []
    for inner in subnet.places:
        if inner.name in shared:
            continue
        tokens, position = inner.tokens, _moved(inner.position, shift)
        if inner.name == entry:
            tokens, position = tokens + replaced.tokens, replaced.position
        places.append(inner._replace(name=names[inner.name], tokens=tokens, position=position))
    return places


def _inner_arc(arc: Arc, names: Mapping[str, str], shift: Optional[Point]) -> Arc:
    """An arc of a subnet as the net has it."""
    bends = filter(None, (_moved(bend, shift) for bend in arc.bends))
    return arc._replace(source=names[arc.source], target=names[arc.target], bends=tuple(bends))


def _joined(net: Net, place: str, entry: str, exit: str, occupied: List[str]) -> List[Arc]:
    """The arcs of a net; those of the replaced place now join the entry, the exit and the occupied
    places of its subnet."""
    arcs: List[Arc] = []
    for arc in net.arcs:
        if arc.inhibitor and arc.source == place:
            arcs += [arc._replace(source=name) for name in occupied]
        elif arc.source == place:
            arcs.append(arc._replace(source=exit))
        elif arc.target == place:
            arcs.append(arc._replace(target=entry))
        else:
            arcs.append(arc)
    return arcs


def _check(
    net: Net,
    replaced: Place,
    subnet: Net,
    entry: str,
    exit: str,
    resources: Collection[str],
    shared: Mapping[str, str],
) -> None:
    element = "place '%s'" % replaced.name
    for end in (entry, exit, *shared):
        if end not in subnet.place_index:
            raise NetError("the net to put in its place has no place '%s'" % end, element=element)
    if subnet.place(entry).tokens or subnet.place(exit).tokens or {entry, exit} & set(resources):
        raise NetError(
            "the net to put in its place has tokens on its entry or exit",
            element=element,
            hint="only its own resources may be marked; tokens enter from outside",
        )
    for inner, outer in shared.items():
        if inner not in resources:
            raise NetError(
                "'%s' of the inserted net is not a resource, so it cannot be shared" % inner,
                element=element,
            )
        if outer == replaced.name:
            raise NetError("a resource cannot be the place that is replaced", element=element)
        net.place(outer)
    if replaced.capacity is not None:
        raise NetError(
            "it has a capacity, which a subnet cannot have",
            element=element,
            hint="let a resource place count the free slots",
        )
    for arc in net.arcs:
        if arc.inhibitor and arc.source == replaced.name and arc.weight > 1:
            raise NetError(
                "its inhibitor arc to '%s' counts %d tokens, which is not possible across several "
                "places" % (arc.target, arc.weight),
                element=element,
                hint="only inhibitor arcs of weight 1 can be carried over",
            )


def _shift(to: Optional[Point], origin: Optional[Point]) -> Optional[Point]:
    if to is None or origin is None:
        return None
    return to[0] - origin[0], to[1] - origin[1]


def _moved(where: Optional[Point], shift: Optional[Point]) -> Optional[Point]:
    """The position in the drawing of the outer net, with the entry at the position of the place."""
    if where is None or shift is None:
        return None
    return where[0] + shift[0], where[1] + shift[1]

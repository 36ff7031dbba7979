"""Nets as JSON objects, the form in which plans and event logs contain them."""

from __future__ import annotations

from typing import Any, Dict, Optional

from gspn_framework_package.model.errors import ExpressionError, NetError
from gspn_framework_package.model.marking_function import Value, parse_value, written
from gspn_framework_package.model.net import Arc, Net, Place, Point, Transition


def net_to_json(net: Net) -> Dict[str, Any]:
    """Return the net as a JSON object; default values are left out."""
    return {
        "name": net.name,
        "places": [_place(p) for p in net.places],
        "transitions": [_transition(t) for t in net.transitions],
        "arcs": [_arc(a) for a in net.arcs],
    }


def net_from_json(data: Dict[str, Any]) -> Net:
    """Return the net of a JSON object that fits the schema.

    :raises NetError: see Net; or a transition has a key that does not apply to its kind, or a rate
        or weight that cannot be read.
    """
    for transition in data["transitions"]:
        _check_kind(transition)
    places = [
        Place(p["name"], p.get("tokens", 0), p.get("capacity"), _position(p))
        for p in data["places"]
    ]
    transitions = [
        Transition(
            t["name"],
            t.get("timed", False),
            _value(t, "rate"),
            _value(t, "weight"),
            t.get("priority", 1),
            t.get("servers", 1),
            _position(t),
        )
        for t in data["transitions"]
    ]
    arcs = [
        Arc(
            a["from"],
            a["to"],
            a.get("weight", 1),
            a.get("inhibitor", False),
            tuple((float(x), float(y)) for x, y in a.get("bends", ())),
        )
        for a in data["arcs"]
    ]
    return Net(places, transitions, arcs, data.get("name", ""))


def _value(transition: Dict[str, Any], key: str) -> Value:
    value = transition.get(key, 1.0)
    if not isinstance(value, str):
        return float(value)
    try:
        return parse_value(value)
    except ExpressionError as error:
        raise NetError(
            "its %s cannot be read: %s" % (key, error.message),
            element="transition '%s'" % transition["name"],
            hint=error.hint,
        ) from None


def _check_kind(transition: Dict[str, Any]) -> None:
    """Refuse keys that do not apply: an immediate transition with a rate most likely lacks
    ``timed``."""
    timed = transition.get("timed", False)
    for key in ("weight", "priority") if timed else ("rate", "servers"):
        if key in transition:
            raise NetError(
                "it has a %s, which %s transitions do not have"
                % (key, "timed" if timed else "immediate"),
                element="transition '%s'" % transition["name"],
                hint='leave it out, or leave "timed" out' if timed else 'is "timed": true missing?',
            )


def _position(node: Dict[str, Any]) -> Optional[Point]:
    position = node.get("position")
    return (float(position[0]), float(position[1])) if position is not None else None


def _place(place: Place) -> Dict[str, Any]:
    data: Dict[str, Any] = {"name": place.name}
    if place.tokens:
        data["tokens"] = place.tokens
    if place.capacity is not None:
        data["capacity"] = place.capacity
    if place.position is not None:
        data["position"] = list(place.position)
    return data


def _transition(transition: Transition) -> Dict[str, Any]:
    data: Dict[str, Any] = {"name": transition.name}
    if transition.timed:
        data.update(timed=True, rate=written(transition.rate))
        if transition.servers != 1:
            data["servers"] = transition.servers
    else:
        if transition.weight != 1:
            data["weight"] = written(transition.weight)
        if transition.priority != 1:
            data["priority"] = transition.priority
    if transition.position is not None:
        data["position"] = list(transition.position)
    return data


def _arc(arc: Arc) -> Dict[str, Any]:
    data: Dict[str, Any] = {"from": arc.source, "to": arc.target}
    if arc.weight != 1:
        data["weight"] = arc.weight
    if arc.inhibitor:
        data["inhibitor"] = True
    if arc.bends:
        data["bends"] = [list(bend) for bend in arc.bends]
    return data

"""JANI, the language of probabilistic model checkers (jani-spec.org): write.

A net becomes a Markov automaton, or a Markov chain if it has no immediate transitions, with one
integer variable per place. Storm (``storm --jani net.jani --prop ...``) and any other tool that
reads JANI can then check properties in CSL or LTL. No information is lost: the weights of immediate
transitions that are enabled together are normalised, and guards and rates express priorities,
inhibitor arcs, capacities and servers. A transition of weight 0 is a nondeterministic choice, as in
the model. The guards of exponential transitions exclude markings that enable immediate ones, so the
result does not depend on whether the tool assumes maximal progress."""

from __future__ import annotations

import json
import math
from functools import reduce
from typing import Any, Callable, Dict, List, Mapping, Sequence

from gspn_framework_package.formats.symbolic import (
    concession,
    identifiers,
    priority_levels,
    upper_bounds,
)
from gspn_framework_package.model.net import Net

_Term = Any  # a JANI expression: a number, a name, or a dictionary with "op"


def to_bytes(net: Net, bounds: Mapping[str, int] = {}) -> bytes:
    """Return the net as a JANI document.

    :param bounds: the maximum number of tokens of places, where known; symbolic engines need it.
    """
    return (_text(_Writer(net, bounds).document(), 4) + "\n").encode("utf-8")


def _text(value: Any, levels: int, indent: str = "\n") -> str:
    """The JSON of a value, with separate lines down to this level of nesting. An edge is one line:
    the file of a net with long conditions would otherwise be mostly spaces."""
    if not levels or not value or not isinstance(value, (dict, list)):
        return json.dumps(value, ensure_ascii=False)
    inside = indent + " "
    if isinstance(value, list):
        ends, members = "[]", [_text(item, levels - 1, inside) for item in value]
    else:
        ends = "{}"
        members = [
            "%s: %s" % (json.dumps(key), _text(item, levels - 1, inside))
            for key, item in value.items()
        ]
    return ends[0] + inside + ("," + inside).join(members) + indent + ends[1]


class _Writer:
    def __init__(self, net: Net, bounds: Mapping[str, int]) -> None:
        self.net = net
        self.bounds = upper_bounds(net, bounds)
        names = [p.name for p in net.places]
        self.names = list(identifiers(names)[0].values())
        self.levels = priority_levels(net)
        # Storm 1.9 to 2.0 assumes 0 for a variable that no edge assigns, so such places are
        # assigned to themselves.
        changed = {p for t in range(len(net.transitions)) for p, _ in net.effect(t)}
        self.unchanged = [p for p in range(len(net.places)) if p not in changed]
        self.enabled = [self._enabled(t) for t in range(len(net.transitions))]

    def document(self) -> Dict[str, Any]:
        return {
            "jani-version": 1,
            "name": self.net.name or "net",
            "type": "ma" if self.levels else "ctmc",
            "features": ["derived-operators"],
            "variables": [self._variable(p) for p in range(len(self.net.places))],
            "properties": [],
            "automata": [
                {
                    "name": "net",
                    "locations": [{"name": "marking"}],
                    "initial-locations": ["marking"],
                    "edges": self._edges(),
                }
            ],
            "system": {"elements": [{"automaton": "net"}]},
        }

    def _variable(self, p: int) -> Dict[str, Any]:
        place, bound = self.net.places[p], self.bounds[p]
        kind: Any = "int"
        if bound is not None:
            kind = {"kind": "bounded", "base": "int", "lower-bound": 0, "upper-bound": bound}
        found = {"name": self.names[p], "type": kind, "initial-value": place.tokens}
        if self.names[p] != place.name:
            found["comment"] = "place %s" % place.name
        return found

    def _edges(self) -> List[Dict[str, Any]]:
        net = self.net
        edges = []
        higher: List[_Term] = []  # enabling conditions of the levels above
        for level in self.levels:
            weighted = [t for t in level if not net.transitions[t].is_controllable]
            if weighted:
                edges.append(self._weighted(weighted, higher))
            for t in level:
                if net.transitions[t].is_controllable:
                    guard = _all([self.enabled[t]] + _none(higher))
                    edges.append(_edge(net.transitions[t].name, guard, [self._target(t)]))
            higher += [self.enabled[t] for t in level]
        for group in self._exponential_groups():
            names = ", ".join(net.transitions[t].name for t in group)
            guard = _all([_any([self.enabled[t] for t in group]), *_none(higher)])
            edge = _edge(names, guard, [self._target(group[0])])
            rates = [self._rate(t) for t in group]
            if len(group) > 1:
                rates = [_choice(self.enabled[t], rate) for t, rate in zip(group, rates)]
            edge["rate"] = {"exp": reduce(lambda a, b: _operation("+", a, b), rates)}
            edges.append(edge)
        return edges

    def _exponential_groups(self) -> List[List[int]]:
        """Group the exponential transitions by effect: if several Markovian edges of an automaton
        lead to the same state, Storm 1.9 to 2.0 ignores all but one of them."""
        groups: Dict[Any, List[int]] = {}
        for t, transition in enumerate(self.net.transitions):
            if transition.timed:
                groups.setdefault(frozenset(self.net.effect(t)), []).append(t)
        return list(groups.values())

    def _weighted(self, level: Sequence[int], higher: Sequence[_Term]) -> Dict[str, Any]:
        """Return one edge for the transitions of one priority; their weights decide which fires."""
        names = ", ".join(self.net.transitions[t].name for t in level)
        guard = _all([_any([self.enabled[t] for t in level])] + _none(higher))
        if len(level) == 1:
            return _edge(names, guard, [self._target(level[0])])
        shares = [_choice(self.enabled[t], self._value(t)) for t in level]
        total = reduce(lambda a, b: _operation("+", a, b), shares)
        targets = []
        for t, share in zip(level, shares):
            target = self._target(t)
            target["probability"] = {"exp": _operation("/", share, total)}
            targets.append(target)
        return _edge(names, guard, targets)

    def _enabled(self, t: int) -> _Term:
        tests = []
        for place, operator, bound in concession(self.net, t):
            name = self.names[place]
            sign = {">=": "≥", "<": "<", "<=": "≤"}[operator]
            tests.append(_operation(sign, name, bound))
        return _all(tests)

    def _target(self, t: int) -> Dict[str, Any]:
        assignments: List[Dict[str, Any]] = [
            {"ref": self.names[p], "value": self.names[p]} for p in self.unchanged
        ]
        for p, change in self.net.effect(t):
            sign = "+" if change > 0 else "-"
            value = _operation(sign, self.names[p], abs(change))
            assignments.append({"ref": self.names[p], "value": value})
        return {"location": "marking", "assignments": assignments}

    def _value(self, t: int) -> _Term:
        """The rate of one server, or the weight."""
        function = self.net.functions.get(t)
        if function is None:
            return self.net.transitions[t].number
        names = {name: self.names[self.net.place_index[name]] for name in function.places}
        element = "transition '%s'" % self.net.transitions[t].name
        return function.write(names, _OPERATIONS, element)

    def _rate(self, t: int) -> _Term:
        transition = self.net.transitions[t]
        rate = self._value(t)
        if transition.servers == 1 or not self.net.inputs[t]:
            return rate
        degrees: List[_Term] = []
        for p, weight in self.net.inputs[t]:
            name: _Term = self.names[p]
            if weight > 1:
                name = {"op": "floor", "exp": _operation("/", name, weight)}
            degrees.append(name)
        if transition.servers is not None:
            degrees.append(transition.servers)
        degree = reduce(lambda a, b: _operation("min", a, b), degrees)
        return _operation("*", rate, degree)


def _edge(comment: str, guard: _Term, destinations: List[Dict[str, Any]]) -> Dict[str, Any]:
    return {
        "location": "marking",
        "guard": {"exp": guard},
        "destinations": destinations,
        "comment": comment,
    }


def _choice(condition: _Term, value: _Term) -> _Term:
    """Return the term for ``value`` if ``condition`` holds, else 0."""
    return {"op": "ite", "if": condition, "then": value, "else": 0}


def _operation(operator: str, left: _Term, right: _Term) -> _Term:
    return {"op": operator, "left": left, "right": right}


def _of_all(operator: str) -> Callable[..., _Term]:
    return lambda *terms: reduce(lambda a, b: _operation(operator, a, b), terms)


_OPERATIONS: Mapping[str, Callable[..., _Term]] = {
    **{operator: _of_all(operator) for operator in ("+", "-", "*", "/", "min", "max", "pow")},
    "^": _of_all("pow"),
    "negate": lambda a: _operation("-", 0, a),
    "abs": lambda a: {"op": "abs", "exp": a},
    "floor": lambda a: {"op": "floor", "exp": a},
    "ceil": lambda a: {"op": "ceil", "exp": a},
    "round": lambda a: {"op": "floor", "exp": _operation("+", a, 0.5)},
    "sqrt": lambda a: _operation("pow", a, 0.5),
    "exp": lambda a: _operation("pow", math.e, a),
    "log": lambda a: _operation("log", a, math.e),
    "ln": lambda a: _operation("log", a, math.e),
}
"""The operations of rates and weights; JANI's ``%`` is of whole numbers, unlike ``mod``."""


def _all(terms: Sequence[_Term]) -> _Term:
    return _joined("∧", terms) if terms else True


def _any(terms: Sequence[_Term]) -> _Term:
    return _joined("∨", terms)


def _joined(operator: str, terms: Sequence[_Term]) -> _Term:
    """Join many terms in a balanced tree: readers of deep ones may overflow their stack."""
    if len(terms) < 3:
        return reduce(lambda a, b: _operation(operator, a, b), terms)
    half = (len(terms) + 1) // 2
    return _operation(operator, _joined(operator, terms[:half]), _joined(operator, terms[half:]))


def _none(terms: Sequence[_Term]) -> List[_Term]:
    return [{"op": "¬", "exp": _any(terms)}] if terms else []

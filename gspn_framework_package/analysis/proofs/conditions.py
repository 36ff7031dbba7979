"""Conditions on markings as formulas of linear inequalities."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any, Callable, Dict, NamedTuple, Tuple

from gspn_framework_package.analysis.proofs.checker import (
    FALSE,
    TRUE,
    All,
    Atom,
    Formula,
    Some,
    opposite,
)
from gspn_framework_package.model.condition import Condition, parse_condition, run_program
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net

_FINEST, _LARGEST = 1 << 16, 1 << 24
"""The numbers of conditions with which floats compute exactly: multiples of a power of 1/2."""


def condition_of(text: str, net: Net) -> Condition:
    """A condition on the markings of a net."""
    return parse_condition(text, [place.name for place in net.places])


def facts_of(condition: Condition) -> Tuple[Formula, ...]:
    """A condition as facts; none if it cannot be written as inequalities."""
    try:
        return (formula_of(condition),)
    except LimitError:
        return ()


class _Sum(NamedTuple):
    """A weighted sum of counts (place number -> weight), plus a constant."""

    weights: Dict[int, Fraction]
    constant: Fraction

    def plus(self, other: _Sum, times: Fraction) -> _Sum:
        weights = dict(self.weights)
        for p, weight in other.weights.items():
            weights[p] = weights.get(p, Fraction(0)) + times * weight
        return _Sum(weights, self.constant + times * other.constant)

    def at_least(self, more: int) -> Atom:
        """The sum is 0 or more, or above 0 if ``more`` is 1."""
        parts = [*self.weights.values(), self.constant]
        scale = 1
        for part in parts:
            scale *= part.denominator // math.gcd(scale, part.denominator)
        terms = tuple((p, int(w * scale)) for p, w in sorted(self.weights.items()) if w)
        return Atom(terms, more - int(self.constant * scale))


def formula_of(condition: Condition) -> Formula:
    """A condition as a formula.

    :raises LimitError: it is not linear, or its numbers are such that floats would round.
    """
    counts = {
        p: _Sum({p: Fraction(1)}, Fraction(0)) for step, p in condition.program if step == "place"
    }
    return _as_formula(run_program(condition.program, counts, {}, _Steps()))


class _Steps(Dict[str, Callable[..., Any]]):
    """What the steps of a condition's program do with sums and formulas."""

    def __init__(self) -> None:
        super().__init__()
        self["+"] = lambda a, b: _as_sum(a).plus(_as_sum(b), Fraction(1))
        self["-"] = lambda a, b: _as_sum(a).plus(_as_sum(b), Fraction(-1))
        self["negate"] = lambda a: _times(_as_sum(a), Fraction(-1))
        self["*"] = _product
        self["/"] = lambda a, b: _product(a, _inverse(b))
        self[">="] = lambda a, b: self["-"](a, b).at_least(0)
        self[">"] = lambda a, b: self["-"](a, b).at_least(1)
        self["<="] = lambda a, b: self[">="](b, a)
        self["<"] = lambda a, b: self[">"](b, a)
        self["=="] = lambda a, b: All((self[">="](a, b), self["<="](a, b)))
        self["!="] = lambda a, b: Some((self[">"](a, b), self["<"](a, b)))
        self["and"] = lambda a, b: All((_as_formula(a), _as_formula(b)))
        self["or"] = lambda a, b: Some((_as_formula(a), _as_formula(b)))
        self["not"] = lambda a: opposite(_as_formula(a))

    def __missing__(self, step: str) -> Callable[..., Any]:
        raise LimitError("not decided: a condition with '%s' is not linear" % step)


def _as_formula(value: Any) -> Formula:
    if isinstance(value, bool):
        return TRUE if value else FALSE
    return value


def _as_sum(value: Any) -> _Sum:
    if isinstance(value, _Sum):
        return value
    number = Fraction(value)
    finest = number.denominator
    if finest > _FINEST or finest & (finest - 1) or abs(number) > _LARGEST:
        raise LimitError("not decided: the condition has the number %s" % value)
    return _Sum({}, number)


def _times(total: _Sum, times: Fraction) -> _Sum:
    return _Sum({}, Fraction(0)).plus(total, times)


def _inverse(value: Any) -> Fraction:
    number = _as_sum(value)
    if number.weights or number.constant == 0:
        raise LimitError("not decided: a condition that divides by counts is not linear")
    return 1 / number.constant


def _product(a: Any, b: Any) -> _Sum:
    left, right = _as_sum(a), _as_sum(b)
    if left.weights and right.weights:
        raise LimitError("not decided: a condition with a product of counts is not linear")
    return _times(left, right.constant) if left.weights else _times(right, left.constant)

"""Conditions on markings as formulas of linear inequalities."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from typing import Any, Callable, Dict, List, NamedTuple, Sequence, Tuple

from gspn_framework_package.analysis.proofs.checker import (
    FALSE,
    TRUE,
    All,
    Atom,
    Formula,
    Some,
    opposite,
)
from gspn_framework_package.model.condition import Condition, run_program
from gspn_framework_package.model.errors import LimitError

_FINEST, _LARGEST = 1 << 16, 1 << 24
"""The numbers of conditions with which floats compute exactly: multiples of a power of 1/2."""

_MOST_CASES = 64
"""Maximum number of cases of a value: in each, every minimum and maximum in it equals one of its
parts."""


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
        p: [_Case((), _Sum({p: Fraction(1)}, Fraction(0)))]
        for step, p in condition.program
        if step == "place"
    }
    return _as_formula(run_program(condition.program, counts, {}, _Steps()))


class _Case(NamedTuple):
    """A value where some inequalities hold: ``min(a, b)`` is one or the other."""

    where: Tuple[Formula, ...]
    total: _Sum


class _Steps(Dict[str, Callable[..., Any]]):
    """The operations of a condition's program on cases of values and on formulas."""

    def __init__(self) -> None:
        super().__init__()
        self["+"] = _of_cases(lambda a, b: a.plus(b, Fraction(1)))
        self["-"] = _of_cases(lambda a, b: a.plus(b, Fraction(-1)))
        self["negate"] = _of_cases(lambda a: _times(a, Fraction(-1)))
        self["*"] = _of_cases(_product)
        self["/"] = _of_cases(lambda a, b: _product(a, _inverse(b)))
        self["min"] = lambda *parts: _one_of(parts, lambda a, b: _no_less(b, a))
        self["max"] = lambda *parts: _one_of(parts, _no_less)
        self["abs"] = lambda a: self["max"](a, self["negate"](a))
        self[">="] = lambda a, b: _compared(a, b, _no_less)
        self[">"] = lambda a, b: _compared(a, b, _above)
        self["<="] = lambda a, b: self[">="](b, a)
        self["<"] = lambda a, b: self[">"](b, a)
        self["=="] = lambda a, b: All((self[">="](a, b), self["<="](a, b)))
        self["!="] = lambda a, b: Some((self[">"](a, b), self["<"](a, b)))
        self["and"] = lambda a, b: All((_as_formula(a), _as_formula(b)))
        self["or"] = lambda a, b: Some((_as_formula(a), _as_formula(b)))
        self["not"] = lambda a: opposite(_as_formula(a))

    def __missing__(self, step: str) -> Callable[..., Any]:
        raise LimitError("not decided: a condition with '%s' is not linear" % step)


def _of_cases(compute: Callable[..., _Sum]) -> Callable[..., List[_Case]]:
    """Apply a computation on sums to values with several cases."""

    def computed(*values: Any) -> List[_Case]:
        return [_Case(where, compute(*sums)) for where, sums in _together(values)]

    return computed


def _together(values: Sequence[Any]) -> List[Tuple[Tuple[Formula, ...], Tuple[_Sum, ...]]]:
    """The cases of several values at once."""
    cases = list(map(_as_cases, values))
    if math.prod(map(len, cases)) > _MOST_CASES:
        raise LimitError("not decided: the condition has more than %d cases" % _MOST_CASES)
    return [
        (tuple(fact for case in each for fact in case.where), tuple(case.total for case in each))
        for each in itertools.product(*cases)
    ]


def _one_of(parts: Sequence[Any], before: Callable[[_Sum, _Sum], Atom]) -> List[_Case]:
    """The value that precedes all others, the first of equal ones."""
    found = []
    for where, sums in _together(parts):
        for k, total in enumerate(sums):
            facts = [opposite(before(other, total)) for other in sums[:k]]
            facts += [before(total, other) for other in sums[k + 1 :]]
            found.append(_Case((*where, *facts), total))
    return found


def _compared(a: Any, b: Any, compare: Callable[[_Sum, _Sum], Atom]) -> Formula:
    parts = [(*where, compare(*sums)) for where, sums in _together((a, b))]
    if len(parts) == 1 and len(parts[0]) == 1:
        return parts[0][0]
    return Some(tuple(map(All, parts)))


def _no_less(a: _Sum, b: _Sum) -> Atom:
    return a.plus(b, Fraction(-1)).at_least(0)


def _above(a: _Sum, b: _Sum) -> Atom:
    return a.plus(b, Fraction(-1)).at_least(1)


def _as_formula(value: Any) -> Formula:
    if isinstance(value, bool):
        return TRUE if value else FALSE
    return value


def _as_cases(value: Any) -> List[_Case]:
    if isinstance(value, list):
        return value
    return [_Case((), _Sum({}, _exact(Fraction(value))))]


def _exact(number: Fraction) -> Fraction:
    finest = number.denominator
    if finest > _FINEST or finest & (finest - 1) or abs(number) > _LARGEST:
        raise LimitError("not decided: the condition has the number %s" % number)
    return number


def _times(total: _Sum, times: Fraction) -> _Sum:
    return _Sum({}, Fraction(0)).plus(total, times)


def _inverse(number: _Sum) -> _Sum:
    if number.weights or number.constant == 0:
        raise LimitError("not decided: a condition that divides by counts is not linear")
    return _Sum({}, _exact(1 / number.constant))


def _product(left: _Sum, right: _Sum) -> _Sum:
    if left.weights and right.weights:
        raise LimitError("not decided: a condition with a product of counts is not linear")
    return _times(left, right.constant) if left.weights else _times(right, left.constant)

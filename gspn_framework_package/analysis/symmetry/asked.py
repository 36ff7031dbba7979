"""Conditions as terms that are independent of the order in which equal parts are named.

``busy1 + busy2 >= 1`` and ``busy2 + busy1 >= 1`` are the same term. A permutation of the places
that maps a condition to the same term preserves its truth, so equal parts may be exchanged although
the condition names them.
"""

from __future__ import annotations

from typing import Dict, Hashable, List, Optional, Sequence, Tuple

from gspn_framework_package.model.condition import Condition

_ANY_ORDER = ("+", "*", "==", "!=", "and", "or", "min", "max")
_FLAT = ("and", "or", "min", "max")
"""The associative operations. Sums are associative too if they consist of counts and whole numbers,
which floats represent exactly."""

Term = Tuple[Hashable, Tuple[int, ...]]
"""An operation and the numbers of its operands, sorted if their order does not matter."""


class Terms:
    """Numbers the terms of conditions from 0; equal terms have the same number.

    :ivar terms: the terms; operands have lower numbers.
    """

    def __init__(self) -> None:
        self.terms: List[Term] = []
        self._numbers: Dict[Term, int] = {}
        self._whole: List[bool] = []

    def of(self, condition: Condition, to: Optional[Sequence[int]] = None) -> int:
        """The number of the term of a condition.

        :param to: place number -> number of the place that replaces it.
        """
        stack: List[int] = []
        for step, argument in condition.program:
            if step == "place":
                place = int(argument) if to is None else int(to[int(argument)])
                stack.append(self._number(("place", place), (), True))
            elif step == "value":
                whole = not isinstance(argument, bool) and argument == int(argument)
                stack.append(self._number(("value", repr(argument)), (), whole))
            elif step == "label":
                stack.append(self._number(("label", argument), (), False))
            else:
                parts = stack[-argument:]
                del stack[-argument:]
                stack.append(self._taking(step, parts))
        return stack[0]

    def _taking(self, operation: str, parts: List[int]) -> int:
        whole = operation == "+" and all(self._whole[part] for part in parts)
        if whole or operation in _FLAT:
            parts = [
                inner
                for part in parts
                for inner in (self.terms[part][1] if self.terms[part][0] == operation else [part])
            ]
        if operation in _ANY_ORDER:
            parts.sort()
        return self._number(operation, tuple(parts), whole)

    def _number(self, operation: Hashable, parts: Tuple[int, ...], whole: bool) -> int:
        term = operation, parts
        if term not in self._numbers:
            self._numbers[term] = len(self.terms)
            self.terms.append(term)
            self._whole.append(whole)
        return self._numbers[term]


def in_any_order(operation: Hashable) -> bool:
    """Whether the operands of a term may be reordered."""
    return operation in _ANY_ORDER


def is_kept(condition: Condition, generators: Sequence[Sequence[int]]) -> bool:
    """Whether these permutations of the places preserve a condition."""
    terms = Terms()
    term = terms.of(condition)
    return all(terms.of(condition, generator) == term for generator in generators)

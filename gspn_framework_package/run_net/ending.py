"""When a condition on the marking holds, as bounds on sums of tokens."""

from __future__ import annotations

import math
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple, Union

from gspn_framework_package.model.condition import Condition, run_program
from gspn_framework_package.model.errors import RefusedError

MOST_WAYS = 200
"""A condition that holds in more ways is refused."""


class Bound(NamedTuple):
    """At least ``least`` and at most ``most`` tokens (None: any number) in the places ``parts``:
    pairs (number of a place, how often its tokens count)."""

    parts: Tuple[Tuple[int, int], ...]
    least: int
    most: Optional[int]


Way = Tuple[Bound, ...]
_Truth = Tuple[List[Way], List[Way]]
"""The ways in which a condition holds, and in which it does not."""
_Sum = Dict[int, float]
"""Place -> how often its tokens count; -1: a number."""


def ways_to_hold(condition: Condition) -> List[Way]:
    """The ways in which a condition holds: in each of them, all of its bounds do.

    :raises RefusedError: it is not made of bounds on sums of tokens.
    """

    def refuse(*_: Any) -> Any:
        raise RefusedError(
            "'%s' does not compare sums of tokens with numbers, which a run net would need"
            % condition.text,
            element="until",
        )

    def as_sum(term: Any) -> _Sum:
        return term if isinstance(term, dict) else {-1: float(term)}

    def add(a: Any, b: Any, sign: float = 1.0) -> _Sum:
        a, b = as_sum(a), as_sum(b)
        return {p: a.get(p, 0.0) + sign * b.get(p, 0.0) for p in {**a, **b}}

    def times(a: Any, b: Any) -> _Sum:
        a, b = as_sum(a), as_sum(b)
        if b.keys() != {-1}:
            a, b = b, a
        return {p: n * b[-1] for p, n in a.items()} if b.keys() == {-1} else refuse()

    def at_least(a: Any, b: Any, strict: bool) -> List[Way]:
        """The ways in which ``a >= b`` holds, or ``a > b`` if ``strict``."""
        difference = add(a, b, -1.0)
        limit = -difference.pop(-1, 0.0)
        parts = tuple((p, int(n)) for p, n in sorted(difference.items()) if n)
        if any(n != int(n) for n in difference.values()) or len({n > 0 for _, n in parts}) > 1:
            refuse()
        if not parts:
            return [()] if (0 > limit if strict else 0 >= limit) else []
        if parts[0][1] > 0:
            least = math.floor(limit) + 1 if strict else math.ceil(limit)
            return [(Bound(parts, max(least, 0), None),)]
        most = math.ceil(-limit) - 1 if strict else math.floor(-limit)
        return [(Bound(tuple((p, -n) for p, n in parts), 0, most),)] if most >= 0 else []

    def both(a: List[Way], b: List[Way]) -> List[Way]:
        if len(a) * len(b) > MOST_WAYS:
            raise RefusedError("it holds in more than %d ways" % MOST_WAYS, element="until")
        return [(*one, *other) for one in a for other in b]

    def above(a: Any, b: Any) -> _Truth:
        return at_least(a, b, True), at_least(b, a, False)

    def equal(a: Any, b: Any) -> _Truth:
        yes = both(at_least(a, b, False), at_least(b, a, False))
        return yes, at_least(a, b, True) + at_least(b, a, True)

    operations: Mapping[str, Callable[..., Any]] = {
        "+": add,
        "-": lambda a, b: add(a, b, -1.0),
        "negate": lambda a: add(0.0, a, -1.0),
        "*": times,
        ">": above,
        "<": lambda a, b: above(b, a),
        "<=": lambda a, b: above(a, b)[::-1],
        ">=": lambda a, b: above(b, a)[::-1],
        "==": equal,
        "!=": lambda a, b: equal(a, b)[::-1],
        "and": lambda a, b: (both(truth(a)[0], truth(b)[0]), truth(a)[1] + truth(b)[1]),
        "or": lambda a, b: (truth(a)[0] + truth(b)[0], both(truth(a)[1], truth(b)[1])),
        "not": lambda a: truth(a)[::-1],
    }

    def truth(term: Union[bool, _Truth]) -> _Truth:
        return term if isinstance(term, tuple) else (([()], []) if term else ([], [()]))

    steps = [step for step, _ in condition.program]
    if any(step not in operations and step not in ("value", "place") for step in steps):
        refuse()
    places = {p: {p: 1.0} for step, p in condition.program if step == "place"}
    return truth(run_program(condition.program, places, functions=operations))[0]

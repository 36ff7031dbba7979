"""The steps of a net, for decision diagrams over its places in a given order.

A step is a diagram too: at each level, what it adds there, and for each range of tokens in which it
is possible the step of the lower levels. Equal steps are the same number, so that their results are
shared. A transition that others take precedence over is a step that asks, on its way down, whether
one of them is enabled.
"""

from __future__ import annotations

from typing import Dict, FrozenSet, List, NamedTuple, Optional, Sequence, Set, Tuple

from gspn_framework_package.analysis.symbolic.kernel import IDENTITY, StepArrays
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net

MANY = 2**60
"""More tokens than any place can hold."""

NO_STEP = -1
"""The step that is possible in no marking."""

_MOST_ROWS = 1_000_000
"""Largest number of rows of all steps together."""

_Gone = FrozenSet[int]
Range = Tuple[int, int]
StepRows = Tuple[Tuple[int, int, int], ...]


class TooManyCasesError(LimitError):
    """The precedence of transitions makes too many cases under an order of the places."""


class FiringRule(NamedTuple):
    """Where a transition has concession, and what it does, by level: the number of tokens from the
    first up to below the second, and the change."""

    guard: Dict[int, Range]
    change: Dict[int, int]


NO_CONDITION = FiringRule({}, {})
"""Always possible, and changes nothing."""


def rule_of(net: Net, t: int, level_of: Sequence[int]) -> Optional[FiringRule]:
    """The rule of a transition; None if no marking enables it."""
    least = dict(net.inputs[t])
    below = dict(net.inhibitors[t])
    for p, change in net.effect(t):
        capacity = net.places[p].capacity
        if capacity is not None and change > 0:
            below[p] = min(below.get(p, MANY), capacity - change + 1)
    guard = {
        level_of[p]: (least.get(p, 0), below.get(p, MANY)) for p in least.keys() | below.keys()
    }
    if any(low >= high for low, high in guard.values()):
        return None
    return FiringRule(guard, {level_of[p]: change for p, change in net.effect(t)})


class StepTable:
    """Makes steps, and numbers them."""

    def __init__(self, levels: int) -> None:
        self._levels = levels
        self._known: Dict[Tuple[int, int, bool, StepRows], int] = {}
        self._steps: List[Tuple[int, int, bool, StepRows]] = [(0, 0, False, ())]
        self._rows = 0
        self._top: List[Set[Tuple[int, int, int, int]]] = [set() for _ in range(levels + 1)]

    def fire_from(self, step: int) -> None:
        """Have a step fired at its level."""
        level, change, _, rows = self._steps[step]
        self._top[level].update((least, below, change, rest) for least, below, rest in rows)

    def lists(self) -> StepArrays:
        """The steps as the kernel reads them."""
        rows: List[int] = [0]
        flat: List[Tuple[int, int, int]] = []
        for _, _, _, of_step in self._steps:
            flat += of_step
            rows.append(len(flat))
        top: List[int] = [0, 0]
        of_top: List[Tuple[int, int, int, int]] = []
        for level in range(1, self._levels + 1):
            of_top += sorted(self._top[level])
            top.append(len(of_top))
        least, below, rest = map(list, zip(*(flat or [(0, 0, 0)])))
        top_least, top_below, top_change, top_rest = map(list, zip(*(of_top or [(0, 0, 0, 0)])))
        level_of, change, closing, _ = map(list, zip(*self._steps))
        return StepArrays(
            level_of,
            change,
            list(map(int, closing)),
            rows,
            least,
            below,
            rest,
            top,
            top_least,
            top_below,
            top_change,
            top_rest,
        )

    def step(
        self, rule: FiringRule, above: Sequence[FiringRule] = (), closing: bool = False
    ) -> int:
        """The step of a transition, or of its guard alone.

        :param above: the rules of the transitions that must not be enabled.
        :param closing: whether the result is closed under the transitions.
        :raises TooManyCasesError: all steps together have too many rows.
        """
        levels = set(rule.guard) | set(rule.change)
        for other in above:
            if not other.guard:
                return NO_STEP
            levels.update(other.guard)
        ordered = sorted(levels, reverse=True)
        lowest = [min(other.guard) for other in above]
        at_level: Dict[int, List[int]] = {}
        for h, other in enumerate(above):
            for level in other.guard:
                at_level.setdefault(level, []).append(h)

        # down: the others that are known to be disabled, as far as lower levels ask about them
        before = self._rows
        plans: List[Dict[_Gone, List[Tuple[int, int, _Gone]]]] = []
        here: Set[_Gone] = {frozenset()}
        for level in ordered:
            low, high = rule.guard.get(level, (0, MANY))
            asked = at_level.get(level, [])
            plan: Dict[_Gone, List[Tuple[int, int, _Gone]]] = {}
            below: Set[_Gone] = set()
            for gone in here:
                ranges = plan[gone] = []
                left = [(h, *above[h].guard[level]) for h in asked if h not in gone]
                ends = {low, high}
                for _, least, most in left:
                    ends.update(end for end in (least, most) if low < end < high)
                cuts = sorted(ends)
                for first, last in zip(cuts, cuts[1:]):
                    fails = [h for h, least, most in left if not least <= first < most]
                    if sum(lowest[h] == level for h, _, _ in left) > sum(
                        lowest[h] == level for h in fails
                    ):
                        continue  # one of them is enabled
                    after = frozenset(h for h in (*gone, *fails) if lowest[h] < level)
                    ranges.append((first, last, after))
                    below.add(after)
                self._rows += len(ranges)
            if self._rows > _MOST_ROWS:
                self._rows = before
                raise TooManyCasesError(
                    "not decided: the priorities make more than %s cases" % format(_MOST_ROWS, ",")
                )
            plans.append(plan)
            here = below

        # up: the steps
        made: Dict[_Gone, int] = dict.fromkeys(here, IDENTITY)
        for level, plan in zip(reversed(ordered), reversed(plans)):
            change = rule.change.get(level, 0)
            made = {
                gone: self._made(level, change, closing, [(a, b, made[g]) for a, b, g in ranges])
                for gone, ranges in plan.items()
            }
        return made[frozenset()]

    def _made(
        self, level: int, change: int, closing: bool, ranges: List[Tuple[int, int, int]]
    ) -> int:
        rows: List[Tuple[int, int, int]] = []
        for first, last, rest in ranges:
            if rest == NO_STEP:
                continue
            if rows and rows[-1][1] == first and rows[-1][2] == rest:
                rows[-1] = (rows[-1][0], last, rest)
            else:
                rows.append((first, last, rest))
        if not rows:
            return NO_STEP
        if change == 0 and len(rows) == 1 and rows[0][:2] == (0, MANY):
            return rows[0][2]
        key = (level, change, closing, tuple(rows))
        number = self._known.get(key)
        if number is None:
            number = self._known[key] = len(self._steps)
            self._steps.append(key)
        return number

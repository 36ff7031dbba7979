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

_MOST_CASES = 30_000
"""Largest number of sets of transitions that may still be enabled at some level: with more, the
priorities do not fit the order of the places, and a long attempt would fail."""

Range = Tuple[int, int]
_Gone = FrozenSet[int]
_Cases = List[Tuple[int, int, _Gone]]
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
    below: Dict[int, int] = {}
    for p, most in net.most_tokens(t):
        below[p] = min(below.get(p, MANY), most + 1)
    guard = {
        level_of[p]: (least.get(p, 0), below.get(p, MANY)) for p in least.keys() | below.keys()
    }
    if any(low >= high for low, high in guard.values()):
        return None
    return FiringRule(guard, {level_of[p]: change for p, change in net.effect(t)})


class Precedence:
    """Transitions of which none may be enabled, level by level, from the highest on.

    :param rules: their rules.
    :ivar always: whether one of them is enabled in every marking.
    :ivar levels: the levels that their guards ask, the highest first.
    :ivar steps: the steps that only ask for them, of those made so far.
    """

    def __init__(self, rules: Sequence[FiringRule] = ()) -> None:
        self.always = any(not rule.guard for rule in rules)
        self._asked: Dict[int, List[Tuple[int, int, int]]] = {}
        for number, rule in enumerate(rules):
            for level, (least, below) in rule.guard.items():
                self._asked.setdefault(level, []).append((number, least, below))
        self._lowest = [min(rule.guard, default=0) for rule in rules]
        self._cases: Dict[Tuple[int, _Gone], _Cases] = {}
        self.levels = sorted(self._asked, reverse=True)
        self.steps: Dict[Tuple[bool, int, _Gone], int] = {}

    def cases(self, level: int, gone: _Gone) -> _Cases:
        """The ranges of tokens at a level in which none of the transitions is enabled yet.

        :param gone: those known to be disabled by a higher level, and asked about by a lower one
            again; each range comes with those after this level.
        :raises TooManyCasesError: there are too many.
        """
        found = self._cases.get((level, gone))
        if found is None:
            if len(self._cases) >= _MOST_CASES:
                raise TooManyCasesError(
                    "not decided: the priorities make more than %s cases" % format(_MOST_CASES, ",")
                )
            found = self._cases[level, gone] = self._new_cases(level, gone)
        return found

    def _new_cases(self, level: int, gone: _Gone) -> _Cases:
        open_ = [asked for asked in self._asked.get(level, []) if asked[0] not in gone]
        last_asked = {number for number, _, _ in open_ if self._lowest[number] == level}
        ends = {0, MANY}.union(end for _, *two in open_ for end in two)
        found: _Cases = []
        cuts = sorted(ends)
        for first, last in zip(cuts, cuts[1:]):
            fails = {number for number, least, below in open_ if not least <= first < below}
            if last_asked <= fails:  # otherwise, one of them is enabled
                after = frozenset(n for n in gone | fails if self._lowest[n] < level)
                found.append((first, last, after))
        return found


class StepTable:
    """Makes steps, and numbers them."""

    def __init__(self, levels: int) -> None:
        self._levels = levels
        self._known: Dict[Tuple[int, int, bool, StepRows], int] = {}
        self._steps: List[Tuple[int, int, bool, StepRows]] = [(0, 0, False, ())]
        self._rows = 0  # of the steps so far
        self._rows_before = 0  # of the steps before the one being made
        self._rows_allowed = 0  # largest allowed number of them once it is made
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
        self,
        rule: FiringRule,
        above: Precedence,
        closing: bool = False,
        most_rows: int = _MOST_ROWS,
    ) -> int:
        """The step of a transition, or of its guard alone.

        :param above: the transitions that must not be enabled.
        :param closing: whether the result is closed under the transitions.
        :param most_rows: most rows of the step.
        :raises TooManyCasesError: it has more, or all steps together have too many.
        """
        if above.always:
            return NO_STEP
        self._rows_before = self._rows
        self._rows_allowed = min(self._rows + most_rows, _MOST_ROWS)
        touched = rule.guard.keys() | rule.change.keys()
        lowest = min(touched, default=self._levels + 1)
        levels = [level for level in above.levels if level > lowest and level not in touched]
        levels = sorted([*levels, *touched], reverse=True)
        plans: List[Tuple[int, Dict[_Gone, _Cases]]] = []
        here: Set[_Gone] = {frozenset()}
        for level in levels:
            low, high = rule.guard.get(level, (0, MANY))
            plan = {
                gone: [
                    (max(first, low), min(last, high), after)
                    for first, last, after in above.cases(level, gone)
                    if first < high and last > low
                ]
                for gone in here
            }
            self._count_rows(plan)
            plans.append((level, plan))
            here = {after for cases in plan.values() for _, _, after in cases}
        made = {gone: self._without(above, lowest, gone, closing) for gone in here}
        for level, plan in reversed(plans):
            change = rule.change.get(level, 0)
            made = {
                gone: self._made(level, change, closing, [(a, b, made[g]) for a, b, g in cases])
                for gone, cases in plan.items()
            }
        return made[frozenset()]

    def _without(self, above: Precedence, below: int, gone: _Gone, closing: bool) -> int:
        """The step from the markings of the levels lower than ``below`` that enable none of these
        transitions, besides those that are ``gone``."""
        known = above.steps
        levels = [level for level in above.levels if level < below]
        plans: List[Tuple[int, Dict[_Gone, _Cases]]] = []
        here: Set[_Gone] = {gone}
        for level in levels:
            plan = {g: above.cases(level, g) for g in here if (closing, level, g) not in known}
            self._count_rows(plan)
            plans.append((level, plan))
            here = {after for cases in plan.values() for _, _, after in cases}
        lower: Optional[int] = None
        for level, plan in reversed(plans):
            for g, cases in plan.items():
                rows = [
                    (a, b, IDENTITY if lower is None else known[closing, lower, after])
                    for a, b, after in cases
                ]
                known[closing, level, g] = self._made(level, 0, closing, rows)
            lower = level
        return IDENTITY if lower is None else known[closing, lower, gone]

    def _count_rows(self, plan: Dict[_Gone, _Cases]) -> None:
        self._rows += sum(map(len, plan.values()))
        if self._rows > self._rows_allowed:
            self._rows = self._rows_before
            raise TooManyCasesError(
                "not decided: the priorities make more than %s rows"
                % format(self._rows_allowed, ",")
            )

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

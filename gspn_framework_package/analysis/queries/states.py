"""The states in which a formula of CTL holds, also where not all states were explored.

A path is a sequence of firings that goes on for ever, or ends where nothing is enabled. Immediate
firings are steps of it like others, so a condition that holds for no time counts.

Of a state that was not explored, the firings are unknown. So there are two sets for a formula: the
states in which it *must* hold, whatever these firings are, and those in which it *may*. If all
states were explored, they are the same.
"""

from __future__ import annotations

from typing import Any, Callable, Dict, Mapping, NamedTuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans
from gspn_framework_package.analysis.graph import can_reach, on_a_cycle
from gspn_framework_package.analysis.queries.grammar import Branching, StateFormula
from gspn_framework_package.analysis.state_space.marking_store import Columns
from gspn_framework_package.analysis.state_space.space import StateSpace
from gspn_framework_package.model.condition import Condition, run_program, vector_functions


class Known(NamedTuple):
    """Boolean arrays: the states in which a formula must hold, and those in which it may."""

    must: Booleans
    may: Booleans

    def opposite(self) -> Known:
        """The negation."""
        return Known(~self.may, ~self.must)

    def both(self, other: Known) -> Known:
        """The conjunction."""
        return Known(self.must & other.must, self.may & other.may)

    def any(self, other: Known) -> Known:
        """The disjunction."""
        return Known(self.must | other.must, self.may | other.may)


def known_where(
    condition: Condition, columns: Any, rows: int, labels: Mapping[str, Known]
) -> Known:
    """Where a condition holds, of which some labels may not be known.

    :param columns: see :meth:`~gspn_framework_package.model.condition.Condition.holds_in_columns`.
    """

    def known(value: Any) -> Known:
        if isinstance(value, Known):
            return value
        return Known(*2 * (np.broadcast_to(np.asarray(value, dtype=bool), (rows,)),))

    functions: Dict[str, Callable[..., Any]] = {
        **vector_functions(),
        "not": lambda a: known(a).opposite(),
        "and": lambda a, b: known(a).both(known(b)),
        "or": lambda a, b: known(a).any(known(b)),
    }
    with np.errstate(all="ignore"):
        return known(run_program(condition.program, columns, labels, functions))


class StateSets:
    """The states of a space in which formulas hold."""

    def __init__(self, space: StateSpace) -> None:
        self._space = space
        self._sources, self._targets = space.sources, space.targets
        self._unexplored = np.arange(len(space)) >= space.explored

    def holding(self, formula: StateFormula) -> Known:
        """The states in which a formula holds."""
        condition = formula.on(self._space.net.place_index)
        if not condition.labels:
            found = self._space.holds(condition)
            return Known(found, found)
        labels: Dict[str, Known] = {
            name: self.branching(part) for name, part in formula.parts.items()
        }
        if "deadlock" in condition.labels:
            dead = self._space.is_dead
            labels["deadlock"] = Known(dead, dead | self._unexplored)
        return known_where(condition, Columns(self._space.store), len(self._space), labels)

    def branching(self, formula: Branching) -> Known:
        """The states from which some path, or every path, satisfies the formula."""
        path = formula.path
        goal = self.holding(path.goal)
        everywhere = Known(*2 * (np.ones(len(self._space), dtype=bool),))
        stay = everywhere if path.stay is None else self.holding(path.stay)
        if not formula.every:
            return self._always(goal) if path.operator == "G" else self._until(stay, goal)
        if path.operator == "G":
            return self._until(everywhere, goal.opposite()).opposite()
        # a path does not have the property if it never reaches the goal, or leaves ``stay`` before
        missed, left = goal.opposite(), goal.opposite().both(stay.opposite())
        return self._always(missed).any(self._until(missed, left)).opposite()

    def _until(self, stay: Known, goal: Known) -> Known:
        """Some path stays until it reaches the goal."""
        may_go_on = goal.may | (self._unexplored & stay.may)
        return Known(self._back(stay.must, goal.must), self._back(stay.may, may_go_on))

    def _always(self, stay: Known) -> Known:
        """Some path stays for ever."""
        ends = self._space.is_dead
        return Known(
            self._for_ever(stay.must, ends), self._for_ever(stay.may, ends | self._unexplored)
        )

    def _for_ever(self, stay: Booleans, ends: Booleans) -> Booleans:
        """The states from which a path within ``stay`` reaches a cycle or one of ``ends``."""
        within = stay[self._sources] & stay[self._targets]
        sources, targets = self._sources[within], self._targets[within]
        around = on_a_cycle(len(self._space), sources, targets)
        return self._back(stay, stay & (around | ends))

    def _back(self, stay: Booleans, goal: Booleans) -> Booleans:
        """The states from which a path within ``stay`` reaches ``goal``."""
        arcs = stay[self._sources]
        return can_reach(len(self._space), self._sources[arcs], self._targets[arcs], goal)

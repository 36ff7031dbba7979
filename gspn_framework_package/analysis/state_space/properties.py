"""Qualitative properties of a bounded net, read off its complete state space (thesis 2.4).

>>> from gspn_framework_package.model.builder import NetBuilder
>>> from gspn_framework_package.analysis.state_space.space import explore
>>> net = (NetBuilder().place("a", tokens=1).place("b").place("end")
...        .exponential("go", inputs="a", outputs="b").exponential("back", inputs="b", outputs="a")
...        .exponential("leave", inputs="b", outputs="end").build())
>>> properties = Properties(explore(net))
>>> properties.deadlocks, properties.reversible, properties.bounds["a"]
([2], False, 1)
>>> properties.liveness["go"].name, properties.liveness["leave"].name
('L3', 'L1')
"""

from __future__ import annotations

import enum
import itertools
from functools import cached_property, lru_cache
from typing import Dict, List, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Indices
from gspn_framework_package.analysis.graph import Components, can_reach, components
from gspn_framework_package.analysis.state_space.space import StateSpace, WitnessStep
from gspn_framework_package.analysis.watch import Watch


class Liveness(enum.IntEnum):
    """Levels of liveness of a transition (Murata 1989). In a bounded net L2 (it can fire any number
    of times) and L3 (it can fire infinitely often) are the same; L3 is reported."""

    L0 = 0
    """Dead: it can never fire."""
    L1 = 1
    """It can fire at least once."""
    L2 = 2
    """For every number there is a firing sequence with that many firings of it."""
    L3 = 3
    """There is an infinite firing sequence with infinitely many firings of it."""
    L4 = 4
    """Live: from every reachable marking, it can still fire."""


class Properties:
    """Properties of a state space.

    :param space: a complete state space.
    :raises LimitError: the space is not complete.
    """

    def __init__(self, space: StateSpace) -> None:
        space.require_complete("its properties")
        self.space = space

    @property
    def bounds(self) -> Dict[str, int]:
        """The largest number of tokens that each place can hold."""
        return {
            place.name: most
            for place, most in zip(self.space.net.places, self.space.store.largest())
        }

    @property
    def k_safe(self) -> int:
        """The smallest k such that the net is k-safe; a 1-safe net is called *safe*."""
        return max(self.bounds.values(), default=0)

    @property
    def deadlocks(self) -> List[int]:
        """Numbers of the states in which nothing is enabled."""
        return [int(s) for s in self.space.deadlocks]

    @property
    def components(self) -> Components:
        """The strongly connected components of the reachability graph."""
        return _components(self.space)

    @property
    def reversible(self) -> bool:
        """Whether the initial marking can be reached again from every reachable marking."""
        space = self.space
        if self.components.number == 1:
            return True
        return bool(can_reach(len(space), space.sources, space.targets, space.starts).all())

    @property
    def home_states(self) -> Indices:
        """Numbers of the home states: those that can be reached from every reachable marking."""
        found = self.components
        if int(found.bottom.sum()) != 1:
            return np.zeros(0, dtype=np.int64)
        return np.flatnonzero(found.bottom[found.of])

    @cached_property
    def liveness(self) -> Dict[str, Liveness]:
        """The liveness level of every transition."""
        space = self.space
        level, _, _ = self._levels(np.arange(len(space.net.transitions) + space.further_steps))
        return {t.name: Liveness(int(v)) for t, v in zip(space.net.transitions, level)}

    def _levels(self, of: Indices) -> Tuple[Indices, Indices, Indices]:
        """The level of each kind of transitions (``of``: the kind of each); and in pairs, the kinds
        and the final components in which they fire."""
        space, found = self.space, self.components
        kinds = int(of.max(initial=-1)) + 1
        level = np.zeros(kinds, dtype=np.int64)
        level[of[np.unique(space.transitions)]] = Liveness.L1
        sources = found.of[space.sources]
        inside = sources == found.of[space.targets]
        level[of[np.unique(space.transitions[inside])]] = Liveness.L3
        final = found.bottom[sources]
        pairs = np.unique(
            of[space.transitions[final]].astype(np.int64) * found.number + sources[final]
        )
        kind, component = pairs // found.number, pairs % found.number
        level[np.bincount(kind, minlength=kinds) == found.bottom.sum()] = Liveness.L4
        return level, kind, component

    @property
    def live(self) -> bool:
        """Whether every transition is live."""
        return all(level is Liveness.L4 for level in self.liveness.values())

    @property
    def dead_transitions(self) -> List[str]:
        """Transitions that can never fire."""
        return [name for name, level in self.liveness.items() if level is Liveness.L0]

    def way_to(self, states: Indices) -> Optional[List[WitnessStep]]:
        """A shortest firing sequence to one of ``states`` (a boolean array), or None if no state is
        set in it."""
        found = np.flatnonzero(states)
        return self.space.witness(int(found[0])) if len(found) else None

    def most_gained(self, gain: Indices, watch: Watch) -> int:
        """The most that a firing sequence gains in all.

        :param gain: what each transition gains, nothing if a cycle has it.
        """
        space, found = self.space, self.components
        sources, targets = found.of[space.sources], found.of[space.targets]
        across = sources != targets
        sources, targets, gains = sources[across], targets[across], gain[space.transitions][across]
        most = np.zeros(found.number, dtype=np.int64)
        # longest paths in an acyclic graph, in as many rounds as the longest has arcs
        for rounds in itertools.count():
            watch.step("rounds", rounds)
            better = most.copy()
            np.maximum.at(better, targets, most[sources] + gains)
            if (better == most).all():
                return int(most.max())
            most = better
        raise AssertionError("a longest path has an end")


@lru_cache(maxsize=4)
def _components(space: StateSpace) -> Components:
    return components(len(space), space.sources, space.targets)

"""Forbidden conditions: the markings from which a team can always avoid them, whatever else
happens.

Decided on the untimed markings, including losses: anything that takes time may end at any moment,
even while a robot is making a decision.
"""

from __future__ import annotations

from typing import List, Sequence

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans
from gspn_framework_package.analysis.decisions.building import Stages
from gspn_framework_package.analysis.decisions.decision_net import Stage
from gspn_framework_package.analysis.graph import ShortestWays, adjacency, flat_ranges
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.plan import Plan


class Safety:
    """The greatest set of states without bad ones that only the policy can leave.

    :param never: conditions that may never hold.
    :param waits: boolean array: the states in which robots may wait by choice.
    :raises RefusedError: the initial state is outside of it.

    :ivar safe: boolean array, one value per state of the decision net.
    """

    def __init__(self, plan: Plan, stages: Stages, never: Sequence[str], waits: Booleans) -> None:
        self._plan = plan
        self._stages = stages
        self._never = never
        bad = np.zeros(len(stages), dtype=bool)
        for condition in never:
            bad |= stages.space.holds(parse_condition(condition, stages.net.net.place_index))
        self._bad = bad
        self.safe = self._fixpoint(waits)
        if not self.safe[0]:
            self._refuse()

    def _fixpoint(self, waits: Booleans) -> Booleans:
        """The greatest safe set when robots may wait in the states ``waits``."""
        stages = self._stages
        count = len(stages)
        live = ~stages.over[stages.sources]
        decided = (stages.kinds == Stage.DECIDED) & live
        levels = stages.priorities[stages.labels]
        arcs = np.flatnonzero(decided)
        top = stages.highest(arcs, levels[arcs])
        decided &= levels == top[stages.sources]
        forced = live & (stages.kinds != Stage.DECIDED)
        sources, targets = stages.sources, stages.targets
        # a state with decisions in which waiting is not permitted needs a safe decision
        needs = np.zeros(count, dtype=bool)
        needs[sources[decided]] = True
        needs &= ~waits & (stages.stage == Stage.DECIDED)
        left = np.bincount(sources[decided], minlength=count)
        into_forced = adjacency(count, targets[forced], sources[forced])
        choices = np.flatnonzero(decided)
        order = np.argsort(targets[choices], kind="stable")
        choices = choices[order]
        begin = np.searchsorted(targets[choices], np.arange(count + 1))
        safe = np.ones(count, dtype=bool)
        frontier = np.flatnonzero(self._bad)
        safe[frontier] = False
        while len(frontier):
            before = [into_forced[frontier].indices]
            arcs = choices[flat_ranges(begin[frontier], begin[frontier + 1])]
            np.subtract.at(left, sources[arcs], 1)
            stuck = np.unique(sources[arcs])
            before.append(stuck[needs[stuck] & (left[stuck] == 0)])
            found = np.unique(np.concatenate(before))
            frontier = found[safe[found]]
            safe[frontier] = False
        return safe

    def _refuse(self) -> None:
        """Refuse the plan. :raises RefusedError: always, with a witness."""
        stages = self._stages
        what = " or ".join(self._never)
        live = ~stages.over[stages.sources]
        ways = ShortestWays(len(stages), stages.sources, stages.targets, live)
        bad = np.flatnonzero(self._bad & ways.reached)
        sequence: List[str] = []
        marking = "at the start"
        if len(bad):
            arcs = min((ways.way_to(int(s)) for s in bad[:1000]), key=len)
            sequence = [stages.net.labels[stages.labels[arc]] for arc in arcs]
            state = int(stages.targets[arcs[-1]]) if arcs else 0
            marking = "at %s" % self._named(state)
        saving = self._who_saves()
        hint = (
            "it could be avoided if robots may wait: --may-wait %s" % " --may-wait ".join(saving)
            if saving
            else "waiting would not avoid it either: change the plan, or the condition"
        )
        raise RefusedError(
            "'%s' cannot be avoided with certainty: it holds %s%s"
            % (what, marking, " after %s" % ", ".join(sequence) if sequence else ""),
            hint=hint,
        )

    def _who_saves(self) -> List[str]:
        """Decision places where permission to wait would suffice; empty if there are none."""
        stages = self._stages
        places = sorted({p for askers in stages.net.askers for p in askers})

        def waits(where: Sequence[int]) -> Booleans:
            allowed = np.ones(len(stages), dtype=bool)
            for t, askers in enumerate(stages.net.askers):
                if stages.net.steps[t] is Stage.DECIDED and not set(askers) & set(where):
                    allowed[stages.sources[stages.arcs_of(t)]] = False
            return allowed

        if not self._fixpoint(waits(places))[0]:
            return []
        needed = list(places)
        for p in places:
            fewer = [q for q in needed if q != p]
            if self._fixpoint(waits(fewer))[0]:
                needed = fewer
        return [self._plan.net.places[p].name for p in needed]

    def _named(self, state: int) -> str:
        stages = self._stages
        named = stages.space.named(state)
        return "(%s)" % ", ".join(
            "%s: %d" % (p, n) for p, n in named.items() if p in self._plan.net.place_index
        )

"""From the explored markings of a decision net to the automaton: which states are vanishing, their
rows, rates and probabilities. Everything is computed on whole arrays, since there may be millions
of states."""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from scipy.special import comb

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.decisions.automaton import CHANCE, WAIT, Automaton
from gspn_framework_package.analysis.decisions.decision_net import (
    DecisionNet,
    Group,
    GroupMember,
    Stage,
)
from gspn_framework_package.analysis.graph import flat_ranges
from gspn_framework_package.analysis.state_space.rated_graph import firing_rate, rate_or_weight
from gspn_framework_package.analysis.state_space.space import StateSpace
from gspn_framework_package.model.marking_function import MarkingFunction

OVER = 7
"""The stage of a state in which the run has ended."""

NO_TIME = int(Stage.TIMED)
"""States with a stage below this are vanishing."""


class Stages:
    """The states of a decision net by what happens in them.

    :param net: the decision net.
    :param space: its markings, explored untimed.
    :param over: boolean array: the run has ended.

    :ivar sources: the state that each arc leaves.
    :ivar kinds: the kind of each arc.
    :ivar stage: for each state the kind of its first steps; OVER if there are none any more.
    """

    def __init__(self, net: DecisionNet, space: StateSpace, over: Booleans) -> None:
        self.net = net
        self.space = space
        self.over = over
        self.sources = space.sources
        self.targets = space.targets
        self.labels = space.transitions
        self.kinds = np.array(net.steps, dtype=np.int8)[self.labels]
        self.stage = np.full(len(space), Stage.TIMED, dtype=np.int8)
        for step in (Stage.ARRIVED, Stage.ASKED, Stage.DECIDED, Stage.NAMED, Stage.SPONTANEOUS):
            self.stage[self.sources[self.kinds == step]] = step
        self.stage[over] = OVER
        self._order = np.argsort(self.labels, kind="stable")
        self._begin = np.searchsorted(
            self.labels[self._order], np.arange(len(net.steps) + 1), side="left"
        )
        self.priorities = np.array([t.priority for t in net.net.transitions], dtype=np.int64)

    def __len__(self) -> int:
        return len(self.space)

    def arcs_of(self, transition: int) -> Indices:
        """The arcs of a transition, ascending."""
        return self._order[self._begin[transition] : self._begin[transition + 1]]

    def has(self, arcs: Indices) -> Booleans:
        """Boolean array: the states that one of ``arcs`` leaves."""
        found = np.zeros(len(self), dtype=bool)
        found[self.sources[arcs]] = True
        return found

    def highest(self, arcs: Indices, levels: Indices) -> Indices:
        """For each state the highest of the ``levels`` of its ``arcs``; -1 if it has none."""
        found = np.full(len(self), -1, dtype=np.int64)
        for level in np.unique(levels).tolist():
            found[self.sources[arcs[levels == level]]] = level
        return found

    def rates(self) -> Floats:
        """The rate of each arc that takes time; 0 for all others."""
        rates = np.zeros(len(self.labels), dtype=np.float64)
        net = self.net.net
        for t, step in enumerate(self.net.steps):
            if step is not Stage.TIMED:
                continue
            arcs = self.arcs_of(t)
            rates[arcs] = firing_rate(net, t, self.space.store, self.sources[arcs])
        return rates

    def spontaneous(self) -> Floats:
        """The probability of each arc in the spontaneous stage: top priority, by weight."""
        chances = np.zeros(len(self.labels), dtype=np.float64)
        arcs = np.flatnonzero(self.kinds == Stage.SPONTANEOUS)
        if not len(arcs):
            return chances
        levels = self.priorities[self.labels[arcs]]
        arcs = arcs[levels == self.highest(arcs, levels)[self.sources[arcs]]]
        weights = self.weights(arcs)
        total = np.bincount(self.sources[arcs], weights=weights, minlength=len(self))
        # without weights the first in file order fires
        states, first = np.unique(self.sources[arcs], return_index=True)
        plain = first[total[states] == 0]
        weights[plain] = 1.0
        total[self.sources[arcs[plain]]] = 1.0
        chances[arcs] = weights / total[self.sources[arcs]]
        return chances

    def by_chance(self, step: Stage) -> Floats:
        """The probability of each arc of a kind that chance decides: each robot that asks is
        equally likely to go first, of those that ask for the highest priority."""
        found: List[Tuple[Indices, Floats]] = []
        for group in self.net.groups:
            if group.step is step:
                arcs, chances = self.draws(group)
                found.append((arcs, chances * self.space.column(group.place, self.sources[arcs])))
        shares = np.zeros(len(self.labels), dtype=np.float64)
        if not found:
            return shares
        arcs = np.concatenate([a for a, _ in found])
        levels = self.priorities[self.labels[arcs]]
        highest = self.highest(arcs, levels)
        total = np.zeros(len(self), dtype=np.float64)
        for mine, values in found:
            level = self.priorities[self.labels[mine]]
            top = level == highest[self.sources[mine]]
            shares[mine[top]] += values[top]
            total += np.bincount(self.sources[mine[top]], weights=values[top], minlength=len(self))
        shares[arcs] /= np.where(total > 0, total, 1.0)[self.sources[arcs]]
        return shares

    def draws(self, group: Group) -> Tuple[Indices, Floats]:
        """The arcs that a robot of a group may ask for, by the weights, with probabilities."""
        arcs, shares = self.ways([group])
        if len(group.members) == 1:
            return arcs, np.ones(len(arcs))
        weights = shares * np.concatenate([self._weights_of(member) for member in group.members])
        levels = self.priorities[self.labels[arcs]]
        top = levels == self.highest(arcs, levels)[self.sources[arcs]]
        arcs, weights = arcs[top], weights[top]
        total = np.bincount(self.sources[arcs], weights=weights, minlength=len(self))
        return arcs, weights / total[self.sources[arcs]]

    def _weights_of(self, member: GroupMember) -> Floats:
        """The weight of each arc of a member."""
        arcs = self.arcs_of(member.transition)
        if isinstance(member.weight, MarkingFunction):
            return self.weights(arcs)
        return np.full(len(arcs), member.weight)

    def weights(self, arcs: Indices) -> Floats:
        """The weight that the net gives the transition of each of ``arcs``."""
        weights = np.zeros(len(arcs))
        labels = self.labels[arcs]
        for t in np.unique(labels).tolist():
            mine = labels == t
            weights[mine] = rate_or_weight(
                self.net.net, t, self.space.store, self.sources[arcs[mine]]
            )
        return weights

    def ways(self, groups: Sequence[Group]) -> Tuple[Indices, Floats]:
        """The arcs that a robot of these groups, which are in the same place, may ask for. Those of
        one state and one transition of the plan differ in who moves with it: the probability of
        each."""
        members = [member for group in groups for member in group.members]
        parts = [self.arcs_of(member.transition) for member in members]
        arcs = np.concatenate(parts)
        if not any(member.partners for member in members):
            return arcs, np.ones(len(arcs))
        counts = []
        for member, mine in zip(members, parts):
            states = self.sources[mine]
            count = np.ones(len(mine))
            for place, here, taken in member.partners:
                free = self.space.column(place, states).astype(np.int64) - here
                count *= comb(free, taken)
            counts.append(count)
        values = np.concatenate(counts)
        origins = np.array(self.net.origins)[self.labels[arcs]]
        keys = self.sources[arcs].astype(np.int64) * (int(origins.max(initial=0)) + 1) + origins
        _, of = np.unique(keys, return_inverse=True)
        of = of.reshape(-1)
        return arcs, values / np.bincount(of, weights=values)[of]


class Pieces:
    """Rows of an automaton under construction, in any order."""

    def __init__(self) -> None:
        self._rows: List[Tuple[Indices, int, Indices, Booleans]] = []
        self._arcs: List[Tuple[Indices, Indices, Floats, Indices, Indices]] = []
        self.rows = 0

    def add_rows(self, states: Indices, order: int, choices: Indices, allowed: Booleans) -> Indices:
        """Add a row for each of ``states``; rows of one state are sorted by ``order``, then by
        their choice. Returns their numbers."""
        self._rows.append((states, order, choices, allowed))
        first = self.rows
        self.rows += len(states)
        return np.arange(first, self.rows, dtype=np.int64)

    def add_arcs(
        self,
        rows: Indices,
        targets: Indices,
        values: Floats,
        fired: Indices,
        rated: Optional[Indices] = None,
    ) -> None:
        """Add arcs to rows with these numbers. ``rated`` are the transitions whose rates theirs are
        proportional to."""
        nothing = np.full(len(rows), -1, dtype=np.int32)
        self._arcs.append((rows, targets, values, fired, nothing if rated is None else rated))

    def built(
        self, states: int, tangible: Booleans, initial: Sequence[Tuple[int, float]]
    ) -> Tuple[Automaton, Booleans, Indices, Indices]:
        """The automaton, which rows are allowed, the new number of each row, and the transition
        whose rate that of each arc is proportional to."""
        of = np.concatenate([r[0] for r in self._rows]).astype(np.int64)
        order = np.repeat([r[1] for r in self._rows], [len(r[0]) for r in self._rows])
        choices = np.concatenate([r[2] for r in self._rows]).astype(np.int32)
        allowed = np.concatenate([r[3] for r in self._rows])
        sorting = np.lexsort((choices, order, of))
        number = np.empty(self.rows, dtype=np.int64)
        number[sorting] = np.arange(self.rows)
        rows = number[np.concatenate([a[0] for a in self._arcs])]
        targets = np.concatenate([a[1] for a in self._arcs]).astype(np.int32)
        values = np.concatenate([a[2] for a in self._arcs])
        fired = np.concatenate([a[3] for a in self._arcs]).astype(np.int32)
        rated = np.concatenate([a[4] for a in self._arcs]).astype(np.int32)
        by_row = np.argsort(rows, kind="stable")
        automaton = Automaton(
            tangible,
            _offsets(of, states),
            _offsets(rows, self.rows),
            targets[by_row],
            values[by_row],
            fired[by_row],
            choices[sorting],
            tuple(initial),
        )
        return automaton, allowed[sorting], number, rated[by_row]


def part_of(
    automaton: Automaton, states: Booleans, initial: Sequence[Tuple[int, float]]
) -> Tuple[Automaton, Indices, Indices]:
    """The automaton of some states, which no arc leaves; with the numbers of these states and of
    their rows.

    :param initial: in the numbers of ``automaton``.
    """
    kept = np.flatnonzero(states)
    number = np.cumsum(states) - 1
    rows = flat_ranges(automaton.rows[kept], automaton.rows[kept + 1])
    arcs = flat_ranges(automaton.arcs[rows], automaton.arcs[rows + 1])
    counts = np.diff(automaton.rows)[kept]
    part = Automaton(
        automaton.tangible[kept],
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        np.concatenate([[0], np.cumsum(np.diff(automaton.arcs)[rows])]).astype(np.int64),
        number[automaton.targets[arcs]].astype(np.int32),
        automaton.values[arcs],
        automaton.fired[arcs],
        automaton.choices[rows],
        tuple((int(number[s]), v) for s, v in initial),
    )
    return part, kept, rows


def _offsets(numbers: Indices, count: int) -> Indices:
    return np.concatenate([[0], np.cumsum(np.bincount(numbers, minlength=count))]).astype(np.int64)


class Built(NamedTuple):
    """The automaton of all states of a decision net.

    :ivar automaton: its states are those of the net; after them the tangible twins of states in
      which robots may wait.
    :ivar allowed: boolean array: the rows that a policy may choose; others are there because the
      present policy may take them.
    :ivar original: for each state the state of the net that it is, or is the twin of.
    :ivar arc_row: for each arc of the net the row that fires it alone; -1: none.
    :ivar wait_row: for each state of the net its row of waiting; -1: none.
    :ivar chance_row: for each state of the net the row that chance decides; -1: none.
    :ivar rated: for each arc of the automaton the number (plan's net) of the transition whose rate
      its own is proportional to; -1: none.
    """

    automaton: Automaton
    allowed: Booleans
    original: Indices
    arc_row: Indices
    wait_row: Indices
    chance_row: Indices
    rated: Indices


# In one piece: the rows of all kinds are numbered one after the other
def build_automaton(stages: Stages, may_wait: Booleans, waits: Booleans) -> Built:
    """Build the automaton of all states.

    :param may_wait: boolean array: the states in which robots may wait by choice.
    :param waits: boolean array: those in which they may wait under the present policy.
    """
    net, space, stage = stages.net, stages.space, stages.stage
    sources, targets, kinds = stages.sources, stages.targets, stages.kinds
    origins = np.array(net.origins, dtype=np.int32)[stages.labels]
    rated_of = np.array(net.rated, dtype=np.int32)[stages.labels]
    count = len(space)
    pieces = Pieces()
    everything = np.arange(count, dtype=np.int64)
    single = everything[stage != Stage.DECIDED]
    row_of = np.full(count, -1, dtype=np.int64)
    row_of[single] = pieces.add_rows(
        single, 0, np.full(len(single), CHANCE), np.ones(len(single), dtype=bool)
    )
    rates = stages.rates()
    asked, arrived = stages.by_chance(Stage.ASKED), stages.by_chance(Stage.ARRIVED)
    for step, values in (
        (Stage.SPONTANEOUS, stages.spontaneous()),
        (Stage.NAMED, stages.by_chance(Stage.NAMED)),
        (Stage.ASKED, asked),
        (Stage.ARRIVED, arrived),
        (Stage.TIMED, rates),
    ):
        arcs = np.flatnonzero((kinds == step) & (stage[sources] == step) & (values > 0))
        pieces.add_arcs(
            row_of[sources[arcs]], targets[arcs], values[arcs], origins[arcs], rated_of[arcs]
        )

    # one row for each transition that a robot may ask for
    decided = np.flatnonzero((kinds == Stage.DECIDED) & (stage[sources] == Stage.DECIDED))
    levels = stages.priorities[stages.labels[decided]]
    top = levels == stages.highest(decided, levels)[sources[decided]]
    apart = _distinguished(stages)
    mixed = np.flatnonzero(((kinds == Stage.NAMED) | (kinds == Stage.DECIDED)) & apart[sources])
    arc_row = np.full(len(kinds), -1, dtype=np.int64)
    for arcs, allowed in ((decided, top), (mixed, np.zeros(len(mixed), dtype=bool))):
        rows = pieces.add_rows(sources[arcs], 1, origins[arcs], allowed)
        arc_row[arcs] = rows
        pieces.add_arcs(rows, targets[arcs], np.ones(len(arcs)), origins[arcs])

    # waiting
    waiting = np.flatnonzero(
        (may_wait & (stage == Stage.DECIDED)) | (waits & ((stage == Stage.DECIDED) | apart))
    )
    wait_row = np.full(count, -1, dtype=np.int64)
    wait_row[waiting] = pieces.add_rows(
        waiting, 2, np.full(len(waiting), WAIT), (may_wait & (stage == Stage.DECIDED))[waiting]
    )
    left = np.zeros(count, dtype=bool)
    left[waiting] = True
    for step, values in ((Stage.ASKED, asked), (Stage.ARRIVED, arrived)):
        arcs = np.flatnonzero((kinds == step) & left[sources] & (values > 0))
        pieces.add_arcs(wait_row[sources[arcs]], targets[arcs], values[arcs], origins[arcs])
        left[sources[arcs]] = False
    twins = np.flatnonzero(left)
    twin_of = np.full(count, -1, dtype=np.int64)
    twin_of[twins] = count + np.arange(len(twins))
    nothing = np.full(len(twins), -1, dtype=np.int32)
    pieces.add_arcs(wait_row[twins], twin_of[twins], np.ones(len(twins)), nothing)
    twin_row = np.full(count, -1, dtype=np.int64)
    twin_row[twins] = pieces.add_rows(
        twin_of[twins], 0, np.full(len(twins), CHANCE), np.ones(len(twins), dtype=bool)
    )
    arcs = np.flatnonzero((kinds == Stage.TIMED) & left[sources])
    pieces.add_arcs(
        twin_row[sources[arcs]], targets[arcs], rates[arcs], origins[arcs], rated_of[arcs]
    )

    tangible = np.ones(count + len(twins), dtype=bool)
    tangible[:count] = stage >= NO_TIME
    automaton, allowed, number, rated = pieces.built(count + len(twins), tangible, ((0, 1.0),))
    return Built(
        automaton,
        allowed,
        np.concatenate([everything, twins]),
        _renumbered(number, arc_row),
        _renumbered(number, wait_row),
        _renumbered(number, np.where(stage == Stage.NAMED, row_of, -1)),
        rated,
    )


def _distinguished(stages: Stages) -> Booleans:
    """The states in which chance decides but the present policy may do otherwise: robots that are
    left to the weights, or to the policy, are among those that move or choose who moves."""
    found = stages.has(np.flatnonzero(stages.kinds == Stage.DECIDED))
    for group in stages.net.groups:
        for member in group.members:
            if member.partners or (group.step is Stage.NAMED and not group.named):
                found[stages.sources[stages.arcs_of(member.transition)]] = True
    return found & (stages.stage == Stage.NAMED)


def _renumbered(number: Indices, rows: Indices) -> Indices:
    return np.where(rows >= 0, number[np.maximum(rows, 0)], -1)

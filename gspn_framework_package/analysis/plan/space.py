"""The state space of a plan under its policy: which markings it reaches, by which firings, at which
rates and with which probabilities."""

from __future__ import annotations

import math
import time
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.plan.reading import NET, TimingNotes, net_notes, run_notes
from gspn_framework_package.analysis.state_space.exploration import (
    Allowance,
    RawGraph,
    label_type,
)
from gspn_framework_package.analysis.state_space.marking_store import PackedStore
from gspn_framework_package.analysis.state_space.packing import Packing
from gspn_framework_package.analysis.state_space.rated_graph import RatedGraph
from gspn_framework_package.analysis.state_space.space import StateSpace
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming
from gspn_framework_package.run_net.compiling import (
    compile_plan,
    no_time_if_tiny,
    one_phase_each,
)
from gspn_framework_package.run_net.run_net import State
from gspn_framework_package.run_net.size import PhasesOfDurations
from gspn_framework_package.run_net.steps import Steps

PLAN_STATE_LIMIT = 200_000
"""Default limit on the states of a plan's exploration."""

_STATE_BYTES, _ARC_BYTES = 400, 100
"""Memory of a state during the exploration, besides its counts, and of an arc."""

WAITS_LABEL = "(waits)"
"""Entry of a firing sequence at which robots wait, having drawn transitions that are not
enabled."""

GOES_ON = "(goes on)"
"""Name of a step in which nothing fires: a phase of an action ends, or the action is done."""


class PlanSpace(StateSpace):
    """The markings that a plan reaches under its policy, and the firings between them; made by
    :func:`explore_plan`. Where it follows the run, several states may have one marking.

    :ivar counters: the omitted places, which are only written.
    :ivar notes: how time was read, and what was assumed.
    :ivar refusal: why there is no Markov chain although all markings are known; empty if there is
      one.
    :ivar most: the largest number of tokens in each place.
    :ivar where_most: if it is not complete, the place that makes it large, in words for people.
    :ivar fewer_phases: place -> fewer phases of each duration there, where durations are not
      represented exactly; empty if all are.
    :ivar replaced: by what those are replaced: sentences for people.
    """

    def __init__(
        self,
        net: Net,
        counters: Tuple[str, ...],
        graph: RawGraph,
        markings: Indices,
        vanishing: Booleans,
        values: Floats,
        *,
        notes: TimingNotes,
        shortage: Tuple[str, str] = ("", ""),
        parts: Tuple[str, ...] = (),
        part_counts: Optional[Indices] = None,
    ) -> None:
        self.most: List[int] = markings.max(axis=0).tolist()
        widths = [max(n.bit_length(), 1) for n in self.most]
        packing = Packing(net, widths)
        order = np.arange(len(net.transitions) + self.further_steps)
        store = PackedStore(packing, packing.pack_all(markings))
        super().__init__(net, store, graph, order, untimed=False, engine="plan", shortage=shortage)
        self.counters = counters
        self.notes = notes
        self.refusal = ""
        self.where_most = ""
        self.fewer_phases: Mapping[str, float] = {}
        self.replaced: List[str] = []
        self._parts, self._part_counts = parts, part_counts
        self._vanishing = vanishing
        self._values = values

    @property
    def is_vanishing(self) -> Booleans:
        """Boolean array: the robots move on in zero time."""
        return self._vanishing

    @property
    def hint(self) -> str:
        """A phrase for messages: what to do if the space is not complete, and what is large."""
        where = "; " + self.where_most if self.where_most else ""
        return super().hint + where

    def transition_name(self, transition: int) -> str:
        """The name of a transition, WAITS_LABEL or GOES_ON."""
        nothing = transition - len(self.net.transitions)
        return (
            (WAITS_LABEL, GOES_ON)[nothing] if nothing >= 0 else super().transition_name(transition)
        )

    def _way_to(self, state: int) -> List[Tuple[int, int]]:
        ends = len(self.net.transitions) + 1
        return [(t, s) for t, s in super()._way_to(state) if t != ends]

    further_steps = 2  # WAITS_LABEL and GOES_ON

    @property
    def starts(self) -> Booleans:
        """Boolean array: the states with the initial marking."""
        if self.notes.reading == NET:
            return super().starts
        found = np.zeros(len(self), dtype=bool)
        found[self.store.find(self.net.initial_marking)] = True
        return found

    def distinct(self, states: Indices) -> Indices:
        """The first of each of the markings of ``states`` (numbers, ascending)."""
        if self.notes.reading == NET or not len(states):
            return states
        _, first = np.unique(self.markings(states), axis=0, return_index=True)
        return states[np.sort(first)]

    @property
    def deadlocks(self) -> Indices:
        """Numbers of the states that nothing leaves, one for each marking."""
        return self.distinct(super().deadlocks)

    def rated(self) -> RatedGraph:
        """The graph with rates and probabilities.

        :raises LimitError: it is not complete, or the durations would need too many states.
        """
        self.require_complete("its Markov chain")
        if self.refusal:
            raise LimitError(
                self.refusal,
                element="its Markov chain",
                hint="gspn simulate follows the durations themselves",
            )
        return RatedGraph(
            self.net,
            self._vanishing,
            self.sources,
            self.targets,
            self.transitions,
            self._values,
            self.store,
            self._parts,
            self._part_counts,
        )


def replaced_durations(space: StateSpace) -> List[str]:
    """Sentences for people on what replaces the durations that are not represented exactly."""
    return space.replaced if isinstance(space, PlanSpace) else []


ChoosePhases = Callable[[PlanSpace, PhasesOfDurations, Sequence[State]], Mapping[str, float]]
"""Chooses place -> the most phases of each duration there. It is given the states with one phase
for each duration."""


def explore_plan(
    plan: Plan,
    *,
    timing: Optional[PlanTiming] = None,
    phases: Optional[ChoosePhases] = None,
    limit: int = PLAN_STATE_LIMIT,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    memory: float = math.inf,
    seconds: float = math.inf,
) -> PlanSpace:
    """Find the markings that a plan reaches under its policy.

    :param plan: a validated plan.
    :param timing: its durations, to follow the run; None: the classical reading of its net.
    :param phases: chooses how many phases durations have; None: as many as they need, at most
        :data:`~gspn_framework_package.run_net.phases.MOST_PHASES`.
    :param limit: stop soon after this many states are known; the result is then not ``complete``.
    :param progress: receives the number of states at intervals.
    :param cancel: called at intervals; returns whether to stop.
    :param memory: stop when the exploration takes more than this many bytes.
    :param seconds: stop after this time (s).
    :raises CancelledError: ``cancel`` returned true.
    """
    room = Allowance(memory, time.monotonic() + seconds)
    work = _Exploration(limit, Watch(progress, cancel), room, seconds)
    untimed = {}
    if timing is not None and phases is not None:
        untimed = no_time_if_tiny(plan, timing)
    run_net = compile_plan(plan, timing, phases={**one_phase_each(plan), **untimed})
    if timing is None:
        return work.explore(Steps(run_net), net_notes(plan))
    notes = run_notes(plan, timing, dict(run_net.splits), list(run_net.assumptions))
    space = work.explore(Steps(run_net), notes)
    if timing.differing:
        space.refusal = "not decided: " + timing.differing
        return space
    many = PhasesOfDurations(run_net)
    if not space.complete:
        space.where_most = many.where_most(space.most)
        return space
    if many.most <= 1:
        return space
    # With one phase for each duration, the same markings are reached. How many states there would
    # be with all phases is known before they are visited.
    most = {**phases(space, many, work.states), **untimed} if phases is not None else {}
    needed = many.states(work.states, most)
    if needed > limit:
        space.refusal = "not decided: %s" % many.why_so_many(needed, limit)
        notes.assumptions.append(
            "for all answers that need no rates, every duration is taken as exponential"
        )
        return space
    replaced = many.matches(most)
    notes.assumptions.extend(replaced)
    found = work.explore(Steps(compile_plan(plan, timing, phases=most)), notes)
    found.fewer_phases, found.replaced = many.fewer(most), replaced
    return found


class _Exploration:
    """Visits states, breadth-first.

    :ivar states: those of the last exploration.
    """

    def __init__(self, limit: int, watch: Watch, room: Allowance, seconds: float) -> None:
        self._limit, self._watch, self._room, self._seconds = limit, watch, room, seconds
        self.states: List[State] = []

    def explore(self, steps: Steps, notes: TimingNotes) -> PlanSpace:
        """Explore the states of a run net."""
        run_net = steps.run_net
        shortage = ("--limit", "")
        index: Dict[State, int] = {steps.start: 0}
        self.states = order = [steps.start]
        vanishing: List[bool] = []
        offsets = [0]
        targets: List[int] = []
        labels: List[int] = []
        values: List[float] = []
        bytes_per_state = 24 * run_net.width + _STATE_BYTES
        explored = 0
        while explored < len(order) <= self._limit:
            at_once, found = steps.expand(order[explored])
            vanishing.append(at_once)
            for target, label, value in found:
                number = index.get(target)
                if number is None:
                    number = index[target] = len(order)
                    order.append(target)
                targets.append(number)
                labels.append(label)
                values.append(value)
            explored += 1
            offsets.append(len(targets))
            if explored % 256 == 0:
                self._watch.step("states", len(order))
                if not self._room.left(len(order) * bytes_per_state + len(targets) * _ARC_BYTES):
                    shortage = ("--limit-memory", "%.3g GB" % (self._room.memory / 1e9))
                    if not self._room.left(0):
                        shortage = ("--limit-time", "%g s" % self._seconds)
                    break
        vanishing += [False] * (len(order) - explored)
        offsets += [len(targets)] * (len(order) - explored)
        graph = RawGraph(
            None,
            np.array(offsets, dtype=np.int64),
            np.array(targets, dtype=np.int32),
            np.array(labels, dtype=label_type(steps.ends + 1)),
            explored,
        )
        named = run_net.named_columns
        part_counts = None
        if named:
            part_counts = steps.counts(order, [column for column, _ in named])
            part_counts = part_counts.astype(np.min_scalar_type(part_counts.max()))
        return PlanSpace(
            run_net.net,
            run_net.counters,
            graph,
            steps.markings(order),
            np.array(vanishing, dtype=bool),
            np.array(values, dtype=np.float64),
            notes=notes,
            shortage=shortage,
            parts=tuple(name for _, name in named),
            part_counts=part_counts,
        )

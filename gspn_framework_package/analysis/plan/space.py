"""The state space of a plan under its policy: which markings it reaches, by which firings, at which
rates and with which probabilities."""

from __future__ import annotations

import math
import time
from typing import Dict, List, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.plan.rules import PlanRules
from gspn_framework_package.analysis.state_space.exploration import (
    Allowance,
    Growing,
    RawGraph,
    label_type,
)
from gspn_framework_package.analysis.state_space.marking_store import PackedStore
from gspn_framework_package.analysis.state_space.packing import Packing
from gspn_framework_package.analysis.state_space.rated_graph import RatedGraph
from gspn_framework_package.analysis.state_space.space import StateSpace
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.net import Marking
from gspn_framework_package.model.plan import Plan

PLAN_STATE_LIMIT = 200_000
"""Default limit on the states of a plan's exploration."""

_STATE_BYTES, _ARC_BYTES = 400, 100
"""Memory of a state during the exploration, besides its counts, and of an arc."""

WAITING = "(waits)"
"""Entry of a firing sequence at which robots wait, having drawn transitions that are not
enabled."""


class PlanSpace(StateSpace):
    """The markings that a plan reaches under its policy, and the firings between them; made by
    :func:`explore_plan`.

    :ivar counters: the omitted places, which are only written.
    """

    def __init__(
        self,
        rules: PlanRules,
        graph: RawGraph,
        markings: Indices,
        vanishing: Booleans,
        values: Floats,
        shortage: Tuple[str, str] = ("", ""),
    ) -> None:
        widths = [max(int(n).bit_length(), 1) for n in markings.max(axis=0)]
        packing = Packing(rules.net, widths)
        order = np.arange(len(rules.net.transitions) + 1)  # the last one: the robots wait
        store = PackedStore(packing, packing.pack_all(markings))
        super().__init__(
            rules.net, store, graph, order, untimed=False, engine="plan", shortage=shortage
        )
        self.counters = rules.counters
        self._vanishing = vanishing
        self._values = values

    @property
    def is_vanishing(self) -> Booleans:
        """Boolean array: the robots move on in zero time."""
        return self._vanishing

    def transition_name(self, transition: int) -> str:
        """The name of a transition, or WAITING."""
        return (
            WAITING
            if transition == len(self.net.transitions)
            else super().transition_name(transition)
        )

    def rated(self) -> RatedGraph:
        """The graph with rates and probabilities.

        :raises LimitError: it is not complete.
        """
        self.require_complete("its Markov chain")
        return RatedGraph(
            self.net,
            self._vanishing,
            self.sources,
            self.targets,
            self.transitions,
            self._values,
            self.store,
        )


def explore_plan(
    plan: Plan,
    *,
    limit: int = PLAN_STATE_LIMIT,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    memory: float = math.inf,
    seconds: float = math.inf,
) -> PlanSpace:
    """Find the markings that a plan reaches under its policy.

    :param plan: a validated plan.
    :param limit: stop soon after this many states are known; the result is then not ``complete``.
    :param progress: receives the number of states at intervals.
    :param cancel: called at intervals; returns whether to stop.
    :param memory: stop when the exploration takes more than this many bytes.
    :param seconds: stop after this time (s).
    :raises CancelledError: ``cancel`` returned true.
    """
    room = Allowance(memory, time.monotonic() + seconds)
    shortage = ("--limit", "")
    rules = PlanRules(plan)
    net = rules.net
    watch = Watch(progress, cancel)
    wait = len(net.transitions)
    index: Dict[Tuple[Marking, bool], int] = {(net.initial_marking, False): 0}
    order: List[Tuple[Marking, bool]] = [(net.initial_marking, False)]
    vanishing: List[bool] = []
    offsets = Growing(np.int64)
    offsets.extend(np.zeros(1, dtype=np.int64))
    targets: List[int] = []
    labels: List[int] = []
    values: List[float] = []

    def add(marking: Marking, waiting: bool, label: int, value: float) -> None:
        key = marking, waiting
        number = index.get(key)
        if number is None:
            number = index[key] = len(order)
            order.append(key)
        targets.append(number)
        labels.append(label)
        values.append(value)

    explored = 0
    while explored < len(order) <= limit:
        marking, waiting = order[explored]
        over = rules.is_over(marking)
        outcomes = [] if waiting or over else rules.outcomes(marking)
        vanishing.append(bool(outcomes))
        for transition, probability in outcomes:
            if transition is None:
                add(marking, True, wait, probability)
            else:
                add(net.fire(marking, transition), False, transition, probability)
        if not outcomes and not over:
            for t, rate in rules.timed(marking):
                add(net.fire(marking, t), False, t, rate)
        explored += 1
        offsets.extend(np.array([len(targets)]))
        if explored % 256 == 0:
            watch.step("states", len(order))
            if not room.left(
                len(order) * (16 * len(net.places) + _STATE_BYTES) + len(targets) * _ARC_BYTES
            ):
                shortage = ("--limit-memory", "%.3g GB" % (memory / 1e9))
                if not room.left(0):
                    shortage = ("--limit-time", "%g s" % seconds)
                break
    vanishing += [False] * (len(order) - explored)
    offsets.extend(np.full(len(order) - explored, len(targets), dtype=np.int64))
    graph = RawGraph(
        None,
        offsets.finished(),
        np.array(targets, dtype=np.int32),
        np.array(labels, dtype=label_type(wait + 1)),
        explored,
    )
    markings = np.array([marking for marking, _ in order], dtype=np.int64).reshape(len(order), -1)
    return PlanSpace(
        rules,
        graph,
        markings,
        np.array(vanishing, dtype=bool),
        np.array(values, dtype=np.float64),
        shortage,
    )

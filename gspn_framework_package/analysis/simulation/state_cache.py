"""Runs of a run net, using a table of the states that occur.

Many independent replications advance in step: one round draws the next event of each of them. Each
state is evaluated once, when a replication first reaches it, so that a round takes only a few array
operations.
"""

from __future__ import annotations

import math
from typing import Dict, List, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Floats, Indices
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.run_net.run_net import RunNet, State
from gspn_framework_package.run_net.steps import Steps

REMEMBERED_STATES = 500_000
"""Largest number of states in the cache before it is cleared."""

TIMELESS_FIRINGS = 10_000
"""More consecutive firings in zero time than this are treated as a timeless cycle."""


class StateCache:
    """The states that the runs have reached so far, as arrays; they are numbered in order of
    discovery."""

    def __init__(self, run_net: RunNet) -> None:
        self.run_net = run_net
        self.net = run_net.net
        self.forget()

    def forget(self) -> None:
        """Clear all states."""
        self._steps = Steps(self.run_net)
        self._index: Dict[State, int] = {}
        self._states: List[State] = []
        self._targets: List[List[State]] = []
        capacity, width = 64, 4
        self.markings = np.zeros((capacity, len(self.net.places)), dtype=np.int64)
        self.exit = np.zeros(capacity)
        """Exit rate (1/s) of each state; infinite for vanishing states, 0 for absorbing ones."""
        self.over = np.zeros(capacity, dtype=bool)
        self.steps = np.full((capacity, width), 2.0)  # cumulative probabilities, padded with 2
        self.targets = np.full((capacity, width), -1, dtype=np.int64)
        self.transitions = np.full((capacity, width), -1, dtype=np.int64)

    def __len__(self) -> int:
        return len(self._states)

    @property
    def start(self) -> State:
        """The state in which runs begin."""
        return self._steps.start

    def state(self, number: int) -> State:
        """The state of a number."""
        return self._states[number]

    def number(self, state: State) -> int:
        """The number of a state; a new state is evaluated."""
        known = self._index.get(state)
        if known is not None:
            return known
        number = self._index[state] = len(self._states)
        self._states.append(state)
        if number == len(self.exit):
            self._grow()
        self._work_out(number, state)
        return number

    def target(self, number: int, arc: int) -> int:
        """The target of an arc, evaluated on first use."""
        if self.targets[number, arc] < 0:
            self.targets[number, arc] = self.number(self._targets[number][arc])
        return int(self.targets[number, arc])

    def _work_out(self, number: int, state: State) -> None:
        marking = self.run_net.marking(state or self.run_net.begin[0][0])
        self.markings[number] = marking
        self._targets.append([])
        if self.run_net.is_over(marking):
            self.over[number] = True
            return
        vanishing, steps = self._steps.expand(state)
        total = sum(step.value for step in steps)
        self.exit[number] = math.inf if vanishing else total
        while len(steps) > self.steps.shape[1]:
            self._widen()
        if steps:
            chances = np.cumsum([step.value for step in steps]) / total
            chances[-1] = 2.0  # rounding must not lead beyond the last one
            self.steps[number, : len(steps)] = chances
            self.transitions[number, : len(steps)] = [
                step.label if step.label < len(self.net.transitions) else -1 for step in steps
            ]
            self._targets[number] = [step.target for step in steps]

    def _grow(self) -> None:
        for name in ("markings", "exit", "over", "steps", "targets", "transitions"):
            array = getattr(self, name)
            fill = {"steps": 2.0, "targets": -1, "transitions": -1}.get(name, 0)
            more = np.full_like(array, fill)
            setattr(self, name, np.concatenate([array, more]))

    def _widen(self) -> None:
        for name, fill in (("steps", 2.0), ("targets", -1), ("transitions", -1)):
            array = getattr(self, name)
            setattr(self, name, np.concatenate([array, np.full_like(array, fill)], axis=1))


class TableRuns:
    """The state of all replications."""

    def __init__(
        self,
        graph: StateCache,
        count: int,
        time: float,
        warmup: float,
        random: np.random.Generator,
    ) -> None:
        net = graph.net
        self.graph = graph
        self.time, self.warmup = time, warmup
        self.count = count
        self._random = random
        self.clock = np.zeros(count)
        self.tokens = np.zeros((count, len(net.places)))  # tokens times seconds, after the warm-up
        self.firings = np.zeros((count, len(net.transitions)))  # after the warm-up
        self.over = np.zeros(count, dtype=bool)
        self.shares: List[Dict[int, float]] = [{} for _ in net.places]
        self.events = 0

    def go(self, watch: Watch) -> None:
        """Run all replications to the end."""
        graph = self.graph
        state = np.full(self.count, graph.number(graph.start))
        timeless = np.zeros(self.count, dtype=np.int64)
        active = np.arange(self.count)
        spent = np.zeros(len(graph.exit))  # seconds in each state, over all runs
        rounds = 0
        while len(active):
            if len(graph) > REMEMBERED_STATES:
                self._fold(spent)
                state, spent = self._forget(state, active), np.zeros(len(graph.exit))
            here = state[active]
            over = graph.over[here]
            if over.any():
                self.over[active[over]] = True
                active, here = active[~over], here[~over]
                continue
            rates = graph.exit[here]
            with np.errstate(divide="ignore"):
                stay = self._random.standard_exponential(len(active)) / rates
            before = self.clock[active]
            after = np.minimum(before + stay, self.time)
            counted = np.maximum(after - np.maximum(before, self.warmup), 0.0)
            if np.isinf(after).any():
                raise RefusedError(
                    "a run stays in (%s) forever, which does not satisfy the end condition"
                    % ", ".join("%s: %d" % i for i in self._stuck(here[np.isinf(after)][0])),
                    hint="give a time as well",
                )
            if len(spent) < len(graph.exit):
                spent = np.concatenate([spent, np.zeros(len(graph.exit) - len(spent))])
            np.add.at(spent, here, counted)
            self.tokens[active] += counted[:, None] * graph.markings[here]
            self.clock[active] = after
            goes_on = before + stay <= self.time
            active, here = active[goes_on], here[goes_on]
            arcs = (graph.steps[here] <= self._random.random(len(here))[:, None]).sum(axis=1)
            fired = graph.transitions[here, arcs]
            late = (self.clock[active] >= self.warmup) & (fired >= 0)
            self.firings[active[late], fired[late]] += 1
            self.events += int((fired >= 0).sum())
            state[active] = self._follow(here, arcs)
            timeless[active] = np.where(np.isinf(graph.exit[here]), timeless[active] + 1, 0)
            if len(active) and timeless[active].max() > TIMELESS_FIRINGS:
                raise RefusedError(
                    "more than %d firings without time between them" % TIMELESS_FIRINGS,
                    hint="a cycle of immediate transitions must have an exit",
                )
            rounds += 1
            if rounds % 64 == 0:
                watch.step("events", self.events)
        self._fold(spent)

    def _follow(self, here: Indices, arcs: Indices) -> Indices:
        targets = self.graph.targets[here, arcs]
        for i in np.flatnonzero(targets < 0).tolist():
            targets[i] = self.graph.target(int(here[i]), int(arcs[i]))
        return targets

    def _stuck(self, state: int) -> List[Tuple[str, int]]:
        marking = tuple(self.graph.markings[int(state)].tolist())
        return list(self.graph.net.named(marking, zeros=False).items())

    def _fold(self, spent: Floats) -> None:
        """Add the time spent in states to the shares of token counts."""
        states = np.flatnonzero(spent)
        for p, share in enumerate(self.shares):
            counts = self.graph.markings[states, p]
            values, of = np.unique(counts, return_inverse=True)
            for count, seconds in zip(
                values.tolist(), np.bincount(of.reshape(-1), weights=spent[states]).tolist()
            ):
                share[count] = share.get(count, 0.0) + seconds

    def _forget(self, state: Indices, active: Indices) -> Indices:
        """Clear all states except the current ones; return their new numbers."""
        known = {int(s): self.graph.state(int(s)) for s in np.unique(state[active])}
        self.graph.forget()
        fresh = {old: self.graph.number(state) for old, state in known.items()}
        renumbered = np.zeros_like(state)
        renumbered[active] = [fresh[int(s)] for s in state[active]]
        return renumbered

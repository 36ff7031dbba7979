"""Runs of a plan evaluated by an aim: their reward, and whether they reach a condition."""

from __future__ import annotations

import math
import time as clock
from typing import List, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.decisions.aims import Objective
from gspn_framework_package.analysis.simulation import kernel, machine
from gspn_framework_package.analysis.simulation.plan_run import PlanRun
from gspn_framework_package.analysis.simulation.plan_tables import PlanTables
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.condition import either, parse_condition
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming

_COMPILED_EVENTS = 200_000
_PLAIN_EVENTS = 5_000
"""Events between two checks of the watch."""

_TO_LOAD = 4.0
"""Loading the compiled kernel takes a second or two."""

_TO_COMPILE = 60.0
"""Compiling it for the first time takes up to a minute."""


class AimedRun:
    """Runs of one plan as it is executed, one after the other.

    When a run ends, the marking stays the same: its places continue to earn reward.

    :param plan: a validated plan.
    :param objective: the reward of a run, and the condition to reach.
    :param watch: receives the progress.
    :param losses: rate (1/s) at which each robot is lost.
    :ivar tables: the plan as arrays.
    :ivar run: the run by the kernel.
    :ivar assumptions: the assumptions about the times of the plan.
    :ivar ended: the status of the kernel at the end of the current run; None until then.
    :ivar watch: receives the progress.
    :ivar deadline: the time of the machine (s, monotonic) at which a run is abandoned.
    """

    def __init__(self, plan: Plan, objective: Objective, watch: Watch, losses: float = 0.0) -> None:
        net = plan.net
        timing = PlanTiming(plan)
        self.assumptions = timing.assumptions
        until = either(plan.until, objective.goal)
        self.tables = PlanTables(plan, timing, until, losses)
        self.run = PlanRun(self.tables)
        self.ended: Optional[int] = None
        self.deadline = math.inf
        goal = objective.goal
        self._goal = None if goal is None else parse_condition(goal, net.place_index)
        self._places: List[Tuple[int, float]] = []
        self._transitions: List[Tuple[int, float]] = []
        for name, reward in objective.rewards.items():
            if name in net.place_index:
                self._places.append((net.place_index[name], reward))
            else:
                self._transitions.append((net.transition_index[name], reward))
        self.watch = watch
        self._before = 0

    def begin(self, seed: int, *numbers: int) -> None:
        """Begin a run; the same seed and numbers give the same run."""
        self._before += self.run.firings_so_far
        self.ended = None
        words = np.random.SeedSequence(seed % 2**64, spawn_key=numbers).generate_state(4, np.uint32)
        self.run.begin(words.tolist())

    def go(self, stop: float = math.inf, most: Optional[int] = None) -> None:
        """Continue until the clock reaches ``stop`` (s), the run ends, or ``most`` events have
        happened.

        :raises RefusedError: the plan cannot be played.
        :raises CancelledError: the work was cancelled.
        :raises LimitError: the deadline has passed.
        """
        while self.ended is None and self.now < stop:
            budget = _COMPILED_EVENTS if self.run.compiled else _PLAIN_EVENTS
            status = self.run.go(stop, budget if most is None else min(budget, most))
            self.watch.step("firings", self.firings)
            if status not in (kernel.MORE, kernel.AT_STOP):
                self.ended = status
            elif status == kernel.AT_STOP:
                break
            if most is not None:
                most -= budget
                if most <= 0:
                    break
            if clock.monotonic() > self.deadline:
                raise LimitError("a run is unfinished after %.6g s of simulated time" % self.now)

    @property
    def now(self) -> float:
        """The time of the run (s)."""
        return self.run.now

    @property
    def firings(self) -> int:
        """The number of firings in all runs so far."""
        return self._before + self.run.firings_so_far

    @property
    def reached(self) -> bool:
        """Whether the run ended with its condition."""
        return (
            self.ended == kernel.UNTIL
            and self._goal is not None
            and self._goal.holds(self.marking())
        )

    def marking(self) -> Tuple[int, ...]:
        """The present marking."""
        return self.run.marking

    def earned(self, at: float) -> float:
        """The reward of the run up to the time ``at`` (s), at which it stopped or before which it
        ended."""
        state = self.run.state
        whole = sum(reward * float(state.firings[t]) for t, reward in self._transitions)
        left = max(at - self.now, 0.0)
        for p, reward in self._places:
            whole += reward * (float(state.counts.area[p]) + left * float(state.counts.level[p]))
        return whole

    def compile(self) -> None:
        """Use the compiled kernel from here on."""
        if not self.run.compiled:
            self.run.compile()


def worth_compiling(seconds: float) -> bool:
    """Whether the compiled kernel pays off for this many seconds of simulation."""
    if not machine.numba_is_there():
        return False
    if machine.is_loaded():
        return True
    return seconds > _TO_COMPILE or (seconds > _TO_LOAD and machine.is_cached())

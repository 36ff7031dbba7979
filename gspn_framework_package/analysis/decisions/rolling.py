"""Rollouts: the tasks of an improvement by simulation. A rollout continues from a state of a run,
under another policy and under the present one, with the same random numbers."""

from __future__ import annotations

from typing import Any, Dict, List, NamedTuple, Sequence

import numpy as np

from gspn_framework_package.analysis.decisions.aims import Aim, Objective
from gspn_framework_package.analysis.simulation.aimed_run import AimedRun
from gspn_framework_package.analysis.simulation.pairs import discounted_reward
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Policy

_STRATA = 4


class Rolled(NamedTuple):
    """Shared by the rollouts of a round: the ``plan`` with its present policy, the aim, the time
    (s) that a rollout lasts, the seed, and whether the compiled kernel is worthwhile."""

    plan: Plan
    objective: Objective
    horizon: float
    seed: int
    compiled: bool


class Rollouts(NamedTuple):
    """A number of rollouts of the ``candidate`` with that number in its round, from ``states`` in
    turn; the first has number ``begin``."""

    candidate: int
    policy: Policy
    states: Sequence[Any]
    begin: int
    times: int


class Roller:
    """Plays the rollouts of a round, and keeps a run for each candidate."""

    def __init__(self, rolled: Rolled) -> None:
        self._rolled = rolled
        self._base = self._run(rolled.plan.policy)
        self._runs: Dict[int, AimedRun] = {}

    def _run(self, policy: Policy) -> AimedRun:
        rolled = self._rolled
        run = AimedRun(rolled.plan.with_policy(policy), rolled.objective, Watch())
        if rolled.compiled:
            run.compile()
        return run

    def gains(self, piece: Rollouts, watch: Watch) -> List[float]:
        """By how much the candidate is better than the present policy, in each rollout."""
        if piece.candidate not in self._runs:
            self._runs[piece.candidate] = self._run(piece.policy)
        runs = (self._runs[piece.candidate], self._base)
        for run in runs:
            run.watch = watch
        sign = 1.0 if self._rolled.objective.maximise else -1.0
        found = []
        for k in range(piece.begin, piece.begin + piece.times):
            state = piece.states[k % len(piece.states)]
            new, old = (self._value(run, state, k) for run in runs)
            found.append(sign * (new - old))
        return found

    def _value(self, run: AimedRun, state: Any, number: int) -> float:
        """The reward of a run continued from ``state``, up to a constant shared by all runs from
        there."""
        objective, seed = self._rolled.objective, self._rolled.seed
        words = np.random.SeedSequence(seed % 2**64, spawn_key=(number, 3))
        _resume(run, state, words.generate_state(4, np.uint32).tolist())
        aim, now = objective.aim, run.now
        if aim is Aim.DISCOUNTED:
            return discounted_reward(run, objective.discount or 1.0, seed, number, _STRATA)
        horizon = self._rolled.horizon
        stop = now + (horizon if aim is Aim.LONG_RUN else 10.0 * horizon)
        run.go(stop)
        if aim is Aim.LONG_RUN:
            return run.earned(stop)
        if aim is Aim.REACH:
            return float(run.reached)
        end = run.now if run.reached else stop
        return end if aim is Aim.TIME_TO else run.earned(end)


def roll_out(roller: Roller, piece: Rollouts, watch: Watch) -> List[float]:
    """Play rollouts; see :class:`~gspn_framework_package.analysis.executors.Workload`."""
    return roller.gains(piece, watch)


def copied(state: Any) -> Any:
    """A copy of the state of a run."""
    return type(state)(*map(copied, state)) if isinstance(state, tuple) else state.copy()


def _resume(run: AimedRun, state: Any, words: List[int]) -> None:
    """Continue from a state of another run of the same plan under any policy, with new random
    numbers. Choices that robots have drawn from the policy but not carried out are drawn again."""
    own = run.run.state.choices.candidates  # the lengths of these depend on the policy
    s = copied(state)
    s = s._replace(choices=s.choices._replace(candidates=own))
    run.run.continue_from(s)
    run.ended = None
    s.random[:] = words
    version = s.choices.stamps.version
    version[:] = [-1] * len(version)
    run.run.look_at_all()

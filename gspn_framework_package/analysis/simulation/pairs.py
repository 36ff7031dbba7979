"""Pairs of runs of two plans: the tasks of a comparison, for any executor."""

from __future__ import annotations

import math
import time as clock
from typing import List, NamedTuple, Optional, Tuple, Union

import numpy as np

from gspn_framework_package.analysis.decisions.aims import Aim, Objective
from gspn_framework_package.analysis.simulation import machine
from gspn_framework_package.analysis.simulation.aimed_run import AimedRun, worth_compiling
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.plan import Plan

_STRATA = 16
"""Number of end times of a discounted run; see :func:`discounted_reward`."""

_PATIENCE = 10.0
"""A run is abandoned after this multiple of the time of the whole comparison."""


class Contest(NamedTuple):
    """The settings shared by the pairs of a comparison.

    :ivar losses: rate (1/s) at which each robot is lost.
    :ivar seconds: computing time (s) of the whole comparison; None: no limit.
    :ivar time: length of a run (s); None if it ends by itself.
    :ivar warmup: time (s) at the start of a run that is excluded.
    """

    old: Plan
    new: Plan
    objective: Objective
    losses: float
    seed: int
    seconds: Optional[float]
    time: Optional[float] = None
    warmup: float = 0.0


class RunValue(NamedTuple):
    """The value of a run.

    :ivar drift: by how much more its first third earns than its last one (1/s).
    :ivar cut: whether it ended early, or did not end.
    :ivar late: whether it ended after its warm-up.
    :ivar missed: whether it never reached its condition.
    """

    value: float
    drift: float = 0.0
    cut: bool = False
    late: bool = False
    missed: bool = False


PlayedPair = Union[Tuple[RunValue, RunValue], str]
"""The runs of the old and of the new plan, or the reason why there are none."""


class PairPlayer:
    """Plays pairs of runs.

    :ivar runs: the runs of the old and of the new plan.
    """

    def __init__(self, contest: Contest, watch: Optional[Watch] = None) -> None:
        self.contest = contest
        self.runs = tuple(
            AimedRun(plan, contest.objective, watch or Watch(), contest.losses)
            for plan in (contest.old, contest.new)
        )
        if contest.seconds is not None:
            for run in self.runs:
                run.deadline = clock.monotonic() + _PATIENCE * max(contest.seconds, 1.0)

    @property
    def firings(self) -> int:
        """The number of firings in all runs so far."""
        return sum(run.firings for run in self.runs)

    def compile(self) -> None:
        """Use the compiled kernel from here on."""
        for run in self.runs:
            run.compile()

    def play(self, number: int) -> PlayedPair:
        """Play the pair with this number."""
        found = []
        for which, run in enumerate(self.runs):
            run.begin(self.contest.seed, number)
            try:
                found.append(self._outcome(run, number))
            except LimitError as error:
                return "a run of the %s plan %s" % (
                    ("old", "new")[which],
                    str(error).replace("a run ", "", 1),
                )
        return found[0], found[1]

    def _outcome(self, run: AimedRun, number: int) -> RunValue:
        contest = self.contest
        aim = contest.objective.aim
        if aim is Aim.DISCOUNTED:
            discount = contest.objective.discount or 0.0
            return RunValue(discounted_reward(run, discount, contest.seed, number, _STRATA))
        if aim is Aim.LONG_RUN:
            assert contest.time is not None
            length = contest.time - contest.warmup
            earned = []
            for k in range(4):
                stop = contest.warmup + length * k / 3
                run.go(stop)
                earned.append(run.earned(stop))
            return RunValue(
                (earned[3] - earned[0]) / length,
                (earned[1] - earned[0] - earned[3] + earned[2]) * 3 / length,
                run.ended is not None,
                run.ended is not None and run.now > contest.warmup,
            )
        run.go(contest.time if contest.time is not None else math.inf)
        if aim is Aim.REACH:
            return RunValue(float(run.reached), cut=run.ended is None)
        if not run.reached:
            return RunValue(math.inf, missed=True)
        return RunValue(run.now if aim is Aim.TIME_TO else run.earned(run.now))


def play_pairs(
    player: PairPlayer, piece: Tuple[int, int], watch: Watch
) -> Tuple[List[PlayedPair], int]:
    """Play pairs; see :class:`~gspn_framework_package.analysis.executors.Workload`.

    :param piece: the number of the first pair, and the number of pairs.
    :returns: the pairs, and the number of their firings.
    """
    before = player.firings
    for run in player.runs:
        run.watch = watch
    first, count = piece
    found = [player.play(number) for number in range(first, first + count)]
    seconds = player.contest.seconds
    if player.firings > machine.WORTH_COMPILING and worth_compiling(
        math.inf if seconds is None else seconds
    ):
        player.compile()
    return found, player.firings - before


def discounted_reward(run: AimedRun, discount: float, seed: int, number: int, strata: int) -> float:
    """The discounted reward of a run from now on, up to what it has earned.

    It equals the mean undiscounted reward up to an exponential time of rate ``discount``. One such
    time is drawn in each of so many equally probable parts (``strata``), so nothing is truncated
    and the mean is exact.
    """
    shift, now = np.random.default_rng([seed % 2**63, number]).random(), run.now
    whole = 0.0
    for k in range(strata):
        stop = now - math.log1p(-(k + shift) / strata) / discount
        run.go(stop)
        whole += run.earned(stop)
    return whole / strata

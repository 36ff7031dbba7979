"""Transient solution of a Markov chain: distributions at given times, by uniformisation.

Let Q be the generator (``Q(i, j)`` the rate from state i to state j, and each row sums to 0),
``p0`` the initial distribution, and ``c`` a clock rate of at least the largest ``-Q(i, i)``. The
chain seen at the ticks of a Poisson clock of rate ``c`` has the transition matrix P, and::

    P = I + Q / c
    p(t) = p0 * exp(Q * t) = sum over k >= 0 of exp(-c * t) * (c * t)**k / k! * p0 * P**k

All terms are non-negative, so nothing cancels; the omitted terms have a total weight of less
than :data:`TRUNCATION_ERROR`. See A. Jensen, "Markoff chains as an aid in the study of Markoff
processes", *Skandinavisk Aktuarietidskrift* 36 (1953), and W. J. Stewart, *Introduction to the
Numerical Solution of Markov Chains* (Princeton University Press, 1994), chapter 8.

The distance to the steady state ``pi`` is the total variation distance, half the sum of
``|p(t)(i) - pi(i)|``, which never grows with t.
"""

from __future__ import annotations

import math
from typing import Iterable, List, NamedTuple, Optional, Tuple

import numpy as np
from scipy import special

from gspn_framework_package.analysis.arrays import Floats, Matrix
from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.solution.steady_state import SteadyState, steady_state
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.errors import UsageError

TRUNCATION_ERROR = 1e-12
"""Probability that the sums over the Poisson distribution may omit."""


class Transient(NamedTuple):
    """The chain at one ``time`` (s): its ``distribution`` (float array over the states of the
    chain)."""

    time: float
    distribution: Floats


class Evolution:
    """Steps a chain through time.

    :param initial: the distribution to start from, if not that of the chain.
    """

    def __init__(
        self, chain: Chain, initial: Optional[Floats] = None, *, watch: Optional[Watch] = None
    ) -> None:
        self.chain = chain
        self.time = 0.0
        self.distribution = np.array(
            chain.initial if initial is None else initial, dtype=np.float64
        )
        self._clock = _clock(chain)
        self._watch = watch or Watch()
        self._stays: Optional[Floats] = None
        self._moves: Optional[Matrix] = None

    def advance(self, duration: float) -> Floats:
        """Advance the time by ``duration`` seconds; returns the distribution then.

        :raises UsageError: the duration is negative or not finite.
        """
        if not (duration >= 0 and math.isfinite(duration)):
            raise UsageError("a duration of %g s is not possible" % duration)
        self.time += duration
        ticks = self._clock * duration
        if ticks == 0:
            return self.distribution
        first, weights = poisson(ticks)
        vector = self.distribution
        result = np.zeros_like(vector)
        left = 1.0  # the remaining Poisson weight
        for k in range(first + len(weights)):
            if k >= first:
                result += weights[k - first] * vector
                left -= weights[k - first]
            following = self._tick(vector)
            if k % 16 == 15:
                self._watch.step("ticks", k)
                change = float(np.abs(following - vector).sum())
                if change * (first + len(weights) - k) < TRUNCATION_ERROR:
                    vector = following
                    break  # it no longer changes
            vector = following
        result += max(left, 0.0) * vector
        self.distribution = result / result.sum()
        return self.distribution

    def _tick(self, vector: Floats) -> Floats:
        if self._moves is None or self._stays is None:
            self._moves = self.chain.inflow / self._clock
            self._stays = 1.0 - self.chain.exit_rates / self._clock
        return self._stays * vector + self._moves @ vector


def transient(
    chain: Chain,
    times: Iterable[float],
    *,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    seconds: float = math.inf,
) -> List[Transient]:
    """The distributions at ``times`` (s), in the order of ``times``.

    :param seconds: longest time (s) that the work may take.
    :raises LimitError: it took longer.
    :raises UsageError: a time is negative or not finite.
    :raises CancelledError: ``cancel`` returned true.
    """
    asked = list(times)
    evolution = Evolution(chain, watch=Watch(progress, cancel, seconds=seconds))
    found = {}
    for time in sorted(set(asked)):
        found[time] = evolution.advance(time - evolution.time)
    return [Transient(time, found[time]) for time in asked]


def truncation_and_rounding(chain: Chain, time: float) -> float:
    """A bound on the error of a sum of probabilities at a ``time`` (s): of the terms of the Poisson
    distribution that are omitted, before and when the distribution no longer changes, and of the
    rounding of each tick and of the weights."""
    ticks = _clock(chain) * time
    if ticks == 0:
        return 0.0
    steps = ticks + _spread(ticks)
    each = int(np.diff(chain.inflow.indptr).max(initial=0)) + 2 + 4 * math.log(steps + math.e)
    return 2 * TRUNCATION_ERROR + steps * each * float(np.finfo(float).eps)


def check_tolerance(tolerance: float) -> None:
    """Check a tolerance. :raises UsageError: a distribution cannot be that far from the steady
    state."""
    if not 0 < tolerance < 1:
        raise UsageError(
            "a tolerance of %g is not possible" % tolerance, hint="give a number between 0 and 1"
        )


def time_to_steady_state(
    chain: Chain,
    tolerance: float = 1e-3,
    *,
    steady: Optional[SteadyState] = None,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    seconds: float = math.inf,
) -> float:
    """The time (s), to about 1 %, from which on the distribution stays within ``tolerance`` of the
    steady state (half the sum of absolute differences, the total variation distance).

    :param seconds: longest time (s) that the work may take.
    :raises LimitError: the steady state was not found, or the work took longer.
    """
    check_tolerance(tolerance)
    goal = (
        steady or steady_state(chain, progress=progress, cancel=cancel, seconds=seconds)
    ).distribution
    watch = Watch(progress, cancel, seconds=seconds)

    def away(vector: Floats) -> float:
        return 0.5 * float(np.abs(vector - goal).sum())

    if away(chain.initial) <= tolerance:
        return 0.0
    # The distance never grows, so the time can be bracketed by doubling, then found by bisection.
    low, step = Evolution(chain, watch=watch), 1.0 / max(float(chain.exit_rates.max()), 1e-300)
    while True:
        high = Evolution(chain, low.distribution, watch=watch)
        high.time = low.time
        high.advance(step)
        if away(high.distribution) <= tolerance:
            break
        low, step = high, 2 * step
        if low.time > 1e300:
            raise UsageError("the chain does not approach the steady state")
    while step > 0.01 * (low.time + step):
        step /= 2
        middle = Evolution(chain, low.distribution, watch=watch)
        middle.time = low.time
        middle.advance(step)
        if away(middle.distribution) > tolerance:
            low = middle
    return low.time + step


def poisson(mean: float) -> Tuple[int, Floats]:
    """The Poisson weights that matter: the first count, and the weights from there on; the omitted
    ones sum to less than :data:`TRUNCATION_ERROR`."""
    spread = _spread(mean)
    first = max(0, int(mean - spread))
    counts = np.arange(first, int(mean + spread) + 1)
    weights = np.exp(counts * math.log(mean) - mean - special.gammaln(counts + 1.0))
    return first, weights / weights.sum()


def _spread(mean: float) -> float:
    """How far the counts that matter are from the mean of a Poisson distribution."""
    return 8 * math.sqrt(mean) + 24


def _clock(chain: Chain) -> float:
    """The rate (1/s) of the ticks."""
    return float(chain.exit_rates.max(initial=0.0)) * 1.02

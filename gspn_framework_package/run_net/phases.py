"""Durations as phases: sequences of exponential stages, which a Markov chain can represent.

Exponential, Erlang and hyper-Erlang durations are phases already. Any other duration is *matched*:
replaced by phases with the same mean and the same variance. With the squared coefficient of
variation c (variance / mean^2):

* c < 1: k phases of one rate, k the smallest number with 1/k <= c; with probability p the first of
  them is skipped. p and the rate match both moments (H. C. Tijms, *Stochastic Models*, Wiley 1994,
  appendix B);
* c > 1: one of two exponentials, balanced so that both contribute half of the mean (ibid.);
* c = 0: no number of phases is enough.

Where that would take more phases than wanted, only the mean is the same, and c as close as that
many phases allow.
"""

from __future__ import annotations

import math
from typing import List, NamedTuple, Tuple

from gspn_framework_package.model.duration import Duration

MOST_PHASES = 200
"""A duration that needs more phases than this gets fewer."""

_TINY, _TINY_SHARE = 1e-3, 1e-4
"""A duration is tiny if its mean is at most this many seconds, and at most this fraction of the
longest mean."""

_EXPONENTIAL = 1e-9
"""A squared coefficient of variation this close to 1 is that of an exponential duration."""


class Phases(NamedTuple):
    """Exponential phases of a duration.

    :ivar start: the possible first phases: pairs (phase, probability).
    :ivar rates: the rate (1/s) of each phase.
    :ivar following: the phase after each phase; -1: the action is done.
    :ivar matched: the matched distribution, for people; empty if the phases are exact.
    """

    start: Tuple[Tuple[int, float], ...]
    rates: Tuple[float, ...]
    following: Tuple[int, ...]
    matched: str = ""

    @property
    def duration(self) -> Duration:
        """The distribution of the time that they take."""
        branches = []
        for first, probability in self.start:
            count, phase = 1, first
            while self.following[phase] >= 0:
                count, phase = count + 1, self.following[phase]
            branches.append((probability, count, count / self.rates[first]))
        return Duration.hyper_erlang(branches)

    def distance(self, duration: Duration) -> float:
        """The largest difference between the probability that they end within a time, and that of
        ``duration``, over all times (Kolmogorov)."""
        import numpy as np

        used = self.duration
        levels = np.linspace(0.0, 1.0, 1001)[1:-1]
        times = np.concatenate([duration.quantile(levels), used.quantile(levels)])
        times = np.concatenate([times, np.nextafter(times, 0.0)])  # on both sides of a jump
        return float(np.abs(duration.cdf(times) - used.cdf(times)).max())


def number_of_phases(duration: Duration, most: float = math.inf) -> float:
    """Number of phases that the duration needs; infinite if it never varies.

    :param most: see :func:`phases_of`.
    """
    if duration.branches is not None:
        count = sum(branch.phases for branch in duration.branches)
        if count <= most:
            return count
    c = _squared_variation(duration, most)
    if c <= 0:
        return math.inf
    if abs(c - 1) <= _EXPONENTIAL:
        return 1
    return 2 if c > 1 else math.ceil(1 / c - _EXPONENTIAL)


def is_tiny(duration: Duration, longest: float) -> bool:
    """Whether a duration that is not made of phases is so short that it can be taken as no time.

    :param longest: the longest mean of a duration (s).
    """
    if duration.branches is not None or duration.mean == 0:
        return False
    return duration.mean <= min(_TINY, _TINY_SHARE * longest)


def phases_of(duration: Duration, most: float = MOST_PHASES) -> Phases:
    """The phases of a duration.

    :param most: the most phases, where two exponential ones count as the inverse of their squared
        variation: with 1/2, the time varies as much as two exponential ones with c = 2.
    """
    if duration.branches is not None and number_of_phases(duration) <= most:
        start: List[Tuple[int, float]] = []
        rates: List[float] = []
        following: List[int] = []
        for branch in duration.branches:
            first = len(rates)
            if branch.probability > 0:
                start.append((first, branch.probability))
            rates += [branch.rate] * branch.phases
            following += [*range(first + 1, first + branch.phases), -1]
        return Phases(tuple(start), tuple(rates), tuple(following))
    return _matched(duration.mean, _squared_variation(duration, most))


def _squared_variation(duration: Duration, most: float) -> float:
    c = duration.variance / duration.mean**2
    return 1.0 if most == 1 else max(c, 1.0 / most)


def _matched(mean: float, c: float) -> Phases:
    if abs(c - 1) <= _EXPONENTIAL:
        return Phases(((0, 1.0),), (1.0 / mean,), (-1,), "an exponential one")
    if c > 1:
        p = (1 + math.sqrt((c - 1) / (c + 1))) / 2
        rates = (2 * p / mean, 2 * (1 - p) / mean)
        return Phases(((0, p), (1, 1 - p)), rates, (-1, -1), "two exponential ones")
    k = math.ceil(1 / c - _EXPONENTIAL)
    root = max(k * (1 + c) - k * k * c, 0.0)
    p = min(max((k * c - math.sqrt(root)) / (1 + c), 0.0), 1.0)
    rate = (k - p) / mean
    following = (*range(1, k), -1)
    if p <= _EXPONENTIAL:
        return Phases(((0, 1.0),), (k / mean,) * k, following, "Erlang with %d phases" % k)
    start = ((0, 1 - p), (1, p))
    return Phases(start, (rate,) * k, following, "Erlang with %d or %d phases" % (k - 1, k))

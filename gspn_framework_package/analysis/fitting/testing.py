"""Tests: does a fitted distribution explain the data, do groups differ, are outcomes independent?

The Kolmogorov-Smirnov distance between data and a distribution fitted to the same data is smaller
than for a given distribution, so the usual p-value is far too large. Therefore the null
distribution is simulated (parametric bootstrap): times are drawn from the fitted distribution,
censored like the data, fitted again, and compared.

With censored times the distance is that of the Kaplan-Meier estimate of the *Cox-Snell residuals*
from the unit exponential distribution: the residual of a time is its integrated hazard.
"""

from __future__ import annotations

import math
from typing import Any, Dict, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis import quantiles
from gspn_framework_package.analysis.fitting.durations import (
    CONFIDENCE,
    DurationFit,
    kaplan_meier,
    likelihood,
    most_likely,
)
from gspn_framework_package.analysis.fitting.sample import Sample
from gspn_framework_package.model.duration import Duration, Kind

SAMPLES = 299
"""Simulated samples of a null distribution."""

_SLOW = 99
"""The same for hyper-Erlang distributions, which take long to fit."""

SIGNIFICANT = 0.05
"""The joint level of all tests of a kind that become notes. That robots differ is one kind."""

LARGEST_SAMPLE = 3_000
"""Of a larger sample, this many times chosen at random are tested."""


class FitTest(NamedTuple):
    """The Kolmogorov-Smirnov distance between data and a fitted distribution, and the probability
    ``p`` of one at least as large if the distribution is true."""

    statistic: float
    p: float


def distance(duration: Duration, sample: Sample) -> float:
    """The Kolmogorov-Smirnov distance, of the Kaplan-Meier estimate if times are censored."""
    times, after = kaplan_meier(sample)
    before = np.concatenate(([1.0], after[:-1]))
    survival = duration.survival(times)
    return float(max(np.abs(survival - after).max(), np.abs(survival - before).max()))


def test_of_fit(
    fit: DurationFit, sample: Sample, generator: Any, samples: int = SAMPLES
) -> Optional[FitTest]:
    """Test whether a fitted distribution explains the sample; None for families without a test
    (deterministic, empirical).

    :param generator: a ``numpy.random.Generator``.
    :param samples: the number of simulated samples.
    """
    if fit.duration.kind in (Kind.DETERMINISTIC, Kind.EMPIRICAL) or sample.size < 2:
        return None
    duration = fit.duration
    size = sample.size + len(sample.censored)
    if size > LARGEST_SAMPLE:
        sample = _part(sample, generator)
        size = LARGEST_SAMPLE
        duration = most_likely(sample, duration)
    found = distance(duration, sample)
    runs = min(samples, _SLOW) if duration.kind is Kind.HYPER_ERLANG else samples
    limits = _censoring(sample)
    worse = drawn = 0
    for _ in range(runs):
        simulated = _draw(duration, size, limits, generator)
        if simulated is not None:
            drawn += 1
            worse += distance(most_likely(simulated, duration), simulated) >= found
    return FitTest(found, (worse + 1) / (drawn + 1))


test_of_fit.__test__ = False  # type: ignore[attr-defined]  # pytest: not a test of this package


def _part(sample: Sample, generator: Any) -> Sample:
    """A random part of a large sample."""
    times = np.concatenate((sample.observed, sample.censored))
    chosen = generator.choice(len(times), LARGEST_SAMPLE, replace=False)
    ended = chosen < sample.size
    return Sample(times[chosen[ended]], times[chosen[~ended]])


def _censoring(sample: Sample) -> Optional[Tuple[Any, Any]]:
    """The Kaplan-Meier estimate of the censoring times, in which observed times count as
    censored; None if no time is censored."""
    if not len(sample.censored):
        return None
    times, after = kaplan_meier(Sample(sample.censored, sample.observed))
    return times, 1 - after


def _draw(
    duration: Duration, size: int, limits: Optional[Tuple[Any, Any]], generator: Any
) -> Optional[Sample]:
    times = duration.sample(generator, size)
    if limits is None:
        return Sample(times)
    at = np.searchsorted(limits[1], generator.random(size), side="right")
    cut = np.append(limits[0], np.inf)[at]
    ended = times <= cut
    if ended.sum() < 2:
        return None
    return Sample(times[ended], cut[~ended])


# -- shares and rates ------------------------------------------------------------------------------


class OutcomeFit(NamedTuple):
    """An event seen ``seen`` times in ``total`` trials, the estimate of its ``probability``, and
    the 95 % ``interval``."""

    seen: int
    total: int
    probability: float
    interval: Tuple[float, float]

    def to_json(self) -> Dict[str, Any]:
        """The share as a JSON object."""
        interval = list(self.interval)
        return {"n": self.seen, "probability": self.probability, "interval": interval}


class EventFit(NamedTuple):
    """The ``rate`` (1/s) of a transition of the environment or of an event, from the firings that
    were ``seen``, with an ``interval`` of 95 %."""

    seen: int
    rate: float
    interval: Tuple[float, float]

    def to_json(self) -> Dict[str, Any]:
        """The rate as a JSON object."""
        return {"n": self.seen, "rate": self.rate, "interval": list(self.interval)}


def outcome_fit(count: int, total: int) -> OutcomeFit:
    """The estimate of a probability from ``count`` of ``total`` trials."""
    share = count / total if total else 0.0
    return OutcomeFit(count, total, share, wilson(count, total))


def event_fit(count: int, exposure: float) -> EventFit:
    """The estimate of a rate from ``count`` events in the time ``exposure`` (s, above 0)."""
    return EventFit(count, count / exposure, rate_interval(count, exposure))


# -- groups ----------------------------------------------------------------------------------------


def groups_differ(samples: Sequence[Sample], like: Duration) -> float:
    """The p-value of the likelihood ratio test that all samples have the same distribution, of the
    family of ``like`` (for families without a density: gamma).

    :param samples: each with at least two different observed times.
    """
    family = like
    if like.kind not in (Kind.EXPONENTIAL, Kind.GAMMA, Kind.LOGNORMAL):
        family = Duration.gamma(1.0, like.mean)
    together = Sample(
        np.concatenate([s.observed for s in samples]),
        np.concatenate([s.censored for s in samples]),
    )
    alike = likelihood(most_likely(together, family), together)
    apart = sum(likelihood(most_likely(sample, family), sample) for sample in samples)
    freedom = (len(samples) - 1) * (1 if family.kind is Kind.EXPONENTIAL else 2)
    return quantiles.chi_squared_above(2 * max(apart - alike, 0.0), freedom)


def outcomes_depend(durations: Sequence[Sequence[float]]) -> float:
    """The p-value of the rank test of Kruskal and Wallis that the durations of different outcomes
    have the same distribution, as they are in a race of exponential transitions.

    :param durations: the durations of each outcome, at least one for each.
    """
    everything = np.concatenate([np.asarray(times, dtype=np.float64) for times in durations])
    if len(durations) < 2 or (everything == everything[0]).all():
        return 1.0
    from scipy import stats  # slow to import

    return float(stats.kruskal(*durations).pvalue)


def shares_differ(counts: Sequence[Sequence[int]]) -> float:
    """The p-value of the likelihood ratio test that all groups have the same shares; 1 if there is
    too little data for the test (Cochran 1954: 5 are to be expected everywhere).

    :param counts: of each group, how often each end was seen; each group and each end was seen.
    """
    table = np.asarray(counts, dtype=np.float64)
    expected = np.outer(table.sum(axis=1), table.sum(axis=0)) / table.sum()
    if expected.min() < 5:
        return 1.0
    ratio = np.log(np.where(table > 0, table, 1.0) / np.where(table > 0, expected, 1.0))
    freedom = (table.shape[0] - 1) * (table.shape[1] - 1)
    return quantiles.chi_squared_above(2 * float((table * ratio).sum()), freedom)


def largest_clear(ps: Sequence[float]) -> float:
    """The largest p-value that is significant among all of these; -1 if none is (S. Holm, *A Simple
    Sequentially Rejective Multiple Test Procedure*, Scandinavian Journal of Statistics 6, 1979)."""
    clear = -1.0
    for rank, p in enumerate(sorted(ps)):
        if p * (len(ps) - rank) >= SIGNIFICANT:
            break
        clear = p
    return clear


def wilson(count: int, total: int, confidence: float = CONFIDENCE) -> Tuple[float, float]:
    """The interval of Wilson (1927) for a probability of which ``count`` of ``total`` trials were a
    success."""
    if total <= 0:
        return 0.0, 1.0
    z = quantiles.normal_quantile((1 + confidence) / 2)
    share = count / total
    middle = (share + z**2 / (2 * total)) / (1 + z**2 / total)
    half = z / (1 + z**2 / total) * math.sqrt(share * (1 - share) / total + z**2 / (4 * total**2))
    low = 0.0 if count == 0 else max(middle - half, 0.0)
    high = 1.0 if count == total else min(middle + half, 1.0)
    return low, high


def rate_interval(count: int, exposure: float) -> Tuple[float, float]:
    """The interval of the rate of events that happened ``count`` times in the time ``exposure``
    (s), from the chi-squared distribution."""
    tail = (1 - CONFIDENCE) / 2
    low = quantiles.chi_squared(1 - tail, 2 * count) / (2 * exposure) if count else 0.0
    return low, quantiles.chi_squared(tail, 2 * count + 2) / (2 * exposure)

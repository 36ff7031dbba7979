"""Durations as phases: sequences of exponential stages, which a Markov chain can represent.

Exponential, Erlang and hyper-Erlang durations are phases already. Any other duration is *matched*:
replaced by phases with the same mean and the same variance. With the squared coefficient of
variation c (variance / mean^2):

* c < 1: k phases of one rate, k the smallest number with 1/k <= c; with probability p the first of
  them is skipped. p and the rate match both moments (H. C. Tijms, *Stochastic Models*, Wiley 1994,
  appendix B);
* c > 1: one of two exponentials, balanced so that both contribute half of the mean (ibid.);
* c = 0: no number of phases is enough.
"""

from __future__ import annotations

import math
from typing import List, NamedTuple, Optional, Tuple

from gspn_framework_package.model.duration import Duration

MOST_PHASES = 200
"""A duration that needs more phases than this is not represented by phases."""

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


def number_of_phases(duration: Duration) -> float:
    """Number of phases that the duration needs; infinite if it never varies."""
    if duration.branches is not None:
        return sum(branch.phases for branch in duration.branches)
    c = _squared_variation(duration)
    if c <= 0:
        return math.inf
    if abs(c - 1) <= _EXPONENTIAL:
        return 1
    return 2 if c > 1 else math.ceil(1 / c - _EXPONENTIAL)


def phases_of(duration: Duration) -> Optional[Phases]:
    """The phases of a duration; None if none exist, or more than :data:`MOST_PHASES` are needed."""
    count = number_of_phases(duration)
    if count > MOST_PHASES:
        return None
    if duration.branches is not None:
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
    return _matched(duration.mean, _squared_variation(duration))


def single_phase(duration: Duration) -> Phases:
    """One exponential phase of the same mean."""
    return Phases(((0, 1.0),), (1.0 / duration.mean,), (-1,))


def _squared_variation(duration: Duration) -> float:
    return duration.variance / duration.mean**2


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

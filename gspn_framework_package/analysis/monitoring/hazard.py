"""The time scale on which the actions of a place end at rate 1, whatever their durations.

An action that has run for x seconds has used up -log P(duration > x) of that time: the integral of
its hazard. Summed over the actions of a place, finished and running ones, that is the number of
actions that were expected to end, and their ends are a Poisson process of rate 1 in it (time
rescaling: Meyer 1971; Brown and others 2002).
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import List

import numpy as np

from gspn_framework_package.analysis.arrays import Floats
from gspn_framework_package.model.duration import Duration, Kind

LEAST_VARIATION = 0.05
"""Durations that vary less than this (standard deviation by mean) have no useful hazard: if a
duration is fixed, one that is a millisecond longer is impossible. They are watched as if they
varied slightly, with the hazard of :data:`STEEP`."""

STEEP = 9.0
"""In this case, (x / mean) ** STEEP replaces the integral: 1 for an action that takes as long as
planned, 0.4 if it is 10 % shorter, 2.4 if it is 10 % longer. Its mean is below 1.1 for every
variation below :data:`LEAST_VARIATION`."""

HICCUPS, STRETCH = 1e-3, 3.0
"""One action in a thousand may take up to three times its planned time without being evidence of a
change, since no fitted distribution covers the rare events of a real machine. This share of
durations is taken to be longer by that factor, unless the durations vary by more than
:data:`WIDE`."""

WIDE = 0.5

KNOTS = 400
LARGEST_HAZARD = 60.0
"""The integral is tabulated up to this value; beyond it, it grows linearly, so that it is finite
for every time."""


class Hazard:
    """The integral of the hazard of a duration, made fast and finite: see the constants.

    :param duration: the duration, with a positive mean.

    >>> from gspn_framework_package.model.duration import Duration
    >>> round(Hazard(Duration.exponential(2.0))(3.0), 6)
    1.5
    >>> fixed = Hazard(Duration.deterministic(2.0))
    >>> round(fixed(2.0), 2), 6 < fixed(3.0) < 8, fixed(1000.0) < 1000
    (1.0, True, True)
    """

    def __init__(self, duration: Duration) -> None:
        self.duration = duration
        self._steep = duration.variation < LEAST_VARIATION
        self._mixed = duration.variation <= WIDE
        times = self._knots(duration.mean)
        values = np.maximum.accumulate(np.clip(self._exact(times), 0.0, LARGEST_HAZARD))
        self._times: List[float] = times.tolist()
        self._values: List[float] = values.tolist()
        self._slope = 1.0 / duration.mean
        self._straight = duration.kind is Kind.EXPONENTIAL

    def __call__(self, elapsed: float) -> float:
        """The integral from 0 to ``elapsed`` seconds."""
        if elapsed <= 0.0:
            return 0.0
        if self._straight:
            return elapsed * self._slope
        times, values = self._times, self._values
        i = bisect_right(times, elapsed)
        if i == len(times):
            return values[-1] + (elapsed - times[-1]) * self._slope
        low = times[i - 1]
        share = (elapsed - low) / (times[i] - low)
        return values[i - 1] + share * (values[i] - values[i - 1])

    def _exact(self, times: Floats) -> Floats:
        plain = self._plain(times)
        if not self._mixed:
            return plain
        rare = self._plain(times / STRETCH) - math.log(HICCUPS)
        with np.errstate(over="ignore"):
            return -np.logaddexp(math.log1p(-HICCUPS) - plain, -rare)

    def _plain(self, times: Floats) -> Floats:
        if self._steep:
            return (times / self.duration.mean) ** STEEP
        # a value far larger than LARGEST_HAZARD replaces infinity, which has no logarithm
        return np.nan_to_num(self.duration.hazard_integral(times), nan=1e9, posinf=1e9)

    def _knots(self, mean: float) -> Floats:
        """Times at which the integral is tabulated: steps of the integral as equal as possible."""
        last = mean
        while self._exact(np.array([last]))[0] < LARGEST_HAZARD and last < 1e6 * mean:
            last *= 1.5
        coarse = np.concatenate(
            [
                np.linspace(0.0, 2 * mean, 2000)[:-1],
                np.geomspace(2 * mean, max(last, 3 * mean), 2000),
            ]
        )
        values = np.clip(self._exact(coarse), 0.0, LARGEST_HAZARD)
        steps = np.concatenate(
            [np.geomspace(1e-4, 4.0, KNOTS), np.linspace(4.0, LARGEST_HAZARD, KNOTS)]
        )
        chosen = np.unique(np.searchsorted(values, steps).clip(max=len(coarse) - 1))
        return np.unique(np.concatenate([[0.0], coarse[chosen], coarse[-1:]]))

"""Estimates from pairs of runs, and how many pairs an answer needs."""

from __future__ import annotations

import math
from typing import Any, Dict, NamedTuple, Optional, Sequence

import numpy as np

from gspn_framework_package.analysis import quantiles
from gspn_framework_package.analysis.arrays import Booleans, Floats
from gspn_framework_package.analysis.fitting.testing import wilson
from gspn_framework_package.analysis.simulation import estimates

POWER = 0.8
"""Probability of detecting a difference of the stated size, used to report the number of runs
needed."""


class Measured(NamedTuple):
    """A mean with its confidence interval; ``why`` is the reason if there is none (``mean``
    None)."""

    mean: Optional[float]
    low: Optional[float] = None
    high: Optional[float] = None
    why: str = ""

    def to_json(self) -> Dict[str, Any]:
        """As plain JSON values; an infinite bound is null."""
        data: Dict[str, Any] = {
            key: value if value is None or math.isfinite(value) else None
            for key, value in (("mean", self.mean), ("low", self.low), ("high", self.high))
        }
        return {**data, "why": self.why} if self.why else data

    def __str__(self) -> str:
        if self.mean is None:
            return "not known (%s)" % self.why
        if self.low == self.high:
            return "%.6g in every run" % self.mean
        return "%.6g (%.6g to %.6g)" % (self.mean, self.low or 0.0, self.high or 0.0)


def truncation(values: Floats) -> int:
    """How many of the first values to leave out so that the mean of the others has the smallest
    marginal standard error; the number of all values if that is more than half of them."""
    count = len(values)
    best, least = 0, math.inf
    for start in range(count - 4):
        rest = values[start:]
        error = float(rest.var()) / len(rest)
        if error < least * (1 - 1e-9):
            best, least = start, error
    return best if 2 * best <= count else count


def paired_mean(values: Floats, confidence: float) -> Measured:
    """The mean of independent values, with Student's interval."""
    found = estimates.mean(values, confidence)
    return Measured(found.mean, found.mean - found.half_width, found.mean + found.half_width)


def paired_share(values: Booleans, confidence: float) -> Measured:
    """A proportion, with Wilson's interval."""
    return Measured(float(values.mean()), *wilson(int(values.sum()), len(values), confidence))


def paired_shares(old: Booleans, new: Booleans, confidence: float) -> Measured:
    """The difference of two proportions in paired data, by D. G. Bonett and R. M. Price,
    *Adjusted Wald confidence interval for a difference of binomial proportions based on paired
    data* (J. Educ. Behav. Stat., 2012)."""
    count = len(old)
    gained, lost = int((new & ~old).sum()), int((old & ~new).sum())
    up, down = (gained + 1) / (count + 2), (lost + 1) / (count + 2)
    z = quantiles.normal_quantile(0.5 + confidence / 2)
    half = z * math.sqrt((up + down - (up - down) ** 2) / (count + 2))
    low, high = max(up - down - half, -1.0), min(up - down + half, 1.0)
    return Measured((gained - lost) / count, low, high)


def pairs_needed(spread: float, size: float, confidence: float) -> int:
    """Number of pairs needed to detect a mean difference of ``size`` with the probability
    :data:`POWER` if differences have the standard deviation ``spread``."""
    z = quantiles.normal_quantile(0.5 + confidence / 2) + quantiles.normal_quantile(POWER)
    return max(2, math.ceil((z * spread / size) ** 2))


def correlation_of(old: Sequence[float], new: Sequence[float]) -> Optional[float]:
    """The correlation of the values of pairs; None where it is not defined."""
    if len(old) < 3 or np.std(old) == 0 or np.std(new) == 0:
        return None
    return float(np.corrcoef(old, new)[0, 1])

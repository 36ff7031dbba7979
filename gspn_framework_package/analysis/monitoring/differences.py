"""Differences of two plans that went through the same recorded runs, with intervals.

The time of the runs is cut into windows, and every measure is a ratio of totals (firings and
seconds, for example). The spread of the windows gives the interval of the difference: that of a
difference of two ratio estimates (W. G. Cochran, *Sampling Techniques*, 1977), whose windows are
paired because both plans met the same world in them.
"""

from __future__ import annotations

import math
from typing import Any, Dict, NamedTuple, Optional

import numpy as np

from gspn_framework_package.analysis import quantiles
from gspn_framework_package.analysis.arrays import Floats

_LEVEL = 0.95
"""Level of the intervals."""


class Ratio(NamedTuple):
    """A measure of one plan, window by window: ``amounts`` per ``bases``."""

    amounts: Floats
    bases: Floats

    @property
    def value(self) -> Optional[float]:
        """The measure over all windows; None if it has no base."""
        base = float(self.bases.sum())
        return float(self.amounts.sum()) / base if base > 0 else None

    def deviations(self) -> Floats:
        """How far each window moves the value, up to their mean."""
        value = self.value or 0.0
        return (self.amounts - value * self.bases) / max(float(self.bases.mean()), 1e-300)


class Difference(NamedTuple):
    """A measure of both plans, with the 95 % interval from ``low`` to ``high`` of new minus old. A
    value is None if its plan does not have the measure; then so is the interval."""

    name: str
    unit: str
    old: Optional[float]
    new: Optional[float]
    low: Optional[float]
    high: Optional[float]

    @property
    def change(self) -> Optional[float]:
        """New minus old."""
        return None if self.old is None or self.new is None else self.new - self.old

    @property
    def significant(self) -> bool:
        """Whether the interval leaves out 0."""
        return self.low is not None and self.high is not None and not self.low <= 0 <= self.high

    def to_json(self) -> Dict[str, Any]:
        """As plain JSON values."""
        return {
            "name": self.name,
            "unit": self.unit,
            "old": self.old,
            "new": self.new,
            "difference": self.change,
            "interval": None if self.low is None else [self.low, self.high],
            "significant": self.significant,
        }


def difference(name: str, unit: str, old: Optional[Ratio], new: Optional[Ratio]) -> Difference:
    """The difference of a measure between two plans in the same windows; None: a plan lacks it."""
    before = old.value if old is not None else None
    after = new.value if new is not None else None
    if old is None or new is None or before is None or after is None:
        return Difference(name, unit, before, after, None, None)
    windows = len(old.amounts)
    if windows < 2:
        return Difference(name, unit, before, after, None, None)
    moved = new.deviations() - old.deviations()
    error = float(moved.std(ddof=1)) / math.sqrt(windows)
    half = quantiles.student(0.5 + _LEVEL / 2, windows - 1) * error
    change = after - before
    return Difference(name, unit, before, after, change - half, change + half)


def per_window(totals: Any) -> Floats:
    """The increase in each window of totals that are given at the ends of the windows."""
    return np.diff(np.asarray(totals, dtype=np.float64), axis=0, prepend=0)

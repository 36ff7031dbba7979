"""Times from which a distribution is estimated."""

from __future__ import annotations

from typing import Any, Sequence, Tuple

import numpy as np

from gspn_framework_package.model.errors import UsageError

SHORTEST_FITTED = 1e-6
"""Seconds: the resolution of the clocks in a log. Shorter times count as this long."""

_GROUPS = 1_000
"""Largest number of groups of censored times."""


class Sample:
    """Times in seconds: ``observed`` to the end, or ``censored`` (cut off).

    :raises UsageError: a time is negative or not a number.
    """

    def __init__(self, observed: Sequence[float], censored: Sequence[float] = ()) -> None:
        self.observed = _times(observed)
        self.censored = _times(censored)
        # a time cut off immediately carries no information
        self.censored = self.censored[self.censored > SHORTEST_FITTED]
        self.grouped = _grouped(self.censored)

    @property
    def size(self) -> int:
        """The number of observed times."""
        return len(self.observed)

    @property
    def total(self) -> float:
        """The sum of all times (s)."""
        return float(self.observed.sum() + self.censored.sum())


def _times(values: Sequence[float]) -> Any:
    times = np.asarray(values, dtype=np.float64).reshape(-1)
    if not np.isfinite(times).all() or (times < 0).any():
        raise UsageError("a time is negative or not a number")
    return np.maximum(times, SHORTEST_FITTED)


def _grouped(times: Any) -> Tuple[Any, Any]:
    """Times with multiplicities: where there are many, neighbours are merged, which hardly changes
    a likelihood."""
    if len(times) <= 2 * _GROUPS:
        return times, np.ones(len(times))
    parts = np.array_split(np.sort(times), _GROUPS)
    return np.array([part.mean() for part in parts]), np.array([float(len(p)) for p in parts])

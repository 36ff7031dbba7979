"""Whether the policy's choices follow its rows: Pearson's chi-squared, block by block."""

from __future__ import annotations

from typing import Dict, List, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis import quantiles

BLOCK = 200
"""Number of choices tested together."""


class ChoiceTest:
    """The choices in one place, in blocks of :data:`BLOCK`.

    The statistic compares how often each transition was chosen with the sum of its probabilities,
    by the exact covariance of the counts, since the row may differ from choice to choice. Blocks
    are judged independently, each at the level that gives the stated rate of false alarms.

    :param alarms: permitted false alarms per second.

    :ivar on: whether the last full block departed.
    :ivar since: when the block began (s).
    :ivar largest: (transition, observed share, expected share) of the largest deviation of the last
        block that departed.
    """

    def __init__(self, alarms: float) -> None:
        self._alarms = alarms
        self.on = False
        self.since = 0.0
        self.largest = ("", 0.0, 0.0)
        self._number: Dict[str, int] = {}
        self._begin()

    def _begin(self) -> None:
        self._rows: List[Tuple[Tuple[int, float], ...]] = []
        self._chosen: List[int] = []

    def count(self, row: Sequence[Tuple[str, float]], chosen: str, now: float) -> bool:
        """Count a choice made with the probabilities ``row``; return whether it completes a block
        that departs from its rows."""
        if not self._rows:
            self.since = now
        self._rows.append(tuple((self._index(name), p) for name, p in row))
        self._chosen.append(self._index(chosen))
        if len(self._rows) < BLOCK:
            return False
        statistic, freedom = self._judge()
        level = min(0.05, self._alarms * max(now - self.since, 1e-9))
        self.on = freedom > 0 and statistic > quantiles.chi_squared(level, freedom)
        if self.on:
            self.largest = self._deviation()
        self._begin()
        return self.on

    @property
    def statistic(self) -> float:
        """The statistic of the block so far."""
        return self._judge()[0] if self._rows else 0.0

    @property
    def critical(self) -> float:
        """The critical value, approximately."""
        return quantiles.chi_squared(
            max(min(0.05, self._alarms), 1e-12), max(len(self._number) - 1, 1)
        )

    def _index(self, name: str) -> int:
        return self._number.setdefault(name, len(self._number))

    def _counts(self) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Observed and expected counts, and the covariance."""
        size = len(self._number)
        observed = np.bincount(self._chosen, minlength=size).astype(np.float64)
        rows = np.zeros((len(self._rows), size))
        for i, row in enumerate(self._rows):
            for t, p in row:
                rows[i, t] += p
        expected = rows.sum(axis=0)
        return observed, expected, np.diag(expected) - rows.T @ rows

    def _judge(self) -> Tuple[float, int]:
        """The statistic, and its degrees of freedom."""
        observed, expected, covariance = self._counts()
        difference = observed - expected
        # a choice that no row allows counts as one that was nearly impossible
        impossible = (np.diag(covariance) < 1e-9) & (np.abs(difference) > 0.5)
        values, vectors = np.linalg.eigh(covariance)
        kept = values > 1e-9 * max(1.0, float(values.max()))
        along = vectors.T @ difference
        statistic = float((along[kept] ** 2 / values[kept]).sum())
        return statistic + 1e3 * float(impossible.sum()), int(kept.sum()) + int(impossible.sum())

    def _deviation(self) -> Tuple[str, float, float]:
        observed, expected, covariance = self._counts()
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-9))
        worst = int(np.argmax(np.abs(observed - expected) / scale))
        name = next(n for n, i in self._number.items() if i == worst)
        return name, observed[worst] / len(self._rows), expected[worst] / len(self._rows)

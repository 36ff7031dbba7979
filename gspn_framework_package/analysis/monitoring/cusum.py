"""Cumulative sums (CUSUM, Page 1954) that detect a change of a rate or a probability, with
thresholds for a given rate of false alarms.

A sum follows the logarithm of the likelihood ratio "the rate has changed by the factor ``ratio``"
against "it is as planned", and never falls below 0. It raises the alarm at its threshold. The mean
time to an alarm, false or justified, is that of a Markov chain: the values of the sum after each
event, in narrow cells (Brook and Evans 1972), with the exact probabilities of moving between them.

>>> chart = RateChart(0.8)
>>> threshold = chart.threshold(10_000)
>>> round(threshold, 1), round(chart.run_length(threshold), -3)
(5.4, 10000.0)
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Callable, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Floats

CELLS = 300
"""Number of cells into which the values of a sum are divided."""

TABULATED = (0.5, 1.0, 2.0, 3.0, 5.0, 8.0)
"""Number of thresholds whose run lengths are computed; others are interpolated."""

LEAST_EVENTS = 20.0
"""The shortest mean time between false alarms of a single sum, in events."""


class RateChart:
    """The properties of the sum for the rate of a point process, on the time scale on which it
    should be a Poisson process of rate 1: with each event the sum grows by log ``ratio``, and with
    each unit of that time by 1 - ``ratio``.

    :param ratio: the factor of the rate to detect; below 1 for fewer events, above 1 for more.
    """

    def __init__(self, ratio: float) -> None:
        if not (ratio > 0 and ratio != 1):
            raise ValueError("a rate cannot change by the factor %g" % ratio)
        self.ratio = ratio

    def run_length(self, threshold: float, rate: float = 1.0) -> float:
        """The mean number of events until the alarm, from a sum of 0.

        :param threshold: where the alarm is raised.
        :param rate: the factor by which the rate has actually changed.
        """
        chain = self._rising if self.ratio < 1 else self._falling
        return chain(threshold, rate)

    def threshold(self, events: float) -> float:
        """The threshold for a mean number of ``events`` between two false alarms."""
        return _threshold(_rate_table(self.ratio), events)

    def _rising(self, h: float, rate: float) -> float:
        """For a sum that rises between events, and may cross the threshold there; an event lowers
        it."""
        slope, drop = (1 - self.ratio) / rate, -math.log(self.ratio)
        edges, values = _cells(h)
        peaks = np.minimum(edges + drop, h)
        below = -np.expm1(-np.maximum(peaks[None, :] - values[:, None], 0.0) / slope)
        moves = np.concatenate([below[:, :1], np.diff(below)], axis=1)
        events = -np.expm1(-(h - values) / slope)  # the chance of an event before the alarm
        return _first(moves, events)

    def _falling(self, h: float, rate: float) -> float:
        """For a sum that falls between events, at most to 0; an event raises it, perhaps to the
        threshold."""
        slope, lift = (self.ratio - 1) / rate, math.log(self.ratio)
        edges, values = _cells(h)
        bottoms = edges - lift
        below = np.exp(-np.maximum(values[:, None] - bottoms[None, :], 0.0) / slope)
        below[:, bottoms < 0] = 0.0
        moves = np.concatenate([np.zeros((len(values), 1)), np.diff(below)], axis=1)
        if lift >= h:
            return 1.0
        return _first(moves, np.ones(len(values)))


class ChanceChart:
    """The properties of the sum for the probability of an outcome: with each trial it grows by the
    logarithm of the likelihood ratio.

    :param chance: the planned probability, above 0 and below 1.
    :param odds: the factor of its odds to detect; above 1 for a larger probability.
    """

    def __init__(self, chance: float, odds: float) -> None:
        if not (0 < chance < 1 and odds > 0 and odds != 1):
            raise ValueError("the odds of %g cannot change by the factor %g" % (chance, odds))
        self.chance, self.odds = chance, odds
        changed = odds * chance / (1 - chance + odds * chance)
        self.hit = math.log(changed / chance)
        """The increment of a trial with the outcome."""
        self.miss = math.log((1 - changed) / (1 - chance))
        """The increment of a trial without it."""

    def run_length(self, threshold: float, chance: float = math.nan) -> float:
        """The mean number of trials until the alarm, from a sum of 0.

        :param threshold: where the alarm is raised.
        :param chance: the actual probability; by default, as planned.
        """
        from scipy.sparse import csc_matrix, identity
        from scipy.sparse.linalg import spsolve

        p = self.chance if math.isnan(chance) else chance
        count = 2 * CELLS
        values = np.linspace(0.0, threshold, count, endpoint=False)
        width = threshold / count
        rows, columns, parts = [], [], []
        for step, weight in ((self.hit, p), (self.miss, 1 - p)):
            at = np.maximum(values + step, 0.0) / width
            low = np.floor(at).astype(np.int64)
            for target, share in ((low, 1 - (at - low)), (low + 1, at - low)):
                kept = target < count
                rows.append(np.flatnonzero(kept))
                columns.append(target[kept])
                parts.append((weight * share)[kept])
        moves = csc_matrix(
            (np.concatenate(parts), (np.concatenate(rows), np.concatenate(columns))),
            shape=(count, count),
        )
        return float(spsolve(identity(count, format="csc") - moves, np.ones(count))[0])

    def threshold(self, trials: float) -> float:
        """The threshold for a mean number of ``trials`` between two false alarms."""
        return _threshold(_chance_table(self.chance, self.odds), trials)


def _cells(h: float) -> Tuple[Floats, Floats]:
    """The edges of the cells from 0 to the threshold; and the values of the sum that represent the
    states: 0, and the middle of each cell."""
    edges = np.linspace(0.0, h, CELLS + 1)
    return edges, np.concatenate([[0.0], (edges[1:] + edges[:-1]) / 2])


def _first(moves: Floats, events: Floats) -> float:
    """The mean number of events from state 0.

    :param moves: the probabilities of moving from state to state without an alarm.
    :param events: the expected number of events in each state before the next move.
    """
    return float(np.linalg.solve(np.eye(len(events)) - moves, events)[0])


_Table = Tuple[Floats, Floats]
"""Thresholds, and the logarithm of the mean number of events between false alarms with each."""


@lru_cache(maxsize=64)
def _rate_table(ratio: float) -> _Table:
    return _table(RateChart(ratio).run_length)


@lru_cache(maxsize=1024)
def _chance_table(chance: float, odds: float) -> _Table:
    return _table(ChanceChart(chance, odds).run_length)


def _table(run_length: Callable[[float], float]) -> _Table:
    lengths = np.maximum.accumulate([max(run_length(h), 1.0) for h in TABULATED])
    return np.array(TABULATED), np.log(lengths)


def _threshold(table: _Table, events: float) -> float:
    """Interpolate in the table, and beyond it in a straight line: there, raising the threshold by 1
    means e times fewer false alarms."""
    thresholds, logs = table
    wanted = math.log(max(events, LEAST_EVENTS))
    if wanted > logs[-1]:
        return float(thresholds[-1] + wanted - logs[-1])
    return float(np.interp(wanted, logs, thresholds))

"""Bounds of a total, from the drift and the mean time until the end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.decisions.solving import layers
from gspn_framework_package.analysis.decisions.solving.fixed_point import (
    Found,
    drift_range,
    solve_model,
)
from gspn_framework_package.analysis.decisions.solving.graphs import any_of_state, reaching
from gspn_framework_package.analysis.decisions.solving.model import Model
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError

_TIE = 1e-9
"""Rows whose values differ by less than this share of the largest value count as equally good."""

_FLOOR = 1e-13
"""A width below this share of the flow through the equations counts as zero (rounding)."""


def is_narrow(width: float, low: float, high: float, scale: float) -> bool:
    """Whether bounds are as close as asked: ``width`` relative to the value, of values of this
    ``scale``."""
    largest = max(abs(low), abs(high))
    return high - low <= max(0.45 * width * largest, _FLOOR * scale)


def steady(
    model: Model,
    values: Floats,
    gain: float,
    good: Callable[[Indices, float], bool],
    chosen: Indices,
    matters: Booleans,
) -> Tuple[Indices, float]:
    """The policy with stable ties, if its certificate is good enough: its rows, and its least
    drift."""
    row_values = model.row_values(values, gain)
    scale = float(np.abs(row_values[np.isfinite(row_values)]).max(initial=0.0))
    for slack in (_TIE, 1e-2 * _TIE, 1e-4 * _TIE):
        rows = model.best_rows(row_values, slack * scale)
        if (rows == chosen).all():
            break
        low, _ = drift_range(model, values.copy(), matters, rows)
        if good(rows, low):
            return rows, low
    return chosen, drift_range(model, values.copy(), matters, chosen)[0]


@dataclass(eq=False)
class Bounded:
    """Bounds of a total from the drift and the mean time until the end."""

    _width: float
    _watch: Watch
    _model: Model
    _begin: Indices
    _shares: Floats
    _matters: Booleans
    _safe: Optional[Indices]
    _proper: bool
    _offset: float = 0.0

    def solve(self, start: Optional[Floats]) -> Tuple[Floats, Indices, float, float, Found]:
        """Values, rows, bounds, and the method used."""
        model = self._model
        longest = self._longest(None) if self._proper else None
        tolerance = 1e-3 * self._width * max(1e-3, float(np.abs(model.constant).max(initial=0.0)))
        values = start
        rounds = 0
        while True:

            def accept(values: Floats, low: float, high: float, target: float = tolerance) -> bool:
                if longest is not None:
                    slow = float(longest[self._begin] @ self._shares)
                    if not len(self._begin):  # the answer is known; these are further states
                        slow = float(longest.max(initial=0.0))
                    value = float(values[self._begin] @ self._shares) + self._offset
                    return is_narrow(
                        self._width,
                        value + min(low, 0.0) * slow,
                        value + max(high, 0.0) * slow,
                        float(np.abs(values).max(initial=0.0)),
                    )
                return max(abs(low), abs(high)) <= target

            found = solve_model(
                model,
                accept,
                matters=self._matters,
                safe=self._safe,
                start=values,
                watch=self._watch,
            )
            rounds += found.rounds
            lower, upper, chosen = self._bounds(found, longest)
            scale = float(np.abs(found.values).max(initial=0.0))
            if is_narrow(self._width, lower, upper, scale):
                return found.values, chosen, lower, upper, found._replace(rounds=rounds)
            worst = max(abs(found.low), abs(found.high))
            if longest is not None or tolerance < 1e-15 * worst:
                raise LimitError(
                    "the bounds only reached %.12g and %.12g" % (lower, upper),
                    hint="ask for a wider interval",
                )
            tolerance = 0.1 * min(tolerance, worst)
            values = found.values

    def _bounds(self, found: Found, longest: Optional[Floats]) -> Tuple[float, float, Indices]:
        model, values = self._model, found.values
        value = float(values[self._begin] @ self._shares) + self._offset
        if longest is not None:
            slow = float(longest[self._begin] @ self._shares)
            chosen, low = steady(
                model,
                values,
                0.0,
                lambda rows, low: is_narrow(
                    self._width, value + low * slow, value + max(found.high, 0.0) * slow, 0.0
                ),
                found.chosen,
                self._matters,
            )
            return (
                value + min(low, 0.0) * slow,
                value + max(found.high, 0.0) * slow,
                chosen,
            )
        # Costs are not negative, and no policy stays forever without any. The policy's own mean
        # time bounds its excess cost.
        chosen, low = steady(
            model,
            values,
            0.0,
            lambda rows, low: low >= 2 * found.low and surely_ends(model, rows),
            found.chosen,
            self._matters,
        )
        own = self._longest(chosen)
        assert own is not None
        lower = value + min(low, 0.0) * float(own[self._begin] @ self._shares)
        return lower, value + self._saved(values, found.high), chosen

    def _saved(self, values: Floats, high: float) -> float:
        """The largest amount by which another policy may cost less than the values.

        A smaller cost ``(1 - e) V - f Z`` satisfies the inequality of all rows: ``Z`` is the
        longest mean time in states without cost before one with a cost, and ``e`` and ``f`` are as
        large as the drift requires."""
        if high <= 0:
            return 0.0
        model, matters = self._model, self._matters
        costly = model.tangible & (model.constant[model.first_rows] < 0)
        rate = -model.constant[model.first_rows]
        value = float(values[self._begin] @ self._shares)
        free = model.tangible & ~costly
        if not (free & matters).any():
            least = float(rate[costly & matters].min(initial=math.inf))
            share = high / least
            return -value * share / (1 - share) if share < 0.5 else math.inf
        timed = model.earning(np.where(model.tangible[model.row_states], 1.0, 0.0))
        rows = model.constant == 0
        kept = any_of_state(model.arrows, rows)
        number, size = layers.numbered(kept, np.zeros(0, dtype=np.int64), 0)
        part = timed.part(number, size, rows)
        longest = np.zeros(len(model))
        longest[kept] = slowest(part, self._watch)
        after = model.matrix @ longest
        paid = -model.constant > 0
        asked = np.where(model.tangible[model.row_states], high, 0.0) + high * after
        paid &= matters[model.row_states]
        share = float((asked[paid] / -model.constant[paid]).max(initial=0.0))
        if share >= 0.5:
            return math.inf
        return -share * value + high * float(longest[self._begin] @ self._shares)

    def _longest(self, chosen: Optional[Indices]) -> Optional[Floats]:
        """An upper bound on the mean time until the end, of a policy or of the slowest one."""
        model = self._model if chosen is None else self._model.taking(chosen)
        return slowest(
            model.earning(np.where(model.tangible[model.row_states], 1.0, 0.0)), self._watch
        )


def slowest(model: Model, watch: Watch) -> Floats:
    """Upper bounds of the highest mean times; the model earns 1 per second."""

    def accept(values: Floats, low: float, high: float) -> bool:
        return high <= 0.5

    found = solve_model(model, accept, watch=watch)
    return found.values / (1 - max(found.high, 0.0))


def surely_ends(model: Model, chosen: Indices) -> bool:
    """Whether a policy reaches the end with probability 1 from every state."""
    taken = model.taking(chosen)
    reached, _ = reaching(taken.arrows, any_of_state(taken.arrows, taken.into))
    return bool(reached.all())

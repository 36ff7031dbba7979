"""The best values of a model, and the residual of its equations.

Gauss-Seidel sweeps with Anderson acceleration come first; small models, and those on which the
sweeps make little progress, are solved by policy iteration. The method does not matter: the
certificate is the *drift* ``d(s) = c + sum of rate * V - E * V`` of the tangible states, with the
vanishing ones backed up exactly. In the long run, the highest gain is between the least and the
largest drift, whatever ``V``.
"""

from __future__ import annotations

import math
from typing import Callable, NamedTuple, Optional, Tuple

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.decisions.solving.graphs import reaching, rows_toward
from gspn_framework_package.analysis.decisions.solving.model import Model
from gspn_framework_package.analysis.graph import components_of
from gspn_framework_package.analysis.solution.anderson import Anderson
from gspn_framework_package.analysis.solution.linear import solve_linear as solve_linear
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError

_Accept = Callable[[Floats, float, float], bool]
"""Takes the values and the least and largest drift; returns whether that is good enough."""

_SMALL = 2_000
"""Up to this many states, policy iteration begins after a few sweeps."""

_WARM = 20
"""Number of sweeps before it."""

_DIRECT = 30_000
"""Up to this many states, policies are evaluated by sparse LU."""

_STRIDE = 2
"""Sweeps between two accelerations."""

_CHECKED = 6
"""The drift is computed after this many strides."""

_ONE_WAY = 4
"""Sweeps run against the order of discovery, in which most values depend on later states. If the
spread has not halved in this many checks, every other one runs the other way."""

_MOST = 20_000
"""Largest number of sweeps."""

_PATIENCE = 40
"""The sweeps stop when the spread of the drift has not halved in this many checks."""

_ROUNDS = 200
"""Largest number of rounds of policy iteration."""

_SWITCH = 1e-13
"""A row must be better by this share of the largest value to replace another."""


class Found(NamedTuple):
    """The values of a model.

    :ivar values: float array, vanishing states backed up exactly.
    :ivar chosen: int array: the best row of each state.
    :ivar low: least drift among the states that matter.
    :ivar high: largest drift.
    :ivar gain: the gain per second; 0 if not requested.
    :ivar method: the method used.
    :ivar rounds: sweeps, or rounds of policy iteration.
    """

    values: Floats
    chosen: Indices
    low: float
    high: float
    gain: float
    method: str
    rounds: int


def drift_range(
    model: Model, values: Floats, matters: Booleans, chosen: Optional[Indices] = None
) -> Tuple[float, float]:
    """Back up the vanishing states, in place, and return the least and the largest drift.

    :param matters: boolean array: the states that count.
    :param chosen: the row that each state takes; None: the best.
    """
    model.settle(values, chosen)
    drift = model.drift(values)[matters[model.tangible]]
    if not len(drift):
        return 0.0, 0.0
    low, high = float(drift.min()), float(drift.max())
    return (low, high) if math.isfinite(low) and math.isfinite(high) else (-math.inf, math.inf)


def solve_model(
    model: Model,
    accept: _Accept,
    *,
    matters: Optional[Booleans] = None,
    long_run: bool = False,
    safe: Optional[Indices] = None,
    start: Optional[Floats] = None,
    watch: Optional[Watch] = None,
) -> Found:
    """The best values of a model.

    :param accept: whether values are good enough.
    :param matters: boolean array: the states that must be good enough; None: all. The others are
        too, if possible.
    :param long_run: whether to find the gain too; the model is then one end component.
    :param safe: rows of a policy that ends with certainty; None: every policy does, or none needs
        to.
    :param start: initial values.
    :raises LimitError: they did not become good enough.
    """
    return _Search(model, accept, matters, long_run, safe, watch or Watch()).run(start)


class _Search:
    def __init__(
        self,
        model: Model,
        accept: _Accept,
        matters: Optional[Booleans],
        long_run: bool,
        safe: Optional[Indices],
        watch: Watch,
    ) -> None:
        self._model, self._accept, self._watch = model, accept, watch
        self._everything = np.ones(len(model), dtype=bool)
        self._matters = self._everything if matters is None else matters
        self._long_run, self._safe = long_run, safe
        self._gain = 0.0
        self._sweeps = 0
        self._last = (-math.inf, math.inf)

    def run(self, start: Optional[Floats]) -> Found:
        values = np.zeros(len(self._model)) if start is None else np.array(start, dtype=np.float64)
        small = len(self._model) <= _SMALL
        values, done = self._swept(values, _WARM if small else _MOST)
        if done:
            return self._found(values, "value iteration", self._sweeps)
        return self._improved(values)

    def _found(self, values: Floats, method: str, rounds: int) -> Found:
        low, high = self._last
        gain = 0.5 * (low + high) if self._long_run else 0.0
        chosen = self._model.best_rows(self._model.row_values(values, gain))
        return Found(values, chosen, low, high, gain, method, rounds)

    def _good(self, values: Floats, matters: Optional[Booleans] = None) -> bool:
        states = self._everything if matters is None else matters
        self._last = drift_range(self._model, values, states)
        return self._accept(values, *self._last)

    def _spread(self) -> float:
        """How far the last values are from the solution of the equations."""
        low, high = self._last
        return high - low if self._long_run else max(abs(low), abs(high))

    # -- sweeps ------------------------------------------------------------------------------------

    def _swept(self, values: Floats, most: int) -> Tuple[Floats, bool]:
        model, long_run = self._model, self._long_run
        size = len(model)
        accelerated = Anderson(size + 1 if long_run else size)
        times = 1.0 / model.exits[model.tangible]
        pace = 1.0 / (_STRIDE * float(times.mean())) if long_run and len(times) else 1.0
        weight = math.sqrt(size) / pace
        values = values.copy()
        best, best_spread = values, math.inf
        halved, halved_at = math.inf, 0
        to_and_fro = False
        for stride in range(1, most // _STRIDE + 1):
            image = values.copy()
            for turn in range(_STRIDE):
                model.sweep(image, self._gain, backward=turn % 2 == 0 or not to_and_fro)
            self._sweeps += _STRIDE
            if stride % _CHECKED == 0 or stride == most // _STRIDE:
                kept = image.copy()
                if self._good(kept):
                    return kept, True
                spread = self._spread()
                if spread < 0.5 * halved:
                    halved, halved_at = spread, stride
                if spread < best_spread:
                    best, best_spread = kept, spread
                waited = stride - halved_at
                if waited > _PATIENCE * _CHECKED:
                    break
                if waited > _ONE_WAY * _CHECKED and not to_and_fro:
                    to_and_fro, halved_at = True, stride
                if not math.isfinite(spread) or spread > 1e4 * best_spread:
                    accelerated.forget()
                    values = best.copy()
                    continue
                self._watch.step("sweeps (spread %.0e)" % spread, stride * _STRIDE)
            if not long_run:
                accelerated.next(values, image)
                continue
            drifted = float((image - values).mean())
            following = np.append(values, self._gain * weight)
            after = np.append(image - drifted, (self._gain + pace * drifted) * weight)
            accelerated.next(following, after)
            self._gain = float(following[-1]) / weight
            values = following[:-1] - following[0]
        return (best if math.isfinite(best_spread) else values), False

    # -- policy iteration --------------------------------------------------------------------------

    def _improved(self, values: Floats) -> Found:
        model = self._model
        chosen = model.best_rows(model.row_values(values, self._gain))
        if self._safe is not None and not _ends(model, chosen):
            chosen = self._safe
        for rounds in range(1, _ROUNDS + 1):
            self._watch.step("policies", rounds)
            if self._long_run:
                chosen = self._one_class(chosen)
                values, gain = self._evaluated_for_ever(chosen)
            else:
                values, gain = self._evaluated(chosen), 0.0
            self._gain = gain
            found = model.row_values(values, gain)
            better = model.best_rows(found)
            slack = _SWITCH * max(1e-300, float(np.abs(found).max(initial=0.0)))
            switch = found[better] > found[chosen] + slack
            if self._good(values.copy()):
                model.settle(values)
                return self._found(values, "policy iteration", rounds)
            if not switch.any():
                break
            chosen = np.where(switch, better, chosen)
        # only rounding errors of the linear solver may remain
        for _ in range(_WARM):
            model.sweep(values, self._gain)
        if self._good(values) or self._good(values, self._matters):
            return self._found(values, "policy iteration", rounds)
        raise LimitError(
            "the bounds did not come close enough: the equations hold to %.1e only, after %d "
            "sweeps and %d policies" % (self._spread(), self._sweeps, rounds),
            hint="ask for a wider interval",
        )

    def _evaluated(self, chosen: Indices) -> Floats:
        model = self._model
        values: Floats = solve_linear(
            model.matrix[chosen],
            model.exits,
            model.constant[chosen],
            backward=True,
            watch=self._watch,
        ).values
        return values

    def _evaluated_for_ever(self, chosen: Indices) -> Tuple[Floats, float]:
        """Bias and gain of a policy with one recurrent class."""
        model = self._model
        matrix, constant = model.matrix[chosen], model.constant[chosen]
        time = model.tangible.astype(np.float64)
        reference = self._reference
        if len(model) <= _DIRECT:
            system = (sparse.diags(model.exits) - matrix).tolil(copy=False).tocsc()
            others = np.arange(len(model)) != reference
            column = sparse.csc_matrix(time.reshape(-1, 1))
            bordered = sparse.hstack(
                [system[:, :reference], column, system[:, reference + 1 :]], format="csc"
            )
            factor = linalg.splu(bordered)
            found = factor.solve(constant)
            for _ in range(2):
                found += factor.solve(constant - bordered @ found)
            return np.where(others, found, 0.0), float(found[reference])
        # The share of time in each state gives the gain. The bias is relative to a state that is
        # often visited: to one that never is, the way is so long that no digits would be left.
        often = solve_linear(matrix.T, model.exits, None, watch=self._watch).values
        gain = float((often @ constant) / (often @ time))
        inside = np.flatnonzero(np.arange(len(model)) != int(np.argmax(often * model.exits)))
        bias = np.zeros(len(model))
        bias[inside] = solve_linear(
            matrix[inside][:, inside],
            model.exits[inside],
            (constant - gain * time)[inside],
            backward=True,
            watch=self._watch,
        ).values
        return bias, gain

    def _one_class(self, chosen: Indices) -> Indices:
        """Change the policy so that only the best of its recurrent classes remains."""
        model = self._model
        matrix = model.matrix[chosen]
        matrix.sum_duplicates()
        _, of, bottom = components_of(matrix)
        classes = np.flatnonzero(bottom)
        best = classes[0]
        if len(classes) > 1:
            gains = [self._gain_of(np.flatnonzero(of == c), matrix, chosen) for c in classes]
            best = classes[int(np.argmax(gains))]
            inside = of == best
            _, after = reaching(model.arrows, inside)
            chosen = np.where(inside, chosen, rows_toward(model.arrows, after))
        self._reference = int(np.flatnonzero((of == best) & model.tangible)[0])
        return chosen

    def _gain_of(self, states: Indices, matrix: sparse.csr_matrix, chosen: Indices) -> float:
        model = self._model
        inflow = matrix[states][:, states].T.tocsr()
        constant = model.constant[chosen][states]
        if len(states) == 1:
            return float(constant[0])
        found = solve_linear(inflow, model.exits[states], None, watch=self._watch).values
        total = float(found[model.tangible[states]].sum())
        return float(found @ constant) / total


def _ends(model: Model, chosen: Indices) -> bool:
    """Whether a policy reaches the known states with certainty."""
    matrix = model.matrix[chosen]
    rest = model.exits - np.asarray(matrix.sum(axis=1)).reshape(-1)
    leaving = model.into[chosen] | (rest > 1e-9 * model.exits)
    taken = model.taking(chosen)
    reached, _ = reaching(taken.arrows, leaving)
    return bool(reached.all())

"""Conditions on a marking, and the question whether the state equation allows a marking with them.

Every reachable marking is ``m = m0 + C x`` for the counts ``x >= 0`` of the firings that lead
there. The converse does not hold, since the equation knows no order of firings. If no ``m`` fulfils
equation and conditions, then no reachable marking fulfils the conditions; a solution proves
nothing. What is left out here only adds solutions: that ``x`` are integers, what inhibitor arcs,
capacities, priorities and policies forbid on the way, and conditions that cannot be expressed.
"""

from __future__ import annotations

import math
from typing import Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

import numpy as np
from scipy import sparse

from gspn_framework_package.analysis.structure.incidence import effects
from gspn_framework_package.analysis.structure.invariants import Invariant
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net

ALWAYS, NEVER = -1, -2
"""Terms that always and never hold."""

LARGEST_COEFFICIENT = 100_000
"""Largest number of a program: larger ones and the tolerances of a solver do not go together."""

LARGEST_PROGRAM = 500_000
"""Most entries of a program."""


def solver_available() -> bool:
    """Whether this SciPy (1.9 or newer) has the solver."""
    try:
        from scipy.optimize import milp  # noqa: F401
    except ImportError:
        return False
    return True


def _changes(net: Net) -> sparse.csr_matrix:
    """The change of each place (row) by each transition (column)."""
    changes = effects(net)
    return sparse.csr_matrix(
        (np.array(changes.values, dtype=float), (changes.places, changes.transitions)),
        shape=(len(net.places), len(net.transitions)),
    )


def _bounds(
    net: Net, changes: sparse.csr_matrix, invariants: Iterable[Invariant]
) -> List[Optional[int]]:
    """An upper bound of the tokens of each place, or None."""
    bounds: List[Optional[int]] = [place.capacity for place in net.places]
    for invariant in invariants:
        weights = {net.place_number(name): w for name, w in invariant.weights.items()}
        if max(weights.values()) > LARGEST_COEFFICIENT:
            continue  # products with them would not be exact
        row = np.zeros(len(net.places))
        row[list(weights)] = list(weights.values())
        if (changes.T @ row > 0).any():
            continue
        value = sum(w * net.initial_marking[p] for p, w in weights.items())
        for p, w in weights.items():
            known = bounds[p]
            bounds[p] = value // w if known is None else min(known, value // w)
    return bounds


class MarkingProgram:
    """A mixed-integer program whose solutions include every reachable marking with the conditions.

    A *term* stands for a condition: where a solution sets it, the condition holds. It need not be
    set where the condition holds, so terms can only be asked for, not denied.

    :param net: the net.
    :param invariants: P-invariants of the net, or of one with fewer transitions: those whose sum no
        transition raises give the bounds of places.
    :raises LimitError: its numbers are too large.
    """

    def __init__(self, net: Net, invariants: Iterable[Invariant]) -> None:
        self._net = net
        self._places = len(net.places)
        self._columns = self._places + len(net.transitions)
        self._rows: List[Tuple[Dict[int, float], float, float]] = []
        self._entries = 0
        self._terms: Dict[Tuple[object, ...], int] = {}
        self._start = np.array([place.tokens for place in net.places], dtype=float)
        self._changes = _changes(net)
        self._check_number(max([0, *abs(self._changes.data), *self._start]))
        self._bounds = _bounds(net, self._changes, invariants)

    def _check_number(self, number: float) -> None:
        if number > LARGEST_COEFFICIENT:
            raise LimitError("not decided: the numbers of the net are too large for a proof")

    # -- terms -------------------------------------------------------------------------------------

    def at_most(self, place: int, count: int) -> int:
        """The term for ``m[place] <= count``. If the place has no known bound, the term always
        holds, which only adds solutions."""
        bound = self._bounds[place]
        if count < 0:
            return NEVER
        if bound is None or bound <= count:
            return ALWAYS
        self._check_number(bound)
        key = ("<=", place, count)
        if key not in self._terms:
            self._terms[key] = term = self._new_column()
            self.add_row({place: 1, term: bound - count}, -math.inf, bound)
        return self._terms[key]

    def at_least(self, place: int, count: int) -> int:
        """The term for ``m[place] >= count``."""
        bound = self._bounds[place]
        if count <= 0:
            return ALWAYS
        if bound is not None and bound < count:
            return NEVER
        self._check_number(count)
        key = (">=", place, count)
        if key not in self._terms:
            self._terms[key] = term = self._new_column()
            self.add_row({place: 1, term: -count}, 0, math.inf)
        return self._terms[key]

    def all_of(self, terms: Sequence[int]) -> int:
        """The term for the conjunction of ``terms``."""
        if NEVER in terms:
            return NEVER
        parts = sorted(set(terms) - {ALWAYS})
        if not parts:
            return ALWAYS
        key = ("and", *parts)
        if key not in self._terms:
            self._terms[key] = term = self._new_column()
            for other in parts:
                self.add_row({term: 1, other: -1}, -math.inf, 0)
        return self._terms[key]

    def any_of(self, terms: Sequence[int]) -> int:
        """The term for the disjunction of ``terms``."""
        if ALWAYS in terms:
            return ALWAYS
        parts = sorted(set(terms) - {NEVER})
        if not parts:
            return NEVER
        key = ("or", *parts)
        if key not in self._terms:
            self._terms[key] = term = self._new_column()
            self.add_row({term: 1, **dict.fromkeys(parts, -1)}, -math.inf, 0)
        return self._terms[key]

    # -- conditions --------------------------------------------------------------------------------

    def limit(self, place: int, count: int) -> None:
        """Keep only solutions with ``m[place] <= count``."""
        bound = self._bounds[place]
        self._bounds[place] = count if bound is None else min(bound, count)

    def require_disabled(self, t: int, *, otherwise: Sequence[int] = ()) -> None:
        """Keep only solutions in which transition number ``t`` is not enabled (priorities aside, as
        in :meth:`Net.is_enabled`), or one of the terms ``otherwise`` holds."""
        net = self._net
        full = [
            (p, capacity - change + 1)
            for p, change in net.effect(t)
            for capacity in (net.places[p].capacity,)
            if change > 0 and capacity is not None
        ]
        if len(net.inputs[t]) == 1 and not net.inhibitors[t] and not full and not otherwise:
            ((place, weight),) = net.inputs[t]
            self.limit(place, weight - 1)  # even if the place has no bound
            return
        self.require(
            [
                *(self.at_most(p, weight - 1) for p, weight in net.inputs[t]),
                *(self.at_least(p, weight) for p, weight in (*net.inhibitors[t], *full)),
                *otherwise,
            ]
        )

    def require(self, terms: Sequence[int]) -> None:
        """Keep only solutions in which one of ``terms`` holds."""
        if ALWAYS not in terms:
            self.add_row(dict.fromkeys(set(terms) - {NEVER}, 1), 1, math.inf)

    def add_row(self, values: Mapping[int, float], low: float, high: float) -> None:
        """Keep only solutions in which this weighted sum of columns, of which the first are the
        places, is between ``low`` and ``high``.

        :raises LimitError: the program gets too large.
        """
        self._rows.append((dict(values), low, high))
        self._entries += len(values)
        if self._entries > LARGEST_PROGRAM:
            raise LimitError("not decided: the program of the proof is too large")

    def _new_column(self) -> int:
        self._columns += 1
        return self._columns - 1

    # -- solving -----------------------------------------------------------------------------------

    def solve(self, seconds: float) -> Optional[List[float]]:
        """The tokens of each place in some solution; None: there is no solution.

        "No solution" is believed if the solver says so twice, with and without simplifying the
        program first.

        :raises LimitError: not decided within ``seconds``.
        """
        if any(not values and low > 0 for values, low, _ in self._rows):
            return None
        for presolve in (True, False):
            found = self._solved(seconds, presolve)
            if found is not None:
                return found
        return None

    def _solved(self, seconds: float, presolve: bool) -> Optional[List[float]]:
        from scipy.optimize import Bounds, LinearConstraint, milp

        transitions = len(self._net.transitions)
        equation = sparse.hstack(
            [
                sparse.identity(self._places),
                -self._changes,
                sparse.csr_matrix(
                    (self._places, self._columns - self._places - transitions), dtype=float
                ),
            ],
            format="csr",
        )
        entries = [
            (row, column, value)
            for row, (values, _, _) in enumerate(self._rows)
            for column, value in values.items()
        ]
        rows, columns, values = zip(*entries) if entries else ((), (), ())
        conditions = sparse.csr_matrix(
            (np.array(values, dtype=float), (rows, columns)),
            shape=(len(self._rows), self._columns),
        )
        low = [row[1] for row in self._rows]
        high = [row[2] for row in self._rows]
        terms = np.arange(self._columns) >= self._places + transitions
        whole = terms.copy()
        whole[: self._places] = True
        upper = np.where(terms, 1.0, np.inf)
        known = [np.inf if bound is None else bound for bound in self._bounds]
        upper[: self._places] = np.where(np.array(known) > LARGEST_COEFFICIENT, np.inf, known)
        answer = milp(
            np.zeros(self._columns),
            integrality=whole.astype(int),
            bounds=Bounds(np.zeros(self._columns), upper),
            constraints=LinearConstraint(
                sparse.vstack([equation, conditions], format="csr"),
                np.concatenate([self._start, low]),
                np.concatenate([self._start, high]),
            ),
            options={"time_limit": max(seconds, 0.1), "presolve": presolve},
        )
        if answer.x is not None:
            return list(answer.x[: self._places].tolist())
        if answer.status != 2:  # 2: infeasible
            raise LimitError("not decided: the proof was not found within %g s" % seconds)
        return None

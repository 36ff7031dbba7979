"""The best long-run policy whose other averages reach given bounds.

Column generation (Dantzig and Wolfe, *Operations Research* 8, 1960): a small linear program mixes
the policies known so far; its prices are the costs of the constraints. Finding the best policy at
these prices is a long-run problem without constraints. That policy joins the others, until none is
better. That problem also bounds the value of all policies. The mixture becomes one randomised
policy, by the flows of its parts (Altman, *Constrained Markov Decision Processes*, 1999); its value
and its averages are computed again.
"""

from __future__ import annotations

from typing import Any, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats
from gspn_framework_package.analysis.decisions.aims import AIM_WIDTH, Aim
from gspn_framework_package.analysis.decisions.automaton import Automaton, Rewards
from gspn_framework_package.analysis.decisions.solving.evaluation import (
    Evaluated,
    evaluate_policy,
    flows,
)
from gspn_framework_package.analysis.decisions.solving.graphs import end_components, staying
from gspn_framework_package.analysis.decisions.solving.layers import arrows_of
from gspn_framework_package.analysis.decisions.solving.optima import optimum
from gspn_framework_package.analysis.decisions.solving.solved import Solved
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError, RefusedError

_KEPT = 1e-9
"""A constraint is met if it is violated by less than this share of its scale."""

_ROUNDS = 300
"""Largest number of policies to mix."""


class Constrained(NamedTuple):
    """The best policy under constraints.

    :ivar lower: certified lower bound of the best value, or upper one: ``upper``.
    :ivar weights: float array over the rows: the probability with which each state takes it.
    :ivar values: the policy's value of each constrained average.
    :ivar prices: the costs of the constraints: the change of the value per unit by which the bound
        is lowered. Never negative; 0 where the constraint does not matter.
    :ivar evaluated: the value of the policy, with its flows.
    :ivar rounds: number of policies in the mixture.
    """

    lower: float
    upper: float
    weights: Floats
    values: List[float]
    prices: List[float]
    evaluated: Evaluated
    rounds: int


class _Column(NamedTuple):
    """A policy: its averages (the objective first) and its flow through each row."""

    averages: Floats
    flow: Floats


def constrained(
    automaton: Automaton,
    rewards: Rewards,
    at_least: Sequence[Tuple[Rewards, float]],
    *,
    names: Optional[Sequence[str]] = None,
    maximise: bool = True,
    width: float = AIM_WIDTH,
    allowed: Optional[Booleans] = None,
    watch: Optional[Watch] = None,
) -> Constrained:
    """The best average reward per second under constraints on other averages.

    :param at_least: pairs (rewards, bound): their average is at least the bound.
    :param names: names of the constraints in messages.
    :raises RefusedError: the constraints cannot be met; the message says what is possible.
    :raises LimitError: the bounds did not become as close as requested.
    """
    return _Work(automaton, rewards, at_least, names, maximise, width, allowed, watch).solve()


class _Work:
    def __init__(
        self,
        automaton: Automaton,
        rewards: Rewards,
        at_least: Sequence[Tuple[Rewards, float]],
        names: Optional[Sequence[str]],
        maximise: bool,
        width: float,
        allowed: Optional[Booleans],
        watch: Optional[Watch],
    ) -> None:
        self._automaton, self._width = automaton, width
        self._sign = 1.0 if maximise else -1.0
        self._allowed, self._watch = allowed, watch or Watch()
        self._asked = [_added([(1.0, part)]) for part, _ in at_least]
        self._bounds = np.array([bound for _, bound in at_least], dtype=np.float64)
        self._names = (
            list(names) if names else ["constraint %d" % (k + 1) for k in range(len(at_least))]
        )
        self._objective = _added([(self._sign, rewards)])
        self._columns: List[_Column] = []
        self._scales = np.ones(len(at_least) + 1)
        self._last: Optional[Solved] = None

    def solve(self) -> Constrained:
        """The best policy."""
        best = self._priced(1.0, np.zeros(len(self._bounds)))
        self._scales[0] = max(abs(best.lower), abs(best.upper), 1e-300)
        for k, bound in enumerate(self._bounds.tolist()):
            prices = np.zeros(len(self._bounds))
            prices[k] = 1.0
            most = self._priced(0.0, prices)
            self._scales[k + 1] = max(abs(bound), abs(most.upper), 1e-300)
            if most.upper < bound - _KEPT * self._scales[k + 1]:
                raise RefusedError(
                    "%s cannot be as high as %.9g: at most %.9g is possible"
                    % (self._names[k], bound, most.upper)
                )
        self._make_feasible()
        prices, upper = self._improve()
        return self._finished(prices, upper)

    # -- policies ----------------------------------------------------------------------------------

    def _priced(self, own: float, prices: Floats) -> Solved:
        """The policy that is best at these prices; it joins the columns."""
        parts = [(own, self._objective)] + list(zip(prices.tolist(), self._asked))
        priced = _added([part for part in parts if part[0]] or [(0.0, self._objective)])
        start = None if self._last is None else self._last.values
        solved = optimum(
            self._automaton,
            Aim.LONG_RUN,
            priced,
            width=max(0.1 * self._width, 1e-11),
            allowed=self._allowed,
            start_values=start,
            watch=self._watch,
        )
        self._last = solved
        weights = np.zeros(len(self._automaton.choices))
        weights[solved.row_of[solved.row_of >= 0]] = 1.0
        sojourn, flow = flows(self._automaton, Aim.LONG_RUN, weights, watch=self._watch)
        averages = [_average(self._automaton, part, sojourn, flow) for part in self._all]
        self._columns.append(_Column(np.array(averages), flow))
        return solved

    @property
    def _all(self) -> List[Rewards]:
        return [self._objective, *self._asked]

    def _table(self) -> Floats:
        """The averages of the columns minus the bounds, in their scales."""
        table = np.array([column.averages for column in self._columns]).T
        table[1:] -= self._bounds[:, None]
        return table / self._scales[:, None]

    def _make_feasible(self) -> None:
        """Add columns until a mixture meets the constraints."""
        for _ in range(_ROUNDS):
            table = self._table()[1:]
            if not len(table) or (table.min(axis=0) >= 0).any():
                return
            # the mixture whose worst constraint is best, and the prices that prove it
            count, number = table.shape
            mixed = _linear(
                np.append(np.zeros(number), -1.0),
                np.hstack([-table, np.ones((count, 1))]),
                np.zeros(count),
                np.append(np.ones(number), 0.0),
                [(0, None)] * number + [(None, None)],
            )
            if -mixed.fun >= -_KEPT * 1e-2:
                return
            proof = _linear(
                np.append(np.zeros(count), 1.0),
                np.hstack([table.T, -np.ones((number, 1))]),
                np.zeros(number),
                np.append(np.ones(count), 0.0),
                [(0, None)] * count + [(None, None)],
            )
            prices = np.maximum(proof.x[:-1], 0.0) / self._scales[1:]
            solved = self._priced(0.0, prices)
            most = solved.upper - float(prices @ self._bounds)
            if most < -_KEPT:
                share = mixed.x[:-1]
                table = np.array([column.averages[1:] for column in self._columns[:-1]]).T
                had = table @ share
                listed = ", ".join(
                    "%s is %.6g instead of %.6g" % item
                    for item in zip(self._names, had.tolist(), self._bounds.tolist())
                )
                raise RefusedError(
                    "the constraints cannot be met together: at the best compromise, %s" % listed
                )
            newest = self._table()[1:, -1]
            if float(prices * self._scales[1:] @ newest) <= proof.x[-1] + 1e-12:
                return
        raise LimitError("the constraints were not decided with %d policies" % _ROUNDS)

    def _improve(self) -> Tuple[Floats, float]:
        """Add columns until none is better: the prices, and an upper bound on the value."""
        upper = np.inf
        best_prices = np.zeros(len(self._bounds))
        for _ in range(_ROUNDS):
            table = self._table()
            count, number = len(table) - 1, table.shape[1]
            # least nu with nu >= value + prices * (average - bound) of every column
            dual = _linear(
                np.append(np.zeros(count), 1.0),
                np.hstack([table[1:].T, -np.ones((number, 1))]),
                -table[0],
                None,
                [(0, None)] * count + [(None, None)],
            )
            known = float(dual.x[-1]) * self._scales[0]
            prices = np.maximum(dual.x[:-1], 0.0) * self._scales[0] / self._scales[1:]
            solved = self._priced(1.0, prices)
            bound = solved.upper - float(prices @ self._bounds)
            if bound < upper:
                upper, best_prices = bound, prices
            if upper - known <= 0.3 * self._width * max(abs(known), abs(upper)):
                return best_prices, upper
            newest = self._table()[:, -1] * self._scales[0]
            scaled = prices * self._scales[1:] / self._scales[0]
            if newest[0] + float(scaled @ newest[1:]) <= known + 1e-13 * abs(known):
                return best_prices, upper
        return best_prices, upper

    def _finished(self, prices: Floats, upper: float) -> Constrained:
        try:
            return self._mixed(prices, upper, 0.0)
        except RefusedError:
            # The parts may have no common states: randomising among them once at the start would
            # need memory. A small share of every row connects them.
            self._add_everything()
        worst = self._columns[-1].averages[0]
        spread = max(abs(upper - worst), 1e-3 * self._scales[0])
        return self._mixed(prices, upper, 0.25 * self._width * abs(upper) / spread)

    def _add_everything(self) -> None:
        """Add a policy that takes each row occasionally but leaves no end component."""
        automaton = self._automaton
        arrows = arrows_of(automaton)
        states = np.ones(len(automaton), dtype=bool)
        rows = np.ones(len(automaton.choices), dtype=bool)
        if self._allowed is not None:
            rows = self._allowed.copy()
        live, rows = staying(arrows, states, rows)
        parts = end_components(arrows, live, rows)
        kept = parts.rows | (rows & (parts.of < 0)[automaton.row_states])
        weights = kept.astype(np.float64)
        sojourn, flow = flows(automaton, Aim.LONG_RUN, weights, watch=self._watch)
        averages = [_average(automaton, part, sojourn, flow) for part in self._all]
        self._columns.append(_Column(np.array(averages), flow))

    def _mixed(self, prices: Floats, upper: float, least: float) -> Constrained:
        """The policy of the best mixture with a share of at least ``least`` of the last column."""
        table = self._table()
        number = table.shape[1]
        limits: List[Tuple[Optional[float], Optional[float]]] = [(0, None)] * (number - 1)
        mixed = _linear(
            -table[0],
            -table[1:],
            np.full(len(table) - 1, 1e-11),
            np.ones(number),
            [*limits, (least, None)],
        )
        share = np.maximum(mixed.x, 0.0)
        flow = sum(part * column.flow for part, column in zip(share, self._columns) if part > 1e-12)
        automaton = self._automaton
        total = np.bincount(automaton.row_states, weights=flow, minlength=len(automaton))
        floor = 0.0 if least else 1e-13 * total.max()
        visited = (total > floor)[automaton.row_states]
        assert self._last is not None
        chosen = np.zeros(len(flow))
        chosen[self._last.row_of[self._last.row_of >= 0]] = 1.0
        weights = np.where(visited, flow, chosen)
        sums = np.bincount(automaton.row_states, weights=weights, minlength=len(automaton))
        weights = np.divide(
            weights,
            sums[automaton.row_states],
            out=np.zeros(len(weights)),
            where=sums[automaton.row_states] > 0,
        )
        evaluated = evaluate_policy(
            automaton, Aim.LONG_RUN, self._objective, weights, width=max(0.1 * self._width, 1e-10),
            watch=self._watch,
        )  # fmt: skip
        values = [
            _average(automaton, part, evaluated.sojourn, evaluated.flow) for part in self._asked
        ]
        for name, value, bound, scale in zip(
            self._names, values, self._bounds.tolist(), self._scales[1:].tolist()
        ):
            if value < bound - 10 * _KEPT * scale:
                raise LimitError(
                    "no policy without memory was found that keeps %s at %.9g; it reached %.9g"
                    % (name, bound, value)
                )
        lower = evaluated.lower
        if upper - lower > self._width * max(abs(lower), abs(upper)):
            raise LimitError(
                "the bounds only reached %.12g and %.12g"
                % (self._sign * lower, self._sign * upper),
                hint="ask for a wider interval",
            )
        # a violation within the tolerance may raise the value above the bound
        upper = max(upper, evaluated.upper)
        evaluated = _signed(evaluated, self._sign)
        low, high = (lower, upper) if self._sign > 0 else (-upper, -lower)
        return Constrained(
            low, high, weights, values, prices.tolist(), evaluated, len(self._columns)
        )


def _signed(evaluated: Evaluated, sign: float) -> Evaluated:
    if sign > 0:
        return evaluated
    return evaluated._replace(
        value=-evaluated.value,
        lower=-evaluated.upper,
        upper=-evaluated.lower,
        values=-evaluated.values,
        row_values=-evaluated.row_values,
        gains=None if evaluated.gains is None else -evaluated.gains,
    )


def _added(parts: Sequence[Tuple[float, Rewards]]) -> Rewards:
    """The sum of rewards, each times a factor."""
    rate = sum(factor * np.asarray(part.rate, dtype=np.float64) for factor, part in parts)
    impulse = sum(factor * np.asarray(part.impulse, dtype=np.float64) for factor, part in parts)
    return Rewards(np.asarray(rate), np.asarray(impulse))


def _average(automaton: Automaton, rewards: Rewards, sojourn: Floats, flow: Floats) -> float:
    """The average reward per second of a policy with these flows."""
    exits = automaton.exit_rates
    share = np.divide(flow, exits, out=flow.copy(), where=exits > 0)
    arcs = share[automaton.arc_rows] * automaton.values
    return float(sojourn @ np.where(automaton.tangible, rewards.rate, 0.0) + arcs @ rewards.impulse)


def _linear(
    cost: Floats,
    upper: Floats,
    bound: Floats,
    equal: Optional[Floats],
    limits: List[Tuple[Optional[float], Optional[float]]],
) -> Any:
    """The solution of a small linear program; ``equal`` times the unknowns is 1."""
    from scipy import optimize  # slow to import

    arguments = {
        "A_ub": upper if len(upper) else None,
        "b_ub": bound if len(upper) else None,
        "A_eq": None if equal is None else equal[None, :],
        "b_eq": None if equal is None else np.ones(1),
        "bounds": limits,
    }
    try:
        tight = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
        found = optimize.linprog(cost, method="highs", options=tight, **arguments)
    except ValueError:  # SciPy before 1.6
        found = optimize.linprog(
            cost, method="revised simplex", options={"tol": 1e-11}, **arguments
        )
    if found.status != 0:
        raise LimitError("the linear program of the policies was not solved: %s" % found.message)
    return found

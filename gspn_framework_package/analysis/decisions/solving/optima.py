"""The best policy of an automaton for an aim, with certified bounds of its value.

Regardless of the method, the bounds come from the equations that the values satisfy (Puterman,
*Markov Decision Processes*, Wiley 1994): with the drift ``d`` of :mod:`.fixed_point`, the best gain
in the long run is between min d and max d; discounted values are off by at most the largest
absolute d, divided by the discount; mean times ``V`` are between ``V / (1 - min d)`` and ``V / (1 -
max d)``. Costs and probabilities are off by at most the drift times the mean time until the end,
which is bounded in the same way. End components in which a policy could stay without cost are
merged first, so that the equations have one solution (de Alfaro, *Computing Minimum and Maximum
Reachability Times*, CONCUR 1999).
"""

from __future__ import annotations

import math
from typing import List, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.decisions.aims import AIM_WIDTH, NARROWEST, Aim
from gspn_framework_package.analysis.decisions.automaton import Automaton, Rewards
from gspn_framework_package.analysis.decisions.solving import layers
from gspn_framework_package.analysis.decisions.solving.bounded import (
    _TIE,
    Bounded,
    is_narrow,
    steady,
    surely_ends,
)
from gspn_framework_package.analysis.decisions.solving.end_classes import (
    EndClasses,
    spoil,
    with_exits,
    without_cost,
)
from gspn_framework_package.analysis.decisions.solving.fixed_point import Found, solve_model
from gspn_framework_package.analysis.decisions.solving.graphs import (
    EndComponents,
    any_of_state,
    avoiding,
    end_components,
    forward,
    reaching,
    rows_into,
    rows_toward,
    surely,
)
from gspn_framework_package.analysis.decisions.solving.layers import (
    Layer,
    Reduced,
    lifted,
    merge_components,
)
from gspn_framework_package.analysis.decisions.solving.model import Model
from gspn_framework_package.analysis.decisions.solving.solved import Solved, row_values_of
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError, RefusedError, UsageError


def optimum(
    automaton: Automaton,
    aim: Aim,
    rewards: Optional[Rewards] = None,
    *,
    goal: Optional[Booleans] = None,
    discount: Optional[float] = None,
    maximise: bool = True,
    width: float = AIM_WIDTH,
    allowed: Optional[Booleans] = None,
    start_values: Optional[Floats] = None,
    watch: Optional[Watch] = None,
) -> Solved:
    """The best stationary policy for an aim.

    :param rewards: the rewards or costs of a run; None for TIME_TO and REACH.
    :param goal: boolean array over the states: where TIME_TO, COST_TO and REACH end.
    :param discount: the rate (1/s) of DISCOUNTED.
    :param width: largest width of the interval, relative to the value.
    :param allowed: boolean array over the rows: those that may be taken; None: all.
    :param start_values: initial values of the states, for example from a similar problem.
    :param watch: receives progress, and may stop the work.
    :raises RefusedError: the aim has no finite value here; the message says why.
    :raises LimitError: the bounds did not become as close as requested, or not in time.
    :raises UsageError: the arguments are invalid.
    """
    if not NARROWEST <= width < 1:
        raise UsageError(
            "a relative width of %g is not possible" % width,
            hint="give a number from %g to 1" % NARROWEST,
        )
    work = _Work(automaton, maximise, width, allowed, start_values, watch or Watch())
    if aim is Aim.LONG_RUN:
        return work.long_run(_given(rewards))
    if aim is Aim.DISCOUNTED:
        if discount is None or not 0 < discount < math.inf:
            raise UsageError("a discounted reward needs a positive rate of discount (1/s)")
        return work.discounted(_given(rewards), discount)
    if goal is None:
        raise UsageError("this aim needs a goal")
    if aim is Aim.REACH:
        return work.reach(goal)
    if aim is Aim.TIME_TO:
        ones = np.ones(len(automaton))
        return work.total(Rewards(ones, np.zeros(len(automaton.targets))), goal, "time")
    return work.total(_given(rewards), goal, "cost")


def _given(rewards: Optional[Rewards]) -> Rewards:
    if rewards is None:
        raise UsageError("this aim needs rewards")
    return rewards


class _Work:
    """One problem; the arguments are those of :func:`optimum`."""

    def __init__(
        self,
        automaton: Automaton,
        maximise: bool,
        width: float,
        allowed: Optional[Booleans],
        start_values: Optional[Floats],
        watch: Watch,
    ) -> None:
        self._automaton = automaton
        self._maximise = maximise
        self._sign = 1.0 if maximise else -1.0
        self._width = width
        self._allowed = allowed
        self._start_values = start_values
        self._watch = watch
        self._asked = width, watch
        self._starts = np.array([s for s, _ in automaton.initial], dtype=np.int64)
        self._shares = np.array([p for _, p in automaton.initial])

    # -- parts -------------------------------------------------------------------------------------

    def _reduced(
        self,
        rewards: Optional[Rewards],
        goal: Optional[Booleans] = None,
        known: Optional[Floats] = None,
        discount: float = 0.0,
    ) -> Reduced:
        automaton = self._automaton
        if rewards is None:
            constant, impulse = np.zeros(len(automaton.choices)), None
        else:
            constant = self._sign * layers.earnings(automaton, rewards)
            impulse = np.asarray(rewards.impulse, dtype=np.float64)
        return layers.reduce(
            automaton,
            constant,
            impulse,
            self._allowed,
            goal=goal,
            known=known,
            discount=discount,
        )

    def _begin(self, stack: List[Layer]) -> Optional[Floats]:
        """The initial values, expressed for the innermost model."""
        if self._start_values is None:
            return None
        values = self._sign * np.nan_to_num(self._start_values, posinf=0.0, neginf=0.0)
        for layer in stack:
            values = values[layer.model.state_ids]
        return values

    def _mean(self, values: Floats) -> float:
        """The mean over the start distribution of one value per state of the automaton."""
        return float(values[self._starts] @ self._shares)

    def _solved(
        self,
        low: float,
        high: float,
        values: Floats,
        chosen: Indices,
        row_values: Floats,
        method: str,
        rounds: int,
        gains: Optional[Floats] = None,
    ) -> Solved:
        """The result, with the signs that the caller sees."""
        sign = self._sign
        known = np.abs(values[np.isfinite(values)])
        if not is_narrow(self._width, 0.45 * low, 0.45 * high, float(known.max(initial=0.0))):
            raise LimitError(
                "the bounds only reached %.12g and %.12g" % (sign * low, sign * high),
                hint="ask for a wider interval",
            )
        lower, upper = (low, high) if self._maximise else (-high, -low)
        values, row_values = sign * values, sign * row_values
        gains = None if gains is None else sign * gains
        bounds = lower + 0.0, upper + 0.0
        return Solved(*bounds, chosen, values, row_values, gains, method, rounds)

    # -- discounted --------------------------------------------------------------------------------

    def discounted(self, rewards: Rewards, discount: float) -> Solved:
        """DISCOUNTED."""
        reduced = self._reduced(rewards, discount=discount)
        model, number = reduced.layer.model, reduced.layer.number
        matters = reduced.reachable(self._automaton)
        starts = number[self._starts]

        def bounds(values: Floats, low: float, high: float) -> Tuple[float, float]:
            value = float(values[starts] @ self._shares)
            return value + low / discount, value + high / discount

        def accept(values: Floats, low: float, high: float) -> bool:
            return is_narrow(
                self._width, *bounds(values, low, high), float(np.abs(values).max(initial=0.0))
            )

        start = self._begin([reduced.layer])
        found = solve_model(model, accept, matters=matters, start=start, watch=self._watch)

        def enough(rows: Indices, low: float) -> bool:
            return accept(found.values, low, found.high)

        chosen, low = steady(model, found.values, 0.0, enough, found.chosen, matters)
        lower, upper = bounds(found.values, low, found.high)
        values, rows = lifted([reduced.layer], found.values, chosen)
        row_values = row_values_of(self._automaton, self._allowed, reduced, values)
        return self._solved(lower, upper, values, rows, row_values, found.method, found.rounds)

    # -- time and cost until a goal ----------------------------------------------------------------

    def total(self, rewards: Rewards, goal: Booleans, what: str) -> Solved:
        """Solve the aims TIME_TO and COST_TO."""
        automaton = self._automaton
        reduced = self._reduced(rewards, goal, np.zeros(len(automaton)))
        base = reduced.layer.model
        everything = np.ones(len(base.constant), dtype=bool)
        avoid, _ = avoiding(base.arrows, base.into, everything)
        hopeless = reaching(base.arrows, avoid)[0] if avoid.any() else avoid
        reachable = reduced.reachable(automaton)
        begin = reduced.layer.number[self._starts]
        begin = begin[begin >= 0]
        costs = (self._sign * base.constant)[reachable[base.row_states]]
        negative = bool((costs < 0).any())
        proper = not hopeless[begin].any()
        if proper:
            inside, rows = ~hopeless, ~hopeless[base.row_states]
        elif self._maximise:
            raise RefusedError(
                "the highest mean %s is infinite: a policy can avoid the goal" % what
            )
        else:
            inside, rows = surely(base.arrows, base.into, everything)
            if not inside[begin].all():
                raise RefusedError(
                    "the mean %s is infinite: no policy reaches the goal with certainty" % what,
                    hint="ask for the highest probability to reach it",
                )
            if negative:
                raise RefusedError(
                    "costs are negative where a policy can avoid the goal, so there may "
                    "be no least cost",
                    hint="make them positive",
                )
        component, inner, count = without_cost(base, inside, rows, proper)
        layer = merge_components(base, component, count, inner, states=inside, rows=rows)
        values, chosen, lower, upper, found = self._total_of(
            layer, [reduced.layer, layer], begin, proper, what == "time"
        )
        values, picked = lifted([reduced.layer, layer], values, chosen)
        unknown = reduced.layer.number >= 0
        values[unknown & np.isnan(values)] = -math.inf * 1.0 if not self._maximise else math.inf
        values[goal] = 0.0
        row_values = row_values_of(self._automaton, self._allowed, reduced, values)
        return self._solved(lower, upper, values, picked, row_values, found.method, found.rounds)

    def _total_of(
        self, layer: Layer, stack: List[Layer], begin: Indices, proper: bool, timed: bool
    ) -> Tuple[Floats, Indices, float, float, Found]:
        model = layer.model
        if not len(model):  # the run begins in the goal
            nothing = np.zeros(0)
            rows = np.zeros(0, dtype=np.int64)
            return nothing, rows, 0.0, 0.0, Found(nothing, rows, 0.0, 0.0, 0.0, "none needed", 0)
        safe = rows_into(model.arrows, model.into, np.ones(len(model.constant), dtype=bool))
        inner = layer.number[begin]
        matters = forward(model.arrows, np.unique(inner))
        shares = self._shares[stack[0].number[self._starts] >= 0]
        guard = None if proper else safe
        start = self._begin(stack)
        if not timed:
            bounded = Bounded(
                self._width, self._watch, model, inner, shares, matters, guard, proper
            )
            return bounded.solve(start)

        def accept(values: Floats, low: float, high: float) -> bool:
            # in terms of -time the constant is -1: the drift of the scaled equations
            return -0.4 * self._width <= low and high <= 0.4 * self._width

        found = solve_model(
            model, accept, matters=matters, safe=guard, start=start, watch=self._watch
        )
        chosen, low = steady(
            model,
            found.values,
            0.0,
            lambda rows, low: (
                accept(found.values, low, found.high) and (proper or surely_ends(model, rows))
            ),
            found.chosen,
            matters,
        )
        value = float(found.values[inner] @ shares)
        if self._maximise:
            return found.values, chosen, value / (1 - low), value / (1 - found.high), found
        return found.values, chosen, value / (1 + low), value / (1 + found.high), found

    # -- probability -------------------------------------------------------------------------------

    def reach(self, goal: Booleans) -> Solved:
        """REACH."""
        ones = goal.astype(np.float64)
        reduced = self._reduced(None, goal, ones * self._sign)
        base = reduced.layer.model
        everything = np.ones(len(base.constant), dtype=bool)
        chosen: Indices = np.full(len(base), -1, dtype=np.int64)
        values: Floats = np.full(len(base), np.nan)
        avoid, keeping = avoiding(base.arrows, base.into, everything)
        if self._maximise:
            able, _ = reaching(base.arrows, any_of_state(base.arrows, base.into))
            never, sure = ~able, surely(base.arrows, base.into, everything)
            certain, possible = sure
            toward = rows_into(base.arrows, base.into, possible)
            chosen[never] = base.first_rows[never]
        else:
            never = avoid
            certain = ~(reaching(base.arrows, avoid)[0]) if avoid.any() else ~avoid
            toward = base.first_rows
            first = np.flatnonzero(keeping)[::-1]
            staying_row = np.full(len(base), -1, dtype=np.int64)
            staying_row[base.row_states[first]] = first
            chosen[never] = staying_row[never]
        chosen[certain] = toward[certain]
        values[never], values[certain] = 0.0, self._sign
        rest = ~never & ~certain
        lower = upper = None
        method, rounds = "graph", 0
        inner = reduced.layer.number[self._starts]
        known = self._sign * goal[self._starts].astype(np.float64)
        if rest.any():
            rows = rest[base.row_states]
            parts = end_components(base.arrows, rest, rows & ~base.into)
            layer = merge_components(
                base,
                parts.of,
                parts.number,
                parts.rows,
                states=rest,
                known=np.nan_to_num(values),
            )
            # the contribution of the goal is part of the constants already
            begin = layer.number[inner[(inner >= 0) & rest[np.maximum(inner, 0)]]]
            model = layer.model
            matters = forward(model.arrows, np.unique(begin))
            shares = self._shares[(inner >= 0) & rest[np.maximum(inner, 0)]]
            offset = float(known @ self._shares)
            settled = (inner >= 0) & ~rest[np.maximum(inner, 0)]
            offset += float(values[inner[settled]] @ self._shares[settled])
            bounded = Bounded(
                self._width, self._watch, model, begin, shares, matters, None, True, offset
            )
            part_values, part_rows, lower, upper, found = bounded.solve(
                self._begin([reduced.layer, layer])
            )
            values = layer.lift(part_values, values)
            chosen = layer.lift_rows(part_rows, chosen)
            method, rounds = found.method, found.rounds
        whole, picked = lifted([reduced.layer], values, chosen)
        whole[goal] = self._sign
        if lower is None or upper is None:
            lower = upper = self._mean(whole)
        low, high = (0.0, 1.0) if self._maximise else (-1.0, 0.0)
        lower, upper = max(lower, low), min(upper, high)
        row_values = row_values_of(self._automaton, self._allowed, reduced, whole)
        return self._solved(lower, upper, whole, picked, row_values, method, rounds)

    # -- long run ----------------------------------------------------------------------------------

    def long_run(self, rewards: Rewards) -> Solved:
        """LONG_RUN."""
        automaton = self._automaton
        reduced = self._reduced(rewards)
        base = reduced.layer.model
        reachable = reduced.reachable(automaton)
        everything = np.ones(len(base), dtype=bool)
        parts = end_components(base.arrows, everything, np.ones(len(base.constant), dtype=bool))
        classes = EndClasses(base, parts)
        bias = np.full(len(base), np.nan)
        chosen = np.full(len(base), -1, dtype=np.int64)
        lows, highs = np.full(parts.number, np.nan), np.full(parts.number, np.nan)
        method, rounds, largest = "graph", 0, 0
        single = classes.sizes == 1
        states = classes.first[single]
        lows[single] = highs[single] = base.constant[base.arrows.rows[states]]
        bias[states], chosen[states] = 0.0, base.arrows.rows[states]
        begun = self._begin([reduced.layer])
        for number in np.flatnonzero(~single).tolist():
            inside = classes.states(number)
            matters = bool(reachable[inside].any())
            part, listed = classes.part(inside)
            found, rows, low, high = self._gain(
                part, None if begun is None else begun[inside], matters
            )
            lows[number], highs[number] = low, high
            bias[inside], chosen[inside] = found.values, listed[rows]
            if len(inside) > largest:
                largest, method, rounds = len(inside), found.method, found.rounds
        gains = np.full(len(base), np.nan)
        held = parts.of >= 0
        middle = 0.5 * (lows + highs)
        gains[held] = middle[parts.of[held]]
        inner = reduced.layer.number[self._starts]
        spread = float(np.ptp(middle)) if parts.number else 0.0
        if spread == 0.0 and parts.number == 1:
            gains[:] = middle[0]
            lower, upper = float(lows[0]), float(highs[0])
            stays = held
        else:
            lower, upper, stays = self._quotient(base, parts, lows, highs, gains, chosen, inner)
        if not stays.all():
            self._transient(base, stays, gains, bias, chosen)
        whole, picked = lifted([reduced.layer], bias, chosen)
        all_gains = reduced.layer.lift(gains, np.full(len(automaton), np.nan))
        row_values = row_values_of(self._automaton, self._allowed, reduced, whole)
        if spread > 0.0:
            spoil(self._automaton, row_values, all_gains, upper - lower)
        return self._solved(lower, upper, whole, picked, row_values, method, rounds, all_gains)

    def _gain(
        self, model: Model, start: Optional[Floats], matters: bool
    ) -> Tuple[Found, Indices, float, float]:
        """The best gain of one end component."""
        flowing = float(np.abs(model.constant).max(initial=0.0))

        def accept(values: Floats, low: float, high: float) -> bool:
            scale = flowing + float(np.abs(values).max(initial=0.0)) * 1e-2 * float(
                model.exits.max()
            )
            return is_narrow(self._width, low, high, scale)

        try:
            found = solve_model(model, accept, long_run=True, start=start, watch=self._watch)
        except LimitError:
            if matters:
                raise
            # no run reaches it: any answer will do
            found = solve_model(
                model, lambda *_: True, long_run=True, start=start, watch=self._watch
            )
        rows, low = steady(
            model,
            found.values,
            found.gain,
            lambda rows, low: accept(found.values, low, found.high),
            found.chosen,
            np.ones(len(model), dtype=bool),
        )
        return found, rows, low, found.high

    def _quotient(
        self,
        base: Model,
        parts: EndComponents,
        lows: Floats,
        highs: Floats,
        gains: Floats,
        chosen: Indices,
        begin: Indices,
    ) -> Tuple[float, float, Booleans]:
        """Decide in which end components to stay and how to get there: fills in the gains and the
        rows of all other states. Returns the bounds, and the states of the components to stay
        in."""
        component, inner = parts.of, parts.rows
        held = component >= 0
        model, staying_rows, layer = with_exits(base, parts, lows)
        starts = layer.number[begin]
        matters = forward(model.arrows, np.unique(starts))

        def bounded(whole: Model) -> Tuple[Floats, Indices, float, float]:
            found = Bounded(
                self._width, self._watch, whole, starts, self._shares, matters, None, True
            )
            return found.solve(None)[:4]

        # the gain of a component is known within its bounds: its lower and upper bounds
        values, rows, lower, upper = bounded(model)
        if (highs > lows).any():
            upper = max(upper, bounded(with_exits(base, parts, highs)[0])[3])
        staying_state = np.zeros(len(model), dtype=bool)
        # staying is preferred to moving on to another component that is as good
        row_values = model.row_values(values)
        has = np.flatnonzero(staying_rows >= 0)
        scale = float(np.abs(row_values).max(initial=0.0))
        as_good = row_values[staying_rows[has]] >= values[has] - 1e-12 * scale
        staying_state[has[as_good]] = True
        stays = held & staying_state[layer.number]
        gains[:] = values[layer.number]
        moving = ~staying_state
        picked = model.row_ids[rows]
        into = np.full(len(base), -1, dtype=np.int64)
        real = moving & (picked < len(base.constant))
        owners = base.row_states[picked[real]]
        leaves = np.zeros(len(base), dtype=bool)
        leaves[owners] = True
        _, after = reaching(base.arrows, leaves, inner)
        toward = rows_toward(base.arrows, after, inner)
        within = held & ~stays
        into[within] = toward[within]
        into[owners] = picked[real]
        chosen[~stays] = into[~stays]
        return lower, upper, stays

    def _transient(
        self, base: Model, stays: Booleans, gains: Floats, bias: Floats, chosen: Indices
    ) -> None:
        """The bias of the states outside the components to stay in, and their rows."""
        rest = ~stays
        number, size = layers.numbered(rest, np.zeros(0, dtype=np.int64), 0)
        rows = np.zeros(len(base.constant), dtype=bool)
        scale = float(np.abs(gains).max(initial=0.0))
        # The rows that preserve the gain, among which the bias decides; in states where staying is
        # possible, the row that leaves.
        kept = base.matrix @ gains >= gains[base.row_states] - 1e-9 * scale
        kept |= base.tangible[base.row_states]
        held = end_components(base.arrows, rest, rest[base.row_states]).of >= 0
        rows |= kept & (rest & ~held)[base.row_states]
        rows[chosen[rest & held]] = True
        earned = base.constant - np.where(
            base.tangible[base.row_states], gains[base.row_states], 0.0
        )
        part = base.earning(earned).part(number, size, rows, np.nan_to_num(bias))
        layer = Layer(part, base.arrows, number, np.zeros(len(rows), dtype=bool))
        flowing = float(np.abs(np.nan_to_num(bias)).max(initial=0.0))

        def accept(values: Floats, low: float, high: float) -> bool:
            largest = max(scale, 1e-3 * float(np.abs(part.constant).max(initial=0.0)))
            return max(abs(low), abs(high)) <= max(1e-9 * largest, 1e-15 * flowing)

        try:
            found = solve_model(part, accept, watch=self._watch)
        except LimitError:  # it only breaks ties
            bias[rest] = 0.0
            return
        layer.lift(found.values, bias)
        ties = part.row_values(found.values)
        largest = float(np.abs(ties[np.isfinite(ties)]).max(initial=0.0))
        layer.lift_rows(part.best_rows(ties, _TIE * largest), chosen)

"""Converts an automaton to the models to solve, and their solutions back."""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.decisions.automaton import Automaton, Rewards
from gspn_framework_package.analysis.decisions.solving.graphs import (
    Arrows,
    end_components,
    forward,
    reaching,
    rows_toward,
    staying,
)
from gspn_framework_package.analysis.decisions.solving.model import Model, made
from gspn_framework_package.analysis.graph import longest_levels
from gspn_framework_package.model.errors import RefusedError, UsageError


class Layer(NamedTuple):
    """A model built from a part of something, with the mapping back.

    :ivar arrows: the rows and arcs it was built from.
    :ivar number: int array: the model's state for each of the states there; -1: none.
    :ivar inner: boolean array over the rows there: those inside merged states.
    """

    model: Model
    arrows: Arrows
    number: Indices
    inner: Booleans

    def lift(self, values: Floats, into: Floats) -> Floats:
        """``into`` (values of the states there) with the values of the model filled in."""
        inside = self.number >= 0
        into[inside] = values[self.number[inside]]
        return into

    def lift_rows(self, chosen: Indices, into: Indices) -> Indices:
        """``into`` (rows of the states there) with the chosen rows of the model filled in. In
        merged states, the other rows lead to the state that leaves."""
        rows = self.model.row_ids[chosen]
        owners = np.searchsorted(self.arrows.rows, rows, side="right") - 1
        if self.inner.any():
            inside = self.number >= 0
            merged = np.bincount(self.number[inside])[self.number[inside]] > 1
            states = np.flatnonzero(inside)[merged]
            leaves = np.zeros(self.arrows.states, dtype=bool)
            leaves[owners] = True
            _, after = reaching(self.arrows, leaves, self.inner)
            toward = rows_toward(self.arrows, after, self.inner)
            into[states] = toward[states]
        into[owners] = rows
        return into


class Reduced(NamedTuple):
    """An automaton without impossible or timeless parts.

    :ivar layer: the model of the states whose values are unknown.
    :ivar live: boolean array over the automaton's states: the states that the allowed rows never
        force a run to leave.
    :ivar rows: boolean array over the automaton's rows: the rows that stay there.
    :ivar constant: float array over the automaton's rows: the reward of each.
    """

    layer: Layer
    live: Booleans
    rows: Booleans
    constant: Floats

    def reachable(self, automaton: Automaton) -> Booleans:
        """Boolean array over the model's states: those that a run may reach."""
        start = self.layer.number[np.array([s for s, _ in automaton.initial], dtype=np.int64)]
        return forward(self.layer.model.arrows, np.unique(start[start >= 0]))


def arrows_of(automaton: Automaton) -> Arrows:
    """The rows and arcs of an automaton."""
    return Arrows(automaton.rows, automaton.arcs, automaton.targets)


def earnings(automaton: Automaton, rewards: Rewards) -> Floats:
    """The reward of each row: per second in a tangible state, otherwise per use.

    :raises UsageError: a reward is not a finite number.
    """
    rate = np.asarray(rewards.rate, dtype=np.float64)
    impulse = np.asarray(rewards.impulse, dtype=np.float64)
    if not (np.isfinite(rate).all() and np.isfinite(impulse).all()):
        raise UsageError("a reward is not a finite number")
    found: Floats = np.where(automaton.tangible, rate, 0.0)[automaton.row_states]
    if impulse.any():
        found = found + np.bincount(
            automaton.arc_rows, weights=automaton.values * impulse, minlength=len(found)
        )
    return found


def reduce(
    automaton: Automaton,
    constant: Floats,
    impulse: Optional[Floats],
    allowed: Optional[Booleans],
    *,
    goal: Optional[Booleans] = None,
    known: Optional[Floats] = None,
    discount: float = 0.0,
) -> Reduced:
    """The model of an automaton's states.

    :param constant: what each row earns.
    :param impulse: what each arc earns; None: nothing.
    :param allowed: the rows that may be taken; None: all.
    :param goal: states in which the run ends.
    :param known: their values; None: 0.
    :raises RefusedError: a start is impossible with these rows, or a cycle takes no time and has a
        reward, or cannot be left.
    """
    arrows = arrows_of(automaton)
    rows = np.ones(len(automaton.choices), dtype=bool) if allowed is None else allowed.copy()
    everything = np.ones(len(automaton), dtype=bool)
    live, rows = staying(arrows, everything, rows, goal)
    free = live & ~automaton.tangible
    if goal is not None:
        free &= ~goal
        rows = rows & ~goal[arrows.row_states]
    starts = np.array([s for s, _ in automaton.initial], dtype=np.int64)
    inner = np.zeros(len(rows), dtype=bool)
    component: Indices = np.full(len(automaton), -1, dtype=np.int64)
    count = 0
    if not live[starts].all():
        raise RefusedError(
            "no choice is allowed from the start: whatever is chosen, the run reaches a state "
            "without an allowed choice"
        )
    if _cycle_among(automaton, free):
        while True:
            found = end_components(arrows, free, rows & free[arrows.row_states])
            if impulse is not None and (impulse[found.rows[automaton.arc_rows]] != 0.0).any():
                raise RefusedError(
                    "a cycle of immediate transitions earns a reward without taking time",
                    hint="give the reward to a transition outside of the cycle, or to a place",
                )
            # a component without an exit is a timeless trap, which no run may enter
            outside = rows & ~found.rows
            held = found.of >= 0
            leaves = np.zeros(found.number, dtype=bool)
            leaves[found.of[arrows.row_states[outside & held[arrows.row_states]]]] = True
            trapped = held & ~leaves[np.where(held, found.of, 0)] if found.number else held
            if not trapped.any():
                break
            rows = rows & ~trapped[arrows.row_states]
            live, rows = staying(arrows, live & ~trapped, rows, goal)
            free &= live
            if not live[starts].all():
                raise RefusedError(
                    "a timeless trap: immediate transitions fire forever, whatever is chosen",
                    hint="a cycle of immediate transitions must have an exit",
                )
        inner, component, count = found.rows, found.of, found.number
    unknown = live if goal is None else live & ~goal
    number, size = numbered(unknown, component, count)
    exits = np.where(automaton.tangible, automaton.exit_rates[automaton.rows[:-1]] + discount, 1.0)
    model = made(
        automaton.tangible,
        arrows,
        automaton.values,
        constant,
        exits,
        number=number,
        size=size,
        rows=rows & ~inner & unknown[arrows.row_states],
        known=known,
        goal=goal,
    )
    return Reduced(Layer(model, arrows, number, inner), live, rows, constant)


def numbered(states: Booleans, component: Indices, count: int) -> Tuple[Indices, int]:
    """New numbers for ``states``: one for each component and each state that is in none, in the
    order of their first states; -1 for all others."""
    number: Indices = np.full(len(states), -1, dtype=np.int64)
    if not count:
        number[states] = np.arange(int(states.sum()))
        return number, int(states.sum())
    listed = np.flatnonzero(states)
    of = component[listed]
    key = np.where(of >= 0, len(states) + of, listed)
    _, first, numbers = np.unique(key, return_index=True, return_inverse=True)
    order = np.empty(len(first), dtype=np.int64)
    order[np.argsort(first, kind="stable")] = np.arange(len(first))
    number[listed] = order[numbers.reshape(-1)]
    return number, len(first)


def merge_components(
    model: Model,
    component: Indices,
    count: int,
    inner: Booleans,
    *,
    states: Optional[Booleans] = None,
    rows: Optional[Booleans] = None,
    known: Optional[Floats] = None,
) -> Layer:
    """The model in which each component of states is one state, without its ``inner`` rows.

    :param states: the states to keep; None: all.
    :param rows: the rows to keep; None: all of these states.
    """
    kept = np.ones(len(model), dtype=bool) if states is None else states
    number, size = numbered(kept, component, count)
    used = kept[model.row_states] & ~inner
    if rows is not None:
        used &= rows
    part = model.part(number, size, used, known)
    return Layer(part, model.arrows, number, inner)


def _cycle_among(automaton: Automaton, states: Booleans) -> bool:
    """Whether there is a cycle among ``states``."""
    if not states.any():
        return False
    sources = automaton.row_states[automaton.arc_rows]
    inner = states[sources] & states[automaton.targets]
    if not inner.any():
        return False
    return not longest_levels(len(states), sources[inner], automaton.targets[inner])[1]


def lifted(layers: List[Layer], values: Floats, chosen: Indices) -> Tuple[Floats, Indices]:
    """Values and rows of the innermost model, expressed for the source of the outermost one."""
    for layer in reversed(layers):
        size = layer.arrows.states
        values = layer.lift(values, np.full(size, np.nan))
        chosen = layer.lift_rows(chosen, np.full(size, -1, dtype=np.int64))
    return values, chosen

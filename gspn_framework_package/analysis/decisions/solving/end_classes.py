"""The end components of a model, in which a policy may stay forever."""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.decisions.automaton import Automaton
from gspn_framework_package.analysis.decisions.solving.graphs import (
    Arrows,
    EndComponents,
    end_components,
)
from gspn_framework_package.analysis.decisions.solving.layers import Layer, merge_components
from gspn_framework_package.analysis.decisions.solving.model import Model
from gspn_framework_package.analysis.graph import flat_ranges


def without_cost(
    model: Model, states: Booleans, rows: Booleans, proper: bool
) -> Tuple[Indices, Booleans, int]:
    """The end components in which a policy could stay without any cost: the component of each
    state, their rows, and their number."""
    if proper:
        return np.full(len(model), -1, dtype=np.int64), np.zeros(len(rows), dtype=bool), 0
    free = rows & (model.constant == 0.0) & ~model.into & states[model.row_states]
    found = end_components(model.arrows, states, free)
    return found.of, found.rows, found.number


class EndClasses:
    """The maximal end components of a model, taken one at a time."""

    def __init__(self, model: Model, parts: EndComponents) -> None:
        self._model = model
        held = np.flatnonzero(parts.of >= 0)
        self._order = held[np.argsort(parts.of[held], kind="stable")]
        self._begins = np.searchsorted(parts.of[self._order], np.arange(parts.number + 1))
        self._rows = parts.rows
        self._number = np.full(len(model), -1, dtype=np.int64)
        self.sizes = np.diff(self._begins)
        """The number of states of each."""
        self.first = self._order[self._begins[:-1]]
        """A state of each."""

    def states(self, component: int) -> Indices:
        """The states of a component."""
        return self._order[self._begins[component] : self._begins[component + 1]]

    def part(self, states: Indices) -> Tuple[Model, Indices]:
        """The model of a component, and the row of the whole model for each of its rows."""
        model, arrows = self._model, self._model.arrows
        if len(states) == len(model) and self._rows.all():
            return model, np.arange(len(model.constant))
        counts = arrows.rows[states + 1] - arrows.rows[states]
        listed = flat_ranges(arrows.rows[states], arrows.rows[states + 1])
        inside = self._rows[listed]
        owners = np.repeat(np.arange(len(states)), counts)[inside]
        listed = listed[inside]
        lengths = arrows.arcs[listed + 1] - arrows.arcs[listed]
        entries = flat_ranges(arrows.arcs[listed], arrows.arcs[listed + 1])
        self._number[states] = np.arange(len(states))
        local = Arrows(
            np.searchsorted(owners, np.arange(len(states) + 1)),
            np.concatenate([[0], np.cumsum(lengths)]),
            self._number[arrows.targets[entries]].astype(np.int32),
        )
        part = Model(
            model.tangible[states],
            local,
            model.values[entries],
            model.constant[listed],
            model.exits[states],
            np.arange(len(listed)),
            states,
            np.zeros(len(listed), dtype=bool),
        )
        return part, listed


def with_exits(base: Model, parts: EndComponents, gains: Floats) -> Tuple[Model, Indices, Layer]:
    """The model in which each end component is one state that may stay, with its gain, or leave.

    :return: the model; the row of each of its states in which it stays (-1: none); the mapping of
        its states from ``base``. Rows that stay come from no row of ``base``.
    """
    idle = base.earning(np.zeros(len(base.constant)))
    layer = merge_components(idle, parts.of, parts.number, parts.rows)
    model = layer.model
    held = np.flatnonzero(parts.of >= 0)
    staying = np.full(len(model), -1, dtype=np.int64)
    staying[layer.number[held]] = parts.of[held]
    stops = np.flatnonzero(staying >= 0)
    rows, arcs = model.arrows.rows, model.arrows.arcs
    at = rows[stops + 1]
    added = np.zeros(len(model) + 1, dtype=np.int64)
    added[1:] = np.cumsum(staying >= 0)
    tangible, exits = model.tangible.copy(), model.exits.copy()
    tangible[stops], exits[stops] = False, 1.0
    following = np.where(staying >= 0, rows[1:] + added[:-1], -1)
    whole = Model(
        tangible,
        Arrows(rows + added, np.insert(arcs, at, arcs[at]), model.arrows.targets),
        model.values,
        np.insert(model.constant, at, gains[staying[stops]]),
        exits,
        np.insert(model.row_ids, at, len(base.constant)),
        model.state_ids,
        np.insert(model.into, at, True),
    )
    return whole, following, layer


def spoil(automaton: Automaton, row_values: Floats, gains: Floats, width: float) -> None:
    """Mark the rows after which the gain is lower."""
    after = np.bincount(
        automaton.arc_rows,
        weights=automaton.values * np.nan_to_num(gains)[automaton.targets],
        minlength=len(automaton.choices),
    )
    own = gains[automaton.row_states]
    scale = float(np.nanmax(np.abs(gains)))
    worse = ~automaton.tangible[automaton.row_states] & (after < own - max(width, 1e-9 * scale))
    row_values[worse & ~np.isnan(row_values)] = -math.inf

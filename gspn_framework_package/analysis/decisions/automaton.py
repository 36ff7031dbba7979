"""The decision problem of a plan as arrays: a Markov automaton.

A state is either *tangible*, so that time passes there, or *vanishing*. A tangible state has one
*row*: arcs with exponential rates. A vanishing state has one row for each choice: arcs with
probabilities. See C. Eisentraut, H. Hermanns, L. Zhang, *On probabilistic automata in continuous
time* (LICS 2010).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices

WAIT = -1
"""The choice of a row in which robots that could move wait."""

CHANCE = -2
"""The choice of a row without a decision; also that of the row of a tangible state."""


@dataclass(frozen=True)
class Automaton:
    """A Markov automaton.

    :ivar tangible: boolean array, one value per state.
    :ivar rows: int64 array of states + 1: state ``s`` has the rows ``rows[s]`` to
      ``rows[s + 1]``: exactly one if it is tangible (without arcs if nothing more can happen), one
      or more if it is vanishing.
    :ivar arcs: int64 array of rows + 1: the arcs of each row.
    :ivar targets: int32 array: the state that each arc leads to.
    :ivar values: float array, one value per arc: the rate (1/s) in a tangible state, the
      probability in a vanishing one.
    :ivar fired: int32 array, one value per arc: the number of the plan's transition that fires;
      -1 if none does.
    :ivar choices: int32 array, one value per row: the number of the plan's transition that the row
      chooses, :data:`WAIT` or :data:`CHANCE`.
    :ivar initial: the possible initial states: pairs (state, probability).
    """

    tangible: Booleans
    rows: Indices
    arcs: Indices
    targets: Indices
    values: Floats
    fired: Indices
    choices: Indices
    initial: Tuple[Tuple[int, float], ...]

    def __len__(self) -> int:
        return len(self.tangible)

    @cached_property
    def row_states(self) -> Indices:
        """The state of each row."""
        return np.repeat(np.arange(len(self), dtype=np.int64), np.diff(self.rows))

    @cached_property
    def arc_rows(self) -> Indices:
        """The row of each arc."""
        return np.repeat(np.arange(len(self.choices), dtype=np.int64), np.diff(self.arcs))

    @cached_property
    def exit_rates(self) -> Floats:
        """Float array, one value per row: the sum of the rates (1/s) of a tangible state's row; 0
        for the rows of vanishing states."""
        sums = np.bincount(self.arc_rows, weights=self.values, minlength=len(self.choices))
        return np.where(self.tangible[self.row_states], sums, 0.0)


class Rewards(NamedTuple):
    """The rewards of a run; negative values are costs.

    :ivar rate: float array, one value per state: per second in it. It counts in tangible states
      only.
    :ivar impulse: float array, one value per arc: each time it is taken.
    """

    rate: Floats
    impulse: Floats

"""The best policy of an automaton, with the properties found."""

from __future__ import annotations

from typing import NamedTuple, Optional

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.decisions.automaton import Automaton
from gspn_framework_package.analysis.decisions.solving import layers
from gspn_framework_package.analysis.decisions.solving.graphs import any_of_row
from gspn_framework_package.analysis.decisions.solving.layers import Reduced


class Solved(NamedTuple):
    """The best policy.

    :ivar lower: certified lower bound of the best value from the automaton's initial states, and
      upper one: ``upper``. If it is maximised, the policy itself has at least the value ``lower``;
      if it is minimised, at most ``upper``.
    :ivar row_of: int array: the row that each state takes: the first of those that are equally good
      (within 1e-9 of the largest value); -1 where no row is allowed, in goals, and where the goal
      must be reached but is not reached with certainty.
    :ivar values: float array: for each state its probability, cost, time or discounted reward, or,
      in the long run, its bias: the extra reward of starting there, beyond the gain. NaN where no
      row is allowed; infinite where the goal is not reached with certainty.
    :ivar row_values: float array: for each row the value of its state if it takes this row now and
      the best ones later. NaN for rows that are not allowed; infinitely bad for rows that lower the
      gain of the long run permanently, or after which the goal is not reached with certainty.
    :ivar gains: float array: the best gain per second from each state; only for the long run,
        otherwise None.
    :ivar method: the method used.
    :ivar rounds: number of sweeps or rounds of policy iteration.
    """

    lower: float
    upper: float
    row_of: Indices
    values: Floats
    row_values: Floats
    gains: Optional[Floats]
    method: str
    rounds: int


def row_values_of(
    automaton: Automaton, allowed: Optional[Booleans], reduced: Reduced, values: Floats
) -> Floats:
    """The value of each row of the automaton."""
    known = np.where(reduced.live, values, 0.0)
    found = reduced.constant + np.bincount(
        automaton.arc_rows,
        weights=automaton.values * known[automaton.targets],
        minlength=len(automaton.choices),
    )
    found = np.where(automaton.tangible[automaton.row_states], values[automaton.row_states], found)
    ends = any_of_row(layers.arrows_of(automaton), ~reduced.live[automaton.targets])
    if allowed is not None:
        ends |= ~allowed
    found[ends] = np.nan
    return found

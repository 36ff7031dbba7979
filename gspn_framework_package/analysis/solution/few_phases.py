"""How many phases the durations of a plan get in its Markov chain."""

from __future__ import annotations

from typing import Mapping, Sequence, Union

import numpy as np

from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.plan.space import ChoosePhases, PlanSpace
from gspn_framework_package.analysis.solution.steady_state import steady_state
from gspn_framework_package.model.errors import LimitError, RefusedError
from gspn_framework_package.run_net.run_net import State
from gspn_framework_package.run_net.size import PhasesOfDurations

FEW_STATES = 100_000
"""Approximate maximum number of states, if the number of phases is not given."""


def phases_for(given: Union[None, int, Mapping[str, float]], limit: int) -> ChoosePhases:
    """How many phases durations get.

    :param given: the most for each, or for those of each place; None: as many as make about
        :data:`FEW_STATES` states.
    :param limit: the most states, if that is less.
    """
    few = min(FEW_STATES, limit)

    def choose(
        space: PlanSpace, many: PhasesOfDurations, states: Sequence[State]
    ) -> Mapping[str, float]:
        if isinstance(given, int):
            return dict.fromkeys([place.name for place in space.net.places], given)
        if given is not None:
            return given
        if many.states(states, many.everything) <= few:
            return {}
        shares = np.zeros(len(space))
        if len(space) < few:
            try:
                chain = Chain.of(space)
                shares[chain.states] = steady_state(chain).distribution
            except (LimitError, RefusedError):
                pass  # the mean times decide
        return many.chosen(states, shares, few)

    return choose

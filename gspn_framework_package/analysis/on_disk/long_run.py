"""The long-run distribution of a chain that is not entirely in memory."""

from __future__ import annotations

from typing import Any, Callable, Dict, Mapping, NamedTuple, Optional, Sequence

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats
from gspn_framework_package.analysis.solution.measures import waiting_times
from gspn_framework_package.model.net import Net


class LongRun(NamedTuple):
    """The long-run share of time in each state (``values``), the number of recurrent states,
    whether they are a deadlock, and the residual and method of the solution."""

    values: Floats
    recurrent: int
    deadlock: bool
    residual: float
    method: str

    def answers(
        self,
        net: Net,
        means: Sequence[float],
        rates: Sequence[float],
        distributions: Sequence[Mapping[int, float]],
        likeliest: Mapping[str, int],
    ) -> Dict[str, Any]:
        """The steady state, with the same keys as in the report of an analysis in memory.

        :param means: the mean tokens of each place.
        :param rates: the throughput (1/s) of each transition.
        :param distributions: for each place: number of tokens -> probability.
        :param likeliest: the most probable marking, without empty places.
        """
        names = [place.name for place in net.places]
        mean_tokens = dict(zip(names, means))
        throughput = {t.name: value for t, value in zip(net.transitions, rates)}
        return {
            "mean_tokens": mean_tokens,
            "throughput": throughput,
            "token_distribution": {
                name: {str(count): value for count, value in counts.items()}
                for name, counts in zip(names, distributions)
            },
            "mean_waiting_time": waiting_times(net, mean_tokens, throughput),
            "residual": self.residual,
            "method": self.method,
            "components": [
                {
                    "states": self.recurrent,
                    "probability": 1.0,
                    "deadlock": self.deadlock,
                    "alike": 1,
                    "marking": likeliest,
                }
            ],
            "component_count": 1,
            "deadlock_count": int(self.deadlock),
            "probability_of_other_components": 0.0,
        }


def recurrent_states(
    dead: Booleans,
    initial: Booleans,
    reaching: Callable[[int], Booleans],
    reached: Callable[[int], Booleans],
) -> Optional[Booleans]:
    """Boolean array: which states recur; None: there are several recurrent classes.

    :param dead: boolean array: the states that nothing leaves.
    :param initial: boolean array: the initial state, if it is one of the chain's states.
    :param reaching: returns the states from which the state with a given number can be reached.
    :param reached: returns the states that can be reached from it.
    """
    state = _last(dead)
    begins_there = False
    if state is None:
        # the initial state if it is tangible, since it reaches all others
        begins_there = bool(initial.any())
        state = _last(initial) if begins_there else 0
    while True:
        assert state is not None
        lead_there = reaching(state)
        if lead_there.all():
            return lead_there if begins_there else reached(state)
        state = _last(reached(state) & ~lead_there)
        begins_there = False
        if state is None:  # it is recurrent, and some states never lead to it
            return None


def _last(states: Booleans) -> Optional[int]:
    """The number of the last of these states; None if there is none."""
    numbers = np.flatnonzero(states)
    return int(numbers[-1]) if len(numbers) else None

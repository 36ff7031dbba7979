"""Where a chain is in the long run, if not all of it is in the memory of one process."""

from __future__ import annotations

from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats
from gspn_framework_package.analysis.distributed.ranks import Ranks
from gspn_framework_package.analysis.solution.measures import waiting_times
from gspn_framework_package.model.net import Net

SEVERAL_CLASSES = "the chain may end in one of several recurrent classes"
"""Why there is no answer for a chain with several of them."""


class LongRun(NamedTuple):
    """The long-run share of time in each state of this rank (``values``), how many states of all
    ranks recur, whether nothing happens there any more, and the residual and method behind it."""

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
        """The steady state, with the keys that it has in the report of an analysis in memory.

        :param means: the mean tokens of each place.
        :param rates: the throughput (1/s) of each transition.
        :param distributions: for each place: number of tokens -> probability.
        :param likeliest: the most probable marking, without its empty places.
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
    ranks: Ranks,
    dead: Booleans,
    initial: Booleans,
    reaching: Callable[[int], Booleans],
    reached: Callable[[int], Booleans],
) -> Optional[Booleans]:
    """Boolean array: which states of this rank recur; None: there are several recurrent classes.
    All ranks call it together.

    :param dead: boolean array: the states of this rank that nothing leaves.
    :param initial: boolean array: where the chain begins, if it is a state of this rank.
    :param reaching: returns the states of this rank from which a state can be reached, which is
        given by its number; -1 if it belongs to another rank.
    :param reached: returns those that can be reached from a state.
    """
    state = _chosen(ranks, dead)
    begins_there = state is None
    if state is None:
        # the initial one, if it is tangible: then all others are reached from it
        begins_there = any(ranks.gather(bool(initial.any())))
        here = initial.copy()
        here[:1] |= not begins_there
        state = _chosen(ranks, here)
    assert state is not None  # a chain has a state
    while True:
        lead_there = reaching(state)
        everywhere = all(ranks.gather(bool(lead_there.all())))
        if everywhere and begins_there:
            return lead_there
        found = reached(state)
        if everywhere:
            return found
        state = _chosen(ranks, found & ~lead_there)
        begins_there = False
        if state is None:  # it recurs, and some states never lead there
            return None


def _chosen(ranks: Ranks, candidates: Booleans) -> Optional[int]:
    """The last of the candidates of the first rank that has one, by its number there (-1 on the
    others); None if there is none."""
    having: List[bool] = ranks.gather(bool(candidates.any()))
    if not any(having):
        return None
    return int(np.flatnonzero(candidates)[-1]) if having.index(True) == ranks.rank else -1

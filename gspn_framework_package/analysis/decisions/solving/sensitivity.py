"""The sensitivity of a value to the rates of the net.

Let ``y(s)`` be the time that runs spend in a tangible state (its share, in the long run), ``V`` the
values and ``rho`` the reward of a firing. A rate ``q`` of an arc from s to t that is proportional
to the rate ``lambda`` of a transition adds ``y(s) * q * (rho + V(t) - V(s)) / lambda`` to the
derivative of the value with respect to ``lambda`` (X.-R. Cao, *Stochastic Learning and
Optimization*, Springer 2007). At an optimum the best policy has the same derivative.
"""

from __future__ import annotations

from typing import Optional

import numpy as np

from gspn_framework_package.analysis.arrays import Floats, Indices
from gspn_framework_package.analysis.decisions.aims import Aim
from gspn_framework_package.analysis.decisions.automaton import Automaton, Rewards
from gspn_framework_package.analysis.decisions.solving.evaluation import Evaluated
from gspn_framework_package.model.errors import RefusedError


def sensitivities(
    automaton: Automaton,
    aim: Aim,
    rewards: Optional[Rewards],
    evaluated: Evaluated,
    rates: Floats,
    *,
    labels: Optional[Indices] = None,
) -> Floats:
    """The derivative of a policy's value with respect to each rate.

    :param rewards: the rewards of the aim; None for TIME_TO and REACH.
    :param evaluated: the value of the policy.
    :param rates: float array: the rate (1/s) of each transition.
    :param labels: int array over the arcs: the number of the transition whose rate each rate is
        proportional to (-1: none); None: the one that fires.
    :return: float array, one value per transition.
    :raises RefusedError: the gain of the long run depends on where the run ends up.
    """
    sources = automaton.row_states[automaton.arc_rows]
    if evaluated.gains is not None:
        seen = evaluated.gains[[s for s, _ in automaton.initial]]
        visited = evaluated.gains[evaluated.sojourn > 0]
        everything = np.concatenate([seen, visited])
        if np.ptp(everything) > 1e-9 * np.abs(everything).max(initial=0.0):
            raise RefusedError(
                "no derivative: the reward in the long run depends on where the run ends up"
            )
    own = automaton.fired if labels is None else labels
    weight = np.where(automaton.tangible[sources], evaluated.sojourn[sources], 0.0)
    arcs = np.flatnonzero((weight > 0) & (own >= 0))
    values = evaluated.values
    gained = values[automaton.targets[arcs]] - values[sources[arcs]]
    if rewards is not None and aim not in (Aim.TIME_TO, Aim.REACH):
        gained = gained + np.asarray(rewards.impulse, dtype=np.float64)[arcs]
    change = np.bincount(
        own[arcs], weights=weight[arcs] * automaton.values[arcs] * gained, minlength=len(rates)
    )
    result: Floats = np.divide(change, rates, out=np.zeros(len(rates)), where=np.asarray(rates) > 0)
    return result

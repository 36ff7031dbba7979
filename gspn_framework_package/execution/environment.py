"""The simulated environment: exponential transitions that move no robot fire at their rates.

This applies only to plans with ``environment: simulate``; otherwise the operator fires them.
"""

from __future__ import annotations

import random
from typing import List, Optional, Tuple

from gspn_framework_package.execution.chance import choose
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import TokenGame


class Environment:
    """Draws when the environment fires next.

    Waiting times are memoryless, so the time is drawn again whenever the marking has changed.

    :param game: the rules.
    :param source: the random number generator.
    """

    def __init__(self, game: TokenGame, source: random.Random) -> None:
        self._game = game
        self._source = source
        self._version: Optional[int] = None
        self._time: Optional[float] = None
        self._choices: List[Tuple[str, float]] = []

    def next_time(self, state: TeamState, now: float) -> Optional[float]:
        """When the environment fires next (seconds, on the clock of ``now``); None if never."""
        if not self._game.plan.simulate_environment or state.paused or state.ended is not None:
            self._version = None
            return None
        if self._version != state.version:
            self._version = state.version
            net = self._game.net
            self._choices = [
                (net.transitions[t].name, net.effective_rate(state.marking, t))
                for t in self._game.environment_transitions
                if net.is_enabled(state.marking, t)
            ]
            total = sum(rate for _, rate in self._choices)
            self._time = now + self._source.expovariate(total) if total > 0 else None
        return self._time

    def due(self, state: TeamState, now: float) -> Optional[str]:
        """The transition that is due at ``now``, None if none is; the next time is then drawn
        anew."""
        time = self.next_time(state, now)
        if time is None or now < time:
            return None
        self._version = None
        return choose(self._choices, self._source.random())

"""The simulated environment: exponential transitions that move no robot fire at their rates.

This applies only to plans with ``environment: simulate``; otherwise the operator fires these
transitions, and tasks come from their sources. The clock, transitions that fire in certain hours of
the day, always runs (:func:`next_of_clock`).
"""

from __future__ import annotations

import random
from typing import Collection, List, Optional, Tuple, Union

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.chance import choose
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import TokenGame


def next_of_clock(
    game: TokenGame, state: TeamState, seconds: float
) -> Optional[Tuple[float, log_entries.Fire]]:
    """The next transition of the clock that fires if nothing else happens: in how many seconds, and
    its entry; None if none does.

    :param seconds: the time of day, in seconds since 1970.
    """
    if not game.clock or state.paused or state.ended is not None:
        return None
    net = game.net
    waits = [
        (game.interrupts[t].seconds_to_hours(seconds), t)
        for t in game.clock
        if net.is_enabled(state.marking, t)
    ]
    if not waits:
        return None
    wait, t = min(waits)
    return wait, log_entries.Fire(net.transitions[t].name)


class Environment:
    """Draws when the environment fires next.

    Waiting times are memoryless, so the time is redrawn whenever the marking has changed.

    :param source: the random number generator.
    :param without: transitions not to simulate, because their tasks have a source.
    :param tasks: whether to draw tasks even if the plan does not simulate its environment.
    """

    def __init__(
        self,
        game: TokenGame,
        source: random.Random,
        *,
        without: Collection[str] = (),
        tasks: bool = False,
    ) -> None:
        self._game = game
        self._source = source
        self._transitions = [
            t
            for t in game.environment_transitions
            if game.net.transitions[t].name not in without
            and t not in game.clock
            and (game.plan.simulate_environment or (tasks and t in game.submissions))
        ]
        self._version: Optional[int] = None
        self._time: Optional[float] = None
        self._choices: List[Tuple[str, float]] = []

    def next_time(self, state: TeamState, now: float) -> Optional[float]:
        """When the environment fires next (seconds, on the clock of ``now``); None if never."""
        if not self._transitions or state.paused or state.ended is not None:
            self._version = None
            return None
        if self._version != state.version:
            self._version = state.version
            net = self._game.net
            self._choices = [
                (net.transitions[t].name, net.effective_rate(state.marking, t))
                for t in self._transitions
                if net.is_enabled(state.marking, t)
            ]
            total = sum(rate for _, rate in self._choices)
            self._time = now + self._source.expovariate(total) if total > 0 else None
        return self._time

    def due(
        self, state: TeamState, now: float
    ) -> Optional[Union[log_entries.Fire, log_entries.Submit]]:
        """The entry that is due at ``now``: a new task, or another firing; None if it is not yet
        time. The next time is then redrawn."""
        time = self.next_time(state, now)
        if time is None or now < time:
            return None
        self._version = None
        name = choose(self._choices, self._source.random())
        if self._game.net.transition_number(name) in self._game.submissions:
            return log_entries.Submit(name, "%s-%d" % (name, state.next_slot))
        return log_entries.Fire(name)

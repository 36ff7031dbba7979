"""Faults in the token game."""

from __future__ import annotations

import random
from typing import Any, ContextManager, List, Sequence
from unittest import mock

from agreement.mutants.mutant import Mutant, wrap
from gspn_framework_package.execution import token_game as token_game_module
from gspn_framework_package.execution import turn
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.model.net import Net


def _no_visit_check() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def current(self: Any, name: str, incarnation: int, visit: int) -> Any:
            robot = self.state.robots.get(name)
            return original(self, name, incarnation, robot.visit if robot else visit)

        return current

    owner = next(
        c for c in vars(token_game_module).values() if isinstance(c, type) and "_current" in vars(c)
    )
    return wrap(owner, "_current", make)


def _last_comes_first() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def add_waiting(self: TeamState, robot: Any) -> None:
            original(self, robot)
            self.waiting = {robot.name: None, **self.waiting}
            here = self.done_in[robot.place]
            self.done_in[robot.place] = {robot.name: None, **here}

        return add_waiting

    return wrap(TeamState, "add_waiting", make)


def _local_randomness() -> ContextManager[Any]:
    return mock.patch.object(turn, "uniform", lambda *_: random.random())


def _biased_draw() -> ContextManager[Any]:
    return mock.patch.object(turn, "choose", lambda choices, number: choices[0][0])


def _forgets_inhibitors() -> ContextManager[Any]:
    def careless(self: Net, marking: Sequence[int], t: int) -> bool:
        return all(marking[p] >= weight for p, weight in self.inputs[t])

    return mock.patch.object(Net, "is_enabled", careless)


MUTANTS: List[Mutant] = [
    Mutant(
        "visit check",
        "token game",
        "a Done of any visit counts for the present one",
        _no_visit_check,
    ),
    Mutant("order", "token game", "the robot done last moves first", _last_comes_first),
    Mutant("local dice", "token game", "draws are local randomness", _local_randomness),
    Mutant("loaded dice", "token game", "the first choice is always drawn", _biased_draw),
    Mutant(
        "enabling",
        "token game",
        "inhibitor arcs and capacities are ignored",
        _forgets_inhibitors,
    ),
]

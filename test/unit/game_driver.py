"""A token game driven entry by entry, for the tests of this folder."""

from __future__ import annotations

from collections import Counter
from typing import Any, List

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.firing import Firing
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan, RobotSpec


def make_plan(
    net: Net, robots: List[str], resources: Any = (), idle: Any = (), **fields: Any
) -> Plan:
    """A plan whose robots a, b, c ... start in the given places."""
    actions = {
        p.name: None if p.name in idle else FunctionAction("actions.f", p.name)
        for p in net.places
        if p.name not in resources
    }
    plan = Plan(net=net, actions=actions, resource_places=frozenset(resources), **fields)
    return plan.with_robots([RobotSpec("abcdefgh"[i], p) for i, p in enumerate(robots)]).validate()


class Run:
    """A token game with its state, driven entry by entry.

    :param in_order: that between equals the first robot to finish goes first.
    """

    def __init__(self, plan: Plan, agents: bool = False, in_order: bool = False) -> None:
        self.game = TokenGame(plan, agents=agents)
        self.state = self.game.new_state()
        self.firings: List[Firing] = []
        self.commands: List[Any] = []
        self.feed(self.game.start_entry()._replace(draws_ties=not in_order))

    def feed(self, *entries: Any) -> List[str]:
        """Apply the entries as one slot; the transitions that fired."""
        step = self.game.reduce(self.state, self.state.next_slot, entries)
        self.firings += step.firings
        self.commands += step.commands
        check_invariants(self.game, self.state)
        return [f.transition for f in step.firings]

    def done(self, robot: str, result: str = "", data: Any = log_entries.NOTHING) -> List[str]:
        state = self.state.robots[robot]
        return self.feed(log_entries.Done(robot, state.incarnation, state.visit, result, data))

    def event(self, robot: str, transition: str, cause: Any = log_entries.NOTHING) -> List[str]:
        state = self.state.robots[robot]
        return self.feed(
            log_entries.Interrupt(robot, state.incarnation, state.visit, transition, cause)
        )

    def fail(self, robot: str, reason: str = "aborted") -> List[str]:
        state = self.state.robots[robot]
        return self.feed(
            log_entries.Failed(robot, state.incarnation, state.visit, state.attempt, reason)
        )

    def place(self, robot: str) -> str:
        return self.game.net.places[self.state.robots[robot].place].name

    def marking(self) -> Any:
        return self.game.net.named(self.state.marking, zeros=False)

    def why(self, robot: str) -> str:
        return self.game.why_waiting(self.state, self.state.robots[robot])


def check_invariants(game: TokenGame, state: TeamState) -> None:
    """Every robot is one token in its place, counts are never negative, and a snapshot is the same
    state."""
    counts = Counter(r.place for r in state.active())
    for p, acts in enumerate(game.acts):
        assert state.marking[p] >= 0
        if acts:
            assert state.marking[p] == counts.get(p, 0)
    for p in game.queues:
        assert len(state.queues.get(p, ())) == state.marking[p]
    again = game.state_from_json(state.to_json(game.net))
    assert again == state

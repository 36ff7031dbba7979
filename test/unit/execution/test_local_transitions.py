"""Local transitions that wait, because their robot is cut off from the others: what they cost, and
that none is lost, however many there are."""

from __future__ import annotations

import cProfile
import dataclasses
import pstats
from typing import Any, Callable, Dict

import pytest

from agreement.world import World
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import consensus, interface, proposals
from gspn_framework_package.execution.agreement.local_transitions import LocalTransitions
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.marking_function import parse_value
from gspn_framework_package.model.net import Arc, Place, Transition
from gspn_framework_package.model.plan import Plan, RobotSpec, Synchronisation, Timing


def _ring() -> Plan:
    builder = NetBuilder("ring").place("A").place("B").place("C")
    for source, target in ("AB", "BC", "CA"):
        builder = builder.exponential(source + target, inputs=source, outputs=target)
    net = builder.build()
    plan = Plan(
        net=net, actions={p.name: FunctionAction("actions.act", p.name) for p in net.places}
    )
    return dataclasses.replace(
        plan,
        robots=tuple(RobotSpec(name, "A") for name in ("r1", "r2", "r3")),
        synchronisation=Synchronisation.PARTIAL,
        timing=Timing(evict_after=0.0, fence_after=0.0),
    )


class Ring(World):
    """A team of which r1 is cut off, and makes so many local transitions."""

    def __init__(self, waiting: int) -> None:
        super().__init__(_ring(), 1, action_time=(0.3, 0.3))
        self.mishaps = False
        for node in self.nodes.values():
            node.start()
        assert self.run(0.25, lambda: all(n.replica.is_settled() for n in self.nodes.values()))
        self.action_time = (0.0005, 0.0005)
        self.blocked = {
            (a, b) for a in self.nodes for b in self.nodes if (a == "r1") != (b == "r1")
        }
        self.waiting = waiting

    def start_action(self, node: Any, goal: StartAction) -> None:
        if node.name == "r1":  # the others are at work for long
            super().start_action(node, goal)

    @property
    def own(self) -> Any:
        return self.nodes["r1"].replica.state.own_proposals

    def move_alone(self) -> None:
        assert self.run(self.now + 1e6, lambda: len(self.own) >= self.waiting)
        self.acting = False

    def restart(self) -> None:
        self.nodes["r1"].crash()
        self.nodes["r1"].start()

    def heal(self) -> None:
        self.blocked = set()
        assert self.run(self.now + 60, lambda: not len(self.own) and self.has_settled())

    def pause(self) -> None:
        """r2 proposes an order that none of them may be passed by."""
        self.blocked = set()
        self.nodes["r2"].give(interface.Order("pause", log_entries.Pause()))
        self.heal()
        assert self.nodes["r2"].results["pause"].ok

    def check(self) -> None:
        logs = [EventLog(str(d.header["log"]), d.header, d.records()) for d in self.logs()]
        verdict = verify(logs, settled=True)
        assert verdict.violation is None, verdict.violation
        assert verdict.firings >= self.waiting


def _calls(what: Callable[[], None]) -> int:
    profile = cProfile.Profile()
    profile.runcall(what)
    return int(pstats.Stats(profile).total_calls)  # type: ignore[attr-defined]


def _cost(waiting: int, end: Callable[[Ring], None]) -> Dict[str, int]:
    """How many calls each part takes."""
    world = Ring(waiting)
    return {
        "alone": _calls(world.move_alone),
        "again": _calls(world.restart),
        "together": _calls(lambda: end(world)),
        "verified": _calls(world.check),
    }


@pytest.mark.parametrize("end", [Ring.heal, Ring.pause])
def test_each_local_transition_that_waits_costs_the_same(end: Callable[[Ring], None]) -> None:
    few, many = _cost(300, end), _cost(1200, end)
    assert {part: many[part] for part in many if many[part] > 1.15 * 4 * few[part]} == {}


def test_an_order_waits_until_more_are_told_than_a_message_holds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for module in (consensus, proposals):
        monkeypatch.setattr(module, "MOST_ITEMS", 20)
    world = Ring(50)
    world.move_alone()
    world.pause()
    world.check()


def test_a_place_that_a_rate_names_is_not_private():
    plan = _ring()
    assert LocalTransitions(TokenGame(plan), "r1").places == {"A", "B", "C"}
    net = (
        plan.net.with_place(Place("stock", 1))
        .with_transition(Transition("sell", timed=True, rate=parse_value("1 + #B")))
        .with_arc(Arc("stock", "sell"))
    )
    named = dataclasses.replace(plan, net=net, resource_places=frozenset({"stock"}))
    assert LocalTransitions(TokenGame(named), "r1").places == {"C"}

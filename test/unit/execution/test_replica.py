"""The agreement core, case by case; its behaviour under faults is in test/simulation."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any, List, Optional

import pytest

from agreement.plans import make_plan
from agreement.world import (
    SimulatedNode,
    Weather,
    World,
)
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.local_transitions import LocalTransitions
from gspn_framework_package.execution.agreement.membership import GUESTS
from gspn_framework_package.execution.agreement.messages import (
    Batch,
    Envelope,
    Hello,
    Learn,
    Proposals,
)
from gspn_framework_package.execution.agreement.quorum import Ballot, is_quorum
from gspn_framework_package.execution.agreement.replica import Pace, ProtocolLimits, Replica
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.execution.firing import Ended, StartAction
from gspn_framework_package.execution.ledger import Item, Origin
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.plan import Plan, RobotSpec, Synchronisation, Timing
from gspn_framework_package.model.policy import Policy

TOUR, MEET, TOKENS, CROWD = range(4)


class Team(World):
    """A team without faults but those that the test makes; a replica that halts does not raise."""

    def on_halted(self, node: SimulatedNode) -> None:
        pass

    def status(self, name: str) -> Any:
        return self.nodes[name].replica.status()

    def order(self, name: str, entry: log_entries.Entry) -> Optional[interface.OrderResult]:
        self.nodes[name].give(interface.Order("the order", entry))
        self.run(self.now + 1.0)
        return self.nodes[name].results.get("the order")

    def check(self, **how: Any) -> None:
        logs = [EventLog(d.header["log"], d.header, d.records()) for d in self.logs()]
        verdict = verify(logs, **how)
        assert verdict.violation is None, verdict.violation


def team(
    kind: int, robots: int, partial: bool = False, weather: Optional[Weather] = None, **how: Any
) -> Team:
    fields = {"evict_after": 0.0, "fence_after": 0.0, "witness": False, **how}
    world = Team(make_plan(kind, robots, partial, **fields), 1, weather)
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    return world


def settle(world: Team) -> None:
    world.acting = False
    assert world.run(world.now + 5, world.has_settled)


@pytest.mark.parametrize("size", range(1, 9))
def test_any_two_quorums_share_a_member(size: int) -> None:
    members = ["m%d" % i for i in range(size)]
    subsets = [{m for i, m in enumerate(members) if bits >> i & 1} for bits in range(1 << size)]
    quorums = [s for s in subsets if is_quorum(s, members)]
    assert all(a & b for a in quorums for b in quorums)
    assert not is_quorum([], members)
    assert is_quorum(members, members)


@pytest.mark.parametrize("partial", [False, True])
def test_one_robot_needs_no_messages(partial: bool) -> None:
    replica = Replica(make_plan(TOKENS, 1, partial, 0.0, 0.0, False), "r1", "run", "log")
    # somebody might know more
    assert not [e for e in replica.start(0.0) if isinstance(e, StartAction)]
    assert not [
        e
        for e in replica.step(interface.Order("o", log_entries.Pause("r1")), 0.1)
        if isinstance(e, interface.OrderResult)
    ]
    effects = replica.step(interface.Tick(), 0.5)
    assert [e.ok for e in effects if isinstance(e, interface.OrderResult)] == [True]
    effects += replica.step(interface.Order("o", log_entries.Resume("r1")), 0.5)
    for result in ["t1", "t2", "t3", "t4"]:
        (goal,) = [e for e in effects if isinstance(e, StartAction)]
        effects = replica.step(
            interface.ActionDone(goal.incarnation, goal.visit, goal.attempt, result), 0.6
        )
        assert not [e for e in effects if isinstance(e, interface.Send) and e.to]
        assert [
            e.firing.transition for e in effects if isinstance(e, interface.Fired) and e.publish
        ] == [result]


def test_a_record_is_written_before_anything_that_depends_on_it() -> None:
    world = team(TOKENS, 3)
    seen: List[List[interface.Effect]] = []
    for node in world.nodes.values():
        carry_out = node.carry_out
        node.carry_out = lambda effects, go=carry_out: (seen.append(effects), go(effects))[1]
    world.run(0.5)
    votes = 0
    for effects in seen:
        for i, effect in enumerate(effects):
            if isinstance(effect, interface.Send) and effect.message["kind"] in (
                "accept",
                "accepted",
            ):
                slot = effect.message["slot"]
                written = [e.record for e in effects[:i] if isinstance(e, interface.Persist)]
                votes += any(r["kind"] == "accepted" and r["slot"] == slot for r in written)
    assert votes > 20


def test_nobody_acts_before_all_are_there() -> None:
    world = Team(make_plan(TOKENS, 3, False, 0.0, 0.0, False), 1)
    for name in ("r1", "r2"):
        world.nodes[name].start()
    world.run(1.0)
    assert world.status("r1")["waits_for"] == "waits for r3 to start"
    assert world.length() == 1
    world.nodes["r3"].start()
    world.run(2.0)
    assert world.length() > 5


def test_the_operator_can_start_without_a_robot_that_never_came() -> None:
    world = Team(make_plan(TOKENS, 3, False, 0.0, 0.0, False), 1)
    for name in ("r1", "r2"):
        world.nodes[name].start()
    world.run(0.5)
    ann = log_entries.Giver("ann", "certificate")
    world.nodes["r1"].give(interface.OrderGiven("force_evict", "r3", "", *ann))
    world.nodes["r1"].give(interface.ForceEvict("f", "r3", ann))
    world.run(1.5)
    assert world.nodes["r1"].results["f"].ok
    assert world.status("r1")["members"] == ["r1", "r2"]
    assert world.length() > 5


@pytest.mark.parametrize("partial", [False, True])
def test_a_pause_stops_the_team_and_a_resume_lets_it_go_on(partial: bool) -> None:
    world = team(TOUR, 3, partial)
    world.run(0.4)
    assert world.order("r2", log_entries.Pause()).ok
    fired = len(world.published)
    world.run(world.now + 0.5)
    assert len(world.published) == fired
    assert all(r["state"] == "Paused" for r in world.status("r1")["robots"])
    assert world.order("r3", log_entries.Resume()).ok
    assert len(world.published) > fired
    settle(world)
    world.check(settled=True)


@pytest.mark.parametrize(
    ("entry", "why"),
    [
        (log_entries.SetPlace("r1", "nowhere"), "not an action place"),
        (log_entries.SetPlace("r9", "A"), "no robot 'r9'"),
        (log_entries.Fire("nothing"), "no transition 'nothing'"),
        (log_entries.Retry("r1"), "did not fail"),
        (log_entries.Evict("r7", -1), "no robot 'r7'"),
    ],
)
def test_orders_that_make_no_sense_are_refused_at_once(entry: log_entries.Entry, why: str) -> None:
    world = team(TOUR, 2)
    world.run(0.3)
    result = world.order("r1", entry)
    assert not result.ok
    assert why in result.text


@pytest.mark.parametrize("partial", [False, True])
def test_a_silent_robot_is_evicted_and_comes_back(partial: bool) -> None:
    world = team(MEET, 3, partial, evict_after=0.4)
    world.run(0.5)
    world.nodes["r2"].suspended = True
    world.run(2.0)
    assert world.status("r1")["members"] == ["r1", "r3"]
    world.nodes["r2"].resume()
    world.run(3.0)
    assert world.status("r1")["members"] == ["r1", "r2", "r3"]
    assert world.status("r2")["incarnation"] == 1
    settle(world)
    world.check(settled=True)


def test_of_two_the_first_goes_on_alone_and_the_second_says_what_it_waits_for() -> None:
    world = team(MEET, 2, evict_after=0.4)
    world.run(0.5)
    world.nodes["r2"].crash()
    world.run(1.5)
    assert world.status("r1")["members"] == ["r1"]
    world = team(MEET, 2, evict_after=0.4)
    world.run(0.5)
    world.nodes["r1"].crash()
    world.run(2.0)
    assert world.status("r2")["members"] == ["r1", "r2"]
    assert not world.status("r2")["quorum"]
    assert "r1" in world.status("r2")["waits_for"]
    world.nodes["r2"].give(interface.ForceEvict("f", "r1"))
    world.run(3.0)
    assert world.nodes["r2"].results["f"].ok
    assert world.status("r2")["members"] == ["r2"]


@pytest.mark.parametrize("partial", [False, True])
def test_a_team_whose_quorum_lost_its_memory_says_so(partial: bool) -> None:
    world = team(TOKENS, 2, partial)
    world.run(1.0)
    world.nodes["r1"].crash()
    world.nodes["r1"].lose_log()
    world.nodes["r1"].start()
    world.run(4.0)
    length = world.length()
    assert world.status("r1")["waits_for"].startswith(
        "waits to be admitted to the team: too many robots lost their logs"
    )
    assert world.status("r2")["waits_for"].startswith(
        "has no quorum; without a vote: r1: too many robots lost their logs"
    )
    assert world.status("r1")["stuck"]
    assert world.status("r2")["stuck"]
    world.run(8.0)
    assert world.length() == length
    world.check()


def test_a_witness_keeps_two_robots_going_whichever_dies() -> None:
    for dead in ("r1", "r2"):
        world = team(MEET, 2, evict_after=0.4, witness=True)
        world.run(0.5)
        world.nodes[dead].crash()
        world.run(2.0)
        (left,) = {"r1", "r2"} - {dead}
        assert world.status(left)["members"] == [left, "w"]


def test_a_robot_given_up_by_force_that_knew_more_learns_the_log_anew() -> None:
    world = team(TOKENS, 2)
    world.run(0.3)
    world.blocked = {("r1", "r2"), ("r2", "r1")}
    world.run(1.0)  # r1 alone is a quorum, and goes on
    ahead = world.nodes["r1"].replica.ledger.length
    assert ahead > world.nodes["r2"].replica.ledger.length
    world._chain.clear()  # from here on the two logs differ, as the operator decided
    world.on_record = lambda node, record: None  # type: ignore[method-assign]
    world.nodes["r2"].give(interface.ForceEvict("f", "r1"))
    world.run(2.0)
    assert world.status("r2")["members"] == ["r2"]
    world.blocked.clear()
    world.run(4.0)
    assert world.status("r2")["members"] == ["r1", "r2"]
    settle(world)
    assert world.status("r1")["hash"] == world.status("r2")["hash"]
    world.check()


def test_a_fenced_robot_stops_its_action_and_starts_it_again() -> None:
    world = team(TOUR, 3, evict_after=3.0, fence_after=0.4)
    world.action_time = (10.0, 10.0)
    world.run(0.5)
    world.blocked = {(a, b) for a in world.nodes for b in world.nodes if "r3" in (a, b)}
    world.run(1.5)
    assert world.status("r3")["fenced"]
    assert "no contact with a quorum" in world.status("r3")["waits_for"]
    assert world.nodes["r3"].replica.state.running is None
    world.blocked.clear()
    world.run(3.0)
    assert not world.status("r3")["fenced"]
    running = world.nodes["r3"].replica.state.running
    assert running is not None
    assert running.attempt == 2


@pytest.mark.parametrize("partial", [False, True])
def test_a_restarted_robot_takes_its_visit_up_with_the_next_attempt(partial: bool) -> None:
    world = team(TOKENS, 3, partial)
    world.run(0.5)
    world.action_time = (10.0, 10.0)
    world.run(1.0)
    before = world.nodes["r2"].replica.state.position
    world.nodes["r2"].crash()
    world.run(1.3)
    world.nodes["r2"].start()
    world.run(2.0)
    after = world.nodes["r2"].replica.state.position
    assert (after.place, after.visit) == (before.place, before.visit)
    assert (after.incarnation, after.attempt) == (before.incarnation + 1, before.attempt + 1)
    world.check()


def test_another_plan_is_not_let_in() -> None:
    world = team(TOKENS, 2)
    world.run(0.3)
    other = replace(world.plan, seed=7)
    stranger = Replica(other, "r2", "sim", "other log")
    stranger.start(0.0)
    hello = Hello(0, True, False, "", (), {}, {}, {})
    message = Envelope("r1", "sim|%s" % world.plan.hash()[:12], "a log", 0, 0, 1, "", hello)
    effects = stranger.step(interface.Received(message.to_json()), 0.1)
    (halted,) = [e for e in effects if isinstance(e, interface.Halted)]
    assert "r1 has a different plan" in halted.reason


def test_messages_of_other_runs_are_ignored() -> None:
    world = team(TOKENS, 2)
    world.run(0.3)
    replica = world.nodes["r1"].replica
    length = replica.ledger.length
    learn = Learn(at=length, slots=((Ballot(9, "r2"), Batch.of([]), replica.ledger.hash),))
    other = "old|%s" % world.plan.hash()[:12]
    message = Envelope("r2", other, world.nodes["r2"].replica.log_id, 0, 0, length + 1, "", learn)
    effects = replica.step(interface.Received(message.to_json()), world.now)
    assert not [e for e in effects if isinstance(e, (interface.Persist, interface.Halted))]
    assert replica.ledger.length == length


def test_a_joiner_far_behind_takes_a_snapshot() -> None:
    world = Team(make_plan(TOKENS, 2, False, 0.0, 0.0, False), 1)
    world.mishaps = False
    world.limits = ProtocolLimits(kept=5)
    for node in world.nodes.values():
        node.start()
    world.run(1.0)
    assert world.length() > 10
    node = world.nodes["j0"] = SimulatedNode(world, "j0")
    node.joins = True
    node.start()
    world.run(2.0)
    assert "j0" in world.status("r1")["members"]
    assert [r["kind"] for r in node.disk.records()].count("snapshot") == 1
    settle(world)
    world.check(settled=True)


@pytest.mark.long
@pytest.mark.parametrize("partial, most", [(False, 0.5), (True, 5.0)])
def test_where_messages_take_long_attempts_do_not_defeat_each_other_for_ever(
    partial: bool, most: float
) -> None:
    world = Team(
        make_plan(TOKENS, 5, partial, 0.0, 0.0, False),
        1,
        Weather(0.1, 0.1),
        action_time=(0.03, 0.07),
    )
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(25.0)
    records = [
        (name, r)
        for name, node in world.nodes.items()
        for r in node.disk.records()
        if r["mono"] > 5.0
    ]
    attempts = sum(r["kind"] == "promised" and r["ballot"][1] == name for name, r in records)
    slots = len({r["slot"] for _, r in records if r["kind"] == "slot"})
    assert slots > 20
    assert attempts < most * slots


def test_a_robot_that_left_ends_and_the_others_go_on() -> None:
    world = team(TOUR, 3)
    world.run(0.3)
    effects = []
    node = world.nodes["r1"]
    carry_out = node.carry_out
    node.carry_out = lambda given: (effects.extend(given), carry_out(given))[1]
    assert world.order("r1", log_entries.Leave("r1")).ok
    assert [e for e in effects if isinstance(e, Ended)]
    length = world.nodes["r2"].replica.ledger.length
    world.run(world.now + 0.5)
    assert world.nodes["r2"].replica.ledger.length > length


def private_places(net: NetBuilder, resources=(), idle=(), **fields: Any) -> Any:
    built = net.build()
    actions = {
        p.name: None if p.name in idle else FunctionAction("f", p.name) for p in built.places
    }
    plan = Plan(
        net=built,
        actions=actions,
        resource_places=frozenset(resources),
        synchronisation=Synchronisation.PARTIAL,
        **fields,
    )
    plan = plan.with_robots([RobotSpec("a", built.places[0].name)])
    return LocalTransitions(TokenGame(plan), "a").places


def test_which_places_are_private() -> None:
    def line() -> NetBuilder:
        net = NetBuilder().place("P").place("Q").place("R")
        return net.exponential("pq", inputs="P", outputs="Q").exponential(
            "qr", inputs="Q", outputs="R"
        )

    assert private_places(line()) == {"P", "Q"}
    assert private_places(line(), idle=["Q"]) == {"Q"}
    assert private_places(line(), until="R >= 1") == {"P"}
    assert (
        private_places(line().exponential("x", inputs="R", outputs="P", inhibitors="Q"))
        == frozenset()
    )
    shared = line().place("tool", tokens=1).exponential("take", inputs=["P", "tool"], outputs="Q")
    assert private_places(shared, resources=["tool"]) == {"Q"}
    meeting = line().exponential("meet", inputs=["P", "Q"], outputs=["Q", "R"])
    assert private_places(meeting) == frozenset()
    weights = line().exponential("two", inputs={"R": 2}, outputs={"P": 2})
    assert private_places(weights) == {"P", "Q"}


@pytest.mark.long
def test_a_robot_that_waits_for_hours_still_waits() -> None:
    world = team(TOKENS, 2)
    world.run(0.5)
    world.nodes["r1"].crash()
    world.nodes["r2"].give(interface.Order("o", log_entries.Pause()))
    world.run(4000.0)
    assert world.status("r2")["waits_for"] == "waits for an answer from r1"
    world.nodes["r1"].start()
    settle(world)
    assert world.nodes["r2"].results["o"].ok


def test_lost_messages_are_not_taken_for_a_slow_network() -> None:
    world = team(TOKENS, 2, True, Weather(0.001, 0.001))
    world.run(0.5)
    carry = world._carry
    asked = set()

    def lose_the_first(sender: str, to: str, text: str, request: str) -> None:
        message = json.loads(text)
        if message["kind"] in ("prepare", "accept"):
            key = (sender, to, message["kind"], message["slot"], tuple(message["ballot"]))
            if key not in asked:
                asked.add(key)
                return
        carry(sender, to, text, request)

    world._carry = lose_the_first  # type: ignore[method-assign]
    world.run(30.0)
    assert len(asked) > 20
    assert all(node.replica.state.round_trip < 0.01 for node in world.nodes.values())


def test_sleep_is_not_taken_for_a_slow_network() -> None:
    world = team(TOKENS, 3, True, Weather(0.001, 0.001))
    world.run(0.5)
    first = world.nodes["r1"]
    assert first.replica is not None
    for _ in range(40):  # until it sleeps while it waits for answers
        world.run(world.now + 0.0007)
        if first.replica.state.attempt is not None:
            break
    assert first.replica.state.attempt is not None
    first.suspended = True
    world.run(world.now + 5.0)
    first.resume()
    for _ in range(200):
        world.run(world.now + 0.001)
        assert first.replica.state.delay < 0.1


@pytest.mark.parametrize("partial", [False, True])
def test_robots_far_apart_do_not_beat_each_other_for_ever(partial: bool) -> None:
    """An answer takes longer than the longest wait for one, until that is known."""
    world = Team(make_plan(TOKENS, 3, partial, 0.0, 0.0, False), 1, Weather(0.6, 0.63))
    world.mishaps = False
    world.pace = Pace()
    for node in world.nodes.values():
        node.start()
    world.run(30.0)
    replicas = [node.replica for node in world.nodes.values()]
    before = min(replica.state.ledger.length for replica in replicas)
    world.run(60.0)
    decided = min(replica.state.ledger.length for replica in replicas) - before
    assert decided > 10  # each takes at least one round trip of 1.2 s, two in partial
    assert max(replica.state.delay for replica in replicas) == 1.0


@pytest.mark.parametrize("partial", [False, True])
def test_robots_that_evict_each_other_do_not_empty_the_team(partial: bool) -> None:
    world = team(TOUR, 3, partial)
    nodes = world.nodes
    nodes["r1"].give(interface.Order("a", log_entries.Evict("r3", -1)))
    nodes["r1"].give(interface.Order("b", log_entries.Evict("r2", -1)))
    nodes["r3"].give(interface.Order("c", log_entries.Evict("r1", -1)))
    world.run(2.0)
    settle(world)
    assert sorted(world.status("r1")["members"]) == ["r1", "r2", "r3"]
    results = [r for node in nodes.values() for r in node.results.values()]
    assert sum(not r.ok for r in results) <= 1
    world.check(settled=True)


def test_the_last_one_of_a_team_stays() -> None:
    world = team(TOUR, 2)
    world.run(0.3)
    for name in ("r1", "r2"):
        world.nodes[name].give(interface.Order("leave", log_entries.Leave(name)))
    world.run(3.0)
    results = {name: world.nodes[name].results["leave"] for name in ("r1", "r2")}
    (stays,) = [name for name, result in results.items() if not result.ok]
    assert (
        results[stays].text
        == "%s is the last robot of the team and stays; stop the run instead" % stays
    )
    assert world.status(stays)["members"] == [stays]
    world.check()


def test_a_robot_that_is_not_evicted_after_all_keeps_its_local_transitions() -> None:
    world = team(TOUR, 3, True)
    world.run(0.5)
    for who in ("r2", "r3", "r1"):  # the last of them stays
        world.nodes["r2"].give(interface.Order("evict " + who, log_entries.Evict(who, -1)))
    world.run(3.0)
    results = world.nodes["r2"].results
    assert [results["evict " + who].ok for who in ("r1", "r2", "r3")] == [True, False, True]
    settle(world)
    assert sorted(world.status("r1")["members"]) == ["r1", "r2", "r3"]
    world.check(settled=True)


@pytest.mark.long
def test_many_robots_that_want_the_next_slot_do_not_defeat_each_other() -> None:
    world = Team(
        make_plan(TOKENS, 24, True, 0.0, 0.0, False),
        1,
        Weather(0.003, 0.008),
        action_time=(0.05, 0.1),
    )
    world.pace = Pace()
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(1.5)
    messages, firings = world.protocol_messages, len(world.published)
    world.run(2.2)
    assert world.protocol_messages - messages < 18 * (len(world.published) - firings)


def test_a_busy_leader_has_robots_that_act_together_move_in_one_slot() -> None:
    robots, delay = 5, 0.001
    world = Team(
        make_plan(TOKENS, robots, False, 0.0, 0.0, False),
        1,
        Weather(delay, delay),
        action_time=(delay / 10, delay / 5),
    )
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(1.0)
    slots, firings = world.nodes["r1"].replica.ledger.length, len(world.published)
    world.run(1.5)
    slots = world.nodes["r1"].replica.ledger.length - slots
    assert len(world.published) - firings > 0.8 * robots * slots
    assert slots > 0.8 * 0.5 / (3 * delay)  # to the leader, from it to the others, and their votes


def test_a_leader_does_not_wait_for_robots_that_act_alone() -> None:
    delay = 0.001
    world = Team(
        make_plan(TOKENS, 3, False, 0.0, 0.0, False),
        1,
        Weather(delay, delay),
        action_time=(0.05, 0.2),
    )
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(5.0)
    disk = world.nodes["r1"].disk
    assert disk is not None
    invoked, waits = {}, []
    for record in disk.records():
        if record["kind"] == "invoked":
            invoked[tuple(record["origin"])] = record["mono"]
        for origin in record.get("origins", ()) if record["kind"] == "slot" else ():
            if tuple(origin) in invoked:
                waits.append(record["mono"] - invoked[tuple(origin)])
    assert len(waits) > 20 and sorted(waits)[len(waits) // 2] < 2.5 * delay


def test_inputs_that_wait_together_go_into_one_slot() -> None:
    world = team(TOUR, 1)
    world.run(1.0)
    replica = world.nodes["r1"].replica
    length = replica.ledger.length
    orders = [
        interface.Order("pause", log_entries.Pause()),
        interface.Order("resume", log_entries.Resume()),
    ]
    effects = replica.step_all(orders, world.now)
    assert replica.ledger.length == length + 1
    answered = [e.order_id for e in effects if isinstance(e, interface.OrderResult) and e.ok]
    assert answered == ["pause", "resume"]
    assert sum(isinstance(e, interface.WakeAt) for e in effects) == 1


def test_of_calls_that_wait_together_each_is_answered() -> None:
    world = team(TOUR, 2)
    world.run(1.0)
    replica = world.nodes["r1"].replica
    calls = [interface.Received({"kind": "nonsense"}, number) for number in ("one", "two")]
    effects = replica.step_all(calls, world.now)
    replies = [e for e in effects if isinstance(e, interface.Reply)]
    assert replies == [interface.Reply("one", {}), interface.Reply("two", {})]


def deciders(partial: bool) -> Plan:
    """One robot decides, one measures, two are at the gate. The policy lets them wait there: without
    a word of the gate while somebody decides, by an empty choice while somebody measures."""
    net = (
        NetBuilder("deciders")
        .place("Decide", tokens=1)
        .place("Measure", tokens=1)
        .place("Gate", tokens=2)
        .place("Through")
        .immediate("decided", inputs="Decide", outputs="Through")
        .exponential("measured", inputs="Measure", outputs="Through")
        .immediate("go", inputs="Gate", outputs="Through")
        .build()
    )
    policy = Policy.from_table(
        ["Decide", "Measure", "Gate"],
        [((1, "-", "-"), {"decided": 1}), ((0, 1, "-"), {}), ((0, 0, "-"), {"go": 1})],
    )
    act = FunctionAction("actions.act", "act")
    places = ["Decide", "Measure", "Gate", "Gate"]
    return Plan(
        net=net,
        policy=policy,
        strict=True,
        actions={"Decide": act, "Measure": act, "Gate": None, "Through": None},
        robots=tuple(RobotSpec("r%d" % (i + 1), place) for i, place in enumerate(places)),
        synchronisation=Synchronisation.PARTIAL if partial else Synchronisation.FULL,
        timing=Timing(evict_after=0.4, fence_after=0.0),
    ).validate()


@pytest.mark.parametrize("partial", [False, True])
def test_when_those_for_whom_the_policy_lets_others_wait_die_the_rows_of_the_rest_decide(
    partial: bool,
) -> None:
    world = Team(deciders(partial), 1)
    world.mishaps = False
    world.action_time = (1000.0, 1000.0)
    for node in world.nodes.values():
        node.start()

    def fired() -> List[str]:
        return [f.firing.transition for _, f in world.published]

    def reason() -> str:
        robots = {robot["robot"]: robot for robot in world.status("r3")["robots"]}
        assert robots["r3"]["state"] == "Waiting"
        return str(robots["r3"]["waits_for"])

    for dead, why in (("r1", "no policy row applies to Gate"), ("r2", "the policy makes it wait")):
        world.run(world.now + 1.0)
        assert fired() == [] and reason().startswith(why)
        world.nodes[dead].crash()
        assert world.run(
            world.now + 10.0, lambda dead=dead: dead not in world.status("r3")["members"]
        )
    assert world.run(world.now + 5.0, lambda: len(fired()) == 2)
    assert fired() == ["go", "go"] and world.status("r3")["members"] == ["r3", "r4"]
    world.check()


@pytest.mark.parametrize("partial", [False, True])
def test_strangers_of_the_same_run_cost_little_and_do_not_stop_a_team(partial: bool) -> None:
    """They greet, ask to join and propose under 10,000 names."""
    world = World(make_plan(0, 5, partial, 0.0, 0.0, False), 1)
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(1.0)
    node, replica = world.nodes["r1"], world.nodes["r1"].replica
    hello = replica.membership._hello()._replace(active=False, joining=True)
    item = Item(log_entries.Leave("r2"), Origin("", 0, 1, ""))
    records = replica.records
    for number in range(10_000):
        name = "s%d" % number
        asks = Proposals([item._replace(origin=Origin(name, 0, 1, name))], False)
        for body in (hello, asks):
            said = {**replica.outbox.signed(body), "from": name, "log": name}
            node.give(interface.Received(json.loads(json.dumps(said))))
    assert len(replica.state.peers.all) <= 4 + GUESTS
    assert len(replica.state.others_proposals) <= 4 + GUESTS
    assert len(replica.state.voteless) <= 4 + GUESTS
    assert replica.records - records < 100
    before = world.length()
    world.run(world.now + 4)
    assert world.length() > before + 10
    assert set(replica.state.peers.all) == {"r2", "r3", "r4", "r5"}


def test_what_another_memory_of_a_life_announced_does_not_stand_before_its_return():
    """A process that lacks the memory of its robot returns with the incarnation that the memory
    had. What the memory announced would hide the return."""
    world = team(TOKENS, 3, partial=True)
    world.run(1.0)
    queue = world.nodes["r1"].replica.proposals
    lost = Item(log_entries.Done("r2", 1, 1, "t1"), Origin("r2", 1, 1, "lost"))
    back = Item(log_entries.Join("r2", 1, "p1", "back"), Origin("r2", 1, 1, "back"))
    other = Item(log_entries.Retry("r3"), Origin("r3", 0, 1, "log"))
    kept = list(queue.batch(False, {"r2": True}, [lost, back, other]).items)
    assert kept == [back, other]
    assert lost in queue.batch(False, {}, [lost, back, other]).items

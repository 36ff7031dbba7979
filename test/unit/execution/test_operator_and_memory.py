"""Evictions by force, lost logs, lost ends of logs, and a second process under one name."""

from __future__ import annotations

import json
from typing import Any, List

import pytest

from agreement.plans import make_plan
from agreement.world import SimulatedNode, World
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.messages import Prepare, Proposals
from gspn_framework_package.execution.agreement.replica import ProtocolLimits
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.execution.ledger import Item, Origin
from gspn_framework_package.execution.verifier import verify

TOUR, MEET, TOKENS, CROWD = range(4)


class Team(World):
    """A team whose replicas may halt without a violation."""

    def on_halted(self, node: SimulatedNode) -> None:
        pass

    def replica(self, name: str) -> Any:
        return self.nodes[name].replica

    def force(self, at: str, robot: str) -> None:
        self.nodes[at].give(interface.ForceEvict("force " + robot, robot))

    def answer(self, at: str, robot: str) -> Any:
        return self.nodes[at].results.get("force " + robot)

    def cut_off(self, *names: str) -> None:
        self.blocked |= {
            (a, b) for a in self.nodes for b in self.nodes if (a in names) != (b in names)
        }

    def verify(self) -> None:
        logs = [EventLog(str(d.header["log"]), d.header, d.records()) for d in self.logs()]
        verdict = verify(logs)
        assert verdict.violation is None, verdict.violation


def team(
    kind: int, robots: int, partial: bool = False, *, joiners: int = 0, evict_after: float = 0.0
) -> Team:
    world = Team(make_plan(kind, robots, partial, evict_after, 0.0, False), 1)
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(0.5)
    for i in range(joiners):
        node = world.nodes["j%d" % i] = SimulatedNode(world, "j%d" % i)
        node.joins = True
        node.start()
    world.run(1.5)
    return world


def all_agree(world: Team) -> None:
    world.acting = False
    assert world.run(world.now + 6, world.has_settled), [
        (n.key, n.halted or n.replica.waits_for()) for n in world.alive()
    ]


# -- evictions by force ----------------------------------------------------------------------------


@pytest.mark.parametrize("partial", [False, True])
@pytest.mark.parametrize("every", [3, 1000])
def test_an_eviction_by_force_does_not_come_back_after_a_restart(partial: bool, every: int) -> None:
    world = team(TOUR, 3, partial)
    world.limits = ProtocolLimits(snapshot_every=every)
    world.nodes["r3"].crash()
    world.run(world.now + 1)
    world.force("r1", "r3")
    world.run(world.now + 1)
    assert world.answer("r1", "r3").ok
    world.nodes["r3"].start()
    world.run(world.now + 1)
    assert world.replica("r1").members() == ["r1", "r2", "r3"]
    world.nodes["r1"].crash()
    world.nodes["r1"].start()
    world.run(world.now + 1)
    assert world.replica("r1").asserted_off() == set()
    world.cut_off("r1")
    world.run(world.now + 0.3)
    length = world.replica("r1").ledger.length
    world.run(world.now + 1)
    assert world.replica("r1").ledger.length == length  # one of three decides nothing
    world.blocked.clear()
    world.run(world.now + 1)
    world.nodes["r2"].give(interface.Order("pause", log_entries.Pause()))
    all_agree(world)
    world.verify()


@pytest.mark.parametrize("partial", [False, True])
def test_who_was_cast_out_is_known_after_a_restart(partial: bool) -> None:
    world = team(TOKENS, 2, partial)
    world.cut_off("r1")
    world.run(world.now + 1)  # r1 alone is a quorum, and goes on
    world.nodes["r1"].crash()
    world.given_up = True
    world.force("r2", "r1")
    world.run(world.now + 1)
    assert world.answer("r2", "r1").ok
    world.nodes["r2"].crash()
    world.nodes["r2"].start()
    world.blocked.clear()
    world.nodes["r1"].start()
    world.run(world.now + 2)
    assert not world.nodes["r1"].halted
    assert not world.nodes["r2"].halted
    all_agree(world)
    world.verify()


def test_after_a_log_was_given_up_and_forgotten_the_verifier_checks_it_again() -> None:
    world = team(TOKENS, 2)
    world.cut_off("r1")
    world.run(world.now + 1)  # r1 alone is a quorum, and goes on
    world.nodes["r1"].crash()
    world.given_up = True
    world.force("r2", "r1")
    world.run(world.now + 1)
    world.blocked.clear()
    world.nodes["r1"].start()
    world.run(world.now + 2)
    world.verify()
    lines = world.nodes["r1"].disk.lines
    kinds = [record["kind"] for record in world.nodes["r1"].disk.records()]
    goal = kinds.index("goal", kinds.index("reset"))
    lines.insert(goal, lines[goal])
    logs = [EventLog(str(d.header["log"]), d.header, d.records()) for d in world.logs()]
    found = verify(logs).violation
    assert found is not None and found.rule == 8 and "twice" in found.text


@pytest.mark.parametrize("partial", [False, True])
def test_one_of_three_needs_the_word_of_the_other_that_is_left(partial: bool) -> None:
    """r2 and r3 may have decided without r1: r1 must not decide without r2, though r3 is off."""
    world = team(TOKENS, 3, partial)
    world.cut_off("r1")
    world.run(world.now + 1)
    world.nodes["r3"].crash()
    world.force("r1", "r3")
    world.run(world.now + 2)
    assert world.answer("r1", "r3") is None
    world.blocked.clear()
    world.run(world.now + 2)
    assert world.answer("r1", "r3").ok
    all_agree(world)
    world.verify()


@pytest.mark.parametrize("partial", [False, True])
def test_a_robot_cast_out_wrongly_is_not_let_in_with_what_was_given_up(partial: bool) -> None:
    world = team(TOKENS, 2, partial)
    world.given_up = True
    world.cut_off("r1")
    world.run(world.now + 1)  # r1 alone is a quorum, and goes on
    first = world.replica("r1")
    join = Item(log_entries.Join("r1", 1, "p1", first.log_id), Origin("r1", 1, 1, first.log_id[:8]))
    # said in a life of r1 that the others know nothing of
    late = first.outbox.signed(Proposals([join], False))
    world.force("r2", "r1")
    world.run(world.now + 1)
    assert world.answer("r2", "r1").ok
    world.nodes["r2"].give(interface.Received(late))
    world.run(world.now + 1)
    assert world.replica("r2").members() == ["r2"]
    world.blocked.clear()
    world.run(world.now + 2)
    assert world.replica("r1").is_settled()
    all_agree(world)
    world.verify()


def test_an_eviction_by_force_is_in_the_log_once_with_whoever_ordered_it() -> None:
    world = team(TOKENS, 3)
    world.given_up = True
    world.nodes["r1"].crash()
    world.nodes["r3"].crash()
    world.run(world.now + 2)  # so long that r2 does not hear them any more
    ann = log_entries.Giver("ann", "team key")
    for robot in ("r1", "r3"):
        world.nodes["r2"].give(interface.ForceEvict("force " + robot, robot, ann))
    world.run(world.now + 1)
    assert world.replica("r2").members() == ["r2"]
    records = world.nodes["r2"].disk.records()
    entries = [e for r in records if r["kind"] == "slot" for e in r["entries"]]
    evicted = [(e["robot"], e.get("by")) for e in entries if e["entry"] == "evict"]
    assert sorted(evicted) == [("r1", ["ann", "team key"]), ("r3", ["ann", "team key"])]


@pytest.mark.parametrize("of_two", [0, 1])
def test_a_wrong_assertion_is_taken_back_also_across_a_crash(of_two: int) -> None:
    """r1 is said to be off, but only the link was cut. The robot that knows that is killed while
    it takes that back, before the first or the second of the two records of that."""
    world = team(TOKENS, 3)
    world.cut_off("r2")
    world.run(world.now + 2)
    world.force("r2", "r1")
    world.run(world.now + 0.5)
    second = world.nodes["r2"]
    assert world.replica("r2").electorate.asserted_off() == {"r1"}
    carry_out = second.carry_out

    def die_while_taking_it_back(effects: List[interface.Effect]) -> None:
        records = [
            number
            for number, effect in enumerate(effects, 1)
            if isinstance(effect, interface.Persist) and effect.record["kind"] in ("void", "forced")
        ]
        if len(records) == 2:
            second.doomed = records[of_two]
            world.random.seed(2)  # the record before which it dies is not written
        carry_out(effects)

    second.carry_out = die_while_taking_it_back  # type: ignore[method-assign]
    world.blocked.clear()
    world.run(world.now + 2)
    assert second.replica is None
    del second.carry_out
    second.start()
    world.run(world.now + 3)
    replica = world.replica("r2")
    assert replica.electorate.asserted_off() == set()
    assert [
        o for o in replica.state.own_proposals if isinstance(o.item.entry, log_entries.Evict)
    ] == []
    assert replica.members() == ["r1", "r2", "r3"]
    world.verify()


def test_an_attempt_that_cannot_succeed_does_not_keep_others_from_trying() -> None:
    """r3 asks for a quorum that will not come, again and again. Carriers may send that to
    everybody. Only r2 knows that r1 and r4 are off."""
    world = team(TOKENS, 4)
    world.given_up = True
    world.nodes["r1"].crash()
    world.nodes["r4"].crash()
    world.run(world.now + 2)
    waits, asks = world.replica("r2").state, world.replica("r3").state
    while waits.attempt is not None or asks.attempt is None or waits.promised != asks.promised:
        world.run(world.now + 0.001)
        assert world.now < 10.0
    again = Prepare(asks.attempt.slot, asks.attempt.ballot, asks.attempt.frozen)
    message = world.replica("r3").outbox.signed(again)
    for name in ("r1", "r4"):
        world.force("r2", name)
    end = world.now + 4
    while world.now < end:
        world.nodes["r2"].give(interface.Received(message))
        world.run(world.now + 0.02)
    assert world.replica("r2").members() == ["r2", "r3"]


def test_visits_of_a_log_that_was_given_up_are_made_again() -> None:
    """The others come back, act, and then hear that the rest went on without them. Where they
    stand now, in the log that counts, they have been before, and further."""
    world = team(TOKENS, 3)
    world.given_up = True
    world.nodes["r1"].crash()
    world.nodes["r3"].crash()
    world.run(world.now + 2)  # so long that r2 does not hear them any more
    world.force("r2", "r1")
    world.force("r2", "r3")
    world.run(world.now + 1)
    assert world.replica("r2").members() == ["r2"]
    world.cut_off("r2")
    for name in ("r1", "r3"):
        world.nodes[name].start()
    world.run(world.now + 1)
    further = {name: own_visit(world, name) for name in ("r1", "r3")}
    world.blocked.clear()
    world.run(world.now + 2)
    assert world.replica("r2").members() == ["r1", "r2", "r3"]
    world.run(world.now + 4)
    for name in ("r1", "r3"):
        assert own_visit(world, name) > further[name]
    world.verify()


def own_visit(world: Team, name: str) -> int:
    return int(world.replica(name).ledger.state.robots[name].visit)


def test_whoever_followed_a_log_that_was_given_up_forgets_it_and_nobody_else() -> None:
    """r1 was off until it was evicted, as the operator said. Then it starts, decides alone as the
    first of two, and lets r2 in, which was never evicted by force."""
    world = team(TOKENS, 3)
    world.given_up = True
    world.nodes["r1"].crash()
    world.nodes["r3"].give(interface.Order("evict", log_entries.Evict("r2", -1)))
    world.run(world.now + 1)
    assert world.replica("r3").members() == ["r1", "r3"]
    world.blocked |= {("r3", "r1"), ("r3", "r2")}
    world.force("r3", "r1")
    world.run(world.now + 1)
    assert world.answer("r3", "r1").ok
    kept = world.replica("r3").ledger.cast_out
    world.nodes["r1"].start()
    world.run(world.now + 1)
    assert "r2" in world.replica("r1").members()  # let in by a log that was given up
    world.blocked.clear()
    world.run(world.now + 1)
    assert world.replica("r3").active
    for name in ("r1", "r2", "r3"):
        assert world.replica(name).ledger.cast_out == kept
    # r2 forgot its votes, and r3 needs them: it says so, and the operator helps
    assert world.replica("r3").is_stuck()
    world.nodes["r2"].crash()
    world.run(world.now + 1)
    world.force("r3", "r2")
    world.run(world.now + 1)
    world.nodes["r2"].start()
    world.run(world.now + 2)
    assert sorted(world.replica("r3").members()) == ["r1", "r2", "r3"]
    all_agree(world)
    world.verify()


@pytest.mark.long
@pytest.mark.parametrize("partial", [False, True])
@pytest.mark.parametrize("joiner_at", ["r1", "r3"])
def test_after_operators_who_contradict_each_other_one_story_is_left(
    partial: bool, joiner_at: str
) -> None:
    world = team(TOKENS, 3, partial)
    world.given_up = True
    world.cut_off("r3")
    node = world.nodes["j"] = SimulatedNode(world, "j")
    node.joins = True
    away = {"r1", "r2", "r3"} - {joiner_at}
    world.blocked |= {(a, b) for a in away for b in ("j",)} | {("j", b) for b in away}
    world.run(world.now + 1)
    world.force("r1", "r3")
    world.force("r3", "r1")
    world.force("r3", "r2")
    world.run(world.now + 1)
    node.start()
    world.run(world.now + 1)
    assert world.answer("r1", "r3").ok
    assert world.answer("r3", "r1").ok
    world.blocked.clear()
    world.run(world.now + 3)
    assert sorted(world.replica("r1").members()) == ["j", "r1", "r2", "r3"]
    all_agree(world)
    world.verify()


def test_where_a_quorum_is_off_the_order_says_what_is_given_up_and_asks_all_the_others() -> None:
    world = team(TOKENS, 5)
    for name in ("r1", "r2", "r3"):
        world.nodes[name].crash()
    world.run(world.now + 1)
    world.cut_off("r5")
    for name in ("r1", "r2", "r3"):
        world.force("r4", name)
    world.run(world.now + 1)
    assert any(
        "r1, r2, r3 could have made decisions without the others" in f
        for f in world.nodes["r4"].faults
    )
    assert world.answer("r4", "r1") is None  # r5 has to be asked
    world.blocked.clear()
    world.run(world.now + 2)
    assert world.answer("r4", "r1").ok
    assert world.replica("r5").members() == ["r4", "r5"]
    world.verify()


@pytest.mark.parametrize("partial", [False, True])
def test_what_is_decided_without_a_quorum_evicts_those_who_are_off(partial: bool) -> None:
    """However much waited before, and though the robot stopped before it proposed the eviction."""
    world = team(TOUR, 3, partial)
    world.limits = ProtocolLimits(batch=1)
    for name in ("r1", "r2", "r3"):
        world.nodes[name].crash()
    node = world.nodes["r3"]
    node.start()
    for number in range(3):
        node.give(interface.Order("resume %d" % number, log_entries.Resume()))
    world.run(world.now + 1)
    length = world.replica("r3").ledger.length
    for name in ("r1", "r2"):
        world.force("r3", name)
    node.crash()
    world.given_up = True
    assert node.disk is not None
    asserted = max(n for n, r in enumerate(node.disk.records()) if r["kind"] == "forced")
    del node.disk.lines[asserted + 1 :]
    assert not any(r.get("entry", {}).get("robot") == "r2" for r in node.disk.records()[asserted:])
    node.start()
    world.run(world.now + 2)
    slots = [r for r in node.disk.records() if r["kind"] == "slot"]
    assert {e["robot"] for e in slots[length]["entries"] if e.get("forced")} == {"r1", "r2"}
    for name in ("r1", "r2"):
        world.nodes[name].start()
    all_agree(world)
    world.verify()


def test_no_local_transition_waits_behind_a_pause_that_comes_with_an_eviction() -> None:
    world = team(TOUR, 3, True)
    world.limits = ProtocolLimits(batch=1)
    for name in ("r1", "r2"):
        world.nodes[name].crash()
        world.nodes[name].start()
    world.run(world.now + 1)
    waiting = world.replica("r1").state.own_proposals
    assert world.run(world.now + 1, lambda: waiting.local > 0)
    world.nodes["r3"].crash()
    world.run(world.now + 0.1)
    assert waiting.local > 0
    world.nodes["r2"].give(interface.Order("pause", log_entries.Pause()))
    world.run(world.now + 1)
    world.nodes["r2"].give(interface.Order("evict", log_entries.Evict("r3", -1)))
    world.run(world.now + 2)
    assert world.nodes["r2"].results["evict"].ok
    world.verify()


def test_a_robot_that_is_heard_is_not_evicted_by_force() -> None:
    world = team(TOKENS, 3)
    world.force("r1", "r2")
    assert not world.answer("r1", "r2").ok
    assert "it is not off" in world.answer("r1", "r2").text
    world.cut_off("r2")
    world.cut_off("r1")
    world.run(world.now + 1)
    world.force("r1", "r2")
    world.run(world.now + 1)
    assert world.answer("r1", "r2").text != "done"
    world.blocked.clear()
    world.run(world.now + 1)
    assert world.replica("r1").asserted_off() == set()
    assert "r2" in world.replica("r3").members()


def test_a_robot_that_was_evicted_before_it_ever_started_joins_and_acts_once() -> None:
    world = Team(make_plan(TOKENS, 3, False, 0.0, 0.0, False), 1)
    world.mishaps = False
    for name in ("r1", "r2"):
        world.nodes[name].start()
    world.run(0.5)
    world.force("r1", "r3")
    world.run(1.5)
    assert world.answer("r1", "r3").ok
    world.nodes["r3"].start()
    world.run(4.0)
    goals = [r for r in world.nodes["r3"].disk.records() if r["kind"] == "goal"]
    assert goals
    assert all(r["incarnation"] > 0 for r in goals)
    assert "r3" in world.replica("r1").members()
    all_agree(world)
    world.verify()


# -- memory ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("partial", [False, True])
def test_the_only_robot_of_the_first_team_learns_its_lost_log_from_those_who_joined(
    partial: bool,
) -> None:
    world = team(TOKENS, 1, partial, joiners=2)
    assert world.replica("r1").members() == ["r1", "j0", "j1"]
    world.nodes["r1"].crash()
    world.nodes["r1"].lose_log()
    world.run(world.now + 0.2)
    world.nodes["r1"].start()
    world.run(world.now + 3)
    assert world.replica("r1").is_settled()
    all_agree(world)
    world.verify()


@pytest.mark.parametrize("partial", [False, True])
def test_a_team_that_can_never_go_on_says_so(partial: bool) -> None:
    world = team(TOKENS, 2, partial, joiners=2)
    for name in ("r1", "r2"):
        world.nodes[name].crash()
        world.nodes[name].lose_log()
    world.run(world.now + 0.5)
    for name in ("r1", "r2"):
        world.nodes[name].start()
    world.run(world.now + 3)
    for name in ("r1", "j0"):
        assert world.replica(name).status()["stuck"]
        assert "too many robots lost their logs" in world.replica(name).waits_for()
    assert not any(n.halted for n in world.nodes.values())


@pytest.mark.parametrize("partial", [False, True])
def test_the_log_is_learned_from_the_only_one_that_has_it_though_it_was_once_evicted_by_force(
    partial: bool,
) -> None:
    """Slot by slot, the learners go through a time in which that robot was out of the team."""
    world = team(TOKENS, 3, partial)
    world.limits = ProtocolLimits(chunk=1)
    world.nodes["r3"].crash()
    world.run(world.now + 1)
    world.force("r1", "r3")
    world.run(world.now + 1)
    assert world.answer("r1", "r3").ok
    world.nodes["r3"].start()
    world.run(world.now + 1)
    assert world.replica("r3").is_settled()
    world.acting = False
    world.run(world.now + 1)
    known = world.replica("r3").ledger.length
    for name in ("r1", "r2"):
        world.nodes[name].crash()
        world.nodes[name].lose_log()
        world.nodes[name].start()
    world.run(world.now + 3)
    assert [world.replica(name).ledger.length for name in ("r1", "r2", "r3")] == [known] * 3
    assert not any(n.halted for n in world.nodes.values())


@pytest.mark.parametrize("partial", [False, True])
def test_a_spare_of_a_robot_that_is_the_whole_team_says_why_it_waits(partial: bool) -> None:
    world = team(TOKENS, 2, partial)
    spare = world.add_spare(world.nodes["r2"])
    world.operator(log_entries.Leave("r1"), world.nodes["r1"])
    world.run(world.now + 1)
    world.remove(world.nodes["r1"])
    spare.start()
    world.run(world.now + 1)
    assert world.replica("r2").is_settled()
    assert spare.replica is not None
    assert "another process runs as r2" in spare.replica.waits_for()
    world.nodes["r2"].crash()
    world.run(world.now + 2)
    assert "another process" not in spare.replica.waits_for()


@pytest.mark.parametrize("partial", [False, True])
def test_a_spare_takes_the_place_and_the_first_one_halts_when_it_is_back(partial: bool) -> None:
    world = team(TOKENS, 3, partial)
    spare = world.add_spare(world.nodes["r3"])
    away = {(a, b) for a in world.nodes for b in world.nodes if a != b and "r3" in (a, b)}
    world.blocked |= away
    spare.start()
    world.run(world.now + 2)
    assert spare.replica.may_vote()
    assert world.replica("r1").known_log("r3") == spare.replica.log_id
    world.blocked.clear()
    world.run(world.now + 1)
    assert "another process runs as r3" in world.nodes["r3"].halted
    assert not spare.halted
    world.remove(world.nodes["r3"])
    all_agree(world)
    world.verify()


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("partial", [False, True])
def test_a_spare_of_a_robot_at_work_waits_and_takes_the_place_when_that_is_gone(
    partial: bool, size: int
) -> None:
    world = team(TOKENS, size, partial)
    first = world.nodes["r2"]
    spare = world.add_spare(first)
    known = first.replica.log_id
    for _ in range(2):  # as it does where it is started again and again
        spare.start()
        world.run(world.now + 1.5)
        assert not first.halted and not spare.halted
        assert first.replica.is_settled() and first.log_id == known
        assert world.replica("r1").known_log("r2") == known
        assert "another process runs as r2" in spare.replica.waits_for()
        spare.crash()
        spare.lose_log()
    spare.start()
    world.run(world.now + 1)
    world.remove(first)
    world.run(world.now + 4)
    if size > 2:  # of two, the other one is no quorum
        assert spare.replica.is_settled()
    world.verify()


def test_no_member_lets_in_a_spare_that_does_not_hear_the_robot_at_work() -> None:
    world = team(TOKENS, 3)
    spare = world.add_spare(world.nodes["r3"])
    world.blocked |= {("r3", spare.key), (spare.key, "r3")}
    spare.start()
    world.run(world.now + 3)
    assert not spare.replica.is_settled()
    assert world.replica("r3").is_settled() and not world.nodes["r3"].halted
    world.verify()


def test_a_spare_does_not_answer_for_the_robot_whose_place_it_did_not_take() -> None:
    """No pause is decided on the word of a process that does not know what its robot has done: only
    with its return does the former life end."""
    world = team(TOUR, 3, True)
    spare = world.add_spare(world.nodes["r3"])
    away = {(a, b) for a in world.nodes for b in world.nodes if a != b and "r3" in (a, b)}
    world.blocked |= away
    carry = world._carry

    def without_greetings(sender: str, to: str, text: str, request: str) -> None:
        if to != spare.key or json.loads(text)["kind"] != "hello":
            carry(sender, to, text, request)

    world._carry = without_greetings  # so that it does not hear that it has to join
    spare.start()
    world.run(world.now + 0.5)
    world.nodes["r1"].give(interface.Order("pause", log_entries.Pause()))
    world.run(world.now + 2)
    assert "pause" not in world.nodes["r1"].results
    world._carry = carry
    world.run(world.now + 2)
    assert world.nodes["r1"].results["pause"].ok
    assert world.replica("r1").known_log("r3") == spare.replica.log_id
    world.blocked.clear()
    world.run(world.now + 1)
    world.remove(world.nodes["r3"])
    all_agree(world)
    world.verify()


def return_that_waits(name: str, away: str) -> Any:
    """A team in partial synchronisation of which one robot returned, as r1 and r2 know, while no
    slot can be decided, because another one is off."""
    world = team(TOUR, 4, True, joiners=1)
    node = world.nodes[name]
    world.nodes[away].crash()
    node.crash()
    node.start()
    for other in ("r1", "r2"):
        world.nodes[other].give(interface.Order("resume", log_entries.Resume()))
    world.run(world.now + 1)
    for other in ("r1", "r2"):
        waiting = [p.item.entry for p in world.replica(other).state.others_proposals[name]]
        joins = [entry for entry in waiting if isinstance(entry, log_entries.Join)]
        assert [(j.incarnation, j.log) for j in joins] == [(1, node.log_id)]
    return world, node, node.log_id


def test_a_return_that_was_lost_with_its_memory_keeps_no_later_one_out() -> None:
    """Both claim the same incarnation, since the new memory never heard of the lost return."""
    world, node, first = return_that_waits("j0", "r4")
    for lost in (node, world.nodes["r4"]):
        lost.crash()
        lost.lose_log()
        lost.start()
    all_agree(world)
    assert world.replica("r1").known_log("j0") == node.replica.log_id != first
    world.verify()


def test_a_robot_out_of_reach_whose_return_waits_passes_no_pause() -> None:
    """The slot that holds its return needs nobody's word for it beside a spare's."""
    world, node, first = return_that_waits("r3", "r4")
    spare = world.add_spare(node)
    world.blocked |= {(a, b) for a in world.nodes for b in world.nodes if a != b and "r3" in (a, b)}
    world.deaf.add(spare.key)  # so that it does not hear that it has to join
    spare.start()
    world.nodes["r4"].start()
    world.nodes["r2"].give(interface.Order("pause", log_entries.Pause()))
    world.run(world.now + 2)
    assert world.nodes["r2"].results["pause"].ok
    assert world.replica("r1").ledger.state.paused
    assert world.replica("r1").ledger.state.robots["r3"].incarnation == 1
    assert world.replica("r1").known_log("r3") == first
    assert node.replica.ledger.length < world.replica("r1").ledger.length
    world.remove(spare)
    world.deaf.clear()
    world.blocked.clear()
    all_agree(world)
    world.verify()


@pytest.mark.parametrize("partial", [False, True])
def test_a_second_process_of_the_only_robot_takes_no_part(partial: bool) -> None:
    world = team(TOUR, 1, partial)
    spare = world.add_spare(world.nodes["r1"])
    spare.start()
    world.run(world.now + 2)
    assert not spare.replica.active
    assert "another process runs as r1" in spare.replica.waits_for()
    assert not world.nodes["r1"].halted
    world.verify()


def test_of_two_processes_of_the_only_robot_that_begin_apart_one_halts() -> None:
    world = team(TOUR, 1)
    world.given_up = True  # each is the whole team: nobody can distinguish them
    spare = world.add_spare(world.nodes["r1"])
    world.blocked |= {("r1", spare.key), (spare.key, "r1")}
    spare.start()
    world.run(world.now + 1)
    assert spare.replica.active
    world.blocked.clear()
    world.run(world.now + 1)
    assert "another process runs as r1" in spare.halted
    assert not world.nodes["r1"].halted


def two_of_the_first(partial: bool, *, acting: bool = True) -> Any:
    """A team of two, known to the second robot with a spare of the first, which began out of
    reach."""
    world = Team(make_plan(TOUR, 2, partial, 0.0, 0.0, False), 1)
    world.mishaps = False
    world.acting = acting
    spare = world.add_spare(world.nodes["r1"])
    world.blocked |= {(a, b) for a in world.nodes for b in world.nodes if a != b and "r1" in (a, b)}
    for node in world.nodes.values():
        node.start()
    world.run(1.0)
    assert spare.replica.active
    return world, spare


def test_the_slot_that_lets_another_log_in_is_not_forgotten() -> None:
    """The spare decides alone that the other process is let in, since its greetings get lost, and
    knows it alone."""
    world, spare = two_of_the_first(True)
    carry = world._carry

    def without_greetings(sender: str, to: str, text: str, request: str) -> None:
        if sender != spare.key or json.loads(text)["kind"] != "hello":
            carry(sender, to, text, request)

    world._carry = without_greetings
    world.blocked.clear()
    world.run(world.now + 6)
    assert world.replica("r2").ledger.logs["r1"] == world.replica("r1").log_id
    assert world.replica("r1").may_vote()
    world.verify()


def test_a_robot_begins_only_if_no_robot_that_is_gone_knew_another_log_of_it() -> None:
    """The log has no entry of r1 that would show it, since no action has ended."""
    world, spare = two_of_the_first(False, acting=False)
    world.blocked = {("r1", spare.key), (spare.key, "r1")}
    world.deaf = {"r1"}  # it learns the slots before anybody can report the spare to it
    world.nodes["r2"].give(interface.Order("evict", log_entries.Evict("r2", -1)))
    while world.replica("r2").members() != ["r1"]:
        world.run(world.now + 0.0005)
        assert world.now < 3.0
    spare.crash()  # before it lets the other one in again
    world.run(world.now + 2)
    assert world.replica("r1").members() == ["r1"]
    assert not world.replica("r1").active
    assert world.replica("r1").waits_for() == "waits for r2 to start"


def test_a_robot_that_lost_its_log_is_no_witness_of_a_start() -> None:
    world, spare = two_of_the_first(False)
    world.blocked = {("r1", spare.key), (spare.key, "r1")}
    world.deaf = {"r1"}  # it learns slots before anybody can report the spare to it
    while world.replica("r1").ledger.length < 2:
        world.run(world.now + 0.0005)
        assert world.now < 3.0
    other = world.nodes["r2"]
    other.crash()
    other.lose_log()
    world.cut_off(spare.key)
    world.deaf = set()
    other.start()
    world.run(world.now + 2)
    assert not world.replica("r1").active  # the other one knows only this process, now
    assert not world.replica("r1").state.amnesic


@pytest.mark.parametrize("partial", [False, True])
def test_no_slot_is_lost_by_the_word_of_a_robot_that_lost_its_log(partial: bool) -> None:
    """r2 lost its log, and hears the other process of r1 before the one with which it decided."""
    world, spare = two_of_the_first(partial)
    spare.give(interface.Order("pause", log_entries.Pause()))
    world.run(world.now + 1)
    decided = spare.replica.ledger.length
    assert decided > 1
    other = world.nodes["r2"]
    other.crash()
    other.lose_log()
    world.blocked = {("r2", spare.key), (spare.key, "r2")}
    world.run(world.now + 0.5)  # r1 hears that another process of its name is in the team
    other.start()
    while world.replica("r2").known_log("r1") != world.replica("r1").log_id:
        world.run(world.now + 0.0005)
        assert world.now < 4.0
    world.blocked.clear()
    for _ in range(3000):
        world.run(world.now + 0.001)
        assert world.length() >= decided
    other.give(interface.Order("resume", log_entries.Resume()))
    world.run(world.now + 3)
    assert other.results["resume"].ok
    assert sum(node.replica.may_vote() for node in world.alive()) == 2
    world.verify()


def test_an_eviction_gets_into_a_full_batch() -> None:
    """With partial synchronisation, a slot that does not hold it waits for the robot that is
    off."""
    world = team(TOUR, 3, True)
    world.limits = ProtocolLimits(batch=1)
    for name in ("r1", "r2"):
        world.nodes[name].crash()
        world.nodes[name].start()
    world.nodes["r3"].crash()
    world.run(world.now + 1)
    for number in range(3):
        world.nodes["r1"].give(interface.Order("resume %d" % number, log_entries.Resume()))
    world.run(world.now + 1)
    world.nodes["r2"].give(interface.Order("evict", log_entries.Evict("r3", -1)))
    world.run(world.now + 2)
    assert world.nodes["r2"].results["evict"].ok
    assert world.replica("r1").members() == ["r1", "r2"]
    world.verify()


@pytest.mark.parametrize("partial", [False, True])
def test_a_log_that_was_cut_is_noticed_and_its_robot_joins_anew(partial: bool) -> None:
    world = team(TOKENS, 3, partial)
    world.nodes["r2"].crash()
    world.nodes["r2"].cut_log(12)
    world.nodes["r2"].start()
    world.run(world.now + 3)
    assert any("the log is shorter than" in f for f in world.nodes["r2"].faults)
    assert world.replica("r2").is_settled()
    all_agree(world)


def test_a_log_whose_end_may_be_lost_is_not_trusted() -> None:
    world = team(TOKENS, 3)
    world.fsync = False
    world.nodes["r2"].lose_power()
    world.nodes["r2"].start()
    world.run(world.now + 3)
    assert [r["why"] for r in world.nodes["r2"].disk.records() if r["kind"] == "outage"] == [
        "the machine was restarted, and the end of the log may not have reached the disk"
    ]
    assert world.replica("r2").is_settled()
    all_agree(world)


def test_a_log_of_which_only_the_header_is_left_is_not_taken_for_a_new_one() -> None:
    """Its robot would say something else under the numbers that it used before."""
    world = team(TOKENS, 3)
    world.fsync = False
    world.nodes["r2"].lose_power()
    del world.nodes["r2"].disk.lines[:]
    world.nodes["r2"].start()
    assert [r["kind"] for r in world.nodes["r2"].disk.records()][:2] == ["outage", "life"]
    world.run(world.now + 3)
    assert world.replica("r2").is_settled()
    assert world.replica("r2").incarnation > 0
    all_agree(world)
    world.verify()


def test_no_ballot_is_used_twice_though_a_log_is_lost() -> None:
    world = team(TOKENS, 3, True)
    for _ in range(3):
        world.nodes["r2"].crash()
        world.nodes["r2"].lose_log()
        world.nodes["r2"].start()
        world.run(world.now + 1.5)
    seen = {}
    for disk in world.logs():
        for record in disk.records():
            if record["kind"] == "accepted":
                key = (record["slot"], tuple(record["ballot"]))
                assert seen.setdefault(key, record["batch"]) == record["batch"]
    assert len({key[1][2] for key in seen if key[1][1] == "r2"}) > 1


def test_a_robot_out_of_contact_soon_starts_no_more_private_actions() -> None:
    world = team(TOUR, 3, True, evict_after=0.4)
    world.action_time = (0.01, 0.02)
    world.cut_off("r3")
    begin = world.now
    world.run(begin + 4)
    goals = [r["mono"] for r in world.nodes["r3"].disk.records() if r["kind"] == "goal"]
    assert not [t for t in goals if t > begin + 1.0]
    world.blocked.clear()
    world.run(world.now + 2)
    assert [
        r for r in world.nodes["r3"].disk.records() if r["kind"] == "goal" and r["mono"] > begin + 4
    ]


@pytest.mark.parametrize("partial", [False, True])
def test_a_name_without_a_robot_keeps_nobody_busy_and_nobody_out(partial: bool) -> None:
    world = team(TOKENS, 3, partial)
    world.acting = False
    world.run(world.now + 1)
    for name in ("r1", "r2", "r3"):
        world.replica(name).proposals.add_others(
            [Item(log_entries.Join("j", 0, "p1", "lost"), Origin("j", 0, 1, "lost"))]
        )
    before = [len(node.disk.lines) for node in world.nodes.values()]
    world.run(world.now + 3)
    assert [len(node.disk.lines) for node in world.nodes.values()] == before
    node = world.nodes["j"] = SimulatedNode(
        world, "j"
    )  # which lost its log after it had asked to be let in
    node.joins = True
    node.start()
    world.run(world.now + 2)
    assert "j" in world.replica("r1").members()

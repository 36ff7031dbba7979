"""Teams whose machines lose power, and with it the newest records of their logs."""

from __future__ import annotations

import json
from typing import Any, List

import pytest

from agreement.plans import make_plan
from agreement.world import SimulatedNode, World
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.messages import PROTOCOL_VERSION
from gspn_framework_package.execution.event_log import EventLog, Record
from gspn_framework_package.execution.verifier import verify

TOUR, MEET, TOKENS, CROWD = range(4)


class Team(World):
    """A team without ``fsync``."""

    def replica(self, name: str) -> Any:
        return self.nodes[name].replica

    def slots(self, name: str) -> List[Record]:
        return [r for r in self.nodes[name].disk.records() if r["kind"] == "slot"]

    def power_off(self, *names: str, kept: int = 10**9) -> None:
        """The power of these fails; at most ``kept`` records after the synced ones survive."""
        for name in names or list(self.nodes):
            node = self.nodes[name]
            node.crash()
            del node.disk.lines[node.disk.synced + kept :]
            node.trusted = False
        self.forget_what_is_lost()

    def start(self, *names: str) -> None:
        for name in names or list(self.nodes):
            self.nodes[name].start()

    def trust(self, at: str) -> Any:
        self.nodes[at].give(interface.ForceEvict("trust", ""))
        self.run(self.now + 2)
        return self.nodes[at].results["trust"]

    def all_agree(self) -> None:
        self.acting = False
        assert self.run(self.now + 6, self.has_settled), [
            (n.key, n.replica.waits_for()) for n in self.alive() if n.replica
        ]

    def verify(self) -> None:
        logs = [EventLog(str(d.header["log"]), d.header, d.records()) for d in self.logs()]
        verdict = verify(logs)
        assert verdict.violation is None, verdict.violation


def team(kind: int, robots: int, partial: bool = False) -> Team:
    world = Team(make_plan(kind, robots, partial, 0.0, 0.0, False), 1)
    world.fsync = world.mishaps = False
    world.start()
    world.run(1.0)
    return world


@pytest.mark.parametrize("partial", [False, True])
@pytest.mark.parametrize("robots", [1, 3])
@pytest.mark.parametrize("kept", [0, 10**9])
def test_a_team_whose_machines_all_lost_power_goes_on(
    robots: int, partial: bool, kept: int
) -> None:
    world = team(TOUR, robots, partial)
    for node in world.nodes.values():
        node.sync()
    synced = {name: world.slots(name) for name in world.nodes}
    world.run(world.now + 0.3)
    world.power_off(kept=kept)
    world.start()
    world.run(world.now + 3)
    for name in world.nodes:
        assert world.replica(name).is_settled()
        assert not world.replica(name).is_stuck()
        assert world.slots(name)[: len(synced[name])] == synced[name]
        assert len(world.slots(name)) > len(synced[name])
    world.all_agree()
    world.verify()


def test_a_team_that_ended_in_order_goes_on_with_any_quorum() -> None:
    world = team(TOKENS, 3)
    for node in world.nodes.values():
        node.end_in_order()
    before = world.slots("r1")
    world.start("r1", "r2")
    world.run(world.now + 2)
    assert world.replica("r1").is_settled()
    assert world.slots("r1")[: len(before)] == before
    assert not any(r["kind"] == "outage" for r in world.nodes["r1"].disk.records())


@pytest.mark.parametrize("partial", [False, True])
def test_without_one_robot_the_team_waits_and_says_what_to_do(partial: bool) -> None:
    world = team(TOUR, 3, partial)
    world.power_off()
    length = len(world.slots("r1"))
    world.start("r1", "r2")
    world.run(world.now + 3)
    for name in ("r1", "r2"):
        status = world.replica(name).status()
        assert status["stuck"]
        assert status["missing"] == ["r3"]
        assert "not heard: r3" in status["waits_for"]
        assert "gspn trust" in status["waits_for"]
        assert {r["robot"]: r["log"] for r in status["robots"]} == {
            "r1": "torn",
            "r2": "torn",
            "r3": "",
        }
    assert len(world.slots("r1")) <= length + 1  # what was accepted is not decided by two
    world.operator(log_entries.Resume(""), world.nodes["r1"])
    refused = [r for r in world.nodes["r1"].results.values() if not r.ok]
    assert "gspn trust" in refused[-1].text
    world.start("r3")
    world.run(world.now + 3)
    assert not world.replica("r1").is_stuck()
    world.all_agree()
    world.verify()


@pytest.mark.parametrize("partial", [False, True])
def test_the_operator_has_those_who_are_here_go_on(partial: bool) -> None:
    world = team(TOUR, 3, partial)
    world.power_off()
    world.start("r1", "r2")
    world.run(world.now + 2)
    done = world.trust("r2")
    assert done.ok, done
    world.run(world.now + 2)
    assert world.replica("r1").members() == ["r1", "r2"]
    assert world.replica("r1").is_settled()
    world.start("r3")
    world.run(world.now + 3)
    assert world.replica("r3").is_settled()
    world.all_agree()
    world.verify()


def test_a_robot_without_its_log_has_no_word_in_what_all_decide() -> None:
    world = team(TOKENS, 3)
    world.power_off()
    world.nodes["r3"].lose_log()
    world.start()
    world.run(world.now + 2)
    assert world.replica("r1").is_stuck()
    assert "without a log: r3" in world.replica("r1").waits_for()
    assert "switch them off" in world.trust("r1").text
    world.nodes["r3"].crash()
    world.run(world.now + 1)
    assert world.trust("r1").ok
    world.start("r3")
    world.run(world.now + 3)
    world.all_agree()


def test_an_order_to_trust_is_for_a_team_that_needs_it() -> None:
    world = team(TOKENS, 3)
    assert "are a quorum" in world.trust("r1").text


def test_who_was_let_in_before_the_power_failed_is_needed_after_it() -> None:
    """The votes that let it in were on the disk before anybody knew of them."""
    world = team(TOKENS, 1)
    joins = world.nodes["j0"] = SimulatedNode(world, "j0")
    joins.joins = True
    world.start("j0")
    assert world.run(
        world.now + 2, lambda: "j0" in (world.replica("r1").members() if joins.replica else ())
    )
    world.power_off("r1", kept=0)
    joins.crash()
    world.start("r1")
    world.run(world.now + 2)
    assert world.replica("r1").members() == ["r1", "j0"]
    assert "not heard: j0" in world.replica("r1").waits_for()
    world.start("j0")
    world.run(world.now + 2)
    world.all_agree()


def _outage_of_two() -> Team:
    """r1 and r2 lost power, and are about to come back; r3 goes on alone."""
    world = team(TOKENS, 3)
    world.acting = False
    world.run(world.now + 1)
    world.power_off("r1", "r2", kept=0)
    return world


def _sent_by(world: Team, robot: str, **body: Any) -> None:
    """r3 gets a message of the life of a robot before the outage."""
    ledger = world.replica("r3").ledger
    told = {
        "version": PROTOCOL_VERSION,
        "from": robot,
        "team": world.replica("r3").config.tag,
        "log": world.nodes[robot].disk.header["log"],
        "incarnation": 0,
        "records": 1000,
        "length": ledger.length,
        "hash": ledger.hash,
    }
    world.nodes["r3"].give(interface.Received(json.loads(json.dumps({**told, **body}))))


def _lost_slot(world: Team) -> Any:
    ledger = world.replica("r3").ledger
    log = world.nodes["r1"].disk.header["log"]
    pause = [{"entry": "pause", "robot": ""}, ["r1", 0, 999, log[:8]], 0]
    slot = [[50, "r1", log], [pause], ledger.hash]
    return {"kind": "learn", "at": ledger.length, "slots": [slot]}


def test_what_a_robot_sent_before_the_outage_does_not_count_after_it() -> None:
    """It may be about a slot that was decided, and lost, and is decided again."""
    for comes_back in (False, True):
        world = _outage_of_two()
        length = world.replica("r3").ledger.length
        if comes_back:
            world.blocked |= {("r3", "r1"), ("r3", "r2")}  # nothing is decided yet
            world.start("r1", "r2")
            world.run(world.now + 0.5)
        _sent_by(world, "r1", **_lost_slot(world))
        assert world.replica("r3").ledger.length == length + (not comes_back)


def test_who_voted_with_all_does_not_learn_from_a_robot_outside() -> None:
    """A robot that is no member may know a slot that the members lost."""
    world = _outage_of_two()
    replica = world.replica("r3")
    assert replica.electorate.can_teach("j0")
    world.start("r1", "r2")
    seen = []

    def voted() -> bool:
        if replica.state.by_all:
            seen.append((replica.electorate.can_teach("j0"), replica.electorate.can_teach("r1")))
        return bool(seen)

    while not voted() and world.now < 10:
        world.run(world.now + 0.0005)
    assert seen[0] == (False, True)


def test_the_vote_of_a_torn_log_counts_only_among_all() -> None:
    """r3 knows all that it voted for, r1 does not, and r2 is off: two of three are no quorum."""
    world = team(TOKENS, 3)
    world.power_off("r1", "r2")
    world.start("r1")
    before = world.replica("r3").ledger.length
    world.run(world.now + 3)
    assert world.replica("r3").is_stuck()
    assert world.replica("r3").ledger.length <= before + 1
    world.start("r2")
    world.run(world.now + 3)
    world.all_agree()
    world.verify()


# -- damaged logs ----------------------------------------------------------------------------------


@pytest.mark.parametrize("partial", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.99])
def test_a_robot_whose_log_was_damaged_learns_it_again(partial: bool, share: float) -> None:
    world = team(TOUR, 3, partial)
    node = world.nodes["r2"]
    node.crash()
    assert node.disk is not None
    whole = int(share * len(node.disk.lines))
    node.damage_log(whole)
    node.start()
    assert not world.replica("r2").may_vote()
    world.run(world.now + 2)
    assert world.replica("r2").may_vote()
    assert world.replica("r2").is_settled()
    assert any("a line is damaged" in fault for fault in node.faults)
    world.all_agree()
    world.verify()


@pytest.mark.parametrize("partial", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
@pytest.mark.parametrize("restarts", [0, 1])
def test_a_robot_alone_whose_log_was_damaged_waits_for_the_operator(
    partial: bool, share: float, restarts: int
) -> None:
    world = team(TOUR, 1, partial)
    node = world.nodes["r1"]
    node.crash()
    assert node.disk is not None
    node.damage_log(int(share * len(node.disk.lines)))
    world.forget_what_is_lost()
    node.start()
    for _ in range(restarts):
        node.crash()
        node.start()
    world.run(world.now + 2)
    assert world.replica("r1").is_stuck()
    assert "a line is damaged" in world.replica("r1").waits_for()
    assert "gspn trust" in world.replica("r1").waits_for()
    assert world.trust("r1").ok
    assert world.replica("r1").is_settled()
    world.all_agree()
    world.verify()

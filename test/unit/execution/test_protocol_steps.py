"""Rules of the agreement that random schedules seldom need: one step of a replica at a time. The
faults in ``test/agreement/mutants/survivors.py`` name the test here that fails with each of them."""

from __future__ import annotations

from typing import Any, List

from agreement.plans import make_plan
from agreement.world import PACE, SimulatedNode, World
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.membership import LINGER
from gspn_framework_package.execution.agreement.messages import (
    Accept,
    Accepted,
    Batch,
    Learn,
    Prepare,
    Promise,
    Pull,
    parse_envelope,
)
from gspn_framework_package.execution.agreement.peers import Life, Peer
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.ledger import Item, Ledger, Origin

TOUR, MEET, TOKENS = range(3)


class Quiet(World):
    """A team in which nothing happens any more but what the test does."""

    def __init__(self, robots: int, partial: bool = False, evict_after: float = 0.0) -> None:
        super().__init__(make_plan(TOKENS, robots, partial, evict_after, 0.0, False), 1)
        self.mishaps = False
        for node in self.nodes.values():
            node.start()
        self.run(0.6)
        self.acting = False
        assert self.run(self.now + 5, self.has_settled)

    def replica(self, name: str) -> Any:
        return self.nodes[name].replica

    def say(self, sender: str, to: str, body: Any, **fields: Any) -> List[interface.Effect]:
        """What a robot does with a message of another."""
        message = {**self.replica(sender).outbox.signed(body), **fields}
        effects: List[interface.Effect] = self.replica(to).step(
            interface.Received(message), self.now
        )
        return effects

    def ballot(self, counter: int, robot: str) -> Ballot:
        return Ballot(counter, robot, self.replica(robot).log_id)

    def propose(self, robot: str, frozen: bool = False) -> List[interface.Effect]:
        replica = self.replica(robot)
        replica.consensus.propose(self.now, frozen)
        effects: List[interface.Effect] = replica.outbox.flush()
        return effects


def pause_of(robot: str, number: int = 1, incarnation: int = 1) -> Item:
    return Item(log_entries.Pause(), Origin(robot, incarnation, number, "another"))


def sent(effects: List[interface.Effect], kind: str) -> List[Any]:
    return [e for e in effects if isinstance(e, interface.Send) and e.message["kind"] == kind]


def written(effects: List[interface.Effect], kind: str) -> List[Any]:
    return [e for e in effects if isinstance(e, interface.Persist) and e.record["kind"] == kind]


# -- ballots and votes -------------------------------------------------------------------------------


def test_a_proposer_writes_its_own_promise_before_it_asks_the_others() -> None:
    effects = Quiet(3).propose("r2")
    (promised,), asked = written(effects, "promised"), sent(effects, "prepare")
    assert promised.durable and promised.record["ballot"] == asked[0].message["ballot"]
    assert effects.index(promised) < effects.index(asked[0])


def test_a_proposer_begins_above_every_ballot_that_it_accepted() -> None:
    world = Quiet(5)
    slot = world.length()
    world.say("r1", "r2", Accept(slot, world.ballot(50, "r1"), Batch.of([pause_of("r1")])))
    assert sent(world.propose("r2"), "prepare")[0].message["ballot"][0] == 51


def test_a_proposer_takes_the_batch_of_the_highest_ballot_not_of_the_last_name() -> None:
    world = Quiet(5)
    slot, replica = world.length(), world.replica("r2")
    replica.state.highest = world.ballot(9, "r1")
    world.propose("r2")
    high, low = Batch.of([pause_of("r1")]), Batch.of([pause_of("r3")])
    ballot = world.ballot(10, "r2")
    world.say("r1", "r2", Promise(slot, ballot, True, (world.ballot(5, "r1"), high), []))
    effects = world.say("r3", "r2", Promise(slot, ballot, True, (world.ballot(4, "r3"), low), []))
    assert {str(e.message["batch"]) for e in sent(effects, "accept")} == {str(high.data)}


def test_a_vote_counts_only_from_a_robot_with_the_same_log() -> None:
    world = Quiet(3)
    slot, replica = world.length(), world.replica("r2")
    replica.proposals.propose(log_entries.Pause())
    world.propose("r2")
    ballot = replica.state.attempt.ballot
    world.say("r1", "r2", Promise(slot, ballot, True, None, []))
    assert replica.state.attempt.batch is not None
    world.say("r1", "r2", Accepted(slot, ballot, []), hash="0" * 64)
    assert replica.ledger.length == slot
    world.say("r1", "r2", Accepted(slot, ballot, []))
    assert replica.ledger.length == slot + 1


def test_the_next_slot_confirms_what_was_accepted_only_under_the_same_ballot() -> None:
    for counter, confirmed in ((6, False), (5, True)):
        world = Quiet(5)
        slot, batch = world.length(), Batch.of([pause_of("r1")])
        world.say("r1", "r2", Accept(slot, world.ballot(5, "r1"), batch))
        after = Batch.of([pause_of("r1", 2)])
        world.say("r1", "r2", Accept(slot + 1, world.ballot(counter, "r1"), after))
        assert (world.replica("r2").ledger.length > slot) is confirmed


def test_a_robot_that_answered_without_a_vote_is_asked_again() -> None:
    world = Quiet(3, partial=True)
    slot, replica = world.length(), world.replica("r1")
    replica.proposals.propose(log_entries.Pause())
    world.propose("r1", frozen=True)
    world.say("r2", "r1", Promise(slot, replica.state.attempt.ballot, False, None, []))
    effects = replica.step(interface.Tick(), world.now + 0.5)
    assert "r2" in [e.to for e in sent(effects, "prepare")]


# -- local transitions -------------------------------------------------------------------------------


def test_a_proposer_of_an_order_holds_still_itself() -> None:
    world = Quiet(3, partial=True)
    replica = world.replica("r1")
    replica.proposals.add_others([pause_of("r2")])
    world.propose("r1", frozen=True)
    assert replica.state.is_frozen()


def test_a_robot_without_a_vote_holds_still_too() -> None:
    world = Quiet(3, partial=True)
    replica = world.replica("r2")
    replica.state.active, replica.state.amnesic = False, True
    world.say("r1", "r2", Prepare(world.length(), world.ballot(50, "r1"), True))
    assert replica.state.frozen_by == world.ballot(50, "r1")


def test_a_slot_for_which_all_hold_still_is_decided_though_its_proposer_is_gone() -> None:
    world = Quiet(3, partial=True)
    replica = world.replica("r2")
    world.say("r1", "r2", Prepare(world.length(), world.ballot(50, "r1"), True))
    for after in (0.01, 0.02 + 2 * PACE.takeover):
        replica.step(interface.Tick(), world.now + after)
    assert replica.state.attempt is not None


def test_who_may_have_been_evicted_makes_no_local_transition() -> None:
    world = Quiet(3, partial=True, evict_after=0.4)
    replica = world.replica("r3")
    assert replica.robot._may_move_alone()
    replica.step(interface.Tick(), world.now + 0.5)
    assert not replica.robot._may_move_alone()


def test_an_eviction_of_an_earlier_life_ends_no_life() -> None:
    asks = Quiet(3, partial=True).replica("r1").electorate.ends_life
    assert asks(log_entries.Evict("r2", 0), {"r2": False})
    assert not asks(log_entries.Evict("r2", -1), {"r2": False})


def test_of_robots_that_all_go_at_once_the_proposer_stays_for_a_later_slot() -> None:
    electorate = Quiet(3).replica("r1").electorate
    items = [
        Item(log_entries.Evict(r, 0), Origin("r2", 1, number, "another"))
        for number, r in enumerate(("r1", "r2", "r3"), 1)
    ]
    assert electorate.with_one_who_stays(items) == items[1:]
    assert electorate.with_one_who_stays(items[:2]) == items[:2]


# -- what is written, and what is noted --------------------------------------------------------------


def test_the_first_contact_with_a_robot_is_on_the_disk() -> None:
    world = World(make_plan(TOKENS, 3, False, 0.0, 0.0, False), 1)
    for name in ("r1", "r2"):
        world.nodes[name].start()
    one, two = (world.nodes[name].replica for name in ("r1", "r2"))
    assert one is not None and two is not None
    hello = two.outbox.signed(two.membership._hello())
    (noted,) = written(one.step(interface.Received(hello), world.now), "peer")
    assert noted.durable and noted.synced


def test_a_slot_that_a_robot_decided_alone_counts_as_its_vote() -> None:
    world = Quiet(1)
    effects = world.replica("r1").step(interface.Order("o", log_entries.Pause()), world.now)
    (slot,) = written(effects, "slot")
    assert slot.durable


def test_what_is_known_of_the_length_of_a_log_does_not_shrink_with_an_old_message() -> None:
    world, peer = Quiet(2), Peer()
    message = world.replica("r2").outbox.signed(Pull())
    for records in (10, 4):
        peer.note_life(parse_envelope({**message, "records": records}))
    assert peer.life == Life(0, 10)


def test_a_new_life_is_above_every_one_that_the_log_knows() -> None:
    replica = Quiet(2).replica("r2")
    replica.state.ledger.seen["r2"] = (5, 1, "another")
    replica.membership.new_life()
    assert replica.incarnation == 6


def test_a_robot_in_whose_name_an_entry_came_begins_another_life() -> None:
    """A late message of a former life, or of another process of its name."""
    world = Quiet(3)
    slot, replica = world.length(), world.replica("r2")
    batch = Batch.of([pause_of("r2", incarnation=5)])
    learn = Learn(at=slot, slots=((world.ballot(3, "r1"), batch, replica.ledger.hash),))
    world.say("r1", "r2", learn)
    assert replica.ledger.length > slot
    assert (replica.incarnation, replica.halted) == (6, None)


def test_proposals_of_others_go_into_the_log_in_the_order_of_their_numbers() -> None:
    queue = Quiet(3).replica("r1").proposals
    queue.add_others([pause_of("r2", number) for number in (3, 1, 2)])
    assert [i.origin.number for i in queue.batch(False).items] == [1, 2, 3]


def test_a_snapshot_names_those_who_were_evicted_by_force() -> None:
    ledger = Quiet(2).replica("r1").ledger
    ledger.cast_out = {"r2": 3}
    again = Ledger(ledger.first)
    again.restore(ledger.snapshot())
    assert again.cast_out == {"r2": 3}


def test_a_snapshot_that_ends_with_the_open_slot_is_taken() -> None:
    world = Quiet(3)
    replica, ahead = world.replica("r3"), Ledger(world.replica("r1").ledger.first)
    ahead.restore(world.replica("r1").ledger.snapshot())
    ahead.append([pause_of("r1")])
    world.say("r1", "r3", Learn(snapshot=ahead.snapshot()), length=ahead.length, hash=ahead.hash)
    assert (replica.ledger.length, replica.ledger.hash) == (ahead.length, ahead.hash)


def test_an_order_is_not_lost_with_the_process_that_took_it() -> None:
    world = Quiet(3)
    node = world.nodes["r2"]
    world.blocked = {(a, b) for a in world.nodes for b in world.nodes if "r2" in (a, b)}
    node.give(interface.Order("o", log_entries.Pause()))
    node.crash()
    node.start()
    world.blocked.clear()
    world.run(world.now + 2)
    assert world.replica("r1").ledger.state.paused


def test_an_order_that_comes_while_a_robot_listens_is_carried_out() -> None:
    world = World(make_plan(TOKENS, 1, False, 0.0, 0.0, False), 1)
    node = world.nodes["r1"]
    node.start()
    node.give(interface.Order("o", log_entries.Pause()))
    assert not node.results
    world.run(1.0)
    assert node.results["o"].ok


# -- who is let in, and who goes ---------------------------------------------------------------------


def test_who_joins_counts_for_the_quorum_with_which_it_is_let_in() -> None:
    """Half of two robots is alive, and is a quorum with the third."""
    world = Quiet(2)
    world.nodes["r2"].crash()
    world.run(world.now + 2)
    node = world.nodes["j1"] = SimulatedNode(world, "j1")
    node.joins = True
    node.start()
    world.run(world.now + 2)
    assert world.replica("r1").members() == ["r1", "r2", "j1"]


def test_a_join_of_a_lost_log_keeps_no_later_one_out() -> None:
    replica = Quiet(3).replica("r1")
    replica.state.peers.hear("j1", replica.state.now).log = "here"
    lost, here = (
        Item(log_entries.Join("j1", number, "p1", log), Origin("j1", number, 1, log))
        for number, log in enumerate(("lost", "here"))
    )
    assert replica.electorate.without_ghosts([lost, here]) == [here]


def test_a_join_that_nobody_answers_for_keeps_nobody_busy() -> None:
    replica = Quiet(3).replica("r2")
    join = Item(log_entries.Join("j1", 0, "p1", "gone"), Origin("j1", 0, 1, "gone"))
    peer = replica.state.peers.hear("j1", replica.state.now)
    for peer.log, wants in (("here", False), ("gone", True)):
        replica.proposals.add_others([join])
        assert replica.proposer.wants() is wants


def test_a_witness_that_lost_its_log_comes_back() -> None:
    world = World(make_plan(TOKENS, 2, False, 0.0, 0.0, True), 1)
    for node in world.nodes.values():
        node.start()
    world.run(0.6)
    (witness,) = (world.nodes[name] for name in world.plan.witness)
    witness.crash()
    witness.lose_log()
    witness.start()
    world.run(world.now + 2)
    assert witness.replica is not None and witness.replica.may_vote()


def test_a_log_that_ends_before_an_eviction_by_force_was_not_given_up() -> None:
    gives_up = Quiet(3).replica("r1").membership._is_given_up
    assert not gives_up("r3", {}, 5, {"r3": 5})
    assert gives_up("r3", {}, 6, {"r3": 5})
    # both hold one eviction, and the other log one more
    assert not gives_up("r1", {"r3": 5}, 9, {"r3": 5})
    assert gives_up("r1", {"r3": 5}, 9, {"r3": 5, "r2": 7})


def test_of_two_logs_with_evictions_by_force_the_one_with_fewer_is_kept() -> None:
    """Both evict r3; the one that does so later counts that eviction as well."""
    gives_up = Quiet(3).replica("r1").membership._is_given_up
    one, other = {"r2": 5, "r3": 6}, {"r1": 4, "r3": 3}
    assert gives_up("r1", one, 9, other)
    assert not gives_up("r2", other, 9, one)


def test_a_robot_that_left_does_not_wait_for_ever_to_be_heard() -> None:
    replica = Quiet(3).replica("r2")
    for peer in replica.state.peers.all.values():
        peer.length = 0
    for lingers in (True, False):
        replica.membership.part()
        assert (replica.halted is None) is lingers
        replica.state.now += LINGER * replica.pace.heartbeat


def test_robots_that_wait_do_not_answer_each_others_answers_without_end() -> None:
    world = World(make_plan(TOKENS, 3, False, 0.0, 0.0, False), 1)
    for name in ("r1", "r2"):
        world.nodes[name].start()
    world.run(2.0)
    assert not any(n.replica.active for n in world.alive() if n.replica is not None)
    assert world.messages < 200

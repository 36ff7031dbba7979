"""Small faults that random schedules find late or never. A transcript or a unit test shows each of
them; where none can, ``harmless`` says why the fault changes nothing that counts."""

from __future__ import annotations

import math
from typing import Any, Callable, Collection, ContextManager, Dict, List, Sequence, Set
from unittest import mock

from agreement.mutants.mutant import Mutant, wrap
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import electorate as electorate_module
from gspn_framework_package.execution.agreement import membership as membership_module
from gspn_framework_package.execution.agreement import peers as peers_module
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.messages import Accept, Envelope, Hello, Learn
from gspn_framework_package.execution.agreement.orders import Orders
from gspn_framework_package.execution.agreement.outbox import Outbox
from gspn_framework_package.execution.agreement.proposals import ProposalQueue
from gspn_framework_package.execution.agreement.proposer import Proposer
from gspn_framework_package.execution.agreement.quorum import Ballot, is_quorum
from gspn_framework_package.execution.agreement.replication import Replication
from gspn_framework_package.execution.agreement.state import Proposal, Waiting
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.ledger import Ledger


def _forgets_its_own_promise() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def promise(self: Consensus, ballot: Ballot, torn: Any) -> None:
            if ballot.robot != self.config.name:
                original(self, ballot, torn)
                return
            self._see(ballot)
            self.state.promised = max(self.state.promised, ballot)

        return promise

    return wrap(Consensus, "_promise", make)


def _sees_no_ballot_in_accept() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_accept(self: Consensus, message: Envelope, body: Accept) -> None:
            with mock.patch.object(self, "_see", lambda ballot: None):
                original(self, message, body)

        return on_accept

    return wrap(Consensus, "on_accept", make)


def _takes_accepted_by_name() -> ContextManager[Any]:
    """Of several accepted batches, that of the robot whose name comes last, not the highest."""

    def make(original: Any) -> Any:
        def over(self: Consensus) -> bool:
            attempt = self.state.attempt
            if attempt is None or attempt.batch is not None:
                return bool(original(self))
            held = [a for a in attempt.promises.values() if a is not None]
            if held:
                last = max(held, key=lambda a: (a[0].robot, a[0].counter))
                for robot, accepted in attempt.promises.items():
                    if accepted is not None and accepted[0] != last[0]:
                        attempt.promises[robot] = last
            return bool(original(self))

        return over

    return wrap(Consensus, "_first_phase_over", make)


def _counts_votes_of_other_logs() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_accepted(self: Consensus, message: Envelope, body: Any, now: float) -> None:
            original(self, message._replace(hash=self.state.ledger.hash), body, now)

        return on_accepted

    return wrap(Consensus, "on_accepted", make)


def _believes_any_ballot_of_the_robot() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_accept(self: Consensus, message: Envelope, body: Accept) -> None:
            held, follows = self.state.accepted, body.slot == self.state.ledger.length + 1
            if held is not None and follows and held[0].robot == body.ballot.robot:
                self.log.decided(held[1], held[0], mine=False)
            original(self, message, body)

        return on_accept

    return wrap(Consensus, "on_accept", make)


def _counts_those_cast_out() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def hear(self: Membership, message: Envelope) -> bool:
            with mock.patch.object(Ledger, "is_cast_out", lambda self, name: False):
                return bool(original(self, message))

        return hear

    return wrap(Membership, "hear", make)


def _persists_lightly(applies: Callable[[Record], bool]) -> Callable[[], ContextManager[Any]]:
    """Records of this kind need not be on the disk, and do not count for the length of the log."""

    def apply() -> ContextManager[Any]:
        def make(original: Any) -> Any:
            def persist(self: Outbox, record: Record, **waits: bool) -> None:
                original(self, record, **({} if applies(record) else waits))

            return persist

        return wrap(Outbox, "persist", make)

    return apply


def _begins_a_life_without_the_log() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def new_life(self: Membership) -> None:
            with mock.patch.object(Electorate, "known_incarnation", lambda self: -1):
                original(self)

        return new_life

    return wrap(Membership, "new_life", make)


def _keeps_the_order_of_arrival() -> ContextManager[Any]:
    def append(self: Waiting, proposal: Proposal) -> None:
        origin = proposal.item.origin
        self._all[origin] = proposal
        self._asking.pop(origin, None)
        if not proposal.item.private:
            self._asking[origin] = proposal

    return mock.patch.object(Waiting, "append", append)


def _does_not_count_who_joins() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def without(self: Electorate, items: Any) -> Any:
            def without_the_last(voters: Collection[str], members: Sequence[str]) -> bool:
                return is_quorum(set(voters) - {members[-1]}, members)

            with mock.patch.object(electorate_module, "is_quorum", without_the_last):
                return original(self, items)

        return without

    return wrap(Electorate, "without_ghosts", make)


def _gives_up_at_the_eviction() -> ContextManager[Any]:
    """A log that ends where the other evicts a robot by force is given up, not only a longer
    one."""

    def make(original: Any) -> Any:
        def is_given_up(
            self: Membership, owner: str, one: Dict[str, int], length: int, other: Dict[str, int]
        ) -> bool:
            return bool(original(self, owner, one, length + 1, other))

        return is_given_up

    return wrap(Membership, "_is_given_up", make)


def _moves_though_perhaps_evicted() -> ContextManager[Any]:
    return mock.patch.object(Electorate, "surely_a_member", lambda self: True)


def _does_not_freeze_itself() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def propose(self: Consensus, now: float, frozen: bool = False) -> None:
            before, ran = self.state.frozen_by, self.state.attempt
            original(self, now, frozen)
            if self.state.attempt is not ran and self.state.attempt is not None:
                self.state.frozen_by = before

        return propose

    return wrap(Consensus, "propose", make)


def _notes_any_length() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def note_life(self: peers_module.Peer, message: Envelope) -> None:
            original(self, message)
            self.life = peers_module.Life(message.incarnation, message.records)

        return note_life

    return wrap(peers_module.Peer, "note_life", make)


def _counts_all_records() -> ContextManager[Any]:
    """A robot says that records are safe which a loss of power may take."""

    def make(original: Any) -> Any:
        def signed(self: Outbox, body: Any) -> Any:
            durable, self.state.durable = self.state.durable, self.state.records
            try:
                return original(self, body)
            finally:
                self.state.durable = durable

        return signed

    return wrap(Outbox, "signed", make)


def _snapshot_without_those_cast_out() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def snapshot(self: Ledger) -> Record:
            return {**original(self), "cast_out": {}}

        return snapshot

    return wrap(Ledger, "snapshot", make)


def _ignores_a_snapshot_of_the_open_slot() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_learn(self: Replication, message: Envelope, body: Learn) -> None:
            snapshot = body.snapshot
            if snapshot is None or snapshot["slot"] != self.state.ledger.length:
                original(self, message, body)

        return on_learn

    return wrap(Replication, "on_learn", make)


def _leads_on_after_others() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def next_slot(self: Consensus, keep_lead: bool, returned: Set[str]) -> None:
            original(self, True, returned)

        return next_slot

    return wrap(Consensus, "next_slot", make)


def _forgets_orders_in_a_restart() -> ContextManager[Any]:
    ends = ("done", "failed", "join")

    def make(original: Any) -> Any:
        def recall(self: ProposalQueue, record: Record) -> None:
            if record["kind"] != "invoked" or record["entry"]["entry"] in ends:
                original(self, record)

        return recall

    return wrap(ProposalQueue, "recall", make)


def _drops_orders_while_it_listens() -> ContextManager[Any]:
    return mock.patch.object(Orders, "take_up_held", lambda self: self.state.held_orders.clear())


# -- faults that were mended, taken back ------------------------------------------------------------


def _freezes_only_with_a_vote() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def answer(self: Consensus, message: Envelope, body: Any, vote: bool) -> None:
            original(self, message, body, vote)
            if not vote and self.state.frozen_by == body.ballot:
                self.state.frozen_by = None

        return answer

    return wrap(Consensus, "_answer_prepare", make)


def _does_not_decide_what_is_frozen() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def wants(self: Proposer) -> bool:
            frozen, self.state.frozen_by = self.state.frozen_by, None
            try:
                return bool(original(self))
            finally:
                self.state.frozen_by = frozen

        return wants

    return wrap(Proposer, "wants", make)


def _counts_evictions_of_earlier_lives() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def ends_life(self: Electorate, entry: log_entries.Entry, robots: Any) -> bool:
            evicts = isinstance(entry, log_entries.Evict) and entry.robot in robots
            return bool(evicts or original(self, entry, robots))

        return ends_life

    return wrap(Electorate, "ends_life", make)


def _stays_fenced() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def watch(self: Membership) -> None:
            fenced = self.state.fenced
            original(self)
            if not self.electorate.may_vote():
                self.state.fenced = fenced

        return watch

    return wrap(Membership, "watch", make)


def _waits_for_the_voteless_to_propose() -> ContextManager[Any]:
    return mock.patch.object(Proposer, "_others_want", lambda self: self.consensus.leads())


def _overlooks_what_was_said_for_it() -> ContextManager[Any]:
    return mock.patch.object(Electorate, "spoken_for", lambda self: False)


def _stands_still_after_a_log_was_given_up() -> ContextManager[Any]:
    """It joins under the incarnation under which it acted in that log."""

    def make(original: Any) -> Any:
        def want(self: Membership) -> None:
            started, self.state.started = self.state.started, None
            try:
                original(self)
            finally:
                self.state.started = started

        return want

    return wrap(Membership, "want_to_join", make)


def _lets_the_last_one_go() -> ContextManager[Any]:
    return mock.patch.object(Electorate, "with_one_who_stays", lambda self, items: items)


def _lets_spares_in() -> ContextManager[Any]:
    return mock.patch.object(Electorate, "without_spares", lambda self, items: list(items))


def _waits_for_ever_to_be_heard() -> ContextManager[Any]:
    return mock.patch.object(membership_module, "LINGER", 10**9)


def _is_a_witness_without_its_log() -> ContextManager[Any]:
    """The word of a robot that lost its own log lets another one begin."""

    def make(original: Any) -> Any:
        def hear(self: Membership, message: Envelope, seen: Any) -> None:
            original(self, message, seen)
            self.state.peers.get(message.sender).welcomes = seen.log

        return hear

    return wrap(Membership, "_hear_of_ourselves", make)


def _asks_only_those_with_a_whole_log() -> ContextManager[Any]:
    """As before: a robot without a vote asks whom it hears, be it without a vote itself."""
    return mock.patch.object(Electorate, "whole", lambda self: [])


def _does_not_ask_the_voteless_again() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def send(self: Consensus, attempt: Any, to: List[str]) -> None:
            answered = attempt.answered | attempt.strangers
            original(self, attempt, [m for m in to if m not in answered])

        return send

    return wrap(Consensus, "_send_attempt", make)


def _answers_every_answer() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_hello(self: Membership, message: Envelope, hello: Hello) -> None:
            self.state.peers.get(message.sender).answered = -math.inf
            original(self, message, hello)

        return on_hello

    return wrap(Membership, "on_hello", make)


def _is_first_contact(record: Record) -> bool:
    return record["kind"] == "peer" and "torn" not in record


def _step(name: str, text: str, apply: Callable[[], ContextManager[Any]], test: str) -> Mutant:
    """A fault that fails a test of one step."""
    return Mutant(name, "steps", text, apply, test="execution/test_protocol_steps.py::test_" + test)


MUTANTS: List[Mutant] = [
    _step(
        "own promise",
        "a proposer does not write down its own promise",
        _forgets_its_own_promise,
        "a_proposer_writes_its_own_promise_before_it_asks_the_others",
    ),
    _step(
        "unseen accept",
        "a proposer may begin below a ballot that it accepted",
        _sees_no_ballot_in_accept,
        "a_proposer_begins_above_every_ballot_that_it_accepted",
    ),
    _step(
        "last name",
        "of what was accepted, a proposer takes what the robot with the last name proposed",
        _takes_accepted_by_name,
        "a_proposer_takes_the_batch_of_the_highest_ballot_not_of_the_last_name",
    ),
    _step(
        "votes of other logs",
        "a vote counts whatever its sender has in its log",
        _counts_votes_of_other_logs,
        "a_vote_counts_only_from_a_robot_with_the_same_log",
    ),
    _step(
        "any ballot of it",
        "an Accept of the next slot confirms what was held under any ballot of its sender",
        _believes_any_ballot_of_the_robot,
        "the_next_slot_confirms_what_was_accepted_only_under_the_same_ballot",
    ),
    Mutant(
        "votes of those cast out",
        "steps",
        "messages of a robot that was evicted by force count",
        _counts_those_cast_out,
        harmless="Replica._give asks Ledger.is_cast_out again before a vote counts, and a robot that "
        "was cast out is no member, so Electorate.may_decide does not count it either.",
    ),
    _step(
        "first contact",
        "a loss of power takes the note whose log counts for a robot",
        _persists_lightly(_is_first_contact),
        "the_first_contact_with_a_robot_is_on_the_disk",
    ),
    _step(
        "decided alone",
        "a slot that a robot decided alone does not count as its vote",
        _persists_lightly(lambda record: record["kind"] == "slot"),
        "a_slot_that_a_robot_decided_alone_counts_as_its_vote",
    ),
    _step(
        "blind new life",
        "a new life ignores the incarnations that the log knows",
        _begins_a_life_without_the_log,
        "a_new_life_is_above_every_one_that_the_log_knows",
    ),
    _step(
        "order of arrival",
        "proposals of another robot stay in the order in which they came",
        _keeps_the_order_of_arrival,
        "proposals_of_others_go_into_the_log_in_the_order_of_their_numbers",
    ),
    _step(
        "joins uncounted",
        "who joins does not count for the quorum with which it is let in",
        _does_not_count_who_joins,
        "who_joins_counts_for_the_quorum_with_which_it_is_let_in",
    ),
    _step(
        "given up early",
        "a log that ends before an eviction by force counts as given up",
        _gives_up_at_the_eviction,
        "a_log_that_ends_before_an_eviction_by_force_was_not_given_up",
    ),
    _step(
        "moves though evicted",
        "a robot makes local transitions although it may have been evicted",
        _moves_though_perhaps_evicted,
        "who_may_have_been_evicted_makes_no_local_transition",
    ),
    _step(
        "proposer moves",
        "who proposes an order does not hold still",
        _does_not_freeze_itself,
        "a_proposer_of_an_order_holds_still_itself",
    ),
    _step(
        "length shrinks",
        "an old message makes a robot forget how long the log of another was",
        _notes_any_length,
        "what_is_known_of_the_length_of_a_log_does_not_shrink_with_an_old_message",
    ),
    Mutant(
        "unsynced records",
        "steps",
        "a robot says that records are safe which a loss of power may take",
        _counts_all_records,
        transcript="power_failure",
    ),
    _step(
        "snapshot without cast out",
        "a snapshot does not say who was evicted by force",
        _snapshot_without_those_cast_out,
        "a_snapshot_names_those_who_were_evicted_by_force",
    ),
    _step(
        "snapshot of the open slot",
        "a snapshot that holds one slot more is not taken",
        _ignores_a_snapshot_of_the_open_slot,
        "a_snapshot_that_ends_with_the_open_slot_is_taken",
    ),
    Mutant(
        "leads after others",
        "steps",
        "a leader goes on leading after a slot of another proposer",
        _leads_on_after_others,
        transcript="partition",
    ),
    _step(
        "orders of a restart",
        "a process that starts again has forgotten the orders that it took",
        _forgets_orders_in_a_restart,
        "an_order_is_not_lost_with_the_process_that_took_it",
    ),
    Mutant(
        "held orders",
        "steps",
        "orders that came while a robot only listened are lost",
        _drops_orders_while_it_listens,
        test="execution/test_protocol_steps.py::"
        "test_an_order_that_comes_while_a_robot_listens_is_carried_out",
    ),
    # faults that were mended, taken back
    _step(
        "voteless moves",
        "a robot without a vote goes on with local transitions",
        _freezes_only_with_a_vote,
        "a_robot_without_a_vote_holds_still_too",
    ),
    _step(
        "frozen for ever",
        "nobody decides a slot for which all hold still",
        _does_not_decide_what_is_frozen,
        "a_slot_for_which_all_hold_still_is_decided_though_its_proposer_is_gone",
    ),
    _step(
        "old eviction",
        "a member is not asked because an earlier life of it is to be evicted",
        _counts_evictions_of_earlier_lives,
        "an_eviction_of_an_earlier_life_ends_no_life",
    ),
    Mutant(
        "stays fenced",
        "steps",
        "a robot that is evicted while it is fenced stays fenced",
        _stays_fenced,
        transcript="task_of_a_later_plan",
    ),
    Mutant(
        "waits for the voteless",
        "steps",
        "only the leader proposes what a robot without a vote wants",
        _waits_for_the_voteless_to_propose,
        transcript="another_log_let_in",
    ),
    _step(
        "spoken for",
        "a robot continues under an incarnation that another process has used",
        _overlooks_what_was_said_for_it,
        "a_robot_in_whose_name_an_entry_came_begins_another_life",
    ),
    Mutant(
        "visits of a lost log",
        "steps",
        "a robot whose log was given up takes the visits that it repeats for done",
        _stands_still_after_a_log_was_given_up,
        test="execution/test_operator_and_memory.py::"
        "test_visits_of_a_log_that_was_given_up_are_made_again",
    ),
    _step(
        "all go at once",
        "robots that all go at once go in one slot",
        _lets_the_last_one_go,
        "of_robots_that_all_go_at_once_the_proposer_stays_for_a_later_slot",
    ),
    Mutant(
        "spare at once",
        "steps",
        "a spare is let in while its robot is at work",
        _lets_spares_in,
        transcript="first_heard",
    ),
    _step(
        "lingers for ever",
        "a robot that left waits for ever to be heard",
        _waits_for_ever_to_be_heard,
        "a_robot_that_left_does_not_wait_for_ever_to_be_heard",
    ),
    Mutant(
        "forgetful witness",
        "steps",
        "the word of a robot that lost its log lets another one begin",
        _is_a_witness_without_its_log,
        test="execution/test_operator_and_memory.py::"
        "test_a_robot_that_lost_its_log_is_no_witness_of_a_start",
    ),
    Mutant(
        "asks the voteless",
        "steps",
        "robots that have no vote ask each other to be let in",
        _asks_only_those_with_a_whole_log,
        transcript="entries_of_a_lost_log",
    ),
    _step(
        "voteless not asked",
        "a robot that answered without a vote is not asked again",
        _does_not_ask_the_voteless_again,
        "a_robot_that_answered_without_a_vote_is_asked_again",
    ),
    _step(
        "endless answers",
        "robots that wait answer each other's answers",
        _answers_every_answer,
        "robots_that_wait_do_not_answer_each_others_answers_without_end",
    ),
]

"""Faults in memory and membership, in what operators order, and where a limit is reached."""

from __future__ import annotations

from typing import Any, Callable, ContextManager, List
from unittest import mock

from agreement.mutants.mutant import (
    Mutant,
    all_patched,
    wrap,
)
from gspn_framework_package.execution.agreement import membership as membership_module
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.agreement.local_robot import LocalRobot
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.messages import Batch, Envelope, Seen
from gspn_framework_package.execution.agreement.outbox import Outbox
from gspn_framework_package.execution.agreement.peers import Peers
from gspn_framework_package.execution.agreement.proposals import ProposalQueue
from gspn_framework_package.execution.agreement.quorum import Ballot, is_quorum
from gspn_framework_package.execution.agreement.recent_slots import RecentSlots
from gspn_framework_package.execution.agreement.recovery import Recovery
from gspn_framework_package.execution.agreement.replica import Replica
from gspn_framework_package.execution.agreement.replication import Replication
from gspn_framework_package.execution.agreement.status import Status
from gspn_framework_package.execution.ledger import Ledger


def _persists_no_promise() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def persist(self: Outbox, record: Any, **waits: bool) -> None:
            if record["kind"] != "promised":
                original(self, record, **waits)

        return persist

    return wrap(Outbox, "persist", make)


def _keeps_returned() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def next_slot(self: Consensus, keep_lead: bool, returned: Any) -> None:
            original(self, keep_lead, set())

        return next_slot

    return wrap(Consensus, "next_slot", make)


def _thaws_with_a_nack() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_nack(self: Consensus, body: Any) -> bool:
            beaten = bool(original(self, body))
            if beaten:
                self.state.frozen_by = None
            return beaten

        return on_nack

    return wrap(Consensus, "on_nack", make)


def _asks_again_without_freezing() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def resend(self: Consensus, now: float) -> None:
            if self.state.attempt is not None:
                self.state.attempt.frozen = False
            original(self, now)

        return resend

    return wrap(Consensus, "resend", make)


def _numbers_only() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def is_news(self: Ledger, origin: Any) -> bool:
            known = self.seen.get(origin.robot)
            return known is None or origin.number > known[1]

        return is_news

    return wrap(Ledger, "is_news", make)


def _evicts_alone() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def accusers(self: Peers, robot: str) -> Any:
            return set(self.all)

        return accusers

    return wrap(Peers, "accusers", make)


def _leaves_at_once() -> ContextManager[Any]:
    return mock.patch.object(membership_module, "LINGER", 0)


def _counts_its_own_sleep() -> ContextManager[Any]:
    return mock.patch.object(
        Peers, "listen_anew", lambda self, now: setattr(self, "since", min(self.since, now))
    )


def _skips_a_slot_of_a_chunk() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def since(self: RecentSlots, slot: int) -> Any:
            slots = original(self, slot)
            return slots[:-1] if slots is not None and len(slots) >= self._chunk else slots

        return since

    return wrap(RecentSlots, "since", make)


def _newest_first() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def batch(self: ProposalQueue, *given: Any) -> Batch:
            limits = self.config.limits
            self.config.limits = limits._replace(batch=10**6)
            try:
                whole: Batch = original(self, *given)
            finally:
                self.config.limits = limits
            return Batch.of(whole.items[-limits.batch :])

        return batch

    return wrap(ProposalQueue, "batch", make)


def _off_for_ever() -> ContextManager[Any]:
    def asserted_off(self: Electorate) -> Any:
        return {name for name in self.state.off if name in self.members()}

    return all_patched(
        mock.patch.object(Electorate, "asserted_off", asserted_off),
        mock.patch.object(Membership, "_heard_though_off", lambda self, robot: None),
    )


def _any_of_those_left() -> ContextManager[Any]:
    """As in a former version, the remaining members decide by their own quorum."""

    def may_decide(self: Electorate, voters: Any, by_all: bool = False) -> bool:
        off = self.asserted_off()
        return is_quorum(voters, [m for m in self.members() if m not in off])

    return mock.patch.object(Electorate, "may_decide", may_decide)


def _evicts_nobody() -> ContextManager[Any]:
    return mock.patch.object(Electorate, "not_cast_out", lambda self, *given: set())


def _drops_its_slots() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def forget(self: Membership, why: str, keep: bool = False) -> None:
            original(self, why)

        return forget

    return wrap(Membership, "forget", make)


def _lets_another_process_know() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def part(self: Membership) -> None:
            def last_heard(electorate: Electorate, robot: str) -> str:
                return electorate.state.peers.get(robot).log

            with mock.patch.object(Electorate, "known_log", last_heard):
                original(self)

        return part

    return wrap(Membership, "part", make)


def _is_silent_before_it_starts() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def is_stuck(self: Status) -> bool:
            lengths = [peer.length for peer in self.state.peers.all.values()]
            return max([self.state.ledger.length, *lengths]) > 1 and bool(original(self))

        return is_stuck

    return wrap(Status, "is_stuck", make)


def _asks_only_members() -> ContextManager[Any]:
    def asked(self: Electorate) -> List[str]:
        return [m for m in self.others() if m not in self.state.off]

    return mock.patch.object(Electorate, "witnesses_of_start", asked)


def _believes_the_forgetful() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def hear(self: Membership, message: Envelope, seen: Seen) -> None:
            original(self, message, seen)
            state = self.state
            other = seen.log not in (state.log_id, state.ledger.logs.get(self.config.name))
            if state.active and other:
                self.forget("%s knows an older log" % message.sender)

        return hear

    return wrap(Membership, "_hear_of_ourselves", make)


def _keeps_to_the_first_heard() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def note(self: Membership, message: Envelope) -> None:
            self.state.peers.unsure.clear()
            original(self, message)

        return note

    return wrap(Membership, "_note_log_of", make)


def _lets_lost_lives_stand() -> ContextManager[Any]:
    return mock.patch.object(
        ProposalQueue, "_without_lost_lives", lambda self, items, unasked: list(items)
    )


def _does_not_know_itself() -> ContextManager[Any]:
    return mock.patch.object(Electorate, "acted_before", lambda self: False)


def _takes_sleep_for_delay() -> ContextManager[Any]:
    return mock.patch.object(Consensus, "woke", lambda self, now: None)


def _forgets_who_was_cast_out() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def resume(self: Recovery, records: Any) -> None:
            original(self, records)
            self.state.ledger.cast_out.clear()

        return resume

    return wrap(Recovery, "resume", make)


def _counts_any_log() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def knows(self: Membership, message: Any) -> bool:
            original(self, message)
            self.state.peers.get(message.sender).surprise = None
            return True

        return knows

    return all_patched(
        wrap(Membership, "_knows", make),
        mock.patch.object(Electorate, "is_our_name", lambda self: True),
    )


def _is_hushed() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def knows(self: Membership, message: Envelope) -> bool:
            self.state.peers.get(message.sender).surprise = None
            return bool(original(self, message))

        return knows

    return wrap(Membership, "_knows", make)


def _ballots_without_log() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def propose(self: Consensus, now: float, frozen: bool = False) -> None:
            log_id, self.state.log_id = self.state.log_id, ""
            try:
                original(self, now, frozen)
            finally:
                self.state.log_id = log_id

        return propose

    return wrap(Consensus, "propose", make)


def _trusts_every_end() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def init(self: Replica, *given: Any, **named: Any) -> None:
            original(self, *given, **dict(named, trusted=True))

        return init

    return wrap(Replica, "__init__", make)


def _never_waits_for_the_disk() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def persist(self: Outbox, record: Any, **waits: bool) -> None:
            original(self, record)

        return persist

    return wrap(Outbox, "persist", make)


def _waits_for_votes_only_sometimes() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def persist(self: Outbox, record: Any, **waits: bool) -> None:
            voted = record["kind"] == "accepted"
            original(self, record, **{how: on and not voted for how, on in waits.items()})

        return persist

    return wrap(Outbox, "persist", make)


def _keeps_its_log_id() -> ContextManager[Any]:
    return mock.patch.object(Membership, "_renew_log_id", lambda self: None)


def _acts_before_it_knows_more() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def consider(self: Membership) -> None:
            peers = self.state.peers
            lengths = {name: peer.length for name, peer in peers.all.items()}
            for peer in peers.all.values():
                peer.length = 0
            original(self)
            for name, length in lengths.items():
                peers.get(name).length = length

        return consider

    return wrap(Membership, "consider_active", make)


def _snapshot_without(field: str) -> Callable[[], ContextManager[Any]]:
    def apply() -> ContextManager[Any]:
        def make(original: Any) -> Any:
            def snapshot(self: Ledger) -> Any:
                return {**original(self), field: {}}

            return snapshot

        return wrap(Ledger, "snapshot", make)

    return apply


def _keeps_promised_low() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_accept(self: Consensus, message: Any, body: Any) -> None:
            promised = self.state.promised
            original(self, message, body)
            self.state.promised = promised

        return on_accept

    return wrap(Consensus, "on_accept", make)


def _learns_what_it_holds() -> ContextManager[Any]:
    def on_chosen(self: Consensus, ballot: Ballot) -> bool:
        held = self.state.accepted
        if held is None:
            return False
        self.log.decided(held[1], held[0], mine=False)
        return True

    return mock.patch.object(Consensus, "on_chosen", on_chosen)


def _moves_while_paused() -> ContextManager[Any]:
    def may(self: LocalRobot) -> bool:
        return self.config.partial and self.electorate.is_settled() and not self.state.is_frozen()

    return mock.patch.object(LocalRobot, "_may_move_alone", may)


def _drops_the_first_proposal() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def batch(self: ProposalQueue, *given: Any) -> Batch:
            whole: Batch = original(self, *given)
            return Batch.of(whole.items[1:]) if len(whole.items) > 1 else whole

        return batch

    return wrap(ProposalQueue, "batch", make)


def _reads_no_facts_back() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def resume(self: Recovery, records: Any) -> None:
            original(self, [r for r in records if r["kind"] != "private"])

        return resume

    return wrap(Recovery, "resume", make)


def _takes_its_former_incarnation() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def new_life(self: Membership) -> None:
            before = self.state.incarnation
            original(self)
            if self.state.records > 1:
                self.state.incarnation = before

        return new_life

    return wrap(Membership, "new_life", make)


def _pulls_without_looking() -> ContextManager[Any]:
    """A replica takes over slots without checking that they follow from its own log."""

    def make(original: Any) -> Any:
        def on_learn(self: Replication, message: Any, body: Any) -> None:
            ledger = self.state.ledger
            if body.slots:
                slots = tuple((b, batch, ledger.hash) for b, batch, _ in body.slots[:1])
                body = body._replace(at=ledger.length, slots=slots)
            original(self, message, body)

        return on_learn

    return wrap(Replication, "on_learn", make)


MUTANTS: List[Mutant] = [
    Mutant("lost promises", "memory", "promises are not written down", _persists_no_promise),
    Mutant(
        "returned followers",
        "protocol",
        "a leader counts on promises of a lost memory",
        _keeps_returned,
        False,
        kinds=("archive",),
    ),
    Mutant(
        "nack thaws",
        "partial",
        "a proposer that is beaten lets local transitions go on",
        _thaws_with_a_nack,
        True,
        robots=5,
        kinds=("freeze",),
    ),
    Mutant(
        "warm retry",
        "partial",
        "a first phase that is repeated does not freeze",
        _asks_again_without_freezing,
        True,
        kinds=("freeze",),
    ),
    Mutant(
        "numbers only",
        "memory",
        "proposals are told apart by their number alone, not by the life of their robot",
        _numbers_only,
    ),
    Mutant(
        "no jury",
        "membership",
        "a robot is evicted though only one does not hear it",
        _evicts_alone,
        kinds=("link",),
    ),
    Mutant(
        "leaves at once",
        "membership",
        "a robot that leaves does not wait until others know",
        _leaves_at_once,
        kinds=("leave",),
        robots=2,
    ),
    Mutant(
        "own sleep",
        "membership",
        "a robot that was suspended assumes that the others were silent",
        _counts_its_own_sleep,
        kinds=("sleep",),
    ),
    Mutant(
        "short chunks",
        "limits",
        "the last slot of a full chunk is not sent",
        _skips_a_slot_of_a_chunk,
        kinds=("tight",),
    ),
    Mutant(
        "newest first",
        "limits",
        "a full batch keeps the newest proposals",
        _newest_first,
        kinds=("tight",),
    ),
    Mutant(
        "off for ever",
        "operator",
        "an assertion that a robot is off stays in force after it returns",
        _off_for_ever,
        kinds=("operator",),
        seeds=("127:2:partial:operator",),
    ),
    Mutant(
        "rest decides",
        "operator",
        "a quorum of the remaining robots decides after an eviction by force",
        _any_of_those_left,
        kinds=("operator",),
    ),
    Mutant(
        "decides and stays",
        "operator",
        "without a quorum, a team decides slots that do not evict the robots that are said to be off",
        _evicts_nobody,
        robots=2,
        kinds=("assertion",),
    ),
    Mutant(
        "drops its slots",
        "memory",
        "a robot whose place another log takes forgets the slots, even one that only it knows",
        _drops_its_slots,
        transcript="another_log_let_in",
    ),
    Mutant(
        "believes the forgetful",
        "membership",
        "a robot forgets slots by the word of one that lost its own log",
        _believes_the_forgetful,
        robots=2,
        kinds=("double", "spare"),
        seeds=("8000789:2:full:spare",),
    ),
    Mutant(
        "first come",
        "membership",
        "who lost its log keeps to the process of a name that it hears first afterwards",
        _keeps_to_the_first_heard,
        transcript="first_heard",
    ),
    Mutant(
        "lost lives stand",
        "memory",
        "what a lost memory announced stands before the return of its robot",
        _lets_lost_lives_stand,
        test="execution/test_replica.py::"
        "test_what_another_memory_of_a_life_announced_does_not_stand_before_its_return",
    ),
    Mutant(
        "not itself",
        "membership",
        "a robot without its log takes part, though the team's log holds entries of it",
        _does_not_know_itself,
        transcript="entries_of_a_lost_log",
    ),
    Mutant(
        "sleep is delay",
        "consensus",
        "a robot takes the time that it slept for the delay of the network",
        _takes_sleep_for_delay,
        robots=5,
        partial=True,
        kinds=("sleep",),
        seeds=("26011010:5:partial:react-sleep",),
    ),
    Mutant(
        "spare knows",
        "membership",
        "a robot that leaves ends when another process of a member knows, but not the member",
        _lets_another_process_know,
        transcript="leave_beside_a_spare",
    ),
    Mutant(
        "hushed",
        "membership",
        "in a large team, what a robot sends keeps it from hearing that its log lacks its end",
        _is_hushed,
        transcript="shortened_log",
    ),
    Mutant(
        "silent start",
        "memory",
        "a team that cannot start, because too many forgot their logs, does not say so",
        _is_silent_before_it_starts,
        robots=2,
        kinds=("stand-in",),
        seeds=("161004100:2:partial:deploy-stand-in",),
    ),
    Mutant(
        "shrunken start",
        "membership",
        "a robot that begins without a log does not ask the robots that are gone",
        _asks_only_members,
        robots=2,
        kinds=("double",),
        seeds=("101956:2:full:react-double",),
    ),
    Mutant(
        "forgets cast out",
        "operator",
        "a restarted robot forgets who was evicted by force",
        _forgets_who_was_cast_out,
        robots=2,
        kinds=("operator",),
    ),
    Mutant(
        "any log",
        "memory",
        "votes count from any log",
        _counts_any_log,
        kinds=("spare", "amnesia"),
    ),
    Mutant(
        "plain ballots",
        "memory",
        "a robot that lost its log uses its ballots again",
        _ballots_without_log,
        kinds=("amnesia", ""),
    ),
    Mutant(
        "trusts the end",
        "memory",
        "a log whose end is lost is trusted",
        _trusts_every_end,
        kinds=("power",),
    ),
    Mutant(
        "no sync",
        "memory",
        "nobody waits until a record is on the disk",
        _never_waits_for_the_disk,
        kinds=("power",),
    ),
    Mutant(
        "unsynced votes",
        "memory",
        "votes are sent before they are on the disk",
        _waits_for_votes_only_sometimes,
        kinds=("power",),
    ),
    Mutant(
        "same id",
        "memory",
        "a robot that forgot its log keeps the same id",
        _keeps_its_log_id,
        kinds=("power", "amnesia", "spare"),
    ),
    Mutant(
        "eager start",
        "membership",
        "a robot acts before it knows where the team is",
        _acts_before_it_knows_more,
        kinds=("late",),
    ),
    Mutant(
        "snapshot without seen",
        "limits",
        "a snapshot does not say whose proposals are in it",
        _snapshot_without("seen"),
        kinds=("tight",),
    ),
    Mutant(
        "snapshot without logs",
        "limits",
        "a snapshot does not say whose logs count",
        _snapshot_without("logs"),
        kinds=("archive",),
        seeds=("65:3:partial:archive",),
    ),
    Mutant(
        "low promise",
        "protocol",
        "a robot that accepts a ballot does not promise it",
        _keeps_promised_low,
        False,
        robots=5,
        kinds=("rivals",),
    ),
    Mutant(
        "learns what it holds",
        "protocol",
        "news that a slot is chosen confirms any value that was accepted",
        _learns_what_it_holds,
        False,
        kinds=("rivals",),
        seeds=("94:3:full:rivals",),
    ),
    Mutant(
        "moves while paused",
        "partial",
        "local transitions go on in a pause",
        _moves_while_paused,
        True,
        kinds=("freeze",),
    ),
    Mutant(
        "drops the first",
        "protocol",
        "of several proposals the first is left out",
        _drops_the_first_proposal,
    ),
    Mutant(
        "lost moves",
        "memory",
        "local transitions are not read back after a restart",
        _reads_no_facts_back,
        True,
    ),
    Mutant(
        "same incarnation",
        "membership",
        "a robot that starts again keeps its incarnation",
        _takes_its_former_incarnation,
    ),
    Mutant(
        "blind learning",
        "protocol",
        "slots are learned whatever log they continue",
        _pulls_without_looking,
        kinds=("operator", ""),
    ),
]

"""Paxos, slot by slot: acceptor, proposer and learner of one replica.

Single-decree Paxos (Lamport 1998) decides each slot of the log, among the members that the log
before it names. A promise holds for its slot and all later ones; a replica has accepted nothing
beyond its first open slot. A proposer whose value was just chosen may therefore skip the first
phase in the next slot, as long as those who promised are a quorum there too. In full
synchronisation it *leads*, and takes the others' proposals until somebody else takes over. Before
any ballot, the first member leads under ballot (0, its name), which every fresh replica counts as
promised.

In partial synchronisation nobody leads: the first phase is how a proposer learns the local
transitions of the others. It needs an answer from every member that it does not evict in the same
slot. A process without the member's memory answers for it only in a slot with which another life of
the robot begins.

One slot is open at a time; batches carry the load.

Owns the ballots, votes and the running attempt of the open slot (the fields of consensus in
:class:`~gspn_framework_package.execution.agreement.state.ReplicaState`). Asks the electorate who
may decide and the proposals what to propose, writes and sends through the outbox, and hands what is
chosen to the log (:class:`ConsensusLog`).
"""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional, Protocol, Set, Union

from gspn_framework_package.execution.agreement.config import Config
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.agreement.messages import (
    MOST_ITEMS,
    Accept,
    Accepted,
    Batch,
    Envelope,
    Nack,
    Prepare,
    Promise,
    Torn,
)
from gspn_framework_package.execution.agreement.outbox import Outbox
from gspn_framework_package.execution.agreement.proposals import ProposalQueue
from gspn_framework_package.execution.agreement.quorum import Ballot, is_quorum
from gspn_framework_package.execution.agreement.state import BallotAttempt, ReplicaState

LONGEST_ROUND_TRIP = 1.0
"""Seconds. A longer answer time means that a robot was away, not that the network is slow."""

MOST_ATTEMPTS = 4
"""Attempts whose answers are still measured, even if they were beaten."""

MOST_BACKOFF = 20
"""How often the wait before a repetition may grow by half; other limits apply long before."""


class ConsensusLog(Protocol):
    """What the consensus needs of the replicated log."""

    def is_open(self, message: Envelope) -> bool:
        """Whether a message is about the open slot, on top of the same log; if not, the robot that
        is behind is helped."""

    def decided(self, batch: Batch, ballot: Ballot, *, mine: bool) -> None:
        """The batch is chosen in the open slot; ``mine``: by our own attempt."""


class Consensus:
    """The protocol for the first open slot."""

    def __init__(
        self,
        config: Config,
        state: ReplicaState,
        outbox: Outbox,
        electorate: Electorate,
        proposals: ProposalQueue,
    ) -> None:
        self.config = config
        self.state = state
        self.outbox = outbox
        self.electorate = electorate
        self.proposals = proposals
        self.log: ConsensusLog
        state.promised = state.highest = Ballot(0, config.first)

    def connect(self, log: ConsensusLog) -> None:
        """Set the log that takes what is chosen."""
        self.log = log

    # -- for the other parts -----------------------------------------------------------------------

    def lead_from_the_start(self, followers: Set[str]) -> None:
        """Everybody is fresh: ballot (0, our name) counts as promised by all."""
        self.state.followers = followers

    def leads(self) -> bool:
        """Whether we may skip the first phase in the open slot."""
        state = self.state
        return (
            not self.config.partial
            and state.followers is not None
            and state.promised.robot == self.config.name
            and is_quorum(state.followers, self.electorate.members())
        )

    def restore(self, record: Dict[str, Any], slot: int) -> None:
        """Take over a ``promised`` or ``accepted`` record of our own log; ``slot`` is the open
        one."""
        state = self.state
        ballot = Ballot.from_json(record["ballot"])
        self._see(ballot)
        state.promised = max(state.promised, ballot)
        if record["kind"] == "accepted":
            batch = Batch.from_json(record["batch"])
            if record["slot"] == slot:
                state.accepted = (ballot, batch)
                if "torn" in record:
                    torn = record["torn"].items()
                    state.by_all[ballot] = {str(r): tuple(map(str, ids)) for r, ids in torn}

    def next_slot(self, keep_lead: bool, returned: Set[str]) -> None:
        """The open slot was decided. ``keep_lead``: by our own attempt; ``returned``: robots that
        joined in it; promises from their former life do not count."""
        state = self.state
        state.accepted = None
        state.attempt = None
        state.frozen_by = None
        state.votes.clear()
        state.by_all.clear()
        if not keep_lead:
            state.followers = None
        elif state.followers is not None:
            state.followers -= returned

    def abandon(self) -> None:
        """Give the running attempt and the lead up."""
        self.state.attempt = None
        self.state.followers = None

    # -- proposer ----------------------------------------------------------------------------------

    def propose(self, now: float, frozen: bool = False) -> None:
        """Try to get the proposals into the open slot. Does nothing while an attempt runs, or
        if we have no vote."""
        state, torn = self.state, self.electorate.needs_all()
        if state.attempt is not None or not (self.electorate.may_vote() or torn):
            return
        slot = state.ledger.length
        if self.leads() and not torn:
            batch = self.proposals.batch(False)
            if batch.items:
                self._begin(BallotAttempt(slot, state.promised, False, now, now, state.slow > 0))
                self._second_phase(batch)
            return
        ballot = Ballot(state.highest.counter + 1, self.config.name, state.log_id)
        state.followers = None
        attempt = BallotAttempt(slot, ballot, frozen, now, now, state.slow > 0, torn=torn)
        self._begin(attempt)
        # until the slot is decided, even if this attempt is beaten: its batch may still win
        if frozen:
            state.frozen_by = ballot
        self._promise(ballot, torn)
        attempt.promises[self.config.name] = state.accepted
        (attempt.strangers if state.torn else attempt.answered).add(self.config.name)
        self._send_attempt(attempt, self.electorate.others())
        self._first_phase_over()

    def _begin(self, attempt: BallotAttempt) -> None:
        state = self.state
        state.attempt = attempt
        state.attempts = [*state.attempts[1 - MOST_ATTEMPTS :], attempt]

    def resend_at(self, retry: float) -> Optional[float]:
        """When the running attempt should be sent again (s)."""
        state = self.state
        if state.attempt is None:
            return None
        patience = max(retry, 2 * state.delay)
        return state.attempt.sent + min(patience * 1.5**state.backoff, max(1.0, patience))

    def resend(self, now: float) -> None:
        """Ask the robots again that have not answered."""
        state = self.state
        attempt = state.attempt
        if attempt is None:
            return
        attempt.sent = now
        attempt.tries += 1
        state.backoff = min(state.backoff + 1, MOST_BACKOFF)
        if attempt.batch is None:
            answered = set(attempt.promises)
            if self._first_phase_over():
                return
        else:
            answered = state.votes.get(attempt.ballot, set())
        self._send_attempt(attempt, [m for m in self.electorate.others() if m not in answered])

    def ask_again(self, robot: str) -> None:
        """A robot that was behind is sent what it lacks; it could not answer what we asked it
        meanwhile."""
        attempt = self.state.attempt
        if attempt is not None and robot in self.missing():
            self._send_attempt(attempt, [robot])

    def missing(self) -> List[str]:
        """The robots whose answers the running attempt lacks."""
        state = self.state
        if state.attempt is None:
            return []
        if state.attempt.batch is None:
            attempt = state.attempt
            answered = set(attempt.promises) if attempt.torn else attempt.answered
        else:
            answered = state.votes.get(state.attempt.ballot, set())
        return [m for m in self.electorate.members() if m not in answered]

    def _send_attempt(self, attempt: BallotAttempt, to: List[str]) -> None:
        body: Union[Prepare, Accept]
        if attempt.batch is None:
            body = Prepare(attempt.slot, attempt.ballot, attempt.frozen, attempt.torn)
        else:
            body = Accept(attempt.slot, attempt.ballot, attempt.batch, attempt.torn)
        self.outbox.send_all(to, body)

    def _first_phase_over(self) -> bool:
        """Go on to the second phase if enough have promised."""
        state = self.state
        attempt = state.attempt
        if attempt is None or attempt.batch is not None:
            return False
        by_all = bool(attempt.torn)
        if not self.electorate.may_decide(attempt.promises, by_all):
            return False
        held = [a for a in attempt.promises.values() if a is not None]
        accepted = max(held, key=lambda a: a[0])[1] if held else None
        if self.electorate.not_cast_out(attempt.promises, (), by_all):
            first = accepted.items if accepted is not None else ()
            forced = self.proposals.batch_without_quorum(
                attempt.frozen and attempt.all_told, first, attempt.promises, by_all
            )
            if forced is None:
                state.attempt = None  # the next one is frozen
                return True
            batch = forced
        elif accepted is not None:
            batch = accepted
        else:
            unasked = self._unasked(attempt) if self.config.partial else {}
            batch = Batch([], [])
            if not unasked or self.proposals.end_lives(unasked):
                batch = self.proposals.batch(attempt.frozen and attempt.all_told, unasked)
            if unasked and not self._are_replaced(unasked, batch):
                if attempt.frozen or not self.proposals.has_control():
                    return False
                state.attempt = None  # an order is before what ends a life: the next one is frozen
                return True
        if not self.config.partial:
            state.followers = None if by_all else set(attempt.promises)
        if not batch.items and not attempt.frozen:
            state.attempt = None
            return True
        self._second_phase(batch)
        return True

    def _unasked(self, attempt: BallotAttempt) -> Dict[str, bool]:
        """The members whose local transitions nobody has reported yet -> whether another process
        of that name answered, which knows nothing of them."""
        return {
            m: m in attempt.strangers
            for m in self.electorate.members()
            if m not in attempt.answered
        }

    def _are_replaced(self, robots: Mapping[str, bool], batch: Batch) -> bool:
        """Whether the batch ends the present life of each of these robots, so that the local
        transitions of it that are not in the log are void: it evicts the robot, or begins another
        life of it."""
        ledger, ended = self.state.ledger, set()
        for item in ledger.news(batch.items):
            if self.electorate.ends_life(item.entry, robots):
                ended.add(getattr(item.entry, "robot", ""))
        return ended.issuperset(robots)

    def _second_phase(self, batch: Batch) -> None:
        state = self.state
        attempt = state.attempt
        assert attempt is not None
        attempt.batch = batch
        assert state.promised == attempt.ballot  # a higher promise ends the first phase
        state.accepted = (attempt.ballot, batch)
        if attempt.torn:
            state.by_all[attempt.ballot] = attempt.torn
        alone = self.electorate.may_choose([self.config.name], batch.items, bool(attempt.torn))
        if not alone:  # otherwise the record of the slot itself follows, before anything leaves
            self._persist_accepted(attempt.slot)
        state.votes.setdefault(attempt.ballot, set()).add(self.config.name)
        if not alone:
            self._send_attempt(attempt, self.electorate.others())
        self._decide_if_chosen(attempt.ballot)

    # -- acceptor ----------------------------------------------------------------------------------

    def _promise(self, ballot: Ballot, torn: Torn) -> None:
        state = self.state
        self._see(ballot)
        if ballot > state.promised:
            state.promised = ballot
            slot = state.ledger.length
            record: Dict[str, Any] = {"kind": "promised", "slot": slot, "ballot": list(ballot)}
            if torn:
                record["torn"] = torn
            self.outbox.persist(record, durable=True, synced=bool(torn))
        if ballot.robot != self.config.name:
            state.followers = None

    def _persist_accepted(self, slot: int) -> None:
        """Write what we accepted. What changes the members, or whose votes count, is on the disk
        before anybody knows that we voted for it: whoever loses power still knows whom to ask."""
        assert self.state.accepted is not None
        ballot, batch = self.state.accepted
        record: Dict[str, Any] = {"kind": "accepted", "slot": slot, "ballot": list(ballot)}
        record["batch"] = batch.data
        if ballot in self.state.by_all:
            record["torn"] = self.state.by_all[ballot]
        synced = "torn" in record or batch.changes_members()
        self.outbox.persist(record, durable=True, synced=synced)

    def _votes_in(self, torn: Torn) -> bool:
        """Whether we have a vote in an attempt in which the votes of these robots count."""
        ids = torn.get(self.config.name, ())
        mine = bool(self.state.torn) and ids[:1] == (self.state.log_id,)
        return mine or self.electorate.may_vote()

    def _is_counted(self, message: Envelope, torn: Torn) -> bool:
        """Whether the word of a sender counts in an attempt in which the votes of these robots
        do."""
        return not message.torn or torn.get(message.sender, ())[:1] == (message.log,)

    def _see(self, ballot: Ballot) -> None:
        self.state.highest = max(self.state.highest, ballot)

    def on_prepare(self, message: Envelope, body: Prepare) -> None:
        """The first phase of another's attempt."""
        state = self.state
        if not self._is_counted(message, body.torn) or not self.log.is_open(message):
            return
        may_vote = self._votes_in(body.torn)
        if body.ballot < state.promised and may_vote:
            self._refuse(message, body.slot)
            return
        if body.frozen:
            state.frozen_by = body.ballot
        if not may_vote:
            # others learn what we know, but our vote does not count
            self._answer_prepare(message, body, vote=False)
            return
        self._promise(body.ballot, body.torn)
        attempt = state.attempt
        if attempt is not None and attempt.batch is None and attempt.ballot < body.ballot:
            state.attempt = None
        self._answer_prepare(message, body, vote=True)

    def _answer_prepare(self, message: Envelope, body: Prepare, vote: bool) -> None:
        # what comes after them might as well be made after this answer, unless nothing may be
        items = self.proposals.own_items(*(() if body.frozen else (self.config.limits.batch,)))
        self.outbox.answer(
            message, Promise(body.slot, body.ballot, vote, self.state.accepted, items)
        )

    def on_accept(self, message: Envelope, body: Accept) -> None:
        """The second phase of another's attempt. Continuing to the next slot under the same ballot
        means that what we accepted before was chosen."""
        state = self.state
        ballot = body.ballot
        held = state.accepted
        if not self._is_counted(message, body.torn):
            return
        if held is not None and held[0] == ballot and body.slot == state.ledger.length + 1:
            self.log.decided(held[1], ballot, mine=False)
        if not self.log.is_open(message) or not self._votes_in(body.torn):
            return
        if ballot < state.promised:
            self._refuse(message, body.slot)
            return
        self._see(ballot)
        if state.accepted is None or state.accepted[0] != ballot:
            state.promised = ballot
            state.accepted = (ballot, body.batch)
            if body.torn:
                state.by_all[ballot] = body.torn
            self._persist_accepted(body.slot)
            if ballot.robot != self.config.name:
                state.followers = None
            if state.attempt is not None and state.attempt.ballot < ballot:
                state.attempt = None
        votes = state.votes.setdefault(ballot, set())
        votes |= {self.config.name, ballot.robot}
        held_items = {item.origin for item in body.batch.items}
        waiting = self.proposals.own_items(self.config.limits.batch, held_items)
        self.outbox.answer(message, Accepted(body.slot, ballot, waiting))
        # those who proposed it get the votes directly
        if not self.config.partial and self.config.is_small:
            origins = {item.origin.robot for item in body.batch.items}
            known = {self.config.name, message.sender}
            told = [m for m in self.electorate.others() if m in origins and m not in known]
            self.outbox.send_all(told, Accepted(body.slot, ballot, []))
        self._decide_if_chosen(ballot)

    def _refuse(self, message: Envelope, slot: int) -> None:
        self.outbox.answer(message, Nack(slot, self.state.promised))

    # -- proposer and learner: the answers ---------------------------------------------------------

    def on_promise(self, message: Envelope, body: Promise, now: float) -> None:
        """An answer to our first phase."""
        self.proposals.add_others(body.items)
        for made in self.state.attempts:
            if made.ballot == body.ballot and made.batch is None:  # it may have been beaten
                self._measure(made, now)
        attempt = self.state.attempt
        if (
            attempt is None
            or attempt.batch is not None
            or not self._answers(message, body, attempt)
        ):
            return
        if message.log == self.electorate.known_log(message.sender) and not message.torn:
            attempt.answered.add(message.sender)
        else:
            attempt.strangers.add(message.sender)
        if body.vote and self._is_counted(message, attempt.torn):
            attempt.promises[message.sender] = body.accepted
        attempt.all_told = attempt.all_told and len(body.items) < MOST_ITEMS
        if self._first_phase_over() and attempt.batch is not None:
            attempt.sent, attempt.began, attempt.tries = now, now, 0
            attempt.patient = self.state.slow > 0

    def on_accepted(self, message: Envelope, body: Accepted, now: float) -> None:
        """A vote for an attempt, ours or that of another."""
        state = self.state
        self.proposals.add_others(body.items)
        if body.slot != state.ledger.length or message.hash != state.ledger.hash:
            return
        attempt = state.attempt
        if attempt is not None and attempt.ballot == body.ballot:
            self._measure(attempt, now)
        if not self._is_counted(message, state.by_all.get(body.ballot, {})):
            return
        state.votes.setdefault(body.ballot, set()).add(message.sender)
        self._decide_if_chosen(body.ballot)

    def on_nack(self, body: Nack) -> bool:
        """Somebody promised a higher ballot; returns whether that ended our attempt."""
        self._see(body.ballot)
        attempt = self.state.attempt
        if attempt is None or body.slot != attempt.slot or body.ballot <= attempt.ballot:
            return False
        self.abandon()
        return True

    def _measure(self, attempt: BallotAttempt, now: float) -> None:
        """Add an answer to the mean round trip, as TCP does (RFC 6298). After a retransmission, an
        answer cannot be matched to one of the transmissions (Karn): the longer wait stays until an
        answer can be matched. The first such answer may mean a slow network, so the next attempt
        waits until its answer can be matched; if that one must be repeated all the same, messages
        were lost."""
        state = self.state
        took = min(now - attempt.began, LONGEST_ROUND_TRIP)
        if attempt.tries:
            state.slow = 0.0 if attempt.patient else took
            return
        state.backoff = 0
        state.slow = 0.0
        state.round_trip += (took - state.round_trip) / (8 if state.round_trip else 1)

    def woke(self, now: float) -> None:
        """We were suspended: that time is no measure of the network, and whoever took it for one
        would give way for as long."""
        for attempt in (*self.state.attempts, self.state.attempt):
            if attempt is not None:
                attempt.began = now

    def took(self, seconds: float) -> None:
        """A proposal of ours that another robot put forward was decided within ``seconds``."""
        self.state.slow = min(self.state.slow, seconds)

    def _answers(self, message: Envelope, body: Promise, attempt: BallotAttempt) -> bool:
        return (
            body.slot == attempt.slot
            and message.hash == self.state.ledger.hash
            and body.ballot == attempt.ballot
        )

    def on_chosen(self, ballot: Ballot) -> bool:
        """We hear that what was accepted under ``ballot`` is chosen in the open slot; False if we
        do not hold it."""
        state = self.state
        if state.accepted is None or state.accepted[0] != ballot:
            return False
        self.log.decided(state.accepted[1], ballot, mine=False)
        return True

    def _decide_if_chosen(self, ballot: Ballot) -> None:
        state = self.state
        held = state.accepted
        if held is None or held[0] != ballot:
            return
        votes, by_all = state.votes.get(ballot, ()), ballot in state.by_all
        if self.electorate.may_choose(votes, held[1].items, by_all):
            mine = state.attempt is not None and state.attempt.ballot == ballot
            self.log.decided(held[1], ballot, mine=mine)

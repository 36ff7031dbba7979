"""Paxos, slot by slot: acceptor, proposer and learner of one replica.

Single-decree Paxos (Lamport 1998) decides each slot of the log, among the members named by the log
before it. A promise holds for its slot and all later ones; a replica has accepted nothing beyond
its first open slot. A proposer whose value was just chosen may therefore skip the first phase in
the next slot, as long as the robots that promised are a quorum there too. In full synchronisation
it *leads*: it takes the others' proposals until another robot takes over. Before any ballot, the
first member leads under ballot (0, its name), which every fresh replica counts as promised.

In partial synchronisation there is no leader: a proposer learns the local transitions of the others
in the first phase. It needs an answer from every member that it does not evict in the same slot. A
process that lacks the member's memory may answer for it only in a slot that begins another life of
the robot.

Only one slot is open at a time; throughput comes from batching.

Owns the ballots, votes and the running attempt of the open slot (the fields of consensus in
:class:`~gspn_framework_package.execution.agreement.state.ReplicaState`). Asks the electorate who
may decide and the proposals what to propose, writes and sends through the outbox, and passes
chosen batches to the log (:class:`ConsensusLog`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional, Protocol, Set, Union

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
from gspn_framework_package.execution.agreement.part import ReplicaPart
from gspn_framework_package.execution.agreement.quorum import Ballot, is_quorum
from gspn_framework_package.execution.agreement.state import BallotAttempt

LONGEST_ROUND_TRIP = 1.0
"""Seconds; a longer response time means that a robot was away, not that the network is slow."""

MOST_ATTEMPTS = 4
"""Number of recent attempts whose response times are still measured, even if they were beaten."""

MOST_BACKOFF = 20
"""How often the wait before a retransmission may grow by half; other limits apply much earlier."""


class ConsensusLog(Protocol):
    """The interface of the replicated log for the consensus."""

    def is_open(self, message: Envelope) -> bool:
        """Whether a message is about the open slot of the same log; if not, help whichever robot is
        behind."""

    def decided(self, batch: Batch, ballot: Ballot, *, mine: bool) -> None:
        """Take a batch that was chosen in the open slot; ``mine``: by our own attempt."""


@dataclass(eq=False)
class Consensus(ReplicaPart):
    """The protocol for the first open slot."""

    def __post_init__(self) -> None:
        self.state.promised = self.state.highest = Ballot(0, self.config.first)

    def connect(self, log: ConsensusLog) -> None:
        """Set the log that receives chosen batches."""
        self.log: ConsensusLog = log

    # -- for the other parts -----------------------------------------------------------------------

    def lead_from_the_start(self, followers: Set[str]) -> None:
        """Lead without a first phase, since all replicas are fresh and have implicitly promised
        ballot (0, our name)."""
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
        """Move on to the next slot. ``keep_lead``: our own attempt decided the last one;
        ``returned``: robots that joined in it, whose earlier promises do not count."""
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
        """Give up the running attempt and the lead."""
        self.state.attempt = None
        self.state.followers = None

    # -- proposer ----------------------------------------------------------------------------------

    def propose(self, now: float, frozen: bool = False) -> None:
        """Try to get the proposals into the open slot. Does nothing while an attempt is running or
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
        """Repeat the attempt's message to robots that have not answered."""
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
        """Repeat our question to a robot that was behind and could not answer it."""
        attempt = self.state.attempt
        if attempt is not None and robot in self.missing():
            self._send_attempt(attempt, [robot])

    def missing(self) -> List[str]:
        """The robots whose answers the running attempt still needs."""
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
        """Move on to the second phase if enough have promised."""
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
                state.attempt = None  # the next attempt is frozen
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
                # an order precedes the entry that ends a life: the next attempt is frozen
                state.attempt = None
                return True
        if not self.config.partial:
            state.followers = None if by_all else set(attempt.promises)
        if not batch.items and not attempt.frozen:
            state.attempt = None
            return True
        self._second_phase(batch)
        return True

    def _unasked(self, attempt: BallotAttempt) -> Dict[str, bool]:
        """The members whose local transitions nobody has reported yet -> whether a process of that
        name answered that does not know them."""
        return {
            m: m in attempt.strangers
            for m in self.electorate.members()
            if m not in attempt.answered
        }

    def _are_replaced(self, robots: Mapping[str, bool], batch: Batch) -> bool:
        """Whether the batch ends the present life of each of these robots, by an eviction or a new
        life, so that its local transitions that are not in the log are void."""
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
        if not alone:  # otherwise the record of the slot itself follows before any message is sent
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
        """Write what we accepted. A batch that changes the members, or whose votes count, is synced
        to the disk before anybody learns of our vote, so that we still know whom to ask after a
        power loss."""
        assert self.state.accepted is not None
        ballot, batch = self.state.accepted
        record: Dict[str, Any] = {"kind": "accepted", "slot": slot, "ballot": list(ballot)}
        record["batch"] = batch.data
        if ballot in self.state.by_all:
            record["torn"] = self.state.by_all[ballot]
        synced = "torn" in record or batch.changes_members()
        self.outbox.persist(record, durable=True, synced=synced)

    def _votes_in(self, torn: Torn) -> bool:
        """Whether we have a vote in an attempt that counts the votes of these robots."""
        ids = torn.get(self.config.name, ())
        mine = bool(self.state.torn) and ids[:1] == (self.state.log_id,)
        return mine or self.electorate.may_vote()

    def _is_counted(self, message: Envelope, torn: Torn) -> bool:
        """Whether a sender's answer counts in an attempt that counts the votes of these robots."""
        return not message.torn or torn.get(message.sender, ())[:1] == (message.log,)

    def _see(self, ballot: Ballot) -> None:
        self.state.highest = max(self.state.highest, ballot)

    def on_prepare(self, message: Envelope, body: Prepare) -> None:
        """Handle the first phase of another robot's attempt."""
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
            # report what we know, although our vote does not count
            self._answer_prepare(message, body, vote=False)
            return
        self._promise(body.ballot, body.torn)
        attempt = state.attempt
        if attempt is not None and attempt.batch is None and attempt.ballot < body.ballot:
            state.attempt = None
        self._answer_prepare(message, body, vote=True)

    def _answer_prepare(self, message: Envelope, body: Prepare, vote: bool) -> None:
        # later ones might as well be made after this answer, unless the slot is frozen
        items = self.proposals.own_items(*(() if body.frozen else (self.config.limits.batch,)))
        self.outbox.answer(
            message, Promise(body.slot, body.ballot, vote, self.state.accepted, items)
        )

    def on_accept(self, message: Envelope, body: Accept) -> None:
        """Handle the second phase of another robot's attempt. If it continues to the next slot
        under the same ballot, then what we accepted in the last one was chosen."""
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
        # the robots whose proposals are in the batch get the votes directly
        if not self.config.partial and self.config.is_small:
            origins = {item.origin.robot for item in body.batch.items}
            known = {self.config.name, message.sender}
            receivers = [m for m in self.electorate.others() if m in origins and m not in known]
            self.outbox.send_all(receivers, Accepted(body.slot, ballot, []))
        self._decide_if_chosen(ballot)

    def _refuse(self, message: Envelope, slot: int) -> None:
        self.outbox.answer(message, Nack(slot, self.state.promised))

    # -- proposer and learner: the answers ---------------------------------------------------------

    def on_promise(self, message: Envelope, body: Promise, now: float) -> None:
        """Handle an answer to our first phase."""
        self.proposals.add_others(body.items)
        for made in self.state.attempts:
            # our attempt may have been beaten
            if made.ballot == body.ballot and made.batch is None:
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
        """Count a vote for our attempt or another robot's."""
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
        """Handle a refusal by a robot that promised a higher ballot; returns whether that ended our
        attempt."""
        self._see(body.ballot)
        attempt = self.state.attempt
        if attempt is None or body.slot != attempt.slot or body.ballot <= attempt.ballot:
            return False
        self.abandon()
        return True

    def _measure(self, attempt: BallotAttempt, now: float) -> None:
        """Add an answer to the mean round trip, as TCP does (RFC 6298). After a retransmission, an
        answer cannot be matched to a transmission (Karn), so the longer wait stays until an answer
        can be matched. The first ambiguous answer may mean a slow network, so the next attempt
        waits long enough for its answer to be matched; if that attempt must be repeated all the
        same, messages were lost."""
        state = self.state
        took = min(now - attempt.began, LONGEST_ROUND_TRIP)
        if attempt.tries:
            state.slow = 0.0 if attempt.patient else took
            return
        state.backoff = 0
        state.slow = 0.0
        state.round_trip += (took - state.round_trip) / (8 if state.round_trip else 1)

    def woke(self, now: float) -> None:
        """Ignore running measurements after we were suspended: that time says nothing about the
        network, and we would give way for as long."""
        for attempt in (*self.state.attempts, self.state.attempt):
            if attempt is not None:
                attempt.began = now

    def took(self, seconds: float) -> None:
        """Note that a proposal of ours, put forward by another robot, was decided within
        ``seconds``."""
        self.state.slow = min(self.state.slow, seconds)

    def _answers(self, message: Envelope, body: Promise, attempt: BallotAttempt) -> bool:
        return (
            body.slot == attempt.slot
            and message.hash == self.state.ledger.hash
            and body.ballot == attempt.ballot
        )

    def on_chosen(self, ballot: Ballot) -> bool:
        """Handle the news that the batch accepted under ``ballot`` was chosen in the open slot;
        False if we do not have that batch."""
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

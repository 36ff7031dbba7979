"""Paxos, slot by slot: acceptor, proposer and learner of one replica.

Each slot of the log is decided by single-decree Paxos (Lamport 1998) among the members that the log
before it names. A promise holds for its slot and all later ones; a replica has accepted nothing
beyond its first open slot. Therefore a proposer whose value was just chosen may skip the first
phase in the next slot, as long as those who promised are a quorum there too: in full
synchronisation it *leads*, and takes the others' facts until somebody else takes over. Before any
ballot, the first member leads under ballot (0, its name), which every fresh replica counts as
promised.

In partial synchronisation nobody leads: the first phase is how a proposer learns the private moves
of the others, and needs an answer of every member that it does not evict in the same slot.

One slot is open at a time; batches carry the load.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, List, Optional, Set, Tuple, Union

from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.agreement.host import Host
from gspn_framework_package.execution.agreement.messages import (
    Accept,
    Accepted,
    Batch,
    Envelope,
    Nack,
    Prepare,
    Promise,
)
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.ledger import Item

LONGEST_ROUND_TRIP = 1.0
"""Seconds: an answer that took longer came from a robot that was away, not through a slow network."""

MOST_BACKOFF = 20
"""Times that the wait before a message is repeated grows by half; it is bounded long before."""


@dataclass
class Attempt:
    """A running attempt of ours to get a batch into ``slot``."""

    slot: int
    ballot: Ballot
    frozen: bool
    sent: float
    began: float
    """When this phase of it did."""
    tries: int = 0
    promises: Dict[str, Optional[Tuple[Ballot, Batch]]] = field(default_factory=dict)
    answered: Set[str] = field(default_factory=set)
    """Those who promised, and those without a vote who told what they know."""
    batch: Optional[Batch] = None
    """None in the first phase."""


class Consensus:
    """The protocol state of one replica for its first open slot.

    :param host: the replica, which knows the log, keeps the records and carries the messages.
    :param partial: partial synchronisation.

    :ivar promised: no ballot below it will be accepted.
    :ivar accepted: what was accepted in the open slot, and under which ballot.
    :ivar leader: who proposed under the highest ballot that was seen.
    :ivar attempt: our own running attempt.
    :ivar round_trip: for how long answers to our attempts take (s), smoothed; 0 before the first.
    """

    def __init__(self, host: Host, partial: bool, first: str) -> None:
        self.host = host
        self.partial = partial
        self.promised = Ballot(0, first)
        self.accepted: Optional[Tuple[Ballot, Batch]] = None
        self.highest = self.promised
        self.attempt: Optional[Attempt] = None
        self.frozen_by: Optional[Ballot] = None
        self.round_trip = 0.0
        self._backoff = 0
        """How often we repeated ourselves since an answer that we know the time of."""
        self._followers: Optional[Set[str]] = None
        self._votes: Dict[Ballot, Set[str]] = {}

    # -- what the host asks and tells --------------------------------------------------------------

    @property
    def leader(self) -> str:
        """Who proposed under the highest ballot seen."""
        return self.highest.robot

    def lead_from_the_start(self, followers: Set[str]) -> None:
        """Everybody is fresh: ballot (0, our name) counts as promised by all."""
        self._followers = followers

    def leads(self) -> bool:
        """Whether we may skip the first phase in the open slot."""
        return (
            not self.partial
            and self._followers is not None
            and self.promised.robot == self.host.name
            and self.host.may_decide(self._followers)
        )

    def restore(self, record: Dict[str, Any], slot: int) -> None:
        """Take over a ``promised`` or ``accepted`` record of our own log; ``slot`` is the open
        one."""
        ballot = Ballot.from_json(record["ballot"])
        self._see(ballot)
        self.promised = max(self.promised, ballot)
        if record["kind"] == "accepted":
            batch = [Item.from_json(item).to_json() for item in record["batch"]]
            if record["slot"] == slot:
                self.accepted = (ballot, batch)

    def next_slot(self, keep_lead: bool, returned: Set[str]) -> None:
        """The open slot was decided. ``keep_lead``: by our own attempt; ``returned``: robots that
        joined in it, whose promises of a former life do not count."""
        self.accepted = None
        self.attempt = None
        self.frozen_by = None
        self._votes.clear()
        if not keep_lead:
            self._followers = None
        elif self._followers is not None:
            self._followers -= returned

    def abandon(self) -> None:
        """Give the running attempt and the lead up."""
        self.attempt = None
        self._followers = None

    def is_frozen(self) -> bool:
        """Whether private moves must wait for the open slot."""
        return self.frozen_by is not None

    # -- proposer ----------------------------------------------------------------------------------

    def propose(self, now: float, frozen: bool = False) -> None:
        """Try to get what the host wants into the open slot. Does nothing while an attempt runs, or
        where we have no vote."""
        if self.attempt is not None or not self.host.may_vote():
            return
        slot = self.host.ledger.length
        if self.leads():
            batch = self.host.batch(False)
            if batch:
                self.attempt = Attempt(slot, self.promised, False, now, now)
                self._second_phase(batch)
            return
        ballot = Ballot(self.highest.counter + 1, self.host.name, self.host.log_id)
        self._followers = None
        self.attempt = attempt = Attempt(slot, ballot, frozen, now, now)
        if frozen:  # until the slot is decided, even if this attempt is beaten: its batch may still win
            self.frozen_by = ballot
        self._promise(ballot)
        attempt.promises[self.host.name] = self.accepted
        attempt.answered.add(self.host.name)
        self._send_attempt(attempt, self.host.others())
        self._first_phase_over()

    def resend_at(self, retry: float) -> Optional[float]:
        """When the running attempt should be sent again (s)."""
        if self.attempt is None:
            return None
        patience = max(retry, 2 * self.round_trip)
        return self.attempt.sent + min(patience * 1.5**self._backoff, max(1.0, patience))

    def resend(self, now: float) -> None:
        """Ask those again who have not answered."""
        attempt = self.attempt
        if attempt is None:
            return
        attempt.sent = now
        attempt.tries += 1
        self._backoff = min(self._backoff + 1, MOST_BACKOFF)
        if attempt.batch is None:
            answered = set(attempt.promises)
            if self._first_phase_over():
                return
        else:
            answered = self._votes.get(attempt.ballot, set())
        self._send_attempt(attempt, [m for m in self.host.others() if m not in answered])

    def ask_again(self, robot: str) -> None:
        """A robot that was behind is sent what it lacks: what we asked it meanwhile it could not answer."""
        if self.attempt is not None and robot in self.missing():
            self._send_attempt(self.attempt, [robot])

    def missing(self) -> List[str]:
        """Whose answers the running attempt lacks."""
        if self.attempt is None:
            return []
        if self.attempt.batch is None:
            answered = self.attempt.answered
        else:
            answered = self._votes.get(self.attempt.ballot, set())
        return [m for m in self.host.members() if m not in answered]

    def _send_attempt(self, attempt: Attempt, to: List[str]) -> None:
        body: Union[Prepare, Accept]
        if attempt.batch is None:
            body = Prepare(attempt.slot, attempt.ballot, attempt.frozen)
        else:
            body = Accept(attempt.slot, attempt.ballot, attempt.batch)
        self.host.send_all(to, body)

    def _first_phase_over(self) -> bool:
        """Go on to the second phase if enough have promised."""
        attempt = self.attempt
        if attempt is None or attempt.batch is not None:
            return False
        if not self.host.may_decide(attempt.promises):
            return False
        accepted = [a for a in attempt.promises.values() if a is not None]
        if accepted:
            batch: Batch = max(accepted, key=lambda a: a[0])[1]
        else:
            batch = self.host.batch(attempt.frozen)
            if self.partial:
                evicted = {item.entry.robot for item in map(Item.from_json, batch) if isinstance(item.entry, log.Evict)}
                if any(m not in attempt.answered and m not in evicted for m in self.host.members()):
                    return False
        if not self.partial:
            self._followers = set(attempt.promises)
        if not batch and not attempt.frozen:
            self.attempt = None
            return True
        self._second_phase(batch)
        return True

    def _second_phase(self, batch: Batch) -> None:
        attempt = self.attempt
        assert attempt is not None
        attempt.batch = batch
        assert self.promised == attempt.ballot  # a higher promise ends the first phase
        self.accepted = (attempt.ballot, batch)
        alone = self.host.may_decide([self.host.name])
        if not alone:  # otherwise the record of the slot itself follows, before anything leaves
            self._persist_accepted(attempt.slot)
        self._votes.setdefault(attempt.ballot, set()).add(self.host.name)
        if not alone:
            self._send_attempt(attempt, self.host.others())
        self._decide_if_chosen(attempt.ballot)

    # -- acceptor ----------------------------------------------------------------------------------

    def _promise(self, ballot: Ballot) -> None:
        self._see(ballot)
        if ballot > self.promised:
            self.promised = ballot
            slot = self.host.ledger.length
            self.host.persist({"kind": "promised", "slot": slot, "ballot": list(ballot)}, durable=True)
        if ballot.robot != self.host.name:
            self._followers = None

    def _persist_accepted(self, slot: int) -> None:
        assert self.accepted is not None
        ballot, batch = self.accepted
        self.host.persist({"kind": "accepted", "slot": slot, "ballot": list(ballot), "batch": batch}, durable=True)

    def _see(self, ballot: Ballot) -> None:
        self.highest = max(self.highest, ballot)

    def on_prepare(self, message: Envelope, body: Prepare) -> None:
        """The first phase of another's attempt."""
        if not self.host.is_open(message):
            return
        if body.ballot < self.promised and self.host.may_vote():
            self._refuse(message, body.slot)
            return
        if body.frozen:
            self.frozen_by = body.ballot
        if not self.host.may_vote():  # what we know counts as told, our vote does not count
            self._answer_prepare(message, body, vote=False)
            return
        self._promise(body.ballot)
        attempt = self.attempt
        if attempt is not None and attempt.batch is None and attempt.ballot < body.ballot:
            self.attempt = None
        self._answer_prepare(message, body, vote=True)

    def _answer_prepare(self, message: Envelope, body: Prepare, vote: bool) -> None:
        items = self.host.own_items()
        self.host.answer(message, Promise(body.slot, body.ballot, vote, self.accepted, items))

    def on_accept(self, message: Envelope, body: Accept) -> None:
        """The second phase of another's attempt. That it goes on to the next slot under the same
        ballot tells that what we accepted before was chosen."""
        ballot = body.ballot
        held = self.accepted
        if held is not None and held[0] == ballot and body.slot == self.host.ledger.length + 1:
            self.host.decided(held[1], ballot, mine=False)
        if not self.host.is_open(message) or not self.host.may_vote():
            return
        if ballot < self.promised:
            self._refuse(message, body.slot)
            return
        self._see(ballot)
        if self.accepted is None or self.accepted[0] != ballot:
            self.promised = ballot
            self.accepted = (ballot, body.batch)
            self._persist_accepted(body.slot)
            if ballot.robot != self.host.name:
                self._followers = None
            if self.attempt is not None and self.attempt.ballot < ballot:
                self.attempt = None
        votes = self._votes.setdefault(ballot, set())
        votes |= {self.host.name, ballot.robot}
        held_items = {tuple(origin) for _, origin, _ in body.batch}
        waiting = [i for i in self.host.own_items() if i.origin not in held_items]
        self.host.answer(message, Accepted(body.slot, ballot, waiting))
        if not self.partial and self.host.is_small:  # those whose facts these are learn the outcome at first hand
            origins = {origin[0] for _, origin, _ in body.batch}
            known = {self.host.name, message.sender}
            told = [m for m in self.host.others() if m in origins and m not in known]
            self.host.send_all(told, Accepted(body.slot, ballot, []))
        self._decide_if_chosen(ballot)

    def _refuse(self, message: Envelope, slot: int) -> None:
        self.host.answer(message, Nack(slot, self.promised))

    # -- proposer and learner: the answers ---------------------------------------------------------

    def on_promise(self, message: Envelope, body: Promise, now: float) -> None:
        """An answer to our first phase."""
        self.host.add_foreign(body.items)
        attempt = self.attempt
        if attempt is None or attempt.batch is not None or not self._answers(message, body, attempt):
            return
        self._measure(attempt, now)
        attempt.answered.add(message.sender)
        if body.vote:
            attempt.promises[message.sender] = body.accepted
        if self._first_phase_over() and attempt.batch is not None:
            attempt.sent, attempt.began, attempt.tries = now, now, 0

    def on_accepted(self, message: Envelope, body: Accepted, now: float) -> None:
        """A vote for an attempt, ours or that of another."""
        self.host.add_foreign(body.items)
        if body.slot != self.host.ledger.length or message.hash != self.host.ledger.hash:
            return
        attempt = self.attempt
        if attempt is not None and attempt.ballot == body.ballot:
            self._measure(attempt, now)
        self._votes.setdefault(body.ballot, set()).add(message.sender)
        self._decide_if_chosen(body.ballot)

    def on_nack(self, body: Nack) -> bool:
        """Somebody promised a higher ballot; whether that ended our attempt."""
        self._see(body.ballot)
        attempt = self.attempt
        if attempt is None or body.slot != attempt.slot or body.ballot <= attempt.ballot:
            return False
        self.abandon()
        return True

    def _measure(self, attempt: Attempt, now: float) -> None:
        """Take an answer into the mean round trip, as TCP does (RFC 6298). Where we asked more than once we do not
        know which time is answered: then it says nothing, and the longer wait stays until one does (Karn)."""
        if attempt.tries:
            return
        self._backoff = 0
        took = min(now - attempt.began, LONGEST_ROUND_TRIP)
        self.round_trip += (took - self.round_trip) / (8 if self.round_trip else 1)

    def _answers(self, message: Envelope, body: Promise, attempt: Attempt) -> bool:
        return (
            body.slot == attempt.slot and message.hash == self.host.ledger.hash and body.ballot == attempt.ballot
        )

    def on_chosen(self, ballot: Ballot) -> bool:
        """We hear that what was accepted under ``ballot`` is chosen in the open slot; False if we
        do not hold it."""
        if self.accepted is None or self.accepted[0] != ballot:
            return False
        self.host.decided(self.accepted[1], ballot, mine=False)
        return True

    def _decide_if_chosen(self, ballot: Ballot) -> None:
        held = self.accepted
        if held is None or held[0] != ballot:
            return
        if self.host.may_decide(self._votes.get(ballot, ())):
            mine = self.attempt is not None and self.attempt.ballot == ballot
            self.host.decided(held[1], ballot, mine=mine)

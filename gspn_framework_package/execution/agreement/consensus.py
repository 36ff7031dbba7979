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
from typing import Any, Dict, List, Optional, Set, Tuple

from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.agreement.host import Host
from gspn_framework_package.execution.agreement.interface import Message
from gspn_framework_package.execution.agreement.quorum import Ballot, is_quorum
from gspn_framework_package.execution.ledger import Item

Batch = List[Any]
"""A proposed value: items as JSON values."""

LONGEST_ROUND_TRIP = 1.0
"""Seconds: an answer that took longer came from a robot that was away, not through a slow network."""


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
            and is_quorum(self._followers, self.host.electorate())
        )

    def restore(self, record: Dict[str, Any], slot: int) -> None:
        """Take over a ``promised`` or ``accepted`` record of our own log; ``slot`` is the open
        one."""
        ballot = Ballot.from_json(record["ballot"])
        self._see(ballot)
        self.promised = max(self.promised, ballot)
        if record["kind"] == "accepted" and record["slot"] == slot:
            self.accepted = (ballot, record["batch"])

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
        ballot = Ballot(self.highest.counter + 1, self.host.name)
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
        return self.attempt.sent + min(patience * 1.5**self.attempt.tries, max(1.0, patience))

    def resend(self, now: float) -> None:
        """Ask those again who have not answered."""
        attempt = self.attempt
        if attempt is None:
            return
        attempt.sent = now
        attempt.tries += 1
        if attempt.batch is None:
            answered = set(attempt.promises)
            if self._first_phase_over():
                return
        else:
            answered = self._votes.get(attempt.ballot, set())
        self._send_attempt(attempt, [m for m in self.host.others() if m not in answered])

    def missing(self) -> List[str]:
        """Whose answers the running attempt lacks."""
        if self.attempt is None:
            return []
        if self.attempt.batch is None:
            answered = self.attempt.answered
        else:
            answered = self._votes.get(self.attempt.ballot, set())
        return [m for m in self.host.electorate() if m not in answered]

    def _send_attempt(self, attempt: Attempt, to: List[str]) -> None:
        message: Message = {"slot": attempt.slot, "ballot": list(attempt.ballot)}
        if attempt.batch is None:
            message.update(kind="prepare", frozen=attempt.frozen)
        else:
            message.update(kind="accept", batch=attempt.batch)
        self.host.send_all(to, message)

    def _first_phase_over(self) -> bool:
        """Go on to the second phase if enough have promised."""
        attempt = self.attempt
        if attempt is None or attempt.batch is not None:
            return False
        electorate = self.host.electorate()
        if not is_quorum(attempt.promises, electorate):
            return False
        accepted = [a for a in attempt.promises.values() if a is not None]
        if accepted:
            batch: Batch = max(accepted, key=lambda a: a[0])[1]
        else:
            batch = self.host.batch(attempt.frozen)
            if self.partial:
                evicted = {item.entry.robot for item in map(Item.from_json, batch) if isinstance(item.entry, log.Evict)}
                if any(m not in attempt.answered and m not in evicted for m in electorate):
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
        alone = is_quorum([self.host.name], self.host.electorate())
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
            self.host.persist({"kind": "promised", "slot": slot, "ballot": list(ballot)})
        if ballot.robot != self.host.name:
            self._followers = None

    def _persist_accepted(self, slot: int) -> None:
        assert self.accepted is not None
        ballot, batch = self.accepted
        self.host.persist({"kind": "accepted", "slot": slot, "ballot": list(ballot), "batch": batch})

    def _see(self, ballot: Ballot) -> None:
        self.highest = max(self.highest, ballot)

    def on_prepare(self, message: Message, now: float) -> None:
        """The first phase of another's attempt."""
        ballot = Ballot.from_json(message["ballot"])
        if not self.host.is_open(message):
            return
        if ballot < self.promised and self.host.may_vote():
            self._refuse(message)
            return
        if message.get("frozen"):
            self.frozen_by = ballot
        if not self.host.may_vote():  # what we know counts as told, our vote does not count
            self._answer_prepare(message, vote=False)
            return
        self._promise(ballot)
        attempt = self.attempt
        if attempt is not None and attempt.batch is None and attempt.ballot < ballot:
            self.attempt = None
        self._answer_prepare(message, vote=True)

    def _answer_prepare(self, message: Message, vote: bool) -> None:
        accepted = self.accepted and [list(self.accepted[0]), self.accepted[1]]
        self.host.answer(
            message,
            {
                "kind": "promise",
                "vote": vote,
                "slot": message["slot"],
                "ballot": message["ballot"],
                "accepted": accepted,
                "items": [i.to_json() for i in self.host.own_items()],
            },
        )

    def on_accept(self, message: Message, now: float) -> None:
        """The second phase of another's attempt. That it goes on to the next slot under the same
        ballot tells that what we accepted before was chosen."""
        ballot = Ballot.from_json(message["ballot"])
        held = self.accepted
        if held is not None and held[0] == ballot and message["slot"] == self.host.ledger.length + 1:
            self.host.decided(held[1], ballot, mine=False)
        if not self.host.is_open(message) or not self.host.may_vote():
            return
        if ballot < self.promised:
            self._refuse(message)
            return
        self._see(ballot)
        if self.accepted is None or self.accepted[0] != ballot:
            self.promised = ballot
            self.accepted = (ballot, message["batch"])
            self._persist_accepted(message["slot"])
            if ballot.robot != self.host.name:
                self._followers = None
            if self.attempt is not None and self.attempt.ballot < ballot:
                self.attempt = None
        votes = self._votes.setdefault(ballot, set())
        votes |= {self.host.name, ballot.robot}
        held_items = {tuple(origin) for _, origin, _ in message["batch"]}
        vote: Message = {
            "kind": "accepted",
            "slot": message["slot"],
            "ballot": message["ballot"],
            "items": [i.to_json() for i in self.host.own_items() if i.origin not in held_items],
        }
        self.host.answer(message, vote)
        if not self.partial and self.host.is_small:  # those whose facts these are learn the outcome at first hand
            origins = {origin[0] for _, origin, _ in message["batch"]}
            known = {self.host.name, message["from"]}
            copy = {k: v for k, v in vote.items() if k != "items"}
            self.host.send_all([m for m in self.host.others() if m in origins and m not in known], copy)
        self._decide_if_chosen(ballot)

    def _refuse(self, message: Message) -> None:
        self.host.answer(
            message,
            {"kind": "nack", "slot": message["slot"], "ballot": list(self.promised)},
        )

    # -- proposer and learner: the answers ---------------------------------------------------------

    def on_promise(self, message: Message, now: float) -> None:
        """An answer to our first phase."""
        self.host.add_foreign(message["items"])
        attempt = self.attempt
        if attempt is None or attempt.batch is not None or not self._answers(message, attempt):
            return
        self._measure(attempt, now)
        attempt.answered.add(message["from"])
        if message["vote"]:
            accepted = message["accepted"]
            attempt.promises[message["from"]] = accepted and (
                Ballot.from_json(accepted[0]),
                accepted[1],
            )
        if self._first_phase_over() and attempt.batch is not None:
            attempt.sent, attempt.began, attempt.tries = now, now, 0

    def on_accepted(self, message: Message, now: float) -> None:
        """A vote for an attempt, ours or that of another."""
        self.host.add_foreign(message.get("items", ()))
        if message["slot"] != self.host.ledger.length:
            return
        if message["hash"] != self.host.ledger.hash:
            return
        ballot = Ballot.from_json(message["ballot"])
        attempt = self.attempt
        if attempt is not None and attempt.ballot == ballot:
            self._measure(attempt, now)
        self._votes.setdefault(ballot, set()).add(message["from"])
        self._decide_if_chosen(ballot)

    def on_nack(self, message: Message, now: float) -> bool:
        """Somebody promised a higher ballot; whether that ended our attempt."""
        ballot = Ballot.from_json(message["ballot"])
        self._see(ballot)
        attempt = self.attempt
        if attempt is None or message["slot"] != attempt.slot or ballot <= attempt.ballot:
            return False
        self.abandon()
        return True

    def _measure(self, attempt: Attempt, now: float) -> None:
        """Take an answer into the mean round trip, as TCP does (RFC 6298); from the first time that was asked, for
        one does not know which time is answered."""
        took = min(now - attempt.began, LONGEST_ROUND_TRIP)
        self.round_trip += (took - self.round_trip) / (8 if self.round_trip else 1)

    def _answers(self, message: Message, attempt: Attempt) -> bool:
        return (
            message["slot"] == attempt.slot
            and message["hash"] == self.host.ledger.hash
            and Ballot.from_json(message["ballot"]) == attempt.ballot
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
        if is_quorum(self._votes.get(ballot, ()), self.host.electorate()):
            mine = self.attempt is not None and self.attempt.ballot == ballot
            self.host.decided(held[1], ballot, mine=mine)

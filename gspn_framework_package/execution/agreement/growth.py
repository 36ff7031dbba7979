"""How a replica's log grows: slots that are decided, slots and snapshots that it catches up on,
and its own records when it starts again."""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.agreement import interface as io
from gspn_framework_package.execution.agreement.core import Core
from gspn_framework_package.execution.agreement.pool import Own, Pool
from gspn_framework_package.execution.agreement.quorum import Ballot, is_quorum
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.firing import (
    Ended,
    Fault,
    Firing,
    StartAction,
)
from gspn_framework_package.execution.ledger import Item, Ledger, Origin
from gspn_framework_package.execution.team_state import GONE, Phase, RobotState
from gspn_framework_package.execution.token_game import Step
from gspn_framework_package.model.errors import LogError

SNAPSHOT_EVERY = 1000
"""Slots after which the log gets a snapshot, where a restart begins to read."""


class Growth(Core):
    """Takes slots into the log, with all that follows from them."""

    def decided(self, batch: List[Any], ballot: Ballot, *, mine: bool) -> None:
        """The batch is chosen in the open slot; ``mine``: by our own attempt."""
        slot = self.ledger.length
        electorate = self.electorate()
        self._commit(batch, ballot, mine=mine)
        if mine and self.halted is None:
            self._tell_chosen(slot, ballot, {origin[0] for _, origin, _ in batch}, electorate)

    def _tell_chosen(self, slot: int, ballot: Ballot, origins: Set[str], electorate: List[str]) -> None:
        """Tell the others, unless what comes next tells it too."""
        self._gathers_until = self._now + self.pace.gather
        if not self.partial and self.pace.gather <= 0:
            self.consensus.propose(self._now)
            attempt = self.consensus.attempt
            if attempt is not None and attempt.ballot == ballot:
                return
        # the others saw the batch, and those whose facts were in it each other's votes
        voted = self.is_small and not self.partial and not is_quorum([self.name], electorate)
        told = [m for m in self._all_others() if not (voted and m in origins)]
        self.send_all(told, {"kind": "learn", "slot": slot, "ballot": list(ballot)})

    def _commit(self, batch: List[Any], ballot: Ballot, *, mine: bool) -> None:
        items = [Item.from_json(i) for i in batch]
        before = self.ledger.hash
        record, step = self.ledger.append(items, ballot)
        slot = record["slot"]
        fresh = [Origin(*o) for o in record["origins"]]
        kept = [i for i in items if i.origin in set(fresh)]
        self.history.add(slot, list(ballot), [i.to_json() for i in kept], before)
        self._persist(record)
        if slot == 0:
            self._first_hash = self.ledger.hash
        returned = {i.entry.robot for i in kept if isinstance(i.entry, log.Join)}
        self.consensus.next_slot(mine, returned)
        self._defeats = 0
        self._hold_since = None
        self._wait_until = None
        self._gave_way = False
        if self.partial and not mine:  # several may want the next slot: not all at once
            self._wait_until = self._now + max(self.pace.backoff, self.consensus.round_trip) * self._draw()
        for firing in step.firings:
            published = mine and not self._was_private(firing, kept)
            self._put(io.Fired(firing, published, self.ledger.hash))
        self._put(*(c for c in step.commands if isinstance(c, (Fault, Ended))))
        self._note_members(kept)
        delays = {
            (c.visit, c.attempt): c.delay
            for c in step.commands
            if isinstance(c, StartAction) and c.robot == self.name and c.delay > 0
        }
        self._after_slot(set(fresh), delays, step)
        if slot and slot % SNAPSHOT_EVERY == 0:
            self._persist(self.ledger.snapshot())

    def _was_private(self, firing: Firing, items: Sequence[Item]) -> bool:
        return any(
            i.private
            and isinstance(i.entry, log.Done)
            and (i.entry.robot, i.entry.incarnation, i.entry.visit) == (firing.robot, firing.incarnation, firing.visit)
            for i in items
        )

    def _note_members(self, items: Sequence[Item]) -> None:
        for item in items:
            entry = item.entry
            if isinstance(entry, log.Join):
                self.forced.discard(entry.robot)
                self.cast_out.discard(entry.robot)
                state = self.ledger.state.robots.get(entry.robot)
                taken = state is not None and state.incarnation == entry.incarnation
                mine = entry.robot == self.name and entry.log == self.log_id
                if mine and not self.active and (taken or self.witness):
                    self._become_active()
            elif isinstance(entry, log.Evict):
                self.forced.discard(entry.robot)
                if entry.forced:
                    self.cast_out.add(entry.robot)

    def _after_slot(
        self,
        fresh: Set[Origin],
        delays: Dict[Tuple[int, int], float],
        step: Optional[Step] = None,
    ) -> None:
        for own in self.pool.prune(self.ledger.is_news):
            if own.order_id:
                self._answer_order(own, own.item.origin in fresh, step)
        state = self._own_state()
        if state is not None and state.incarnation > self.incarnation and self.active:
            self._new_life()  # a Join of a former life of ours, late; a second process would be heard
        self._follow()
        if state is not None and state.phase in GONE and self.ledger.state.ended is None:
            self._on_gone(state)
        self._act(delays)

    def _answer_order(self, own: Own, in_log: bool, step: Optional[Step]) -> None:
        slot = self.ledger.length - 1
        if not in_log:
            self._put(io.OrderResult(own.order_id, False, "was overtaken by a newer one"))
            return
        faults = [
            c.message
            for c in (step.commands if step is not None else ())
            if isinstance(c, Fault) and isinstance(own.item.entry, (log.SetPlace, log.Fire))
        ]
        self._put(io.OrderResult(own.order_id, not faults, "; ".join(faults) or "done, in slot %d of the log" % slot))

    def _follow(self) -> None:
        """Take over where the log says that our robot is; private moves that it rules out are
        void."""
        for own in self.own.follow(self.ledger, self.pool.own):
            self.pool.own.remove(own)
            origin = list(own.item.origin)
            self._persist({"kind": "void", "origin": origin, "why": "the log rules it out"})

    def _on_gone(self, state: RobotState) -> None:
        """The log says that we were evicted, or have left."""
        if state.phase is Phase.LEFT and self.active and state.incarnation == self.incarnation:
            self.leaving = True
        elif self.incarnation <= state.incarnation:
            self.pool.own = [o for o in self.pool.own if o.order_id]
            self._new_life()

    # -- catching up ----------------------------------------------------------------------------------

    def is_open(self, message: io.Message) -> bool:
        """Whether a message is about the open slot, on top of the same log; where it is not, the
        one that is behind is helped."""
        slot = message["slot"]
        if slot < self.ledger.length:
            self._help(message)
            return False
        if slot > self.ledger.length:
            self._pull(message["from"])
            return False
        if message["length"] == self.ledger.length and message["hash"] != self.ledger.hash:
            self._conflict(message["from"], slot)
            return False
        return True

    def _pull(self, robot: str) -> None:
        """Ask a robot that is ahead for what we lack, not too often."""
        length, until = self._asked_until
        if length == self.ledger.length and self._now < until:
            return
        self._asked_until = (self.ledger.length, self._now + self.pace.retry)
        self.send_all([robot], {"kind": "pull"})

    def _help(self, message: io.Message) -> None:
        """Send a robot that is behind what it lacks."""
        slots = self.history.since(message["length"])
        if slots is None:
            record = self.ledger.snapshot()
            self.answer(message, {"kind": "learn", "snapshot": record})
            return
        self.answer(
            message,
            {"kind": "learn", "at": message["length"], "slots": slots},
        )

    def _on_pull(self, message: io.Message) -> None:
        if message["length"] < self.ledger.length:
            self._help(message)

    def _on_learn(self, message: io.Message) -> None:
        if "snapshot" in message:
            if message["snapshot"]["slot"] >= self.ledger.length:
                self._take_snapshot(message["snapshot"])
        elif "slots" in message:
            at = message["at"]
            for slot, (ballot, batch, before) in enumerate(message["slots"], at):
                if slot != self.ledger.length or self.halted is not None:
                    continue
                if before != self.ledger.hash:
                    self._conflict(message["from"], slot)
                    return
                self.decided(batch, Ballot.from_json(ballot), mine=False)
        elif message["slot"] == self.ledger.length and not self.consensus.on_chosen(
            Ballot.from_json(message["ballot"])
        ):
            self._pull(message["from"])

    def _take_snapshot(self, record: Record) -> None:
        self.ledger.restore(record)
        self._persist(record)
        self.history.clear(self.ledger.length)
        self.consensus.next_slot(False, set())
        self._after_slot(set(), {})

    def _conflict(self, other: str, slot: int) -> None:
        """Our log differs from another's before ``slot``."""
        if other in self.cast_out or other in self.forced:
            return  # the operator gave up what it knows
        if not self.active or self.name in self.peers.get(other).cast_out:
            self._forget()
            return
        self._halt("the log differs from that of %s before slot %d: one of them is broken" % (other, slot))

    def _forget(self) -> None:
        """What we know does not count (any more): learn the log from the others, then join. Until
        then we have no vote."""
        self._persist({"kind": "reset"})
        self._stop_acting()
        self.active = False
        self.forgetful = True
        self.ledger = Ledger(self.ledger.game)
        self.history.clear(0)
        self.pool = Pool()
        self.consensus.next_slot(False, set())
        self.own.follow(self.ledger, ())

    # -- beginning, and starting again ----------------------------------------------------------------

    def _begin(self) -> None:
        """The first slot is the same for all who have the plan: nothing to agree on."""
        start = self.ledger.game.start_entry()
        self._commit([Item(start, Origin("", 0, 0)).to_json()], Ballot(0, ""), mine=False)

    def _resume(self, records: Sequence[Record]) -> None:
        """Take up our own log again."""
        open_facts: Dict[Origin, Item] = {}
        begin = max((i for i, r in enumerate(records) if r["kind"] in ("snapshot", "reset")), default=0)
        for number, record in enumerate(records):
            kind = record["kind"]
            if kind == "life":
                self.incarnation = record["incarnation"]
                self.joining = record.get("joining", self.joining)
            elif kind == "active":
                self.active = True
                self.forgetful = False
            elif kind == "reset":
                self.active = False
                self.forgetful = True
                open_facts.clear()
            elif kind == "peer":
                self.peers.known[record["robot"]] = record["log"]
            elif kind == "forced":
                self.forced |= set(record["robots"])
            elif kind in ("invoked", "private"):
                item = Item.from_json([record["entry"], record["origin"], kind == "private"])
                open_facts[item.origin] = item
            elif kind == "void":
                open_facts.pop(Origin(*record["origin"]), None)
            elif number >= begin and kind == "snapshot":
                self.ledger.restore(record)
                self.history.clear(self.ledger.length)
            elif number >= begin and kind == "slot":
                self._replay(record)
        for record in records:
            if record["kind"] in ("promised", "accepted"):
                self.consensus.restore(record, self.ledger.length)
        for item in open_facts.values():
            if self.ledger.is_news(item.origin):
                self.pool.own.append(Own(item))
        self.forced &= set(self._member_names())
        self._first_hash = next((r["hash"] for r in records if r["kind"] == "slot" and r["slot"] == 0), "")
        self._new_life()
        if self.ledger.length == 0 and not (self.joining or self.forgetful):
            self._begin()

    def _replay(self, record: Record) -> None:
        items = [Item(log.from_json(e), Origin(*o)) for e, o in zip(record["entries"], record["origins"])]
        before = self.ledger.hash
        again, _ = self.ledger.append(items)
        if (again["slot"], again["hash"]) != (record["slot"], record["hash"]):
            raise LogError(
                "slot %s of our own log does not follow from what is before it" % record["slot"],
                hint="the file was changed, or belongs to another version of the plan",
            )
        ballot = record.get("ballot", [0, ""])
        self.history.add(record["slot"], ballot, [i.to_json() for i in items], before)

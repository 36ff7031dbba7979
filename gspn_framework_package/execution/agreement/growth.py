"""How a replica's log grows: slots that are decided, slots and snapshots that it catches up on,
and its own records when it starts again."""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.agreement import interface as io
from gspn_framework_package.execution.agreement.core import Core
from gspn_framework_package.execution.agreement.messages import Chosen, Envelope, Learn, Pull
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


class Growth(Core):
    """Takes slots into the log, with all that follows from them."""

    def decided(self, batch: List[Any], ballot: Ballot, *, mine: bool) -> None:
        """The batch is chosen in the open slot; ``mine``: by our own attempt."""
        slot = self.ledger.length
        alone = mine and self.may_decide([self.name])
        self._commit(batch, ballot, mine=mine, alone=alone)
        if mine and self.halted is None:
            self._tell_chosen(slot, ballot, {origin[0] for _, origin, _ in batch}, alone)

    def _tell_chosen(self, slot: int, ballot: Ballot, origins: Set[str], alone: bool) -> None:
        """Tell the others, unless what comes next tells it too."""
        self._gathers_until = self._now + self.pace.gather
        if not self.partial and self.pace.gather <= 0:
            self.consensus.propose(self._now)
            attempt = self.consensus.attempt
            if attempt is not None and attempt.ballot == ballot:
                return
        # those whose facts were in the batch saw each other's votes
        voted = self.is_small and not self.partial and not alone
        told = [m for m in self.others() if not (voted and m in origins)]
        if alone:  # nobody else has seen the batch
            self.send_all(told, Learn(at=slot, slots=self.history.since(slot) or ()))
        else:
            self.send_all(told, Learn(Chosen(slot, ballot)))

    def _commit(self, batch: List[Any], ballot: Ballot, *, mine: bool, alone: bool = False) -> None:
        items = [Item.from_json(i) for i in batch]
        before = self.ledger.hash
        record, step = self.ledger.append(items, ballot)
        slot = record["slot"]
        fresh = [Origin(*o) for o in record["origins"]]
        kept = [i for i in items if i.origin in set(fresh)]
        self.history.add(slot, ballot, [i.to_json() for i in kept], before)
        self.persist(record, durable=alone)  # then it is our vote as well
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
        if slot and slot % self.limits.snapshot_every == 0 and self.halted is None and self.ledger.length == slot + 1:
            self.persist(self.ledger.snapshot())

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
                state = self.ledger.state.robots.get(entry.robot)
                taken = state is not None and state.incarnation == entry.incarnation
                mine = entry.robot == self.name and entry.log == self.log_id
                if mine and not self.active and (taken or self.witness):
                    self._become_active()
                elif self.active and entry.robot == self.name and not self._is_our_name():
                    # somebody was let in under our name: from here on its votes count, and ours do not
                    self._superseded_at, self._rival_since = self._now, None
                    self._forget("another log was let in as %s" % self.name)
                    return
            elif isinstance(entry, log.Evict) and self.ledger.is_cast_out(entry.robot):
                self.pool.forget(entry.robot)

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
        if self.active and self._spoken_for():
            self._new_life()  # a former life of ours, late, or somebody else in our name
        self._follow()
        if state is not None and state.phase in GONE and self.ledger.state.ended is None:
            self._on_gone(state)
        self._act(delays)

    def _spoken_for(self) -> bool:
        """Whether the log holds something of ours that this life did not say, so that what it says
        would not be news."""
        incarnation, number, tag = self.ledger.seen.get(self.name, (-1, 0, ""))
        if self._known_incarnation() > self.incarnation:
            return True
        return incarnation == self.incarnation and tag == self.log_id[:8] and number > self._number

    def _answer_order(self, own: Own, in_log: bool, step: Optional[Step]) -> None:
        slot = self.ledger.length - 1
        if not in_log:
            self._put(io.OrderResult(own.order_id, False, "was overtaken by a newer one"))
            return
        why = self._without_effect(own.item.entry, step)
        self._put(io.OrderResult(own.order_id, not why, why or "done, in slot %d of the log" % slot))

    def _without_effect(self, entry: log.Entry, step: Optional[Step]) -> str:
        """Why an order that is in the log changed nothing; "" if it did."""
        if isinstance(entry, (log.SetPlace, log.Fire)):
            return "; ".join(c.message for c in (step.commands if step is not None else ()) if isinstance(c, Fault))
        if isinstance(entry, (log.Leave, log.Evict)) and self._member_names() == [entry.robot]:
            return "%s is the last one of the team, and stays; stop the run instead" % entry.robot
        return ""

    def _follow(self) -> None:
        """Take over where the log says that our robot is; private moves that it rules out are
        void."""
        for own in self.own.follow(self.ledger, self.pool.own):
            self.pool.own.remove(own)
            origin = list(own.item.origin)
            self.persist({"kind": "void", "origin": origin, "why": "the log rules it out"})

    def _on_gone(self, state: RobotState) -> None:
        """The log says that we were evicted, or have left."""
        if state.phase is Phase.LEFT and self.active and state.incarnation == self.incarnation:
            self.leaving = True
        elif self.incarnation <= state.incarnation:
            self.pool.own = [o for o in self.pool.own if o.order_id]
            self._new_life()

    # -- catching up ----------------------------------------------------------------------------------

    def is_open(self, message: Envelope) -> bool:
        """Whether a message is about the open slot, on top of the same log; where it is not, the
        one that is behind is helped."""
        slot = message.body.slot
        if slot < self.ledger.length:
            self._help(message)
            return False
        if slot > self.ledger.length:
            self._pull(message.sender)
            return False
        if message.length == self.ledger.length and message.hash != self.ledger.hash:
            self._conflict(message.sender, slot)
            return False
        return True

    def _pull(self, robot: str) -> None:
        """Ask a robot that is ahead for what we lack, not too often."""
        length, until = self._asked_until
        if length == self.ledger.length and self._now < until:
            return
        self._asked_until = (self.ledger.length, self._now + self.pace.retry)
        self.send_all([robot], Pull())

    def _help(self, message: Envelope) -> None:
        """Send a robot that is behind what it lacks."""
        slots = self.history.since(message.length)
        if slots is None:
            self.answer(message, Learn(snapshot=self.ledger.snapshot()))
        else:
            self.answer(message, Learn(at=message.length, slots=slots))

    def _on_pull(self, message: Envelope) -> None:
        if message.length < self.ledger.length:
            self._help(message)
            self.consensus.ask_again(message.sender)

    def _on_learn(self, message: Envelope, body: Learn) -> None:
        if body.snapshot is not None:
            if body.snapshot["slot"] >= self.ledger.length:
                self._take_snapshot(message.sender, body.snapshot)
        elif body.chosen is not None:
            if body.chosen.slot == self.ledger.length and not self.consensus.on_chosen(body.chosen.ballot):
                self._pull(message.sender)
        else:
            for slot, (ballot, batch, before) in enumerate(body.slots, body.at):
                if slot != self.ledger.length or self.halted is not None:
                    continue
                if before != self.ledger.hash:
                    self._conflict(message.sender, slot)
                    return
                self.decided(batch, ballot, mine=False)

    def _take_snapshot(self, sender: str, record: Record) -> None:
        try:
            self.ledger.restore(record)
        except LogError as error:
            self._fault("a snapshot of %s is not taken over: %s" % (sender, error))
            return
        self.persist(self.ledger.snapshot())
        for robot in self.ledger.cast_out:
            if self.ledger.is_cast_out(robot):
                self.pool.forget(robot)
        self.history.clear(self.ledger.length)
        self.consensus.next_slot(False, set())
        self._become_active_by_snapshot()
        self._after_slot(set(), {})

    def _become_active_by_snapshot(self) -> None:
        """The snapshot may hold our own ``Join``."""
        state = self._own_state()
        if self.active or self.ledger.logs.get(self.name) != self.log_id:
            return
        if self.witness or (state is not None and state.phase not in GONE and state.incarnation <= self.incarnation):
            self._become_active()

    def _conflict(self, other: str, slot: int) -> None:
        """Our log differs from another's before ``slot``."""
        if self.ledger.is_cast_out(other) or other in self.asserted_off():
            return  # the operator gave up what it knows
        if not self.active:
            self._forget("it differs from that of %s" % other)
            return
        if other not in self.astray:
            self.astray[other] = slot
            self._fault(
                "the log of %s differs from ours before slot %d: one of them is broken, and what it says does not count"
                % (other, slot)
            )
        members = self._member_names()
        if is_quorum([m for m in members if m in self.astray], members):
            self._forget("it differs from that of a quorum (%s)" % ", ".join(sorted(self.astray)))

    def _forget(self, why: str) -> None:
        """What we know does not count (any more): learn the log from the others, then join. Until
        then we have no vote. From here on our log counts as another one, since the votes that it
        gave before are forgotten."""
        self._renew_log_id()
        self.persist({"kind": "reset", "log": self.log_id, "why": why}, durable=True)
        if self.active:
            self._fault("forgets its log, and learns it anew: %s" % why)
        self._stop_acting()
        self.active = False
        self.forgetful = True
        self.astray.clear()
        self.off.clear()
        self.ledger = Ledger(self.ledger.game)
        self.history.clear(0)
        for own in self.pool.own:
            if own.order_id:
                self._put(io.OrderResult(own.order_id, False, "%s forgot its log: %s" % (self.name, why)))
        self.pool = Pool()
        self.consensus.abandon()
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
            try:
                self._recall(record, number >= begin, open_facts)
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                raise _damaged(record, number, error) from None
        self._recall_votes(records)
        for item in open_facts.values():
            if self.ledger.is_news(item.origin):
                self.pool.own.append(Own(item))
        self._first_hash = next((r["hash"] for r in records if r["kind"] == "slot" and r["slot"] == 0), "")
        if not self._trusted:
            self._forget("the machine was started anew, and the end of the log may not have reached the disk")
        elif self.active and not self._is_our_name():
            self._forget("another log was let in as %s" % self.name)
        self._new_life()
        if self.ledger.length == 0 and not (self.joining or self.forgetful):
            self._begin()

    def _recall(self, record: Record, counts: bool, open_facts: Dict[Origin, Item]) -> None:
        """Take over one record of our own log. ``counts``: no snapshot or reset comes after it."""
        kind = record["kind"]
        if kind == "life":
            self.incarnation = _whole(record["incarnation"])
            self.joining = bool(record.get("joining", self.joining))
        elif kind == "active":
            self.active = True
            self.forgetful = False
        elif kind == "reset":
            self.active = False
            self.forgetful = True
            self.log_id = str(record.get("log", self.log_id))
            self.ledger = Ledger(self.ledger.game)
            self.off.clear()
            open_facts.clear()
        elif kind == "peer":
            self.peers.known[str(record["robot"])] = str(record["log"])
        elif kind == "forced":
            self._recall_off(record)
        elif kind in ("invoked", "private"):
            item = Item.from_json([record["entry"], record["origin"], kind == "private"])
            open_facts[item.origin] = item
        elif kind == "void":
            open_facts.pop(Origin(*record["origin"]), None)
        elif counts and kind == "snapshot":
            self.ledger.restore(record)
            self.history.clear(self.ledger.length)
        elif counts and kind == "slot":
            self._replay(record)

    def _recall_votes(self, records: Sequence[Record]) -> None:
        """Take promises and votes up again; those before a reset are of another memory."""
        last = max((i for i, r in enumerate(records) if r["kind"] == "reset"), default=-1)
        for number, record in enumerate(records):
            if record["kind"] in ("promised", "accepted"):
                try:
                    self.consensus.restore(record, self.ledger.length if number > last else -1)
                except (KeyError, TypeError, ValueError, LogError) as error:
                    raise _damaged(record, number, error) from None

    def _recall_off(self, record: Record) -> None:
        """An assertion of the operator, from our own log; older ones do not say which incarnation
        they are about, and have to be made again."""
        robots = record["robots"]
        if isinstance(robots, dict):
            self.off = {str(robot): int(incarnation) for robot, incarnation in robots.items()}

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
        self.history.add(record["slot"], Ballot.from_json(ballot), [i.to_json() for i in items], before)


def _whole(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise ValueError("not a whole number: %.80r" % (value,))
    return value


def _damaged(record: Record, number: int, error: Exception) -> LogError:
    return LogError(
        "record %d of our own log, '%s', is damaged (%r)" % (number + 1, record.get("kind"), error),
        hint="move the file away: the robot then learns the log from the others, and joins again",
    )

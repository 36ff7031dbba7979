"""The replicated log: decided slots, catching up on slots and snapshots, and help for robots that
are behind.

Owns ``ledger``, ``recent``, ``first_hash`` and ``asked_until``. When a slot is in the log it
notifies, in this order, the proposer (the next slot is open), the membership (robots were admitted
or evicted), the proposals (some no longer wait) and the local robot (it may have moved). Implements
the log that consensus and membership need.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.local_robot import LocalRobot
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.messages import Batch, Chosen, Envelope, Learn, Pull
from gspn_framework_package.execution.agreement.part import ReplicaPart
from gspn_framework_package.execution.agreement.proposer import Proposer
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.firing import Ended, Fault, StartAction, TaskEnded
from gspn_framework_package.execution.ledger import Item, Ledger, Origin
from gspn_framework_package.execution.token_game import Step
from gspn_framework_package.model.errors import LogError


@dataclass(eq=False)
class Replication(ReplicaPart):
    """Appends slots to the log, and notifies the other parts."""

    proposer: Proposer
    membership: Membership
    robot: LocalRobot

    # -- decided slots --------------------------------------------------------------------

    def begin(self) -> None:
        """Append the first slot, which follows from the plan and needs no agreement."""
        start = self.config.game.start_entry()
        self._commit(Batch.of([Item(start, Origin("", 0, 0))]), Ballot(0, ""), mine=False)

    def decided(self, batch: Batch, ballot: Ballot, *, mine: bool) -> None:
        """Append a batch that was chosen in the open slot; ``mine``: by our own attempt."""
        slot, by_all = self.state.ledger.length, ballot in self.state.by_all
        alone = mine and self.electorate.may_choose([self.config.name], batch.items, by_all)
        self._commit(batch, ballot, mine=mine, alone=alone)
        if mine and self.state.halted is None:
            origins = {item.origin.robot for item in batch.items}
            if not self.proposer.lead_on(ballot, origins):
                self._report_chosen(slot, ballot, set() if by_all else origins, alone)

    def _report_chosen(self, slot: int, ballot: Ballot, origins: Set[str], alone: bool) -> None:
        """Inform the others; in a small team, except those whose proposals were in the batch,
        because they saw each other's votes."""
        voted = self.config.is_small and not self.config.partial and not alone
        receivers = [m for m in self.electorate.others() if not (voted and m in origins)]
        if alone:  # no other robot has seen the batch
            self.outbox.send_all(
                receivers, Learn(at=slot, slots=self.state.recent.since(slot) or ())
            )
        else:
            self.outbox.send_all(receivers, Learn(Chosen(slot, ballot)))

    def _commit(self, batch: Batch, ballot: Ballot, *, mine: bool, alone: bool = False) -> None:
        state = self.state
        before = state.ledger.hash
        game = state.ledger.game
        record, step = state.ledger.append(batch.items, ballot)
        slot = record["slot"]
        fresh = {Origin(*o) for o in record["origins"]}
        kept = [i for i in batch.items if i.origin in fresh]
        all_kept = len(kept) == len(batch.items)
        state.recent.add(slot, ballot, batch if all_kept else Batch.of(kept), before)
        # in a team of one, this record is our vote as well
        self.outbox.persist(record, durable=alone, synced=alone and batch.changes_members())
        if slot == 0:
            state.first_hash = state.ledger.hash
        returned = {i.entry.robot for i in kept if isinstance(i.entry, log_entries.Join)}
        self.proposer.next_slot(mine, returned)
        local = _local_visits(kept)
        for number, firing in enumerate(step.firings):
            # a local transition was published when it was made
            of_visit = (firing.robot, firing.incarnation, firing.visit)
            published = mine and of_visit not in local
            plan = step.game_of(number, game).plan
            self.outbox.put(interface.Fired(firing, published, state.ledger.hash, plan))
        # the robot that decided a slot reports the tasks that ended with it
        kinds = (Fault, Ended, TaskEnded) if mine else (Fault, Ended)
        self.outbox.put(*(c for c in step.commands if isinstance(c, kinds)))
        self.membership.note_members(kept)
        delays = {
            (c.visit, c.attempt): c.delay
            for c in step.commands
            if isinstance(c, StartAction) and c.robot == self.config.name and c.delay > 0
        }
        self._after_slot(fresh, delays, step)
        if (
            slot
            and slot % self.config.limits.snapshot_every == 0
            and state.halted is None
            and state.ledger.length == slot + 1
        ):
            self.outbox.persist(state.ledger.snapshot())

    def _after_slot(
        self, fresh: Set[Origin], delays: Dict[Tuple[int, int], float], step: Optional[Step]
    ) -> None:
        self.proposals.take_out_decided(fresh, step)
        if self.state.active and self.electorate.spoken_for():
            # a delayed message of a former life of ours, or another process of our name
            self.membership.new_life()
        self.robot.follow()
        self.membership.note_own_fate()
        self.robot.act(delays)

    def begin_anew(self) -> None:
        """Forget all slots."""
        self.state.ledger = Ledger(self.config.game)
        self.state.recent.clear(0)

    def keep_slots(self) -> None:
        """Keep all slots under a new log id, without the votes."""
        self.outbox.persist(self.state.ledger.snapshot(), durable=True)

    # -- catching up, and helping others catch up -----------------------------------------------

    def is_open(self, message: Envelope) -> bool:
        """Whether a message is about the open slot of the same log; if not, help whichever robot is
        behind."""
        ledger, slot = self.state.ledger, message.body.slot
        if slot < ledger.length:
            self.help(message)
            return False
        if slot > ledger.length:
            self.pull(message.sender)
            return False
        if message.length == ledger.length and message.hash != ledger.hash:
            self.membership.conflict(message.sender, slot)
            return False
        return True

    def pull(self, robot: str) -> None:
        """Ask a robot that is ahead for the slots that we lack, but not too often."""
        state = self.state
        length, until = state.asked_until
        if length == state.ledger.length and state.now < until:
            return
        state.asked_until = (state.ledger.length, state.now + self.config.pace.retry)
        self.outbox.send_all([robot], Pull())

    def help(self, message: Envelope) -> None:
        """Send a robot that is behind the slots that it lacks."""
        slots = self.state.recent.since(message.length)
        if slots is None:
            self.outbox.answer(message, Learn(snapshot=self.state.ledger.snapshot()))
        else:
            self.outbox.answer(message, Learn(at=message.length, slots=slots))

    def on_pull(self, message: Envelope) -> None:
        """Answer another robot's request for the slots that it lacks."""
        if message.length < self.state.ledger.length:
            self.help(message)
            self.proposer.ask_again(message.sender)

    def help_if_behind(self, message: Envelope) -> None:
        """Send the sender the slots that it lacks, if its log is shorter."""
        if message.length < self.state.ledger.length:
            self.help(message)

    def pull_if_behind(self, message: Envelope) -> None:
        """Ask the sender for the slots that we lack, if its log is longer."""
        if message.length > self.state.ledger.length:
            self.pull(message.sender)

    def on_learn(self, message: Envelope, body: Learn) -> None:
        """Take another robot's report of decisions."""
        state = self.state
        if body.snapshot is not None:
            if body.snapshot["slot"] >= state.ledger.length:
                self._take_snapshot(message.sender, body.snapshot)
        elif body.chosen is not None:
            if body.chosen.slot == state.ledger.length and not self.proposer.on_chosen(
                body.chosen.ballot
            ):
                self.pull(message.sender)
        else:
            for slot, (ballot, batch, before) in enumerate(body.slots, body.at):
                if slot != state.ledger.length or state.halted is not None:
                    continue
                if before != state.ledger.hash:
                    self.membership.conflict(message.sender, slot)
                    return
                self.decided(batch, ballot, mine=False)

    def _take_snapshot(self, sender: str, record: Record) -> None:
        state = self.state
        try:
            state.ledger.restore(record)
        except LogError as error:
            self.outbox.fault("cannot use a snapshot from %s: %s" % (sender, error))
            return
        self.outbox.persist(state.ledger.snapshot())
        state.recent.clear(state.ledger.length)
        self.proposer.begin_anew()
        self.membership.note_snapshot()
        self._after_slot(set(), {}, None)

    # -- reading our own log --------------------------------------------------------------------

    def recall(self, record: Record) -> None:
        """Take over a slot or a snapshot of our own log."""
        if record["kind"] == "snapshot":
            self.state.ledger.restore(record)
            self.state.recent.clear(self.state.ledger.length)
        else:
            self._replay(record)

    def _replay(self, record: Record) -> None:
        state = self.state
        items = [
            Item(log_entries.from_json(e), Origin(*o))
            for e, o in zip(record["entries"], record["origins"])
        ]
        before = state.ledger.hash
        again, _ = state.ledger.append(items)
        if (again["slot"], again["hash"]) != (record["slot"], record["hash"]):
            raise LogError(
                "slot %s of our own log does not follow from the records before it"
                % record["slot"],
                hint="the file was changed, or belongs to another version of the plan",
            )
        ballot = record.get("ballot", [0, ""])
        state.recent.add(record["slot"], Ballot.from_json(ballot), Batch.of(items), before)

    def recall_is_over(self, records: Sequence[Record]) -> None:
        """Finish reading."""
        first = (r["hash"] for r in records if r["kind"] == "slot" and r["slot"] == 0)
        self.state.first_hash = next(first, "")


def _local_visits(items: Sequence[Item]) -> Set[Tuple[str, int, int]]:
    """The visits (robot, incarnation, number) that local transitions ended."""
    return {
        (i.entry.robot, i.entry.incarnation, i.entry.visit)
        for i in items
        if i.private and isinstance(i.entry, log_entries.Done)
    }

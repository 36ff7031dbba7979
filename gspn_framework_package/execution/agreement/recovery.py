"""Reads a replica's own log when it restarts.

Owns nothing: routes each record to the part that handles it (membership, replication, proposals,
consensus), in the order of the log, and lets the membership begin the next life.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.part import ReplicaPart
from gspn_framework_package.execution.agreement.reactions import Reactions
from gspn_framework_package.execution.agreement.replication import Replication
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.model.errors import LogError

OF_MEMBERSHIP = ("life", "active", "reset", "outage", "peer", "forced")
OF_PROPOSALS = ("invoked", "private", "void", "reset")
OF_REPLICATION = ("slot", "snapshot")
OF_REACTIONS = ("offered", "slot", "snapshot")
OF_CONSENSUS = ("promised", "accepted")


@dataclass(eq=False)
class Recovery(ReplicaPart):
    """Passes records to the parts."""

    consensus: Consensus
    membership: Membership
    replication: Replication
    reactions: Reactions

    def resume(self, records: Sequence[Record]) -> None:
        """Resume from our own log.

        :raises LogError: the records contradict each other or the plan.
        """
        begin = max((i for i, r in enumerate(records) if _replaces_slots(r)), default=0)
        for number, record in enumerate(records):
            try:
                self._recall(record, number >= begin)
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                raise _damaged(record, number, error) from None
        if any(r["kind"] == "reset" for r in records[begin + 1 :]):
            self.replication.keep_slots()  # we stopped right after that reset
        self._recall_votes(records)
        self.proposals.recall_is_over()
        self.replication.recall_is_over(records)
        self.membership.recall_is_over()
        knows_all = bool(self.state.torn or self.state.damage) or not self.state.amnesic
        if self.state.ledger.length == 0 and knows_all and not self.state.joining:
            self.replication.begin()

    def _recall(self, record: Record, counts: bool) -> None:
        """Take over a record. ``counts``: whether no snapshot or reset follows it."""
        kind = record["kind"]
        if kind in OF_MEMBERSHIP:
            self.membership.recall(record)
        if kind in OF_PROPOSALS:
            self.proposals.recall(record)
        if kind in OF_REACTIONS:
            self.reactions.recall(record)
        if _forgets_slots(record):
            self.replication.begin_anew()
        elif counts and kind in OF_REPLICATION:
            self.replication.recall(record)

    def _recall_votes(self, records: Sequence[Record]) -> None:
        """Restore promises and votes; those before a reset belong to another memory."""
        last = max((i for i, r in enumerate(records) if r["kind"] == "reset"), default=-1)
        for number, record in enumerate(records):
            if record["kind"] in OF_CONSENSUS:
                try:
                    self.consensus.restore(
                        record, self.state.ledger.length if number > last else -1
                    )
                except (KeyError, TypeError, ValueError, LogError) as error:
                    raise _damaged(record, number, error) from None


def _replaces_slots(record: Record) -> bool:
    """Whether a record replaces all slots before it."""
    return record["kind"] == "snapshot" or _forgets_slots(record)


def _forgets_slots(record: Record) -> bool:
    """Whether a reset discarded our slots as well as our votes."""
    return record["kind"] == "reset" and not record.get("keep")


def _damaged(record: Record, number: int, error: Exception) -> LogError:
    return LogError(
        "record %d of our own log, '%s', is damaged (%r)" % (number + 1, record.get("kind"), error),
        hint="move the file away; the robot then gets the log from the others and rejoins",
    )

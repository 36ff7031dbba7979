"""Faults in what robots do whose machines lost power."""

from __future__ import annotations

from typing import Any, Collection, ContextManager, Dict, Sequence
from unittest import mock

from agreement.mutants.mutant import Mutant, wrap
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.messages import Batch
from gspn_framework_package.execution.agreement.outbox import Outbox
from gspn_framework_package.execution.agreement.recovery import Recovery
from gspn_framework_package.execution.event_log import Record


def _asks_a_quorum() -> ContextManager[Any]:
    """As if the robots remembered all that they voted for."""

    def make(original: Any) -> Any:
        def may_decide(self: Electorate, voters: Collection[str], by_all: bool = False) -> bool:
            return bool(original(self, voters, False))

        return may_decide

    return wrap(Electorate, "may_decide", make)


def _needs_only_a_quorum() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def needs_all(self: Electorate) -> Any:
            with mock.patch.object(Electorate, "missing_after_outage", lambda self: []):
                return original(self)

        return needs_all

    return wrap(Electorate, "needs_all", make)


def _changes_members_unsynced() -> ContextManager[Any]:
    return mock.patch.object(Batch, "changes_members", lambda self: False)


def _votes_unsynced() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def persist(self: Outbox, record: Record, **waits: bool) -> None:
            torn = "torn" in record
            original(self, record, **{how: on and not torn for how, on in waits.items()})

        return persist

    return wrap(Outbox, "persist", make)


def _forgets_its_vote() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def recall(self: Recovery, records: Sequence[Record]) -> None:
            kept = [r for r in records if self.config.trusted or r["kind"] != "accepted"]
            original(self, kept)

        return recall

    return wrap(Recovery, "_recall_votes", make)


def _votes_though_torn() -> ContextManager[Any]:
    """It votes in every slot, and nobody can see that its log lost its end."""

    def make(original: Any) -> Any:
        def outlive(self: Membership) -> None:
            if not self.state.active:
                original(self)

        return outlive

    return wrap(Membership, "_outlive_outage", make)


_KINDS: Dict[str, Any] = {"kinds": ("outage", "trust")}

MUTANTS = [
    Mutant(
        "whole though torn",
        "outage",
        "a log that lost its end counts",
        _votes_though_torn,
        **_KINDS,
    ),
    Mutant(
        "quorum of torn",
        "outage",
        "a quorum decides for those who forgot",
        _asks_a_quorum,
        seeds=("228:2:full:outage",),
        **_KINDS,
    ),
    Mutant(
        "torn without all",
        "outage",
        "not everybody has to be there",
        _needs_only_a_quorum,
        **_KINDS,
    ),
    Mutant(
        "members unsynced",
        "outage",
        "a vote on the members is not on the disk",
        _changes_members_unsynced,
        **_KINDS,
    ),
    Mutant(
        "torn votes unsynced",
        "outage",
        "a vote after a loss of power is not on the disk",
        _votes_unsynced,
        **_KINDS,
    ),
    Mutant(
        "vote lost",
        "outage",
        "a vote on the disk is forgotten",
        _forgets_its_vote,
        seeds=("7162:3:full:outage",),
        **_KINDS,
    ),
]

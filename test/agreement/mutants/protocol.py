"""Faults in the protocol of a slot, and in local transitions."""

from __future__ import annotations

from typing import Any, ContextManager, Dict, List, Sequence
from unittest import mock

from agreement.mutants.mutant import (
    Mutant,
    all_patched,
    wrap,
)
from gspn_framework_package.execution.agreement import electorate as electorate_module
from gspn_framework_package.execution.agreement import membership as membership_module
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.local_transitions import LocalTransitions
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.agreement.state import ReplicaState, Waiting
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.execution.token_game import TokenGame


def _bare_half() -> ContextManager[Any]:
    def half(voters: Any, members: Sequence[str]) -> bool:
        return 2 * sum(1 for m in members if m in voters) >= len(members)

    return all_patched(
        mock.patch.object(electorate_module, "is_quorum", half),
        mock.patch.object(membership_module, "is_quorum", half),
    )


def _forgets_promises() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_accept(self: Consensus, message: Any, body: Any) -> None:
            self.state.promised = min(self.state.promised, body.ballot)
            original(self, message, body)

        return on_accept

    return wrap(Consensus, "on_accept", make)


def _ignores_accepted() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_promise(self: Consensus, message: Any, body: Any, now: float) -> None:
            original(self, message, body._replace(accepted=None), now)

        return on_promise

    return wrap(Consensus, "on_promise", make)


def _amnesia() -> ContextManager[Any]:
    return mock.patch.object(Consensus, "restore", lambda self, record, slot: None)


def _counts_any_vote() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_accepted(self: Consensus, message: Any, body: Any, now: float) -> None:
            ledger, attempt = self.state.ledger, self.state.attempt
            if attempt is not None:
                body = body._replace(ballot=attempt.ballot, slot=ledger.length)
            original(self, message._replace(hash=ledger.hash), body, now)

        return on_accepted

    return wrap(Consensus, "on_accepted", make)


def _keeps_leading() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def _promise(self: Consensus, ballot: Ballot, torn: Any) -> None:
            state = self.state
            followers, promised = state.followers, state.promised
            original(self, ballot, torn)
            if followers is not None and ballot.robot != self.config.name:
                state.followers, state.promised = followers, promised

        return _promise

    return wrap(Consensus, "_promise", make)


def _believes_any_next() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_accept(self: Consensus, message: Any, body: Any) -> None:
            held = self.state.accepted
            if held is not None and body.slot == self.state.ledger.length + 1:
                self.log.decided(held[1], held[0], mine=False)
            original(self, message, body)

        return on_accept

    return wrap(Consensus, "on_accept", make)


def _votes_without_memory() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def consider_active(self: Membership) -> None:
            if not self.state.active and not self.state.joining and self.state.ledger.length:
                self.become_active()

        return consider_active

    return wrap(Membership, "consider_active", make)


def _no_deduplication() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def append(self: Ledger, items: Any, ballot: Any = None) -> Any:
            self.seen = {}
            return original(self, items, ballot)

        return append

    return wrap(Ledger, "append", make)


def _asks_only_a_quorum() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def first_phase_over(self: Consensus) -> bool:
            if self.state.attempt is not None:
                self.state.attempt.answered |= set(self.electorate.members())
            return bool(original(self))

        return first_phase_over

    return wrap(Consensus, "_first_phase_over", make)


def _lets_strangers_answer() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def unasked(self: Consensus, attempt: Any) -> Dict[str, bool]:
            return {m: other for m, other in original(self, attempt).items() if not other}

        return unasked

    return wrap(Consensus, "_unasked", make)


def _does_not_freeze() -> ContextManager[Any]:
    return mock.patch.object(ReplicaState, "is_frozen", lambda self: False)


def _everything_private() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def init(self: LocalTransitions, game: TokenGame, robot: str) -> None:
            original(self, game, robot)
            resources = game.plan.resource_places
            for t, ends in enumerate(game.net.outputs):
                places = [
                    p for p, _ in game.net.inputs[t] if game.net.places[p].name not in resources
                ]
                targets = [p for p, _ in ends if game.net.places[p].name not in resources]
                if len(places) == 1 and targets and game.net.transitions[t].timed:
                    self._target[places[0], t] = targets[0]

        return init

    return wrap(LocalTransitions, "__init__", make)


def _drops_proposals() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_nack(self: Consensus, body: Any) -> bool:
            beaten = bool(original(self, body))
            if beaten:
                self.state.own_proposals = Waiting()
            return beaten

        return on_nack

    return wrap(Consensus, "on_nack", make)


MUTANTS: List[Mutant] = [
    Mutant("bare half", "protocol", "exactly half of the members is a quorum", _bare_half),
    Mutant("promises", "protocol", "an acceptor does not keep its promises", _forgets_promises),
    Mutant(
        "accepted values",
        "protocol",
        "a proposer ignores what others have accepted",
        _ignores_accepted,
    ),
    Mutant("amnesia", "protocol", "promises and votes are not read back after a restart", _amnesia),
    Mutant("any vote", "protocol", "votes of other slots and ballots count", _counts_any_vote),
    Mutant(
        "keeps leading",
        "protocol",
        "a leader does not notice that it was replaced",
        _keeps_leading,
        False,
    ),
    Mutant(
        "any next",
        "protocol",
        "any Accept of the next slot confirms what was held",
        _believes_any_next,
        False,
        5,
    ),
    Mutant(
        "no memory", "protocol", "a robot that lost its log votes at once", _votes_without_memory
    ),
    Mutant("repeats", "protocol", "repeated entries are not left out", _no_deduplication),
    Mutant(
        "dropped proposals",
        "protocol",
        "a proposer that gives way forgets its proposals",
        _drops_proposals,
    ),
    Mutant(
        "quorum only",
        "partial",
        "the first phase does not wait for every member",
        _asks_only_a_quorum,
        True,
        kinds=("freeze",),
    ),
    Mutant(
        "stand-in",
        "partial",
        "a spare answers for the robot whose place it did not take",
        _lets_strangers_answer,
        True,
        kinds=("stand-in",),
    ),
    Mutant(
        "no freeze",
        "partial",
        "local transitions do not stop for orders",
        _does_not_freeze,
        True,
        kinds=("freeze",),
    ),
    Mutant(
        "all private",
        "partial",
        "transitions that touch resources count as local",
        _everything_private,
        True,
    ),
]

"""Faults in putting another plan into the team."""

from __future__ import annotations

from typing import Any, Callable, ContextManager, Dict, List, Optional, Sequence
from unittest import mock

from agreement.mutants.mutant import Mutant, wrap
from gspn_framework_package.execution import plan_change
from gspn_framework_package.execution import token_game as token_game_module
from gspn_framework_package.execution.agreement.deployment import Deployment
from gspn_framework_package.execution.agreement.local_robot import LocalRobot
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import TeamState


def _adopts_without_votes() -> ContextManager[Any]:
    return mock.patch.object(plan_change, "vote_of", lambda state, member: "")


def _keeps_old_names() -> ContextManager[Any]:
    return mock.patch.object(TeamState, "present_name", lambda self, name: name)


def _fills_resources_again() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def new_marking(state: Any, old: Any, new: Any, names: Any) -> Dict[str, int]:
            marking: Dict[str, int] = original(state, old, new, names)
            initial = {p.name: p.tokens for p in new.net.places if p.name in new.resource_places}
            return {**marking, **initial}

        return new_marking

    return wrap(plan_change, "new_marking", make)


def _lets_requests_stand() -> ContextManager[Any]:
    def leave_out(self: Any, asked: Any) -> None:
        self.state.waiting.clear()
        self.state.done_in.clear()
        for name in asked:
            if self.state.robots[name].phase is Phase.DONE:
                self.state.add_waiting(self.state.robots[name])

    return mock.patch.object(token_game_module._Reducer, "_ask_anew", leave_out)


def _plans_without(key: str) -> Callable[[], ContextManager[Any]]:
    def make(original: Any) -> Any:
        def to_json(self: TeamState) -> Dict[str, Any]:
            return {k: v for k, v in original(self).items() if k != key}

        return to_json

    return lambda: wrap(TeamState, "_plans_to_json", make)


def _acts_by_the_first_plan() -> ContextManager[Any]:
    return mock.patch.object(LocalRobot, "follow_plan", lambda self: None)


def _never_votes_again() -> ContextManager[Any]:
    return mock.patch.object(
        Deployment, "_has_voted", lambda self, staged: self.config.name in staged.votes
    )


def _counts_votes_of_earlier_lives() -> ContextManager[Any]:
    def vote_of(state: TeamState, member: str) -> Optional[str]:
        votes = state.staged.votes if state.staged is not None else {}
        return votes[member][1] if member in votes else None

    return mock.patch.object(plan_change, "vote_of", vote_of)


def _overrules_who_cannot() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        return lambda state, member: None if original(state, member) is None else ""

    return wrap(plan_change, "vote_of", make)


def _adopts_in_any_state() -> ContextManager[Any]:
    def why_not(state: TeamState, old: Any, new: Any, mapping: Any) -> List[str]:
        return plan_change.why_never(old, new, mapping)

    return mock.patch.object(plan_change, "why_not", why_not)


def _loses_tasks() -> ContextManager[Any]:
    return mock.patch.object(plan_change, "_tasks_without_place", lambda *_: [])


def _keeps_votes_of_other_stages() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def stage(self: Any, entry: Any) -> None:
            before = self.state.staged
            original(self, entry)
            if before is not None:
                self.state.staged.votes.update(before.votes)

        return stage

    return wrap(token_game_module._Reducer, "_stage", make)


_DEPLOYED = ("deploy-tight", "deploy-archive")


def _deploying(
    name: str,
    text: str,
    apply: Callable[[], ContextManager[Any]],
    kinds: Sequence[str] = ("deploy", "deploy-calm"),
    seeds: Sequence[str] = (),
) -> Mutant:
    """A fault in putting another plan into the team."""
    return Mutant(name, "deployment", text, apply, kinds=kinds, seeds=seeds)


MUTANTS: List[Mutant] = [
    _deploying("no votes", "a plan is adopted without votes", _adopts_without_votes),
    _deploying("old names", "what is under way keeps its old names", _keeps_old_names),
    _deploying("new resources", "resources are full again", _fills_resources_again),
    _deploying("old requests", "robots that are done ask the policy", _lets_requests_stand),
    _deploying("acts as before", "a robot acts by the first plan", _acts_by_the_first_plan),
    _deploying(
        "votes of the dead",
        "a vote of an earlier life counts",
        _counts_votes_of_earlier_lives,
        ("deploy", "deploy-operator"),
        seeds=("74:3:full:deploy",),
    ),
    _deploying(
        "overruled",
        "a vote against a plan counts for it",
        _overrules_who_cannot,
        seeds=("58:3:full:deploy",),
    ),
    _deploying("any state", "a plan is adopted that does not fit", _adopts_in_any_state),
    Mutant(
        "lost tasks",
        "deployment",
        "a plan is adopted that has no place for tasks",
        _loses_tasks,
        test="execution/test_plan_change.py::test_tasks_that_wait_carry_over_and_are_never_dropped",
    ),
    _deploying("votes stay", "votes on one plan count for the next", _keeps_votes_of_other_stages),
    _deploying("votes once", "a robot that restarts does not vote again", _never_votes_again),
    *(
        _deploying(
            "snapshot without " + key,
            "a snapshot lacks '%s'" % key,
            _plans_without(key),
            _DEPLOYED,
        )
        for key in ("staged", "adopted")
    ),
]

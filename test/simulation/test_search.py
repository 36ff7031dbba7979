"""A small search of what small teams can do (more: ``python3 -m benchmarks.agreement_search``), and
faults that it finds."""

from __future__ import annotations

import pytest

from agreement.mutants import MUTANTS
from agreement.search import SCOPES, Found, Scope, Search

TRANSITIONS = 2_500
"""For each scope, breadth first, and as many at random."""


@pytest.mark.parametrize("scope", SCOPES, ids=lambda scope: scope.name)
def test_nothing_that_a_small_team_can_do_breaks_a_rule(scope: Scope) -> None:
    search = Search(scope)
    search.breadth_first(TRANSITIONS)
    assert search.depth >= 2
    search.walk(TRANSITIONS, 0)
    assert search.transitions >= 2 * TRANSITIONS
    assert search.longest >= 1
    assert search.verified >= 1


@pytest.mark.parametrize(
    "name, scope",
    [
        ("bare half", "two"),
        ("accepted values", "three"),
        ("returned followers", "three"),
        ("no freeze", "two, partial"),
        ("no sync", "two"),
    ],
)
def test_a_seeded_fault_is_found(name: str, scope: str) -> None:
    (mutant,) = [m for m in MUTANTS if m.name == name]
    (small,) = [s for s in SCOPES if s.name == scope]
    with mutant.apply(), pytest.raises(Found) as found:
        for seed in range(5):
            Search(small).walk(8_000, seed)
    assert len(found.value.story) == len(found.value.actions)
    assert "<locals>" not in str(found.value), "the mutant no longer fits the program"


def test_the_same_steps_lead_to_the_same_logs() -> None:
    """What is computed once for many states of a team is what each of them would do."""
    search = Search(SCOPES[0])
    search.walk(500, 3)
    team, path = search.begin, []
    while (action := next(search.actions(team), None)) is not None and len(path) < 30:
        path.append(action)
        team = search.after(team, action)
    now = [search.processes[number] for number in team.processes]
    again = search.replay(path)
    for one, other in zip(now, again):
        assert other is not None
        assert (other.length, other.promised, other.log_id) == (
            one.length,
            one.promised,
            one.log_id,
        )

"""A small search of what small teams can do (more: ``python3 -m benchmarks.agreement_search``), and
faults that it finds."""

from __future__ import annotations

import pytest

from agreement.mutants import MUTANTS
from agreement.plans import RELAY
from agreement.search import SCOPES, Action, Found, Scope, Search
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface

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


TASK = log_entries.Submit("order", "t1", {})


@pytest.mark.parametrize(
    "entry",
    [
        log_entries.CancelTask("t1"),
        log_entries.GiveBack("t1"),
        TASK._replace(id="t2", replaces="t1"),
    ],
    ids=lambda entry: type(entry).__name__,
)
def test_no_robot_moves_on_with_a_task_that_is_taken_from_it(entry: log_entries.Entry) -> None:
    """r2 carries the task through a private place. It is asked about the slot in which the task is
    taken from it, and its action ends before that is decided."""
    orders = ((0, interface.TaskCame(TASK)), (0, interface.Order("o", entry)))
    search = Search(Scope("relay", 2, True, orders, RELAY, slots=9, ticks=30))
    team, path = search.begin, []

    def do(action: Action) -> None:
        nonlocal team
        path.append(action)
        team = search.after(team, action)

    def settle() -> None:
        taken = set()
        for _ in range(4):
            while True:
                todo = [a for a in search.actions(team) if a.what == "take" and a not in taken]
                if not todo:
                    break
                for action in todo:
                    taken.add(action)
                    do(action)
            do(Action("tick", 0))
            do(Action("tick", 1))

    do(Action("order", 0, 0))
    settle()
    assert search.processes[team.processes[1]].running
    known = len(search.messages)
    do(Action("order", 0, 1))
    do(Action("tick", 0))
    asked = [
        number
        for number, message in enumerate(search.messages)
        if number >= known and '"kind":"prepare"' in message.text
    ]
    do(Action("take", 1, asked[-1]))
    do(Action("done", 1))
    settle()
    search.verify(path)

"""What the benchmark of tasks and events reads in the logs, and how it cuts the network."""

import random
from types import SimpleNamespace

import pytest

from benchmarks.harness.team import MASTER
from benchmarks.reacting_tasks import (
    SENDER,
    courier_plan,
    is_well,
    make_row,
    outcome,
    random_cut,
)

WELL = {
    "tasks": 2,
    "done_once": 2,
    "twice": 0,
    "dropped": 0,
    "two_winners": 0,
    "tracebacks": 0,
    "logs": "valid",
}


def slot(number, *entries, **firing):
    """A record of a log, with a firing if one is told."""
    firings = [{"robot": "robot_1", "incarnation": 0, "visit": 1, **firing}] if firing else []
    told = [{"robot": "robot_1", "incarnation": 0, "visit": 1, "entry": entry} for entry in entries]
    return {"kind": "slot", "slot": number, "entries": told, "firings": firings}


def done(number, task, **more):
    return slot(number, "done", transition="delivered", tasks=[[task, "robot x", "done"]], **more)


def test_a_slot_that_several_logs_have_counts_once():
    first, second = done(1, "a"), done(2, "b", visit=2)
    found = outcome([[first, {"kind": "goal"}], [first, second]])
    assert found.done == {"a": 1, "b": 1} and found.two_winners == 0


def test_a_task_that_is_done_twice_and_one_that_is_dropped_are_seen():
    dropped = slot(3, "evict", transition="x", tasks=[["b", "robot x", "dropped"]])
    row = make_row(
        "abc",
        outcome([[done(1, "a"), done(2, "a", visit=2), dropped]]),
        SimpleNamespace(violation=None),
    )
    assert (row["done_once"], row["lost"], row["twice"], row["dropped"]) == (0, 2, 1, 1)
    assert row["evictions"] == 1


def test_of_a_result_and_an_event_of_one_visit_one_wins():
    wins, loses = slot(1, "interrupt", transition="bump"), slot(2, "done")
    found = outcome([[wins, loses]])
    assert (found.interrupts, found.races, found.two_winners) == (1, 1, 0)
    both = outcome([[wins, done(2, "a")]])
    assert (both.races, both.two_winners) == (1, 1)


@pytest.mark.parametrize(
    "wrong",
    [
        {"tasks": 0, "done_once": 0},
        {"done_once": 1},
        {"twice": 1},
        {"dropped": 1},
        {"two_winners": 1},
        {"tracebacks": 1},
        {"logs": "rule 2: x"},
    ],
    ids=str,
)
def test_whatever_is_wrong_makes_the_run_a_failure(wrong):
    assert is_well(WELL)
    assert not is_well({**WELL, **wrong})


def test_every_random_cut_cuts_something_between_nodes_that_exist():
    for robots in (3, 5):
        names = [robot.name for robot in courier_plan(robots).robots]
        cuts = [random_cut(names, random.Random(seed)) for seed in range(200)]
        nodes = {MASTER, SENDER, *names}
        assert all(cut and {end for pair in cut for end in pair} <= nodes for cut in cuts)
        one_way = [cut for cut in cuts if any((b, a) not in cut for a, b in cut)]
        assert one_way and len(one_way) < len(cuts)
        # the sender with one robot only; nobody with anybody
        assert any(sum((SENDER, name) not in cut for name in names) == 1 for cut in cuts)
        assert any(len(cut) == len(nodes) * (len(nodes) - 1) for cut in cuts)

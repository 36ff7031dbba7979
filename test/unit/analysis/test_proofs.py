"""Proofs by the state equation that nothing gets stuck: never wrong, and found where it matters."""

import json
from collections import Counter
from pathlib import Path

import pytest
from generated_nets import bounded_nets, reference_space
from generated_plans import small_plans, with_events
from hypothesis import given, settings

from gspn_framework_package.analysis.plan.markings import PlanMarkings
from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.analysis.preflight.report import Severity
from gspn_framework_package.analysis.proofs import dead_markings, program
from gspn_framework_package.analysis.proofs.dead_markings import never_dead, plan_never_dead
from gspn_framework_package.analysis.proofs.program import MarkingProgram, solver_available
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.making.site_plan import build_site_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import CancelledError, LimitError
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy, PolicyRow

PLANS = Path(__file__).parents[3] / "plans"

pytestmark = pytest.mark.skipif(
    not solver_available(), reason="this SciPy has no solver of mixed-integer programs"
)


def test_what_is_proven_of_nets_holds():
    count = Counter()

    @settings(derandomize=True, max_examples=150)
    @given(bounded_nets())
    def ask(net):
        alive = all(reference_space(net).values())
        proven = never_dead(net, 10.0)
        assert alive or not proven
        count[alive, proven] += 1

    ask()
    assert count[True, True] > count[True, False] > 0, "it proves most, but is not complete"
    assert count[False, False] > 10


UNKNOWN = "unknown"


def stuck(plan, losses):
    """A dead marking of a plan; None if it has none, and UNKNOWN if its markings are too many."""
    markings = PlanMarkings(plan, 2_000, losses=losses)
    found = [finding for lost in (False, True) for finding in markings.dead(after_losses=lost)]
    return found[0] if found else None if markings.complete else UNKNOWN


@pytest.mark.parametrize("losses", [False, True])
@pytest.mark.parametrize("plans", [small_plans(), with_events(small_plans())], ids=["", "events"])
def test_what_is_proven_of_plans_holds(plans, losses):
    count = Counter()

    @settings(derandomize=True, max_examples=100)
    @given(plans)
    def ask(plan):
        found = stuck(plan, losses)
        proven = plan_never_dead(plan, 10.0, losses=losses)
        assert found in (None, UNKNOWN) or not proven
        if found != UNKNOWN:
            count[found is None, proven] += 1

    ask()
    assert count[True, True] > 2 * count[True, False] and count[False, False] > 10, count


@pytest.mark.parametrize("name", sorted(p.name for p in PLANS.iterdir() if p.is_dir()))
def test_the_example_plans_are_proven_never_to_get_stuck(name):
    plan = read_plan(str(PLANS / name))
    assert plan_never_dead(plan, 10.0, losses=False)
    waits_for_the_lost = stuck(plan, True) not in (None, UNKNOWN)
    assert plan_never_dead(plan, 10.0, losses=True) is not waits_for_the_lost


def site(folder, **more):
    """A plan of six robots on a map of 30 nodes, whose markings are far too many to visit."""
    names = {(x, y): "n%d%d" % (x, y) for x in range(6) for y in range(5)}
    nodes = {name: [4 * x, 4 * y] for (x, y), name in names.items()}
    steps = [((x, y), (x + 1, y)) for x, y in names] + [((x, y), (x, y + 1)) for x, y in names]
    edges = [[names[a], names[b]] for a, b in steps if b in names]
    tasks = {
        "plan": "site",
        "start": ["n00", "n10", "n20", "n30", "n40", "n50"],
        "speed": 1.0,
        "tasks": {"Inspect": {"at": ["n34", "n12", "n53", "n04"], "seconds": 9, "again_after": 60}},
        "battery": {"full": 0.1, "low": 0.1},
        "docks": {"n00": 1},
        "charge": 60,
        **more,
    }
    for name, data in (("map.yaml", {"nodes": nodes, "edges": edges}), ("tasks.yaml", tasks)):
        (folder / name).write_text(json.dumps(data), "utf-8")
    made = build_site_plan(str(folder / "map.yaml"), str(folder / "tasks.yaml"), 6)
    made.write(str(folder / "plan"))
    return read_plan(str(folder / "plan"))


def test_a_plan_of_a_map_is_proven_but_not_if_robots_can_meet_head_on(tmp_path):
    report = check(site(tmp_path), limit=100)
    (item,) = report.of("dead_markings")
    assert item.severity is Severity.OK and item.details["losses"]
    assert not report.of("exploration")
    (tmp_path / "narrow").mkdir()
    narrow = site(tmp_path / "narrow", node_capacity=1)
    assert not plan_never_dead(narrow, 10.0, losses=False)


WAIT = ()
GO = (("go", 1.0),)
BLOCKED = (("blocked", 1.0),)


@pytest.mark.parametrize(
    "rows, proven",
    [
        ([((None, None), GO)], True),
        ([((1, None), GO), ((0, None), GO)], True),
        ([((None, None), GO), ((1, None), WAIT)], False),
        ([((None, None), GO), ((1, 0), BLOCKED)], False),
        ([((None, None), GO), ((1, 1), BLOCKED)], True),  # "key" holds nothing
        ([((None, None), BLOCKED)], False),
        ([((0, None), GO)], False),  # in a strict plan, no row moves nobody
    ],
)
def test_a_robot_moves_only_by_the_row_that_takes_precedence(rows, proven):
    net = (
        NetBuilder("rows")
        .place("door", tokens=1)
        .place("room")
        .place("key")
        .immediate("go", inputs="door", outputs="room")
        .immediate("blocked", inputs=["door", "key"], outputs=["room", "key"])
        .exponential("back", inputs="room", outputs="door")
        .build()
    )
    plan = Plan(
        net=net,
        resource_places=frozenset(["key"]),
        actions={"door": None, "room": FunctionAction("actions.do", "do")},
        robots=(RobotSpec("robot_1", "door"),),
        policy=Policy(["door", "key"], [PolicyRow(*row) for row in rows]),
        strict=True,
    ).validate()
    assert plan_never_dead(plan, 10.0, losses=False) is proven
    assert (stuck(plan, False) is None) is proven


def lanes(first="lane_a", second="lane_b"):
    """Two robots that each take two lanes, one after the other."""
    builder = NetBuilder("lanes").place("lane_a", tokens=1).place("lane_b", tokens=1)
    for robot, lane, other in (("x", "lane_a", "lane_b"), ("y", first, second)):
        builder.place(robot + "_rests", tokens=1).place(robot + "_half").place(robot + "_drives")
        builder.exponential(robot + "_1", inputs=[robot + "_rests", lane], outputs=robot + "_half")
        builder.exponential(
            robot + "_2", inputs=[robot + "_half", other], outputs=robot + "_drives"
        )
        builder.exponential(
            robot + "_3",
            inputs=robot + "_drives",
            outputs=[robot + "_rests", "lane_a", "lane_b"],
        )
    return builder.build()


def test_robots_that_wait_for_each_other_are_not_proven_away():
    assert never_dead(lanes(), 10.0)
    assert not never_dead(lanes("lane_b", "lane_a"), 10.0)


def trapped():
    """A net whose state equation allows the empty marking, which a marked trap excludes."""
    return (
        NetBuilder("trapped")
        .place("a", tokens=1)
        .place("b")
        .exponential("more", inputs="a", outputs={"a": 1, "b": 1})
        .exponential("join", inputs={"a": 1, "b": 1}, outputs="b")
        .exponential("on", inputs="b", outputs="a")
        .build()
    )


def test_a_marked_trap_excludes_what_the_state_equation_allows(monkeypatch):
    net = trapped()
    assert never_dead(net, 10.0)
    monkeypatch.setattr(dead_markings, "largest_trap", lambda *given, **more: ())
    assert not never_dead(net, 10.0)


def test_what_is_too_large_stays_open(monkeypatch):
    net = lanes()
    monkeypatch.setattr(program, "LARGEST_PROGRAM", 5)
    assert not never_dead(net, 10.0)
    huge = NetBuilder("huge").place("a", tokens=10**9).exponential("go", inputs="a", outputs="a")
    with pytest.raises(LimitError):
        MarkingProgram(huge.build(), [])


def test_a_proof_can_be_cancelled():
    with pytest.raises(CancelledError):
        never_dead(lanes(), 10.0, cancel=lambda: True)


def test_the_check_proves_what_its_markings_leave_open(monkeypatch):
    plan = read_plan(str(PLANS / "inspection"))
    whole = check(plan).of("dead_markings")
    (item,) = check(plan, limit=20).of("dead_markings")
    assert [i.severity for i in whole] == [item.severity] == [Severity.OK]
    assert item.details["decided_by"] == "state equation"
    assert "no dead marking can be reached" in item.text
    (open_item,) = check(plan, limit=20, prove=False).of("dead_markings")
    assert open_item.details["undecided"] and "was not decided within" in open_item.text
    monkeypatch.setattr(program, "solver_available", lambda: False)
    assert check(plan, limit=20).of("dead_markings") == (open_item,)

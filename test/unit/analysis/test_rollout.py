"""A policy that is improved by simulation is better than the old one, and says how much."""

from pathlib import Path

import pytest

from gspn_framework_package.analysis.decisions.aims import AtLeast, Objective, Request
from gspn_framework_package.analysis.decisions.optimise import optimise
from gspn_framework_package.analysis.decisions.rollout import improve
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import CancelledError, RefusedError
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy, PolicyRow, PolicyScope

ACT = FunctionAction("actions.work", "work")


def machines(**choices):
    """Three robots and two machines for one robot each: `left` is quick, `right` is slow."""
    net = NetBuilder().place("choose", 3)
    for name, rate in (("left", 1.0), ("right", 0.6)):
        net.place(name + "_queue").place(name).place(name + "_free", 1)
        net.immediate("to_" + name, inputs="choose", outputs=name + "_queue")
        net.immediate(
            "begin_" + name, inputs=(name + "_queue", name + "_free"), outputs=name, priority=2
        )
        net.exponential(name + "_done", rate=rate, inputs=name, outputs=("rest", name + "_free"))
    net.place("rest").exponential("rested", rate=2.0, inputs="rest", outputs="choose")
    rows = [((), {**choices})]
    begin = {"begin_left": 0.5, "begin_right": 0.5}
    return Plan(
        net.build(),
        policy=Policy.from_table((), [((), _shared({**rows[0][1], **begin}))]),
        actions={
            "choose": None,
            "left_queue": None,
            "right_queue": None,
            "left": ACT,
            "right": ACT,
            "rest": ACT,
        },
        resource_places=frozenset(["left_free", "right_free"]),
        robots=tuple(RobotSpec("r%d" % k, "choose") for k in range(3)),
    ).validate()


def _shared(weights):
    total = sum(weights.values())
    return {t: w / total for t, w in weights.items()}


QUICKLY = {"seconds": None, "rounds": 1, "visits": 200, "pairs": 30}
"""Without a limit in time, so that a busy machine gives the same answers."""

DONE = Objective.long_run({"left_done": 1.0, "right_done": 1.0})


@pytest.mark.long
def test_a_bad_policy_is_improved_but_not_beyond_the_optimum():
    plan = machines(to_right=1.0)
    found = improve(plan, Request(DONE), seed=1, seconds=None, rounds=2, visits=200, pairs=40)
    assert found.improved and found.difference.low > 0.1 and found.markings >= 1
    exact = optimise(plan, Request(DONE), simulated=0.0)
    best = exact.teams[0].upper
    assert found.new.low <= best * (1 + 1e-6)
    assert found.new.mean > 0.85 * best
    half = (found.old.high - found.old.low) / 2
    assert abs(found.old.mean - exact.present) < 2 * half < 0.1 * exact.present
    again = plan.with_policy(found.policy)
    assert any("distance from the optimum" in note for note in found.notes)
    assert again.policy.rows[-1].choices == plan.policy.rows[-1].choices


@pytest.mark.long
def test_the_best_policy_is_left_alone():
    plan = machines(to_right=1.0)
    best = optimise(plan, Request(DONE), simulated=0.0).plan
    found = improve(best, Request(DONE), seed=2, **QUICKLY)
    assert not found.improved and found.policy == best.policy and found.markings == 0
    assert found.difference[:3] == (0.0, 0.0, 0.0) and found.old.low <= found.old.high
    assert any("present one stays" in note for note in found.notes)


@pytest.mark.long
def test_it_waits_where_it_may_and_never_enters_what_is_forbidden():
    """The slow machine costs more than it earns: waiting for the quick one is best."""
    plan = machines(to_right=1.0)
    aim = Objective.long_run({"left_done": 1.0, "right": -2.0})
    waiting = improve(plan, Request(aim, may_wait=frozenset(["choose"])), seed=3, **QUICKLY)
    assert waiting.improved and waiting.new.low > waiting.old.high
    barred = improve(plan, Request(aim, never=("left_queue >= 1",)), seed=3, **QUICKLY)
    assert not barred.improved
    assert any("nothing more is guaranteed" in note for note in barred.notes)


@pytest.mark.long
def test_the_policy_of_a_subnet_is_improved_among_its_own_rows():
    plan = machines(to_right=1.0)
    rows = [PolicyRow((), (("begin_left", 0.5), ("begin_right", 0.5)))]
    rows.append(PolicyRow((), (("to_right", 1.0),)))
    scope = PolicyScope(("choose",), 1, 2)
    found = improve(plan.with_policy(Policy((), rows, [scope])), Request(DONE), seed=1, **QUICKLY)
    assert found.improved
    (own,) = found.policy.scopes
    assert own.places == ("choose",) and own.last - own.first == 1 + found.markings
    assert any(name == "to_left" for name, _ in found.policy.rows[own.first].choices)
    assert found.policy.rows[0].choices == rows[0].choices


@pytest.mark.long
def test_a_time_to_a_condition():
    plan = machines(to_right=1.0)
    found = improve(plan, Request(Objective.time_to("rest == 3")), seed=4, **QUICKLY)
    assert found.improved and found.difference.high < 0


@pytest.mark.long
@pytest.mark.parametrize("robots", [60])
def test_a_large_team_is_improved_or_told_that_it_is_not(robots):
    plan = read_plan(Path(__file__).parents[3] / "plans" / "patrol").for_robots(robots)
    aim = Objective.long_run({"p1:Check_Temperature_L1": 1.0})
    found = improve(plan, Request(aim), seed=5, seconds=4.0)
    assert found.old.mean is not None and found.old.low < found.old.high
    if found.improved:
        assert found.difference.low > 0 and found.policy != plan.policy
    else:
        assert found.policy == plan.policy
        assert any("present one stays" in note for note in found.notes)


def test_what_it_cannot_do_is_refused_and_it_can_be_cancelled():
    plan = machines(to_right=1.0)
    with pytest.raises(RefusedError, match="constraints on the long run"):
        improve(plan, Request(DONE, at_least=(AtLeast("left_done", 0.1),)))
    with pytest.raises(CancelledError):
        improve(plan, Request(DONE), cancel=lambda: True)

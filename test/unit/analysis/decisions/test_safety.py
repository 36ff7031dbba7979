"""What may never be: which markings are safe, and why a plan is refused."""

import pytest

from gspn_framework_package.analysis.decisions.problem import DecisionProblem
from gspn_framework_package.analysis.plan.reading import NET, RUN
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.plan import Plan, RobotSpec, Timing

WORK = FunctionAction("actions.work", "work")


def never_two(plan):
    """At most one robot in Check and Alarm of each location of the patrol."""
    names = [p.name for p in plan.net.places]
    return ['"%s" + "%s" > 1' % (names[i], names[i + 1]) for i in range(0, 16, 4)]


def test_the_safe_markings_of_the_patrol():
    plan = read_plan("plans/patrol/plan.json")
    decisions = DecisionProblem(plan, reading=NET, never=never_two(plan))
    assert len(decisions.safety.safe) == 4845
    assert decisions.safety.safe.sum() == 3199


@pytest.mark.long
@pytest.mark.parametrize("reading", [NET, RUN])
def test_whatever_is_allowed_stays_safe(reading):
    plan = read_plan("plans/patrol/plan.json")
    decisions = DecisionProblem(plan, reading=reading, never=never_two(plan))
    for team in decisions.teams:
        safe = decisions.safety.safe[decisions.built.original[team.states_in]]
        automaton, allowed = team.automaton, decisions.allowed(team)
        rows = automaton.arc_rows
        leaves = safe[automaton.row_states[rows]] & ~safe[automaton.targets]
        assert not (leaves & allowed[rows]).any()
        for condition in never_two(plan):
            assert not (safe & decisions.goal(team, condition)).any()


def narrow(**more):
    """Two robots come to a door; only one may be inside."""
    net = (
        NetBuilder("door")
        .place("way", tokens=2)
        .place("door")
        .place("inside")
        .exponential("come", rate=1.0, inputs="way", outputs="door")
        .immediate("enter", inputs="door", outputs="inside")
        .exponential("leave", rate=1.0, inputs="inside", outputs="way")
        .build()
    )
    return Plan(
        net,
        actions={"way": WORK, "door": None, "inside": WORK},
        robots=(RobotSpec("r1", "way"), RobotSpec("r2", "way")),
        **more,
    ).validate()


@pytest.mark.parametrize("reading", [NET, RUN])
def test_a_plan_is_refused_with_a_witness_and_who_would_have_to_wait(reading):
    with pytest.raises(RefusedError) as refusal:
        DecisionProblem(narrow(), reading=reading, never=["inside > 1"])
    assert "come, come, enter, enter" in refusal.value.message or "enter" in refusal.value.message
    assert "inside: 2" in refusal.value.message
    assert "--may-wait door" in (refusal.value.hint or "")


@pytest.mark.parametrize("reading", [NET, RUN])
def test_waiting_saves_it(reading):
    decisions = DecisionProblem(narrow(), reading=reading, never=["inside > 1"], may_wait=["door"])
    team = decisions.teams[0]
    allowed = decisions.allowed(team)
    enter = decisions.plan.net.transition_index["enter"]
    taken = team.markings[team.automaton.row_states, 2] >= 1
    assert not allowed[(team.automaton.choices == enter) & taken].any()
    assert allowed[(team.automaton.choices == enter) & ~taken].all()


def test_what_waiting_cannot_avoid_is_refused_too():
    with pytest.raises(RefusedError) as refusal:
        DecisionProblem(narrow(), reading=NET, never=["door > 1"])
    assert "--may-wait" not in (refusal.value.hint or "")


def test_the_loss_of_a_robot_counts():
    """A guard that may be lost must not be what keeps the others safe."""
    plan = narrow(timing=Timing(evict_after=10.0))
    with pytest.raises(RefusedError, match="robot lost in"):
        DecisionProblem(plan, reading=NET, never=["way + door + inside < 2"])
    DecisionProblem(narrow(timing=Timing(evict_after=0.0)), reading=NET, never=["way + door > 9"])

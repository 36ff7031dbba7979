"""The check warns of a robot that waits for good for what it has requested, and of no other."""

from dataclasses import replace

import pytest
from test_preflight import make_plan

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.analysis.preflight.report import Severity
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.plan import LostKind, LostRule, Timing

NO_LOSSES = Timing(evict_after=0)


def deserter(back="c", idle=(), **more):
    """A robot in a meets one in b, which may leave, and then comes ``back`` to c, or to b."""
    builder = (
        NetBuilder("deserter")
        .place("a", tokens=1)
        .place("b", tokens=1)
        .place("c")
        .place("d")
        .exponential("meet", inputs=["a", "b"], outputs=["a", "b"])
        .exponential("leave", inputs="b", outputs="c")
        .exponential("go", inputs="c", outputs="d")
        .exponential("back", inputs="d", outputs=back)
        .exponential("ask", inputs=["a", "d"], outputs=["a", "d"])
        .place("bell", tokens=1)
        .exponential("ring", inputs=["a", "bell"], outputs=["a", "bell"])
    )
    return make_plan(builder, resources=["bell"], idle=idle, timing=NO_LOSSES, **more)


def waiting(plan):
    return check(plan).of("waiting")


@pytest.mark.parametrize("timing", [NO_LOSSES, Timing()])
def test_a_robot_whose_partner_never_returns_is_named(timing):
    plan = replace(deserter(outcomes={"a": {"meet": 1.0}}), timing=timing)
    report = check(plan)
    (item,) = report.of("waiting")
    assert item.severity is Severity.WARNING and report.exit_code == 0
    assert item.text == (
        "a robot in a that requests meet can wait forever while others continue: in (a: 1, c: 1, "
        "bell: 1), reached by leave, meet can never fire; let nothing take away for good what it needs, or let "
        'an event such as {"after": SECONDS} move the robot on'
    )
    assert (item.details["place"], item.details["transition"]) == ("a", "meet")
    assert item.details["sequence"] == ["leave"]
    assert report.doubts == ("can let robots wait forever",)


def test_every_transition_that_the_action_may_name_is_looked_at():
    found = [(i.details["place"], i.details["transition"]) for i in waiting(deserter())]
    assert found == [("a", "meet")]
    assert len(waiting(deserter(idle=["c"]))) == 1
    often = deserter(outcomes={"a": {"meet": 0.1, "ask": 0.9}})
    assert len(waiting(often)) == 1


@pytest.mark.parametrize(
    "plan",
    [
        pytest.param(deserter(back="b"), id="the partner returns"),
        pytest.param(deserter(outcomes={"a": {"ask": 1.0}}), id="no action names it"),
        pytest.param(deserter(idle=["a"]), id="no action, and none of three is named"),
        pytest.param(
            deserter(events={"ring": EventSource(after=5.0)}), id="an event can move the robot"
        ),
        pytest.param(
            replace(deserter(), on_lost=LostRule(LostKind.FIRE, "ask")), id="a loss can move it"
        ),
        pytest.param(deserter(until="d >= 1"), id="the run ends"),
    ],
)
def test_a_robot_that_can_go_on_is_not(plan):
    assert waiting(plan) == ()


def test_a_marking_in_which_nobody_goes_on_is_dead_instead():
    builder = (
        NetBuilder("left alone")
        .place("a", tokens=1)
        .place("b", tokens=1)
        .place("end")
        .exponential("meet", inputs=["a", "b"], outputs=["a", "b"])
        .exponential("leave", inputs="b", outputs="end")
    )
    report = check(make_plan(builder, timing=NO_LOSSES))
    assert report.of("waiting") == ()
    assert report.of("dead_markings")[0].severity is Severity.WARNING


def choosing(idle=(), outcomes=None):
    """A robot in look may switch off the lamp, which one in a needs."""
    builder = (
        NetBuilder("lamp")
        .place("a", tokens=1)
        .place("look", tokens=1)
        .place("b")
        .place("lamp", tokens=1)
        .exponential("see", inputs=["a", "lamp"], outputs=["a", "lamp"])
        .immediate("off", inputs=["look", "lamp"], outputs="b")
        .immediate("keep", inputs="look", outputs="b")
        .exponential("again", inputs="b", outputs="look")
    )
    return make_plan(
        builder, resources=["lamp"], idle=idle, timing=NO_LOSSES, outcomes=outcomes or {}
    )


def test_what_the_policy_or_an_action_never_chooses_takes_nothing_away():
    assert [item.details["transition"] for item in waiting(choosing())] == ["see"]
    assert [item.details["sequence"] for item in waiting(choosing(idle=["look"]))] == [["off"]]
    assert waiting(choosing(outcomes={"look": {"keep": 1.0}})) == ()


def test_priorities_among_immediate_transitions_are_left_alone():
    plan = choosing()
    first = [t._replace(priority=2) if t.name == "keep" else t for t in plan.net.transitions]
    net = plan.net.__class__(plan.net.places, first, plan.net.arcs, plan.net.name)
    assert waiting(replace(plan, net=net)) == ()

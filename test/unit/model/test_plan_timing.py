"""The times of a plan's places: what the plan gives, what the net gives, where the run differs."""

import pytest

from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.plan_timing import POLICY, PlanTiming

ACT = FunctionAction("actions.work", "work")


def net_of(*, inhibited=False):
    builder = (
        NetBuilder()
        .place("work", 1)
        .place("decide")
        .exponential("good", rate=3.0, inputs="work", outputs="decide")
        .exponential("bad", rate=1.0, inputs="work", outputs="decide")
        .immediate("again", inputs="decide", outputs="work")
    )
    if inhibited:
        builder = builder.inhibitor("decide", "bad")
    return builder.build()


def timing_of(net=None, **settings):
    actions = settings.pop("actions", {"work": ACT, "decide": ACT})
    robots = settings.pop("robots", (RobotSpec("r", "work"),))
    return PlanTiming(Plan(net or net_of(), actions=actions, robots=robots, **settings).validate())


def test_the_net_gives_what_the_plan_does_not():
    timing = timing_of()
    work, decide = timing.places[0], timing.places[1]
    assert work.duration == Duration.exponential(0.25)
    assert work.outcomes == ((0, 0.75), (1, 0.25))
    assert decide.duration == Duration.none()
    assert decide.outcomes == ((POLICY, 1.0),)
    assert timing.splits == {}
    assert [a.split(" take")[0] for a in timing.assumptions[:2]] == [
        "the actions of decide",
        "the actions of work",
    ]


def test_what_the_plan_gives_takes_precedence():
    timing = timing_of(
        durations={"decide": Duration.exponential(2.0), "work": Duration.erlang(3, 1.0)},
        outcomes={"work": {"good": 1.0, "bad": 0.0}, "decide": {"again": 0.25, "": 0.75}},
        failures={"work": 0.1},
    )
    assert timing.places[0].outcomes == ((0, 1.0),)
    assert timing.places[0].failure == 0.1
    assert timing.places[1].outcomes == ((2, 0.25), (POLICY, 0.75))
    assert "not exponential (Erlang" in timing.splits["work"]
    assert "before the policy decides" in timing.splits["decide"]
    assert timing.assumptions == []


def test_what_else_can_disable_a_transition_splits_its_place():
    assert timing_of(net_of(inhibited=True)).splits == {
        "work": "bad has an inhibitor arc from decide"
    }


@pytest.mark.parametrize("own", [False, True])
def test_a_place_mapped_to_no_action_takes_no_time(own):
    if own:
        spec = RobotSpec("r", "work", {"work": None})
        timing = timing_of(
            robots=(spec, RobotSpec("other", "work")), net=net_of().with_marking((2, 0))
        )
        assert timing.of("other", 0).duration == Duration.exponential(0.25)
    else:
        timing = timing_of(actions={"work": None, "decide": ACT})
        assert timing.splits == {"work": "its action takes no time"}
    found = timing.of("r", 0)
    assert found.duration == Duration.none()
    assert found.outcomes == ()  # two transitions, and nothing names one
    assert timing.of("r", 1) == timing.places[1]


def test_a_place_that_is_not_mapped_keeps_the_time_of_the_net():
    assert timing_of(actions={}).of("r", 0).duration == Duration.exponential(0.25)

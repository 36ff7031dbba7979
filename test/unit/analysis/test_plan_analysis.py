"""A plan under its policy is a Markov chain, by the rules of the execution."""

from dataclasses import replace

import pytest
from generated_nets import bounded_nets
from hypothesis import HealthCheck, assume, given, settings

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.chain import Chain
from gspn_framework_package.analysis.plan.space import WAITS_LABEL, explore_plan
from gspn_framework_package.analysis.solution.measures import Measures
from gspn_framework_package.analysis.solution.steady_state import steady_state
from gspn_framework_package.analysis.state_space import explore
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Policy, PolicyRow
from gspn_framework_package.run_net.compiling import compile_plan
from gspn_framework_package.run_net.steps import Steps


def outcomes(plan, marking=None):
    """What happens at once when a run begins in a marking: transition -> probability; None: all
    wait."""
    net = plan.net
    if marking is not None:
        net = net.with_marking(marking)
    steps = Steps(compile_plan(replace(plan, net=net), None))
    vanishing, found = steps.expand(steps.start)
    if not vanishing:
        return {}
    return {s.label if s.label < steps.waits else None: s.value for s in found}


relaxed = settings(deadline=None, suppress_health_check=list(HealthCheck))


def policy(places, *rows):
    return Policy(places, [PolicyRow(counts, tuple(choices.items())) for counts, choices in rows])


def junction(robots, **more):
    """Robots arrive in ``d`` at rate 1 each, and go ``up`` or ``down``, which take 1/2 s and 1/4
    s."""
    net = (
        NetBuilder("junction")
        .place("a", tokens=robots)
        .place("d")
        .place("up")
        .place("down")
        .exponential("arrive", rate=1, inputs="a", outputs="d")
        .immediate("go_up", weight=3, inputs="d", outputs="up")
        .immediate("go_down", inputs="d", outputs="down")
        .exponential("from_up", rate=2, inputs="up", outputs="a")
        .exponential("from_down", rate=4, inputs="down", outputs="a")
        .build()
    )
    return Plan(net=net, **more)


@relaxed
@given(bounded_nets())
def test_a_plan_without_robots_is_its_net(net):
    """The same chain by another way: every place a resource, so that the weights decide."""
    try:
        one = Chain.of(explore(net))
    except RefusedError:
        assume(False)
    plan = Plan(
        net=net,
        resource_places=frozenset(p.name for p in net.places),
        until=" and ".join(["p0 >= 1000"] + ["%s >= 0" % p.name for p in net.places]),
    )
    # the condition, which never holds, reads every place: none is left out as a mere counter
    other = Chain.of(explore_plan(plan))
    assert len(one) == len(other)
    means = [Measures(c, steady_state(c).distribution) for c in (one, other)]
    assert means[0].mean_tokens == pytest.approx(means[1].mean_tokens, abs=1e-9)
    assert means[0].throughput == pytest.approx(means[1].throughput, abs=1e-9)


def test_weights_decide_where_there_is_no_policy():
    throughput = Analysis(junction(2)).measures.throughput
    assert throughput["go_up"] == pytest.approx(3 * throughput["go_down"])


def test_robots_work_in_parallel():
    """Three robots, each its own action: three times the throughput of one, although the file says
    one server."""
    one, three = (Analysis(junction(n)).measures.throughput["arrive"] for n in (1, 3))
    assert three == pytest.approx(3 * one, rel=1e-9)
    assert Analysis(junction(3).net).measures.throughput["arrive"] < 2 * one


def test_the_policy_decides():
    rows = policy(["up"], ((0,), {"go_up": 1.0}), ((None,), {"go_down": 1.0}))
    analysis = Analysis(junction(2, policy=rows))
    assert analysis.boundedness.bounds["up"] == 1
    markings = {analysis.space.marking(s) for s in range(len(analysis.space))}
    assert markings == {
        (2, 0, 0, 0),
        (1, 1, 0, 0),
        (1, 0, 1, 0),
        (0, 1, 1, 0),
        (0, 0, 1, 1),
        (1, 0, 0, 1),
        (0, 1, 0, 1),
    }


def test_probabilities_of_a_row():
    rows = policy(["a"], ((None,), {"go_up": 0.3, "go_down": 0.7}))
    throughput = Analysis(junction(1, policy=rows)).measures.throughput
    assert throughput["go_up"] / throughput["arrive"] == pytest.approx(0.3)


def meeting(chance, robots=2):
    """Robots in ``d`` draw: go alone, or meet another one there."""
    net = (
        NetBuilder("meeting")
        .place("a", tokens=robots)
        .place("d")
        .place("alone")
        .place("together")
        .exponential("arrive", rate=1, inputs="a", outputs="d")
        .immediate("go", inputs="d", outputs="alone")
        .immediate("meet", inputs={"d": 2}, outputs={"together": 2})
        .exponential("from_alone", rate=1, inputs="alone", outputs="a")
        .exponential("from_together", rate=1, inputs={"together": 2}, outputs={"a": 2})
        .build()
    )
    choices = {name: value for name, value in (("meet", chance), ("go", 1 - chance)) if value}
    return Plan(net=net, policy=policy(["a"], ((None,), choices)))


def test_a_draw_that_is_not_enabled_waits_for_the_marking_to_change():
    plan = meeting(0.9)
    space = explore_plan(plan)
    arrived = plan.net.marking({"a": 1, "d": 1})
    asking = next(
        s for s in range(len(space)) if space.marking(s) == arrived and space.is_vanishing[s]
    )
    waiting = {name: space.marking(target) for name, target in space.successors(asking)}
    assert waiting == {"go": plan.net.marking({"a": 1, "alone": 1}), WAITS_LABEL: arrived}
    assert outcomes(plan, arrived) == pytest.approx(
        {plan.net.transition_number("go"): 0.1, None: 0.9}
    )
    # Drawing only among what is enabled would turn {meet 0.9, go 0.1} into go 1.0, and nobody would
    # ever meet.
    assert Analysis(plan).measures.throughput["meet"] > 0


def test_nobody_meets_who_never_draws_it():
    assert Analysis(meeting(0.0)).measures.throughput["meet"] == 0


def test_all_wait_for_ever_where_one_is_left_over():
    analysis = Analysis(meeting(1.0, robots=1))
    assert [analysis.space.named(dead) for dead in analysis.properties.deadlocks] == [{"d": 1}]


def test_two_draws_at_once():
    """Two robots in ``d``: each draws meet with 0.9 or go with 0.1; any order of the two is as
    likely."""
    plan = meeting(0.9)
    net = plan.net
    meet, go = net.transition_number("meet"), net.transition_number("go")
    # both meet: 0.81; both go: 0.01; one each: whoever is first, 0.18 shared equally; all draws are
    # enabled
    found = outcomes(plan, net.marking({"d": 2}))
    assert found == pytest.approx({meet: 0.81 + 0.09, go: 0.01 + 0.09})


def test_priorities_go_before_the_policy():
    net = (
        NetBuilder()
        .place("d", tokens=1)
        .place("x")
        .place("y")
        .immediate("low", priority=1, inputs="d", outputs="x")
        .immediate("high", priority=2, inputs="d", outputs="y")
        .build()
    )
    plan = Plan(net=net, policy=policy(["d"], ((None,), {"low": 0.5, "high": 0.5})))
    assert outcomes(plan) == {1: 1.0}


def test_a_strict_plan_waits_without_a_row():
    rows = policy(["a"], ((0,), {"go_up": 1.0}))
    free, strict = junction(2, policy=rows), junction(2, policy=rows, strict=True)
    asking = free.net.marking({"a": 1, "d": 1})
    assert set(outcomes(free, asking)) == {1, 2}
    assert outcomes(strict, asking) == {}


def test_resources_go_first():
    net = (
        NetBuilder()
        .place("d", tokens=1)
        .place("e")
        .place("r", tokens=1)
        .place("s")
        .immediate("robot", priority=9, inputs="d", outputs="e")
        .immediate("resource", inputs="r", outputs="s")
        .build()
    )
    plan = Plan(net=net, resource_places=frozenset(["r", "s"]), until="s > 5")
    assert list(outcomes(plan)) == [1]


def test_until_ends_the_run():
    plan = junction(1, until="up >= 1")
    analysis = Analysis(plan)
    assert analysis.space.named(analysis.properties.deadlocks[0]) == {"up": 1}
    assert analysis.first_passage("up >= 1").probability == 1.0
    passage = Analysis(replace(plan, until="down >= 1")).first_passage("up >= 1")
    assert passage.probability == pytest.approx(0.75)


def test_counters_are_left_out_and_still_can_be_waited_for():
    net = (
        NetBuilder()
        .place("work", tokens=1)
        .place("done")
        .exponential("do", rate=2, inputs="work", outputs=["work", "done"])
        .build()
    )
    analysis = Analysis(Plan(net=net, resource_places=frozenset(["done"])))
    assert analysis.left_out == ("done",) and len(analysis.space) == 1
    assert analysis.boundedness.bounded is False
    assert analysis.first_passage("done >= 6").mean_time == pytest.approx(3.0)

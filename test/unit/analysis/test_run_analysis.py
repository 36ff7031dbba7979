"""A plan is analysed as it runs: doing, then done, and off as soon as it can."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from running_plans import running_plans
from scipy import integrate, stats

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.chain import Chain
from gspn_framework_package.analysis.chain_export import explicit_chain
from gspn_framework_package.analysis.drawing import chain_graph
from gspn_framework_package.analysis.plan.space import explore_plan
from gspn_framework_package.analysis.solution.measures import Measures
from gspn_framework_package.analysis.solution.steady_state import steady_state
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import LimitError, RefusedError, UsageError
from gspn_framework_package.model.failure import FailureEnd, FailureRule
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.plan_timing import PlanTiming
from gspn_framework_package.model.policy import Policy, PolicyRow
from gspn_framework_package.run_net.phases import number_of_phases, phases_of

exponential, erlang = Duration.exponential, Duration.erlang


def plan_of(net, durations=None, rows=(), **more):
    """A plan whose actions take these times; ``rows`` of the policy hold for any marking."""
    places = [p.name for p in net.places if p.name not in more.get("resource_places", ())]
    actions = {name: FunctionAction("actions.work", "work") for name in places}
    policy = Policy([], [PolicyRow((), tuple(choices.items())) for choices in rows])
    robots = [
        RobotSpec("%s_%d" % (p.name, i), p.name)
        for p in net.places
        if p.name in places
        for i in range(p.tokens)
    ]
    return Plan(
        net=net,
        actions=actions,
        durations=durations or {},
        policy=policy,
        robots=tuple(robots),
        **more,
    ).validate()


def test_a_place_of_more_tokens_than_a_byte_counts():
    builder = NetBuilder("parts").place("Idle", tokens=1).place("Busy").place("parts", tokens=300)
    builder.exponential("take", inputs={"Idle": 1, "parts": 300}, outputs="Busy")
    builder.exponential("give", inputs="Busy", outputs={"Idle": 1, "parts": 300})
    durations = {"Idle": exponential(1.0), "Busy": exponential(2.0)}
    plan = plan_of(builder.build(), durations, resource_places=frozenset(["parts"]))
    assert Analysis(plan).measures.mean_tokens["parts"] == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("rule", "idle"), [(FailureRule.stop(), 0.0), (FailureRule.retry(1_000), 1 / 7)]
)
def test_a_failure_that_stops_the_team_moves_no_robot(rule, idle):
    """The column that counts it is that of no place."""
    net = NetBuilder("two").place("a", tokens=1).place("b")
    net.exponential("there", inputs="a", outputs="b").exponential("back", inputs="b", outputs="a")
    durations = {"a": exponential(1.0), "b": exponential(3.0)}
    plan = plan_of(net.build(), durations, failures={"b": 0.5}, on_failure={"*": rule})
    tokens = Analysis(plan).measures.mean_tokens
    assert tokens == pytest.approx({"a": idle, "b": 1 - idle}, abs=1e-9)


def pair():
    """A robot in ``a`` and one in ``b`` go on together."""
    return (
        NetBuilder("pair")
        .place("a", tokens=1)
        .place("b", tokens=1)
        .exponential("meet", rate=1, inputs=["a", "b"], outputs=["a", "b"])
        .build()
    )


def test_a_join_waits_for_the_later_of_two():
    plan = plan_of(pair(), {"a": exponential(1.0), "b": exponential(0.5)})
    analysis = Analysis(plan)
    assert analysis.measures.throughput["meet"] == pytest.approx(1 / (1 + 1 / 2 - 1 / 3))
    assert set(analysis.timing.splits) == {"a", "b"}
    assert Analysis(plan, timing="net").measures.throughput["meet"] == pytest.approx(1.0)


def test_a_join_of_erlang_times():
    plan = plan_of(pair(), {"a": erlang(2, 1.0), "b": erlang(3, 2.0)})
    times = np.linspace(0, 40, 400_001)
    longer = 1 - plan.durations["a"].cdf(times) * plan.durations["b"].cdf(times)
    later = float(((longer[1:] + longer[:-1]) / 2 * np.diff(times)).sum())  # mean of the maximum
    assert Analysis(plan).measures.throughput["meet"] == pytest.approx(1 / later, rel=1e-8)


def test_an_inhibitor_holds_a_robot_that_is_done():
    net = (
        NetBuilder()
        .place("wait", tokens=1)
        .place("busy", tokens=1)
        .place("off")
        .place("free")
        .exponential("leave", rate=1, inputs="wait", outputs="off", inhibitors="busy")
        .exponential("end", rate=1 / 2, inputs="busy", outputs="free")
        .build()
    )
    plan = plan_of(net)
    assert list(Analysis(plan).timing.splits) == ["wait"]
    # the later of the two, for the robot is doing its action while the other one is busy
    assert Analysis(plan).first_passage("off == 1").mean_time == pytest.approx(1 + 2 - 1 / 1.5)
    net_only = Analysis(plan, timing="net")
    assert net_only.first_passage("off == 1").mean_time == pytest.approx(2 + 1)


def test_a_decision_that_takes_time():
    net = (
        NetBuilder()
        .place("work", tokens=1)
        .place("decide")
        .exponential("done", rate=2, inputs="work", outputs="decide")
        .immediate("again", inputs="decide", outputs="work")
        .build()
    )
    plan = plan_of(net, {"decide": exponential(0.1)})
    analysis = Analysis(plan)
    assert analysis.measures.throughput["again"] == pytest.approx(1 / 0.6)
    assert analysis.measures.mean_tokens["decide"] == pytest.approx(0.1 / 0.6)
    assert analysis.properties.live and analysis.reversible
    without = Analysis(replace(plan, durations={}))
    assert without.measures.throughput["again"] == pytest.approx(2)
    assert without.timing.splits == {}


def test_an_action_without_time_ends_after_what_others_can_do():
    """Two robots wait for a room. When it is free both set off, before either has decided; without
    an action the first is inside at once, and holds the other one up."""
    net = (
        NetBuilder()
        .place("wait", tokens=2)
        .place("decide")
        .place("room", tokens=1)
        .place("off")
        .exponential("leave", rate=0.01, inputs="room", outputs="off")
        .exponential("set_off", rate=100, inputs="wait", outputs="decide", inhibitors="room")
        .immediate("enter", inputs="decide", outputs="room", inhibitors="room")
        .build()
    )
    plan = plan_of(net, until="off > 1")
    acting = Analysis(plan).first_passage("decide == 2")
    assert acting.probability == pytest.approx(1, abs=0.03)
    idle = replace(plan, actions={**plan.actions, "decide": None}).validate()
    assert Analysis(idle).first_passage("decide == 2").probability == 0


def meeting(**more):
    """Two robots deliberate: each goes alone, or wants to meet the other."""
    net = (
        NetBuilder("meeting")
        .place("d", tokens=2)
        .place("alone")
        .place("together")
        .immediate("go", inputs="d", outputs="alone")
        .immediate("meet", inputs={"d": 2}, outputs={"together": 2})
        .build()
    )
    return plan_of(net, {"d": exponential(1.0)}, [{"meet": 0.9, "go": 0.1}], **more)


def test_a_draw_is_held_while_the_partner_is_doing():
    """The first robot to finish wants to meet with 0.9, and holds that until the second is done.
    Then either of them goes first. Who is left when the other goes alone may wait for ever."""
    analysis = Analysis(meeting())
    reached = analysis.first_passage
    meet = 0.9 * (0.5 + 0.5 * 0.9)
    assert reached("together == 2").probability == pytest.approx(meet)
    assert reached("alone == 2").probability == pytest.approx((1 - meet) * 0.1)
    assert reached("d == 1 and deadlock").probability == pytest.approx((1 - meet) * 0.9)
    assert len(analysis.properties.deadlocks) == 3
    way = analysis.reach("d == 1 and deadlock").witness
    assert [step.transition for step in way] == ["go", "(waits)"]
    # the first of the two takes 1/2 s, the other one 1 s more
    assert reached("d == 0 or (d == 1 and deadlock)").mean_time == pytest.approx(1.5)


def test_what_an_action_named_is_not_overridden():
    """In ``d`` the action names ``go`` with 0.1; otherwise the policy lets the robot meet."""
    plan = replace(
        meeting(), outcomes={"d": {"go": 0.1, "": 0.9}}, policy=Policy([], [])
    ).validate()
    rows = Policy([], [PolicyRow((), (("meet", 1.0),))])
    reached = Analysis(replace(plan, policy=rows)).first_passage
    assert reached("together == 2").probability == pytest.approx(0.81)
    assert reached("alone == 2").probability == pytest.approx(0.01)


def test_a_named_robot_is_left_when_two_of_three_meet():
    """Two of three named ``go``, which is inhibited; the third lets the policy decide: nobody is
    free to meet it."""
    net = (
        NetBuilder()
        .place("d", tokens=3)
        .place("closed", tokens=1)
        .place("alone")
        .place("together")
        .immediate("go", inputs="d", outputs="alone", inhibitors="closed")
        .immediate("meet", inputs={"d": 2}, outputs={"together": 2})
        .build()
    )
    plan = plan_of(net, {"d": exponential(1.0)}, resource_places=frozenset(["closed"]))
    plan = replace(plan, outcomes={"d": {"go": 0.4, "": 0.6}}).validate()
    reached = Analysis(plan).first_passage
    assert reached("together == 2").probability == pytest.approx(0.6**3 + 3 * 0.6**2 * 0.4)
    space = Analysis(plan).space
    assert len(space.deadlocks) == 2  # by marking: three states, or two, or one, named ``go``


def test_several_done_robots_and_priorities():
    """A robot that is done with an exponential request gives way to an immediate one."""
    net = (
        NetBuilder()
        .place("a", tokens=1)
        .place("b", tokens=1)
        .place("gate", tokens=1)
        .place("tool")
        .place("first")
        .place("second")
        .exponential("open", rate=0.001, inputs="gate", outputs="tool")
        .exponential("slow", rate=10, inputs=["a", "tool"], outputs="first")
        .immediate("quick", inputs=["b", "tool"], outputs="second")
        .build()
    )
    plan = plan_of(
        net, {"b": exponential(0.1)}, resource_places=frozenset(["gate", "tool"]), until="tool > 9"
    )
    # both are done long before the tool is there, but for a chance of about 1e-4
    assert Analysis(plan).first_passage("second == 1").probability == pytest.approx(1, abs=3e-4)


@pytest.mark.parametrize(
    "duration",
    [
        exponential(2.0),
        erlang(4, 2.0),
        Duration.hyper_erlang([(0.3, 1, 5.0), (0.7, 3, 0.5)]),
    ],
    ids=lambda d: d.kind.value,
)
def test_exact_phases_have_the_distribution(duration):
    net = (
        NetBuilder()
        .place("a", tokens=1)
        .place("b")
        .exponential("t", rate=0.5, inputs="a", outputs="b")
        .build()
    )
    times = [0.1, 0.5, 1.0, 3.0, 9.0]
    passage = Analysis(plan_of(net, {"a": duration})).first_passage("b == 1", times)
    assert passage.mean_time == pytest.approx(duration.mean)
    assert passage.within == pytest.approx(duration.cdf(np.array(times)).tolist(), abs=1e-9)


@pytest.mark.parametrize(
    "duration",
    [
        Duration.gamma(4.0, 2.0),
        Duration.gamma(4.3, 2.0),
        Duration.gamma(1.0, 2.0),
        Duration.gamma(0.4, 2.0),
        Duration.lognormal(0.3, 2.0),
        Duration.lognormal(1.5, 2.0),
        Duration.uniform(1.0, 3.0),
        Duration.empirical([1.0, 1.5, 1.7, 4.0]),
    ],
    ids=lambda d: d.describe(),
)
def test_matched_phases_have_the_same_mean_and_variance(duration):
    phases = phases_of(duration)
    count = len(phases.rates)
    assert count == number_of_phases(duration) and phases.matched
    assert sum(v for _, v in phases.start) == pytest.approx(1)
    # moments of the time to absorption
    inner = np.zeros((count, count))
    for i, (rate, following) in enumerate(zip(phases.rates, phases.following)):
        inner[i, i] = -rate
        if following >= 0:
            inner[i, following] = rate
    start = np.zeros(count)
    for phase, v in phases.start:
        start[phase] = v
    inverse = np.linalg.inv(-inner)
    mean = start @ inverse @ np.ones(count)
    square = 2 * start @ inverse @ inverse @ np.ones(count)
    assert mean == pytest.approx(duration.mean)
    assert square - mean**2 == pytest.approx(duration.variance)


def test_what_was_matched_is_said():
    plan = plan_of(pair(), {"a": Duration.gamma(2.5, 1.0), "b": exponential(1.0)})
    told = [text for text in Analysis(plan).timing.assumptions if "replaced" in text]
    assert len(told) == 1 and "a (gamma" in told[0] and "Erlang with 2 or 3 phases" in told[0]


def test_the_same_chain_where_no_split_is_due():
    for name in ("plans/tokens", "plans/measure"):
        plan = read_plan(name).for_robots(3)
        run, net = Analysis(plan), Analysis(plan, timing="net")
        assert run.timing.splits == {} and len(run.space) == len(net.space)
        assert run.space.arcs == net.space.arcs
        for one, other in (
            (run.measures.throughput, net.measures.throughput),
            (run.measures.mean_tokens, net.measures.mean_tokens),
        ):
            assert one == pytest.approx(other, rel=1e-12, abs=1e-14)


def checks(throughput):
    return sum(value for name, value in throughput.items() if "Temperature" in name)


def patrol_with(times):
    """The patrol with the mean durations of its actions and the outcomes that it draws."""
    plan = read_plan("plans/patrol")
    durations = {p: times(p) for p in plan.action_places}
    outcomes = {
        p: {
            plan.net.transitions[t].name: 0.15 if "High" in plan.net.transitions[t].name else 0.85
            for t in plan.net.consumers[plan.net.place_number(p)]
        }
        for p in plan.action_places
        if "Check" in p
    }
    return replace(plan, durations=durations, outcomes=outcomes).validate()


def seconds(place):
    return 1.2 if "Check" in place else 0.1 if "Decide" in place else 0.5


def test_the_patrol():
    plan = read_plan("plans/patrol")
    assert checks(Analysis(plan, timing="net").measures.throughput) == pytest.approx(
        1.194798945367, rel=1e-12
    )
    analysis = Analysis(plan)
    assert sorted(analysis.timing.splits) == sorted(p for p in plan.action_places if "Wait" in p)
    assert checks(analysis.measures.throughput) == pytest.approx(1.28168, rel=1e-5)


def agrees(plan, time, runs=12):
    """The exact measures are those of runs in virtual time, within their spread."""
    far = stats.t.ppf(1 - 1e-7, runs - 1)
    analysis = Analysis(plan)
    exact = {**analysis.measures.throughput, **analysis.measures.mean_tokens}
    found = [VirtualRun(plan, seed=seed).run(time=time, warmup=time / 20) for seed in range(runs)]
    for name, value in exact.items():
        samples = np.array(
            [r.throughput(name) if name in r.firings else r.mean_tokens[name] for r in found]
        )
        error = samples.std(ddof=1) / math.sqrt(runs)
        assert abs(samples.mean() - value) <= far * error + 1e-9, name


@pytest.mark.long
def test_the_patrol_with_fitted_times_as_it_runs():
    plan = patrol_with(lambda place: exponential(seconds(place)))
    assert checks(Analysis(plan).measures.throughput) == pytest.approx(1.675231, rel=1e-6)
    agrees(plan, 100)


@pytest.mark.long
@pytest.mark.parametrize("phases", [1, 2])
def test_meetings_and_resources_as_they_run(phases):
    plan = read_plan("plans/rendezvous")
    timing = PlanTiming(plan)
    durations = {
        plan.net.places[p].name: erlang(phases, one.duration.mean)
        for p, one in timing.places.items()
        if one.duration.mean > 0
    }
    agrees(replace(plan, durations=durations).validate(), 200)


def test_too_many_phases_are_refused_with_their_number():
    plan = patrol_with(lambda place: Duration.gamma(59.0, seconds(place)))
    analysis = Analysis(plan, phases=59)
    with pytest.raises(LimitError) as refused:
        analysis.chain  # noqa: B018
    told = str(refused.value)
    assert "gspn simulate" in told and "--phases" in told and "states, more than" in told
    # what does not depend on the phases is known all the same
    assert analysis.properties.live and analysis.boundedness.bounded


def test_the_number_of_states_is_foreseen():
    plan = patrol_with(lambda place: erlang(2, seconds(place))).for_robots(2)
    found = len(explore_plan(plan, timing=PlanTiming(plan)))
    space = explore_plan(plan, timing=PlanTiming(plan), limit=found - 1)
    foreseen = re.search(r"about (\d+) states", space.refusal)
    assert space.complete and foreseen
    assert found <= int(foreseen.group(1)) <= 1.05 * found


def test_a_space_that_is_too_large_names_the_place_that_makes_it_so():
    plan = patrol_with(lambda place: erlang(5 if place.endswith("L1") else 2, seconds(place)))
    space = explore_plan(plan.for_robots(4), timing=PlanTiming(plan), limit=50)
    with pytest.raises(
        LimitError, match="within 5. states.*raise --limit.*_L1 holds up to 1 robot, "
    ):
        space.require_complete("the answer")
    assert re.search(r"each in one of \d+ phases or other conditions", space.where_most)


def test_the_states_are_told_apart_where_they_are_shown():
    plan = read_plan("plans/rendezvous")
    analysis = Analysis(plan)
    chain = explicit_chain(analysis)
    assert "At_Dock (done, wants Hand_Over)" in chain.places
    assert len({tuple(state) for state in chain.states}) == len(chain.states)
    drawn = chain_graph(analysis.chain).text()
    assert "At_Dock (doing its action)" in drawn and "At_Dock (done, wants Hand_Over)" in drawn
    # where no split is due, only places are shown
    plain = explicit_chain(Analysis(read_plan("plans/tokens")))
    assert list(plain.places) == ["p1", "p2", "p3", "p5", "p6", "p7"]


def test_a_condition_on_a_counter():
    net = (
        NetBuilder()
        .place("work", tokens=1)
        .place("think")
        .place("done")
        .exponential("do", rate=2, inputs="work", outputs=["think", "done"])
        .immediate("again", inputs="think", outputs="work")
        .build()
    )
    plan = plan_of(net, {"think": erlang(2, 1.0)}, resource_places=frozenset(["done"]))
    analysis = Analysis(plan)
    assert analysis.left_out == ("done",)
    assert analysis.first_passage("done >= 3").mean_time == pytest.approx(3 * 0.5 + 2 * 1.0)


def test_an_action_that_never_says_what_to_do():
    """No action in ``a``, and two ways out: the robot is stuck there."""
    net = (
        NetBuilder()
        .place("b", tokens=1)
        .place("a")
        .exponential("come", rate=1, inputs="b", outputs="a")
        .exponential("one", rate=1, inputs="a", outputs="b")
        .exponential("two", rate=1, inputs="a", outputs="b")
        .build()
    )
    plan = plan_of(net)
    plan = replace(plan, actions={**plan.actions, "a": None}).validate()
    analysis = Analysis(plan)
    assert [analysis.space.named(dead) for dead in analysis.properties.deadlocks] == [{"a": 1}]


def test_robots_that_differ_are_reported():
    plan = read_plan("plans/rendezvous")
    slow = plan.robots[0]._replace(actions={"Fetch": None})
    told = Analysis(replace(plan, robots=(slow, *plan.robots[1:])).validate()).timing.assumptions
    assert any("every robot in Fetch" in text for text in told)


def test_a_net_has_no_run():
    with pytest.raises(UsageError):
        Analysis(pair(), timing="run")
    with pytest.raises(UsageError):
        Analysis(plan_of(pair()), timing="walk")
    assert Analysis(pair()).timing.reading == "net"
    assert len(Chain.of(explore_plan(plan_of(pair())))) == 1


relaxed = settings(deadline=None, suppress_health_check=list(HealthCheck))


@relaxed
@given(running_plans())
def test_the_chain_of_a_run_is_one(plan):
    """Probabilities sum to 1, rates are positive, and no robot is lost or made. In the steady state
    as many robots enter each place as leave it, and stay there as long as their actions take, or
    longer."""
    timing = PlanTiming(plan)
    space = explore_plan(plan, timing=timing, limit=3_000)
    assume(space.complete)
    graph = space.rated()
    total = np.bincount(graph.sources, weights=graph.values, minlength=len(graph))
    assert total[graph.vanishing] == pytest.approx(np.ones(int(graph.vanishing.sum())))
    assert (graph.values > 0).all()
    acting = [space.net.place_number(name) for name in plan.action_places]
    assert set(space.markings()[:, acting].sum(axis=1)) == {len(plan.robots)}
    try:
        chain = Chain.of(space)
    except RefusedError:
        return  # a timeless trap
    measures = Measures(chain, steady_state(chain).distribution)
    rates, tokens = measures.throughput, measures.mean_tokens
    for p in timing.places:
        leaving = {t: w for t in plan.net.consumers[p] for q, w in plan.net.inputs[t] if q == p}
        entering = {t: w for t in plan.net.producers[p] for q, w in plan.net.outputs[t] if q == p}
        name = [t.name for t in plan.net.transitions]
        came = sum(w * rates[name[t]] for t, w in entering.items())
        assert sum(w * rates[name[t]] for t, w in leaving.items()) == pytest.approx(came, abs=1e-9)
        assert tokens[plan.net.places[p].name] >= came * timing.of("", p).duration.mean - 1e-9


@relaxed
@given(running_plans(kinds=("work", "instant"), joint=False))
def test_no_more_states_than_the_net_where_no_split_is_due(plan):
    """Robots that stay where they are, in zero time, are left out: others keep their draws then,
    which the net does not know."""
    assume(all(plan.net.effect(t) or one.timed for t, one in enumerate(plan.net.transitions)))
    run = explore_plan(plan, timing=PlanTiming(plan))
    assert run.notes.splits == {}
    net = explore_plan(as_net(plan))
    assert (len(run), run.arcs) == (len(net), net.arcs)
    try:
        chains = [Chain.of(run), Chain.of(net)]
    except RefusedError:
        return  # a timeless trap
    # the states of the two may be found in another order
    rates, markings = zip(*(by_marking(chain, len(run.net.places)) for chain in chains))
    assert markings[0] == markings[1]
    assert abs(rates[0] - rates[1]).max(initial=0.0) < 1e-12


def by_marking(chain, places):
    """The rates between the states of a chain, and their markings, ordered by marking."""
    columns = np.array([chain.column(p) for p in range(places)])
    order = np.lexsort(columns)
    return chain.rates.toarray()[np.ix_(order, order)], columns[:, order].T.tolist()


def as_net(plan):
    """The plan with rates in its net that make the durations."""
    transitions = list(plan.net.transitions)
    for name, duration in plan.durations.items():
        leaving = plan.net.consumers[plan.net.place_number(name)]
        leaving = [t for t in leaving if plan.net.transitions[t].name not in plan.events]
        total = sum(plan.net.transitions[t].rate for t in leaving)
        for t in leaving:
            rate = plan.net.transitions[t].rate / total / duration.mean
            transitions[t] = transitions[t]._replace(rate=rate)
    return replace(
        plan, durations={}, net=Net(plan.net.places, transitions, plan.net.arcs, plan.net.name)
    )


@pytest.mark.long
@settings(relaxed, max_examples=12, derandomize=True)
@given(running_plans())
def test_a_run_in_virtual_time_has_the_measures_of_the_chain(plan):
    space = explore_plan(plan, timing=PlanTiming(plan), limit=500)
    assume(space.complete)
    try:
        chain = Chain.of(space)
    except RefusedError:
        assume(False)
    assume(len(chain.bottom_components()) == 1)
    assume(len(chain.bottom_components()[0]) > 1)
    agrees(plan, 100)


def test_an_action_that_names_nothing_asks_for_the_only_transition_or_stays():
    """Where no policy can be asked; it once fired the last transition of the net."""
    builder = NetBuilder("silent").place("a", tokens=1).place("b").place("c")
    builder.exponential("on", rate=2.0, inputs="a", outputs="b")
    one = builder.exponential("back", rate=1.0, inputs="b", outputs="a").build()
    found = Analysis(plan_of(one, outcomes={"a": {"": 1.0}})).measures
    assert found.throughput["on"] == pytest.approx(2 / 3)
    two = builder.exponential("off", rate=2.0, inputs="a", outputs="c").build()
    found = Analysis(plan_of(two, outcomes={"a": {"": 1.0}})).measures
    assert found.mean_tokens["a"] == pytest.approx(1.0)


# -- failures ------------------------------------------------------------------------------------


def workshop(rule, robots=1, **more):
    """A robot works for 1 s, which fails with 0.3, and rests for 2 s; where its work broke, it
    mends for 5 s."""
    net = (
        NetBuilder("workshop")
        .place("work", tokens=robots)
        .place("rest")
        .place("broken")
        .exponential("go", rate=1, inputs="work", outputs="rest")
        .exponential("break", rate=1, inputs="work", outputs="broken")
        .exponential("back", rate=0.5, inputs="rest", outputs="work")
        .exponential("mend", rate=0.2, inputs="broken", outputs="work")
        .build()
    )
    settings = {"failures": {"work": 0.3}, "durations": {"work": Duration.exponential(1.0)}, **more}
    return Plan(
        net=net,
        actions=dict.fromkeys(["work", "rest", "broken"], FunctionAction("a.b", "b")),
        outcomes={"work": {"go": 1.0}},
        on_failure={"work": rule},
        **settings,
    )


def test_a_failure_fires_what_its_rule_says():
    analysis = Analysis(workshop(FailureRule.fire("break")))
    cycle = 1 + 0.7 * 2 + 0.3 * 5
    assert analysis.measures.throughput["go"] == pytest.approx(0.7 / cycle)
    assert analysis.measures.throughput["break"] == pytest.approx(0.3 / cycle)
    assert analysis.timing.splits == {"work": "an attempt at its action can fail"}


def test_retries_are_counted():
    """Two retries at most: the work ends well within three attempts with 1 - 0.3^3."""
    passage = Analysis(workshop(FailureRule.retry(2))).first_passage("rest >= 1")
    assert passage.probability == pytest.approx(1 - 0.3**3)


def test_each_retry_has_its_delay_and_the_last_failure_fires():
    rule = FailureRule("growing", 2, (0.5, 4.0), FailureEnd.FIRE, "break")
    measures = Analysis(workshop(rule)).measures
    first, second, third = 0.3, 0.3**2, 0.3**3
    work = 1 + first * (0.5 + 1) + second * (4.0 + 1)
    cycle = work + (1 - third) * 2 + third * 5
    assert measures.throughput["break"] == pytest.approx(third / cycle)
    assert measures.mean_tokens["work"] == pytest.approx(work / cycle)


def test_delays_beyond_those_that_are_told_apart_are_said():
    rule = FailureRule("growing", 30, tuple(float(k) for k in range(1, 31)))
    said = Analysis(workshop(rule, failures={"work": 0.9})).timing.assumptions
    assert "robots in work try again after 20 s from failure 20 on" in said


def test_many_retries_are_retries_without_end():
    analysis = Analysis(workshop(FailureRule.retry(1000, delay=0.5)))
    cycle = 1 / 0.7 + 0.3 / 0.7 * 0.5 + 2
    assert analysis.measures.throughput["go"] == pytest.approx(1 / cycle)
    ten = Analysis(workshop(FailureRule.retry(21), failures={"work": 0.9}))
    assert any("try again for ever" in said for said in ten.timing.assumptions)


def test_a_robot_whose_action_failed_for_good_stays():
    analysis = Analysis(workshop(FailureRule(), robots=2))
    assert analysis.first_passage("rest >= 1").probability == pytest.approx(1 - 0.3**2)
    assert [analysis.space.named(d) for d in analysis.properties.deadlocks] == [{"work": 2}]


def test_a_failure_stops_the_team():
    analysis = Analysis(workshop(FailureRule.stop(), robots=2))
    # the first of both to end decides, while nobody else has come back
    assert analysis.first_passage("rest >= 1").probability == pytest.approx(0.7)
    ends = {tuple(analysis.space.named(d).items()) for d in analysis.properties.deadlocks}
    assert ends == {(("work", 2),), (("work", 1), ("rest", 1))}


@pytest.mark.parametrize("duration", [Duration.erlang(3, 1.0), Duration.uniform(0.2, 1.8)])
def test_a_timeout_cuts_an_attempt_off(duration):
    rule = FailureRule.fire("break")
    plan = workshop(rule, failures={}, timeouts={"work": 1.2}, durations={"work": duration})
    analysis = Analysis(plan)
    late = duration.survival(1.2)
    mean, _ = integrate.quad(duration.survival, 0, 1.2, points=[0.2])
    cycle = mean + (1 - late) * 2 + late * 5
    assert analysis.measures.throughput["break"] == pytest.approx(late / cycle, rel=1e-6)
    assert any("is cut off" in said for said in analysis.timing.assumptions)


def test_an_action_that_takes_no_time_fails_too():
    rule = FailureRule.fire("break")
    analysis = Analysis(workshop(rule, durations={"work": Duration.deterministic(0.0)}))
    assert analysis.measures.throughput["break"] == pytest.approx(0.3 / (0.7 * 2 + 0.3 * 5))


def test_an_action_that_names_nothing_has_failed():
    """Two exponential transitions leave the place, and the action names none of them."""
    plan = workshop(FailureRule.fire("break"), failures={})
    plan = replace(plan, outcomes={"work": {"": 1.0}})
    measures = Analysis(plan).measures
    assert measures.throughput["go"] == 0
    assert measures.throughput["break"] == pytest.approx(1 / 6)

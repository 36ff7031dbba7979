"""Events that interrupt, in the analysis and the simulation of a plan: every reading and the run in
virtual time agree on them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from generated_plans import plain_event, small_plans, with_events
from hypothesis import HealthCheck, assume, given, reject, settings
from running_plans import running_plans
from scipy import stats
from test_run_analysis import as_net, by_marking, plan_of
from test_simulation_as_run import TooLongError, assert_alike, kernel_rows, reference

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.chain import Chain
from gspn_framework_package.analysis.decisions.problem import DecisionProblem
from gspn_framework_package.analysis.plan.reading import RUN
from gspn_framework_package.analysis.plan.space import explore_plan
from gspn_framework_package.analysis.simulation import machine, simulate
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.plan_timing import PlanTiming

EVENT = EventSource("sensor", "std_msgs/Empty")


def guards(robots=2, durations=None, event=EVENT, rate=0.3):
    """Robots that work; an event sends one of them to a charger with one dock, and it comes
    back."""
    net = (
        NetBuilder("guards")
        .place("Work", robots)
        .place("Charge")
        .place("Dock", 1)
        .exponential("finish", rate=1, inputs="Work", outputs="Work")
        .exponential("low", rate=rate, inputs=["Work", "Dock"], outputs="Charge")
        .exponential("full", rate=1, inputs="Charge", outputs=["Work", "Dock"])
        .build()
    )
    return plan_of(net, durations, resource_places=frozenset(["Dock"]), events={"low": event})


@pytest.mark.parametrize("timing", ["run", "net"])
@pytest.mark.parametrize("robots", [1, 2, 3])
def test_an_event_comes_to_each_robot_at_its_rate(timing, robots):
    measures = Analysis(guards(robots), timing=timing).measures
    # the dock is empty for 1 / (0.3 robots) seconds, then taken for one second
    assert measures.throughput["low"] == pytest.approx(1 / (1 / (0.3 * robots) + 1))
    assert measures.throughput["finish"] == pytest.approx(measures.mean_tokens["Work"])


def test_an_event_is_no_outcome_of_the_action():
    timing = PlanTiming(guards(durations={"Work": Duration.erlang(3, 2.0)}))
    net = guards().net
    work, finish = net.place_index["Work"], net.transition_index["finish"]
    assert timing.places[work].outcomes == ((finish, 1.0),)
    assert PlanTiming(guards()).places[work].duration == Duration.exponential(1.0)
    assert timing.events[work] == (net.transition_index["low"],)
    assert guards().of_action(work) == (finish,)
    assert any("the events low occur at the rates" in text for text in timing.assumptions)


def test_what_a_visit_or_a_task_carries_on_is_said_to_change_nothing():
    """In the analysis, in the optimiser and in the simulation."""
    plan = guards(1, event=EVENT._replace(resume=True))
    plan = replace(plan, tasks=Tasks(queues=("Dock",)))
    resumed = (
        "a visit that continues one that low interrupted takes as long, and ends, as any other"
    )
    alike = "tasks from Dock are interchangeable: how long an action takes or what it names cannot"
    for notes in (
        Analysis(plan).timing.assumptions,
        DecisionProblem(plan, reading=RUN).assumptions,
        simulate(plan, time=1.0, replications=2).notes,
    ):
        assert resumed in notes
        assert any(note.startswith(alike) for note in notes)
    assert not any("continues one" in note for note in Analysis(guards()).timing.assumptions)


def waiting_for_a_partner(event=EVENT):
    """A robot is done soon, and then waits for one that never comes."""
    net = (
        NetBuilder("partners")
        .place("a", 1)
        .place("b")
        .place("off")
        .exponential("meet", rate=1, inputs=["a", "b"], outputs=["off", "off"])
        .exponential("call", rate=0.5, inputs="a", outputs="off")
        .build()
    )
    return plan_of(net, {"a": Duration.erlang(2, 1.0)}, events={"call": event})


def test_an_event_interrupts_who_is_done_as_well():
    passage = Analysis(waiting_for_a_partner()).first_passage("off == 1")
    assert (passage.probability, passage.mean_time) == (pytest.approx(1), pytest.approx(2))
    clocks = kernel_rows(waiting_for_a_partner(), time=1e9, runs=2_000)[:, 0]
    assert stats.kstest(clocks, "expon", (0, 2)).pvalue > 1e-4


def test_time_interrupts_after_that_time_in_the_simulation():
    plan = waiting_for_a_partner(EventSource(after=3.5))
    assert set(kernel_rows(plan, time=100.0, runs=20)[:, 0]) == {3.5}
    notes = Analysis(plan).timing.assumptions
    assert any("call come at the rates of the net, not after a fixed time" in n for n in notes)
    assert Analysis(plan).first_passage("off == 1").mean_time == pytest.approx(2)


@pytest.mark.long
def test_an_event_that_is_held_fires_when_it_can():
    rows = kernel_rows(guards(event=EVENT._replace(hold=True), rate=0.2), time=500.0, runs=40)
    lost = kernel_rows(guards(rate=0.2), time=500.0, runs=40)
    low = 1 + guards().net.transition_index["low"]
    assert rows[:, low].mean() > lost[:, low].mean() * 1.05
    notes = Analysis(guards(event=EVENT._replace(hold=True))).timing.assumptions
    assert any("the simulation holds them" in n for n in notes)
    free = waiting_for_a_partner(EVENT._replace(hold=True))
    assert not any("holds" in n for n in Analysis(free).timing.assumptions)


@pytest.mark.long
@pytest.mark.parametrize("acts", [True, False])
@pytest.mark.parametrize("durations", [{}, {"idle": Duration.erlang(2, 3.0)}])
def test_a_place_that_only_events_leave(acts, durations):
    net = (
        NetBuilder("idle")
        .place("idle", 1)
        .place("work")
        .exponential("call", rate=0.5, inputs="idle", outputs="work")
        .exponential("door", rate=0.25, inputs="idle", outputs="idle")
        .exponential("done", rate=2, inputs="work", outputs="idle")
        .build()
    )
    plan = plan_of(net, durations, events={"call": EVENT, "door": EVENT})
    if not acts:
        plan = replace(plan, actions={**plan.actions, "idle": None}).validate()
    for timing in ("run", "net"):
        analysis = Analysis(plan, timing=timing)
        assert len(analysis.space) == 2
        assert analysis.timing.splits == {}
        assert analysis.measures.mean_tokens["idle"] == pytest.approx(0.8)
        assert analysis.measures.throughput["door"] == pytest.approx(0.2)
    rows = kernel_rows(plan, time=200.0, runs=100)
    tokens = rows[:, 1 + len(net.transitions)] / 200
    assert abs(tokens.mean() - 0.8) < 6 * tokens.std(ddof=1) / 10


@pytest.mark.long
def test_an_outcome_may_name_the_transition_of_an_event():
    """Then the robot asks for it, besides."""
    net = guards().net
    plan = guards()
    plan = replace(plan, outcomes={"Work": {"finish": 0.5, "low": 0.5}}).validate()
    assert "Work" in Analysis(plan).timing.splits
    exact = Analysis(plan).measures
    rows = kernel_rows(plan, time=300.0, runs=100)
    for name in ("finish", "low"):
        found = rows[:, 1 + net.transition_index[name]] / 300
        spread = found.std(ddof=1) / 10
        assert abs(found.mean() - exact.throughput[name]) < 6 * spread


@pytest.mark.long
def test_tasks_come_in_without_a_simulated_environment():
    net = (
        NetBuilder("orders")
        .place("Idle", 1)
        .place("Deliver")
        .place("orders")
        .exponential("order", rate=0.5, outputs="orders")
        .immediate("take", inputs=["Idle", "orders"], outputs="Deliver")
        .exponential("deliver", rate=1, inputs="Deliver", outputs="Idle")
        .build()
    )
    plan = plan_of(
        net, resource_places=frozenset(["orders"]), tasks=Tasks(("orders",), ("deliver",))
    )
    found = simulate(plan, time=400.0, replications=30, seed=5).throughput["deliver"]
    assert abs(found.mean - 0.5) < 4 * found.half_width
    space = explore_plan(plan, timing=PlanTiming(plan), limit=50)
    assert not any("environment: simulate" in note for note in space.notes.assumptions)


relaxed = settings(
    deadline=None,
    derandomize=True,
    suppress_health_check=[
        HealthCheck.too_slow,
        HealthCheck.filter_too_much,
        HealthCheck.data_too_large,
    ],
)


@pytest.mark.long
@settings(relaxed, max_examples=8)
@given(with_events(running_plans(), plain_event()))
def test_the_simulation_has_the_measures_of_the_chain(plan):
    space = explore_plan(plan, timing=PlanTiming(plan), limit=500)
    assume(space.complete)
    try:
        chain = Chain.of(space)
    except RefusedError:
        assume(False)
    assume(len(chain.bottom_components()) == 1)
    assume(len(chain.bottom_components()[0]) > 1)
    measures = Analysis(plan).measures
    exact = {**measures.throughput, **measures.mean_tokens}
    runs, time = 60, 100.0
    samples = simulate(
        plan, time=time, warmup=10.0, replications=runs, seed=12, samples=True
    ).samples
    net = plan.net
    names = [t.name for t in net.transitions] + [p.name for p in net.places]
    rows = np.column_stack([samples.firings, samples.tokens]) / (time - 10.0)
    far = stats.t.ppf(1 - 1e-7, runs - 1)
    for name, column in zip(names, rows.T):
        if name in exact:
            error = column.std(ddof=1) / math.sqrt(runs)
            assert abs(column.mean() - exact[name]) <= far * error + 1e-9, name


@pytest.mark.long
@settings(relaxed, max_examples=40)
@given(with_events(running_plans(kinds=("work", "instant"), joint=False), plain_event()))
def test_both_readings_are_one_chain_where_no_split_is_due(plan):
    assume(all(plan.net.effect(t) or one.timed for t, one in enumerate(plan.net.transitions)))
    run = explore_plan(plan, timing=PlanTiming(plan), limit=300)
    assert run.notes.splits == {}
    assume(run.complete)
    net = explore_plan(as_net(plan))
    assert (len(run), run.arcs) == (len(net), net.arcs)
    try:
        chains = [Chain.of(run), Chain.of(net)]
    except RefusedError:
        return  # a timeless trap
    rates, markings = zip(*(by_marking(chain, len(run.net.places)) for chain in chains))
    assert markings[0] == markings[1]
    assert abs(rates[0] - rates[1]).max(initial=0.0) < 1e-12


@pytest.mark.long
@settings(relaxed, max_examples=12)
@given(with_events(small_plans()))
def test_the_simulation_agrees_with_the_run_in_virtual_time(plan):
    runs, time = 100, 12.0
    try:
        rows = kernel_rows(plan, time=time, runs=runs, losses=0.03)
        expected = reference(plan, time=time, runs=runs, losses=0.03, most_slots=5_000)
    except (RefusedError, TooLongError):
        reject()
    assert_alike(plan, expected, rows)


@pytest.mark.long
@pytest.mark.skipif(not machine.numba_is_there(), reason="numba is missing")
@settings(relaxed, max_examples=10)
@given(with_events(small_plans()))
def test_both_forms_give_the_same_numbers(plan):
    results = []
    for compiled in (False, True):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(machine, "is_loaded", lambda compiled=compiled: compiled)
            try:
                results.append(simulate(plan, time=9.0, replications=5, seed=4, losses=0.02))
            except RefusedError as error:
                results.append(str(error))
    assert str(results[0]) == str(results[1])

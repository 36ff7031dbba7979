"""Simulation: agrees with the exact results inside its confidence intervals, at the stated rate; is
reproducible."""

import importlib.util
import math
import random
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from generated_nets import bounded_nets
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from scipy import stats

from benchmarks.nets import flexible_manufacturing, kanban, philosophers
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.simulation import kernel, machine, simulate, state_cache
from gspn_framework_package.analysis.simulation.kernel_run import KernelRun
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import (
    CancelledError,
    ExpressionError,
    NetError,
    RefusedError,
    UsageError,
)

PLANS = Path(__file__).parents[3] / "plans"


def test_intervals_hold_the_truth_at_the_stated_rate():
    """Of 200 intervals of 90 % about 180 hold the mean time to starvation, 550/101 s; the bounds
    are those outside of which a right program would be once in a million."""
    held = 0
    for seed in range(200):
        estimate = simulate(
            philosophers(4),
            until="think1+think2+think3+think4+eat1+eat2+eat3+eat4 == 0",
            replications=40,
            seed=seed,
            confidence=0.9,
        ).time_to_condition
        held += abs(estimate.mean - 550 / 101) <= estimate.half_width
    low, high = stats.binom.ppf([5e-7, 1 - 5e-7], 200, 0.9)
    assert low <= held <= high


def plan(name):
    return read_plan(PLANS / name)


SUBJECTS = [
    kanban(1),
    flexible_manufacturing(1),
    plan("rendezvous"),
    plan("measure"),
    plan("patrol"),
]


def deciding_patrol():
    """The patrol with decisions that take time. Where an action takes none, the chain lets its robot
    ask at once; in a run, others that wait go first."""
    decides = {p: Duration.exponential(0.3) for p in plan("patrol").actions if "Decide" in p}
    return replace(plan("patrol"), durations=decides).validate()


COMPILED = importlib.util.find_spec("numba") is not None

READINGS = [(s, "net") for s in SUBJECTS]
READINGS += [(s, "run") for s in (*SUBJECTS[2:4], deciding_patrol())]


@pytest.mark.long
@pytest.mark.parametrize(("subject", "timing"), READINGS, ids=lambda s: getattr(s, "name", s))
def test_long_runs_agree_with_the_steady_state(subject, timing):
    analysis = Analysis(subject, timing=timing)
    measures = analysis.measures
    settled = analysis.time_to_steady_state(1e-4)
    result = simulate(
        subject,
        time=6 * settled,
        warmup=settled,
        replications=1500 if COMPILED else 300,  # without numba, a run takes far longer
        seed=1,
        confidence=0.99999,
        timing=timing,
    )
    for name, exact in measures.mean_tokens.items():
        estimate = result.mean_tokens[name]
        assert abs(estimate.mean - exact) <= estimate.half_width + 1e-9, name
    for name, exact in measures.throughput.items():
        estimate = result.throughput[name]
        assert abs(estimate.mean - exact) <= estimate.half_width + 1e-9, name
    for name, exact in measures.token_distribution.items():
        for count, probability in exact.items():
            assert result.token_distribution[name].get(count, 0.0) == pytest.approx(
                probability, abs=0.05
            )


def test_a_count_beyond_the_longest_row_does_not_stop_the_loop_at_each_firing(monkeypatch):
    grown = []
    grow = KernelRun._grow
    monkeypatch.setattr(KernelRun, "_grow", lambda run: (grown.append(run), grow(run)))
    net = NetBuilder().place("heap").exponential("comes", rate=1.0, outputs="heap").build()
    found = simulate(net, time=2.0 * kernel.LONGEST_ROW, replications=2, seed=1)
    assert found.mean_tokens["heap"].mean > 0.9 * kernel.LONGEST_ROW
    assert len(grown) < 30


@pytest.mark.long
def test_first_passage_of_a_counter():
    subject = plan("measure")
    exact = Analysis(subject).first_passage("P3 >= 4", [2.0])
    options = {"replications": 4000, "seed": 3, "confidence": 0.99999}
    result = simulate(subject, until="P3 >= 4", **options)
    assert result.reached.mean == 1.0
    assert (
        abs(result.time_to_condition.mean - exact.mean_time) <= result.time_to_condition.half_width
    )
    short = simulate(subject, until="P3 >= 4", time=2.0, **options)
    assert abs(short.reached.mean - exact.within[0]) <= short.reached.half_width


def test_a_run_until_nothing_is_enabled():
    net = (
        NetBuilder()
        .place("a", tokens=2)
        .place("b")
        .place("c")
        .exponential("x", inputs="a", outputs="b")
        .exponential("y", inputs="b", outputs="c")
        .build()
    )
    result = simulate(net, until="deadlock", replications=2000, seed=3)
    assert result.reached.mean == 1.0
    expected = Analysis(net).first_passage("deadlock").mean_time
    assert abs(result.time_to_condition.mean - expected) < 2 * result.time_to_condition.half_width


def test_the_same_seed_gives_the_same_result():
    results = [simulate(kanban(1), time=50, replications=20, seed=seed) for seed in (5, 5, 6)]
    assert results[0] == results[1] != results[2]


def test_forgetting_markings_changes_nothing(monkeypatch):
    options = {"time": 50, "replications": 20, "seed": 5, "timing": "net"}
    whole = simulate(plan("rendezvous"), **options)
    monkeypatch.setattr(state_cache, "REMEMBERED_STATES", 40)
    forgetful = simulate(plan("rendezvous"), **options)
    assert forgetful.mean_tokens == whole.mean_tokens and forgetful.throughput == whole.throughput
    for place, shares in whole.token_distribution.items():
        assert forgetful.token_distribution[place] == pytest.approx(shares)


@pytest.mark.long
def test_an_unbounded_net():
    net = NetBuilder().place("jobs").exponential("arrive", rate=2.0, outputs="jobs").build()
    result = simulate(net, time=10.0, replications=2000, confidence=0.99999)
    assert abs(result.throughput["arrive"].mean - 2.0) <= result.throughput["arrive"].half_width
    assert abs(result.mean_tokens["jobs"].mean - 10.0) <= result.mean_tokens["jobs"].half_width


def test_a_dead_marking_is_kept_until_the_end():
    net = (
        NetBuilder()
        .place("a", tokens=1)
        .place("b")
        .exponential("t", rate=1e6, inputs="a", outputs="b")
        .build()
    )
    result = simulate(net, time=10.0, replications=10)
    assert result.mean_tokens["b"].mean == pytest.approx(1.0, abs=1e-4)
    assert result.end_time == (10.0, 0.0)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({}, UsageError, "how long is a run"),
        ({"time": 0}, UsageError, "a run of 0 s"),
        ({"time": 10, "warmup": 10}, UsageError, "warm-up"),
        ({"time": 10, "replications": 0}, UsageError, "replications"),
        ({"time": 10, "confidence": 1}, UsageError, "confidence"),
        ({"until": "nowhere > 1"}, ExpressionError, "no place 'nowhere'"),
        ({"until": "left1 > 1"}, RefusedError, "stays in .* forever"),
    ],
)
def test_what_makes_no_sense(options, error, message):
    with pytest.raises(error, match=message):
        simulate(philosophers(3), **options)


def test_a_timeless_trap_is_noticed():
    net = (
        NetBuilder()
        .place("a", tokens=1)
        .place("b")
        .immediate("ab", inputs="a", outputs="b")
        .immediate("ba", inputs="b", outputs="a")
        .build()
    )
    with pytest.raises(RefusedError, match="without time"):
        simulate(net, time=1.0, replications=2)


def test_cancel_and_json():
    with pytest.raises(CancelledError):
        simulate(kanban(2), time=1e6, replications=10, cancel=lambda: True)
    one = simulate(kanban(1), time=1.0, replications=1).to_json()
    assert one["mean_tokens"]["free1"]["half_width"] is None
    assert math.isfinite(one["mean_tokens"]["free1"]["mean"])


def test_a_choice_without_weights_is_refused():
    net = NetBuilder().place("a", tokens=1).place("b").place("c")
    net.immediate("x", weight=0.0, inputs="a", outputs="b")
    net.immediate("y", weight=1.0, inputs="a", outputs="c")
    with pytest.raises(RefusedError, match="no weights decide between x, y"):
        simulate(net.build(), time=1.0, replications=2)


# -- generated nets ----------------------------------------------------------------------------------


def gillespie(net, time, until, source):
    """Seconds, firings and token-seconds of a run, by the firing rule of the model alone."""
    marking, now, timeless = net.initial_marking, 0.0, 0
    firings, tokens = [0] * len(net.transitions), [0.0] * len(net.places)
    while not until.holds(marking, {"deadlock": not net.enabled(marking)}):
        enabled = net.enabled(marking)
        timed = [t for t in enabled if net.transitions[t].timed]
        weights = [
            net.effective_rate(marking, t) if timed else net.value(marking, t) for t in enabled
        ]
        timeless = 0 if timed else timeless + 1
        if timeless > 1000:
            raise RefusedError("timeless")
        if timed or not enabled:
            stay = source.expovariate(sum(weights)) if timed else time
            tokens = [a + n * min(stay, time - now) for a, n in zip(tokens, marking)]
            now += stay
            if now >= time:
                now = time
                break
        t = source.choices(enabled, weights)[0]
        firings[t] += 1
        marking = net.fire(marking, t)
    return [now, *firings, *tokens]


@pytest.mark.long
@settings(max_examples=20, deadline=None, derandomize=True)
@given(bounded_nets(), st.sampled_from(["deadlock", "p0 >= 3", "p0 == 9"]))
def test_generated_nets(net, until):
    assert_played_by_the_firing_rule(net, until)


@pytest.mark.long
@settings(max_examples=20, deadline=None, derandomize=True)
@given(bounded_nets(dependent=True), st.sampled_from(["deadlock", "p0 >= 3", "p0 == 9"]))
def test_generated_nets_whose_rates_depend_on_the_marking(net, until):
    assert_played_by_the_firing_rule(net, until)


def test_a_rate_that_is_not_above_0_ends_the_simulation():
    net = (
        NetBuilder()
        .place("a", 3)
        .place("b")
        .exponential("t", "2 - #b", inputs="a", outputs="b")
        .build()
    )
    with pytest.raises(NetError, match=r"'t': its rate '2 - #b' is 0 in \(a: 1, b: 2\)"):
        simulate(net, time=1e9, replications=2)


def assert_played_by_the_firing_rule(net, until):
    """Compare runs in both forms of the kernel with those that the firing rule alone makes."""
    names = [p.name for p in net.places]
    condition = parse_condition(until, names, ["deadlock"])
    forms = []
    for compiled in (False, machine.numba_is_there()):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(machine, "is_loaded", lambda compiled=compiled: compiled)
            try:
                forms.append(
                    simulate(net, time=4.0, until=until, replications=150, seed=3, samples=True)
                )
            except RefusedError:
                reject()
    assert str(forms[0].to_json()) == str(forms[1].to_json())
    found = forms[0].samples
    rows = np.column_stack([found.clock, found.firings, found.tokens])
    source = random.Random(8)
    try:
        other = np.array([gillespie(net, 4.0, condition, source) for _ in range(150)])
    except RefusedError:
        reject()
    spread = np.sqrt((rows.var(axis=0, ddof=1) + other.var(axis=0, ddof=1)) / 150)
    distance = np.abs(rows.mean(axis=0) - other.mean(axis=0))
    # 7.5 standard errors: one in ten million times for a thousand comparisons
    assert (distance <= 7.5 * spread + 1e-6).all()


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        "check patrol --json",
        "analyse rendezvous --json",
        "simulate patrol --time 60 --replications 3 --json",
    ],
)
def test_without_numba_the_answers_are_the_same(words, capsys, monkeypatch):
    monkeypatch.chdir(PLANS)
    monkeypatch.setattr(machine, "WORTH_COMPILING", 0)
    told = []
    for _ in range(2):
        assert main(words.split()) == 0
        told.append(re.sub(r'"[a-z_]*(seconds|_s)": [0-9.e-]+', "", capsys.readouterr().out))
        monkeypatch.setitem(sys.modules, "numba", None)
        assert not machine.numba_is_there()
    assert told[0] == told[1]


def test_a_long_simulation_without_numba_says_that_it_is_slow(monkeypatch):
    plan = read_plan(PLANS / "patrol")
    monkeypatch.setattr(machine, "MANY_FIRINGS", 10)
    monkeypatch.setattr(machine, "numba_is_there", lambda: False)
    assert machine.SLOW in simulate(plan, time=60.0, replications=3).notes
    monkeypatch.setattr(machine, "numba_is_there", lambda: True)
    assert machine.SLOW not in simulate(plan, time=60.0, replications=3).notes

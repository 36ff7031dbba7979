"""The simulation of a plan is its run: the kernel agrees with the token game in virtual time, and
its two forms with each other."""

import math
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from generated_plans import DURATIONS, small_plans
from hypothesis import HealthCheck, given, reject, settings
from hypothesis import strategies as st
from scipy import stats

from benchmarks.policy import decision_net, random_policy
from gspn_framework_package.analysis.simulation import kernel, machine, simulate
from gspn_framework_package.analysis.simulation.net_arrays import compile_condition
from gspn_framework_package.analysis.simulation.plan_run import PlanRun
from gspn_framework_package.analysis.simulation.plan_tables import _KINDS, PlanTables
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.duration import Duration, DurationPart, Family, Kind
from gspn_framework_package.model.errors import CancelledError, RefusedError, UsageError
from gspn_framework_package.model.families import compose
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.plan_timing import PlanTiming
from gspn_framework_package.model.policy import Policy, PolicyRow
from gspn_framework_package.model.policy_cell import CountTest

PLANS = Path(__file__).parents[3] / "plans"

LIMIT = 7.5
"""Largest difference of two means, in standard errors. With 100 runs on either side, one of a
thousand comparisons is beyond it by chance once in ten million times."""


class TooLongError(Exception):
    pass


def reference(plan, *, time, runs, losses=0.0, most_slots=20_000):
    """Rows of seconds, firings and token-seconds, by the token game itself."""

    def check(slots):
        if slots > most_slots:
            raise TooLongError

    rows = []
    for seed in range(runs):
        result = VirtualRun(plan, seed=seed, loss_rate=losses).run(time=time, while_running=check)
        rows.append(
            [result.time]
            + [result.firings[t.name] for t in plan.net.transitions]
            + [
                result.mean_tokens[p.name] * result.seconds if result.seconds else 0.0
                for p in plan.net.places
            ]
        )
    return np.array(rows, dtype=float)


def kernel_rows(plan, *, time, runs, losses=0.0):
    samples = simulate(
        plan, time=time, replications=runs, seed=12, losses=losses, samples=True
    ).samples
    return np.column_stack([samples.clock, samples.firings, samples.tokens])


def assert_alike(plan, one, other):
    names = ["end", *(t.name for t in plan.net.transitions), *(p.name for p in plan.net.places)]
    spread = np.sqrt(one.var(axis=0, ddof=1) / len(one) + other.var(axis=0, ddof=1) / len(other))
    distance = np.abs(one.mean(axis=0) - other.mean(axis=0))
    wrong = distance > LIMIT * spread + 1e-6 * (1.0 + np.abs(one.mean(axis=0)))
    assert not wrong.any(), [
        (names[i], one[:, i].mean(), other[:, i].mean(), spread[i]) for i in np.flatnonzero(wrong)
    ]


@pytest.mark.long
@settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    suppress_health_check=[
        HealthCheck.too_slow,
        HealthCheck.filter_too_much,
        HealthCheck.data_too_large,
    ],
)
@given(small_plans())
def test_generated_plans(plan):
    runs, time = 100, 12.0
    for losses in (0.0, 0.05):
        try:
            rows = kernel_rows(plan, time=time, runs=runs, losses=losses)
        except RefusedError:
            reject()
        try:
            assert_alike(plan, reference(plan, time=time, runs=runs, losses=losses), rows)
        except TooLongError:
            reject()


@pytest.mark.long
@pytest.mark.parametrize("name", ["patrol", "measure", "rendezvous", "tokens", "fork_join"])
def test_shipped_plans(name):
    plan = read_plan(PLANS / name)
    slow = plan.action_places[0]
    plan = replace(plan, durations={slow: Duration.gamma(30.0, 1.0), **plan.durations}).validate()
    assert_alike(plan, reference(plan, time=20.0, runs=100), kernel_rows(plan, time=20.0, runs=300))


@pytest.mark.long
def test_a_draw_is_kept_until_the_marking_changes():
    """The robot in `wait` draws mostly a meeting for which nobody comes; each step of the other one
    gives it another draw."""
    net = (
        NetBuilder()
        .place("wait", 1)
        .place("partner")
        .place("free")
        .place("here", 1)
        .place("there")
        .immediate("meet", inputs=["wait", "partner"], outputs=["free", "partner"])
        .immediate("alone", inputs="wait", outputs="free")
        .exponential("rest", rate=5.0, inputs="free", outputs="wait")
        .exponential("go", rate=2.0, inputs="here", outputs="there")
        .exponential("back", rate=2.0, inputs="there", outputs="here")
        .build()
    )
    row = PolicyRow((None,), (("meet", 0.9), ("alone", 0.1)))
    plan = Plan(
        net,
        policy=Policy(["wait"], [row]),
        actions=dict.fromkeys(net.place_index, FunctionAction("actions.work", "work")),
        robots=(RobotSpec("waits", "wait"), RobotSpec("walks", "here")),
    ).validate()
    rows = kernel_rows(plan, time=60.0, runs=100)
    assert_alike(plan, reference(plan, time=60.0, runs=100), rows)
    alone = rows[:, 1 + net.transition_index["alone"]].mean()
    assert 8 < alone < 16  # 0.1 of 120 steps of the other; never more than one a step


@pytest.mark.skipif(not machine.numba_is_there(), reason="numba is missing")
@settings(max_examples=20, deadline=None, derandomize=True)
@given(small_plans())
def test_both_forms_give_the_same_numbers(plan):
    results = []
    for compiled in (False, True):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(machine, "is_loaded", lambda compiled=compiled: compiled)
            try:
                results.append(simulate(plan, time=9.0, replications=15, seed=4, losses=0.02))
            except RefusedError as error:
                results.append(str(error))
    assert str(results[0]) == str(results[1])


@pytest.mark.skipif(not machine.numba_is_there(), reason="numba is missing")
def test_a_run_may_change_its_form_at_any_time():
    plan = read_plan(PLANS / "patrol").for_robots(9)
    results = []
    for switch in (math.inf, 3):
        tables = PlanTables(plan, PlanTiming(plan))
        run = PlanRun(tables)
        run.begin([1, 2, 3, 4])
        for k in range(7):
            if k == switch:
                run.compile()
            assert run.go(1e9, 50) == kernel.MORE
        results.append([list(part) for part in machine.all_in(run.state)])
    assert results[0] == results[1]


@pytest.mark.skipif(not machine.numba_is_there(), reason="numba is missing")
def test_the_kernel_is_compiled_once_for_all_plans(monkeypatch):
    monkeypatch.setattr(machine, "is_loaded", lambda: True)
    for name, time in (("patrol", 5), ("measure", 200.0), ("fork_join", 3.0)):
        simulate(read_plan(PLANS / name), time=time, replications=2, losses=0.01)
    assert len(machine.compiled_kernel()["play"].signatures) == 1


LATE = compose(
    Family(
        "late",
        {"chance": {}, "delay": {}},
        ("delay",),
        lambda chance, delay: [
            DurationPart(1 - chance, 0.0, Duration.erlang(3, 2.0)),
            DurationPart(chance, delay, Duration.gamma(1.5, 1.0)),
        ],
    ),
    {"chance": 0.3, "delay": 1.5},
)


@pytest.mark.parametrize("length", [*DURATIONS, LATE], ids=lambda d: d.kind.value)
def test_durations_are_those_of_the_plan(length):
    """Kolmogorov's test of 2,000 visits, with an error of one in ten million."""
    state = [11, 22, 33, 44]
    chances, shifts, parts = zip(*length.parts)
    table_from, table = machine.ragged([part.parameters for part in parts], np.float64)
    durations = kernel.Durations(
        timing_of=[0],
        part_from=[0, len(parts)],
        part_chance=chances,
        part_shift=shifts,
        part_kind=[_KINDS[part.kind] for part in parts],
        part_mean=[part.mean for part in parts],
        table_from=table_from,
        table=table,
        timeout=[math.inf],
    )
    drawn = [kernel.draw_length(0, durations, state) for _ in range(2000)]
    if length.kind is Kind.DETERMINISTIC:
        assert set(drawn) == {length.mean}
    else:
        assert stats.kstest(drawn, length.cdf)[1] > 1e-7


def test_random_numbers_are_those_of_the_published_generator():
    """xoshiro128++ from the state 1, 2, 3, 4, as its authors' C code gives it."""
    state, words = [1, 2, 3, 4], []
    for _ in range(3):
        value = int(kernel.draw_uniform(state) * 2**53)
        words += [value >> 26, value & (2**26 - 1)]

    def next_word(s):
        def turn(x, k):
            return ((x << k) | (x >> (32 - k))) & 0xFFFFFFFF

        result = (turn((s[0] + s[3]) & 0xFFFFFFFF, 7) + s[0]) & 0xFFFFFFFF
        t = (s[1] << 9) & 0xFFFFFFFF
        s[2] ^= s[0]
        s[3] ^= s[1]
        s[1] ^= s[2]
        s[0] ^= s[3]
        s[2] ^= t
        s[3] = turn(s[3], 11)
        return result

    other = [1, 2, 3, 4]
    assert next_word(list(other)) == 641
    expected = [next_word(other) for _ in range(6)]
    assert words == [w >> (5 if i % 2 == 0 else 6) for i, w in enumerate(expected)]


@pytest.mark.long
@settings(max_examples=200, deadline=None)
@given(
    st.sampled_from(
        [
            "a >= 1 and b < 2",
            "not (a == 2) or b > 3",
            "min(a, b, 2) + max(a, 1) >= 3",
            "a / b > 1",
            "mod(a, 3) == 1 and abs(a - b) <= 1",
            "sqrt(a - 2) >= 0 or floor(a / 2) != ceil(b / 2)",
            "round(a * 0.3) ^ 2 >= b",
            "exp(a) > 20 or log(b) < 1",
            "-a + pow(2, b) >= 4",
            "true and a <> 1",
        ]
    ),
    st.integers(0, 6),
    st.integers(0, 6),
)
def test_conditions_hold_as_in_a_run(text, a, b):
    condition = parse_condition(text, ["a", "b"])
    operations, arguments = compile_condition(condition)
    stack = [0.0] * (len(operations) + 1)
    value = kernel.value_of(
        0, len(operations), operations.tolist(), arguments.tolist(), [a, b], 0.0, stack
    )
    assert (value != 0.0) == condition.holds((a, b))


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(st.data())
def test_rows_of_a_large_policy_are_found(data):
    """Whether listed or hashed, the row is that of the policy table."""
    net = decision_net()
    source = random.Random(data.draw(st.integers(0, 10**6)))
    policy = random_policy(net, data.draw(st.sampled_from([3, 12, 13, 60])), source)
    policy = Policy(policy.places, [with_comparisons(row, source) for row in policy.rows])
    plan = Plan(net, policy=policy, robots=(RobotSpec("r", "decide"),)).validate()
    tables = PlanTables(plan, PlanTiming(plan))
    table = policy.bind(net)
    for _ in range(40):
        row = source.choice(policy.rows)
        marking = [c if isinstance(c, int) else source.randrange(3) for c in row.counts]
        if source.random() < 0.3:
            marking[source.randrange(len(marking))] += 1
        b = tables.book
        for place, expected in (
            (0, table.distribution(marking, 0)),
            (len(net.places), table.matches(marking, 0) or None),
        ):
            entry = kernel.find_entry(place, marking, b.rows)
            assert (entry < 0) == (expected is None)
            if place == 0 and entry >= 0:
                assert b.rows.entry_row[entry] == expected.row


def with_comparisons(row, source):
    """The row, or one that tests some of its counts."""
    if source.random() < 0.6:
        return row
    signs = ["<", "<=", ">", ">=", "!="]
    return row._replace(
        counts=tuple(
            CountTest(source.choice(signs), count) if count and source.random() < 0.3 else count
            for count in row.counts
        )
    )


# -- statistics --------------------------------------------------------------------------------------


@pytest.mark.long
def test_precision_decides_how_many_runs():
    plan = read_plan(PLANS / "rendezvous")
    result = simulate(plan, time=60.0, precision=0.05, measures=["Hand_Over", "Fetch"])
    assert result.precision["wanted"] == 0.05 and result.precision["reached"] <= 0.05
    for estimate in (result.throughput["Hand_Over"], result.mean_tokens["Fetch"]):
        assert estimate.half_width <= 0.05 * estimate.mean
    finer = simulate(plan, time=60.0, precision=0.02, measures=["Hand_Over", "Fetch"])
    assert finer.replications > 2 * result.replications
    limited = simulate(plan, time=60.0, precision=0.001, replications=40)
    assert limited.replications == 40 and limited.precision["reached"] > 0.001


@pytest.mark.long
def test_batches_of_one_run_agree_with_many_runs():
    plan = read_plan(PLANS / "rendezvous")
    one = simulate(plan, time=3000.0, warmup=50.0, batches=30, confidence=0.999999, seed=1)
    many = simulate(plan, time=150.0, warmup=50.0, replications=60, confidence=0.999999, seed=2)
    assert one.replications == 1 and one.batches == 30
    for name, estimate in one.throughput.items():
        other = many.throughput[name]
        assert abs(estimate.mean - other.mean) < estimate.half_width + other.half_width
    with pytest.raises(RefusedError, match="cannot be divided into batches"):
        simulate(replace(plan, until="At_Dock >= 2"), time=3000.0, batches=30)


def test_what_was_never_seen_has_a_bound():
    """In 100 s without one, events of up to 0.03 a second are possible (the rule of three)."""
    net = (
        NetBuilder()
        .place("a", 1)
        .place("b")
        .exponential("often", rate=1.0, inputs="a", outputs="a")
        .exponential("rarely", rate=1e-9, inputs="a", outputs="b")
        .exponential("back", rate=1.0, inputs="b", outputs="a")
        .build()
    )
    act = FunctionAction("actions.work", "work")
    plan = Plan(net, actions={"a": act, "b": act}, robots=(RobotSpec("r", "a"),)).validate()
    result = simulate(plan, time=10.0, replications=10, until="b >= 1")
    rare = result.throughput["rarely"]
    assert (rare.mean, rare.seen) == (0.0, False)
    assert rare.half_width == pytest.approx(0.03, rel=0.01)
    assert str(rare) == "not seen, below 0.03" and str(result.mean_tokens["b"]) == "not seen"
    assert result.reached.half_width == pytest.approx(1 - 0.05**0.1)
    assert result.time_to_condition is None
    data = result.to_json()
    assert data["throughput"]["rarely"] == {
        "mean": 0.0,
        "half_width": rare.half_width,
        "seen": False,
    }
    assert "seen" not in data["throughput"]["often"]


@pytest.mark.long
def test_a_run_ends_when_every_robot_is_inactive():
    result = simulate(read_plan(PLANS / "fork_join"), time=1000.0, replications=50)
    assert result.reached is None and result.end_time.mean < 100


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"timing": "other", "time": 1}, UsageError, "no reading 'other'"),
        ({"losses": -1, "time": 1}, UsageError, "losses"),
        ({"losses": 1, "time": 1, "timing": "net"}, UsageError, "lose robots"),
        ({"precision": 2, "time": 1}, UsageError, "precision"),
        ({"measures": ["Fetch"], "time": 1}, UsageError, "give --precision"),
        (
            {"measures": ["Nowhere"], "precision": 0.1, "time": 1},
            UsageError,
            "no place or transition 'Nowhere'",
        ),
        ({"batches": 1, "time": 1}, UsageError, "batches"),
        ({"batches": 20, "until": "Fetch > 9"}, UsageError, "how long"),
        ({"batches": 20, "time": 1, "precision": 0.1}, UsageError, "exclude"),
        ({"batches": 20, "time": 1, "timing": "net"}, UsageError, "batches are for nets"),
    ],
)
def test_options_that_make_no_sense(options, error, message):
    with pytest.raises(error, match=message):
        simulate(read_plan(PLANS / "rendezvous"), **options)


@pytest.mark.long
def test_cancel_within_a_long_run():
    calls = []
    with pytest.raises(CancelledError):
        simulate(
            read_plan(PLANS / "patrol"),
            time=1e12,
            replications=1,
            cancel=lambda: calls.append(1) or len(calls) > 3,
        )


@pytest.mark.long
def test_a_cycle_without_time_is_refused():
    net = (
        NetBuilder()
        .place("a", 1)
        .place("b")
        .immediate("ab", inputs="a", outputs="b")
        .immediate("ba", inputs="b", outputs="a")
        .build()
    )
    act = FunctionAction("actions.work", "work")
    for actions in ({"a": None, "b": None}, {"a": act, "b": act}):
        plan = Plan(net, actions=actions, robots=(RobotSpec("r", "a"),)).validate()
        with pytest.raises(RefusedError, match="without time"):
            simulate(plan, time=1.0, replications=1)


def test_a_run_without_end_is_refused():
    net = (
        NetBuilder()
        .place("a", 1)
        .place("b")
        .exponential("t", inputs=["a", "b"], outputs="a")
        .build()
    )
    act = FunctionAction("actions.work", "work")
    plan = Plan(net, actions={"a": act, "b": act}, robots=(RobotSpec("r", "a"),)).validate()
    with pytest.raises(RefusedError, match=r"stays in \(a: 1\) forever"):
        simulate(plan, until="b >= 1", replications=1)

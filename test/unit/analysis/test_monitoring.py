"""Predicted against observed: the alarm, its thresholds, and the prediction intervals."""

from __future__ import annotations

import math
from dataclasses import replace
from statistics import NormalDist
from typing import Any, List

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.analysis.monitoring import prediction
from gspn_framework_package.analysis.monitoring.choices import BLOCK, ChoiceTest
from gspn_framework_package.analysis.monitoring.comparison import (
    Observed,
    compare,
    interval,
)
from gspn_framework_package.analysis.monitoring.cusum import ChanceChart, RateChart
from gspn_framework_package.analysis.monitoring.hazard import Hazard
from gspn_framework_package.analysis.monitoring.monitor import Monitor
from gspn_framework_package.analysis.monitoring.prediction import (
    RunSample,
    draw_parameters,
    growth,
)
from gspn_framework_package.analysis.monitoring.streams import Alarm
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration, Evidence
from gspn_framework_package.model.plan import Plan, RobotSpec

DURATIONS = [
    Duration.exponential(2.0),
    Duration.gamma(59.0, 1.2),
    Duration.gamma(0.5, 1.0),
    Duration.lognormal(1.0, 1.0),
    Duration.erlang(4, 1.0),
    Duration.uniform(0.5, 1.5),
    Duration.uniform(0.99, 1.01),
    Duration.hyper_erlang([(0.9, 2, 1.0), (0.1, 1, 20.0)]),
    Duration.empirical([0.2, 0.5, 0.6, 0.7, 0.9, 2.0]),
    Duration.deterministic(0.7),
    Duration.gamma(3000.0, 1.0),
]


# -- the sums --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "ratio, threshold, between, delay",
    [(0.80, 5, 6469, 192), (0.67, 6, 6676, 84), (1.25, 5, 6026, 146), (1.50, 6, 4856, 48)],
)
def test_the_chain_gives_the_simulated_run_lengths(
    ratio: float, threshold: float, between: float, delay: float
) -> None:
    """The figures were simulated, with an error of some per cent, and count expected ends."""
    chart = RateChart(ratio)
    assert chart.run_length(threshold) == pytest.approx(between, rel=0.06)
    assert chart.run_length(threshold, ratio) / ratio == pytest.approx(delay, rel=0.04)


@pytest.mark.long
@pytest.mark.parametrize("ratio", [0.5, 0.8, 1.25, 2.0])
def test_run_lengths_agree_with_a_simulation(ratio: float) -> None:
    generator = np.random.default_rng(5)
    lengths = [_simulated_length(ratio, 2.0, generator) for _ in range(1500)]
    error = np.std(lengths) / math.sqrt(len(lengths))
    assert abs(RateChart(ratio).run_length(2.0) - np.mean(lengths)) < 4 * error


def _simulated_length(ratio: float, threshold: float, generator: Any) -> int:
    """Ends until the alarm, of a sum that is followed step by step."""
    value, count = 0.0, 0
    while True:
        value = max(value + (1 - ratio) * generator.exponential(), 0.0)
        if value >= threshold:
            return count
        count += 1
        value = max(value + math.log(ratio), 0.0)
        if value >= threshold:
            return count


@pytest.mark.long
@pytest.mark.parametrize("chance, odds", [(0.5, 2.0), (0.1, 2.0), (0.1, 0.5), (0.02, 2.0)])
def test_run_lengths_of_outcomes_agree_with_a_simulation(chance: float, odds: float) -> None:
    chart = ChanceChart(chance, odds)
    generator = np.random.default_rng(6)
    lengths = []
    for _ in range(600):
        value, count = 0.0, 0
        while value < 1.5:
            count += 1
            step = chart.hit if generator.random() < chance else chart.miss
            value = max(value + step, 0.0)
        lengths.append(count)
    error = np.std(lengths) / math.sqrt(len(lengths))
    assert abs(chart.run_length(1.5) - np.mean(lengths)) < 4 * error


@pytest.mark.parametrize("events", [100.0, 1e4, 1e7])
@pytest.mark.parametrize("ratio", [0.67, 1.5])
def test_a_threshold_gives_the_stated_run_length(ratio: float, events: float) -> None:
    chart = RateChart(ratio)
    assert chart.run_length(chart.threshold(events)) == pytest.approx(events, rel=0.15)


def test_thresholds_rise_for_rarer_alarms_without_end() -> None:
    thresholds = [RateChart(0.8).threshold(10.0**k) for k in range(16)]
    assert thresholds == sorted(thresholds) and math.isfinite(thresholds[-1])


# -- the time in which ends come at rate 1 ---------------------------------------------------------


@pytest.mark.parametrize("duration", DURATIONS, ids=lambda d: d.describe())
def test_ends_come_at_rate_1(duration: Duration) -> None:
    hazard = Hazard(duration)
    times = duration.sample(np.random.default_rng(1), 4000)
    assert np.mean([hazard(float(x)) for x in times]) == pytest.approx(1.0, abs=0.06)


@given(st.sampled_from(DURATIONS), st.floats(0, 1e9), st.floats(0, 1e9))
@settings(max_examples=200, deadline=None)
def test_the_hazard_is_finite_and_rises(duration: Duration, x: float, y: float) -> None:
    hazard = _hazard(duration)
    low, high = hazard(min(x, y)), hazard(max(x, y))
    assert 0.0 <= low <= high < math.inf


_HAZARDS: dict = {}


def _hazard(duration: Duration) -> Hazard:
    if duration not in _HAZARDS:
        _HAZARDS[duration] = Hazard(duration)
    return _HAZARDS[duration]


# -- the monitor -----------------------------------------------------------------------------------


def _plan(duration: Duration, robots: int = 2, **fields: Any) -> Plan:
    """Robots go round: Work, then Rest, where the policy has a choice of two ways back."""
    net = (
        NetBuilder()
        .place("Work", robots)
        .place("Rest")
        .exponential("good", rate=1.0, inputs="Work", outputs="Rest")
        .exponential("bad", rate=1.0, inputs="Work", outputs="Rest")
        .immediate("left", weight=1.0, inputs="Rest", outputs="Work")
        .immediate("right", weight=1.0, inputs="Rest", outputs="Work")
        .build()
    )
    action = FunctionAction("actions.work", "work")
    return Plan(
        net,
        actions={"Work": action, "Rest": None},
        robots=tuple(RobotSpec("r%d" % i, "Work") for i in range(1, robots + 1)),
        durations={"Work": duration},
        outcomes={"Work": {"good": 0.9, "bad": 0.1}},
        **fields,
    ).validate()


def _play(
    plan: Plan,
    attempts: int,
    every: float,
    factors: Any = lambda robot, now: 1.0,
    bad: float = 0.1,
    seed: int = 1,
) -> Monitor:
    """Robots that work without a pause; ``factors`` makes their durations longer."""
    generator = np.random.default_rng(seed)
    duration = plan.durations["Work"]
    names = [robot.name for robot in plan.robots]
    monitor = Monitor(plan, names, {"Work": len(names) / duration.mean}, every)
    ends: List[Any] = []
    for name in names:
        monitor.begin(name, "Work", 0.0)
        ends.append((duration.sample(generator) * factors(name, 0.0), name))
    for _ in range(attempts):
        ends.sort()
        now, name = ends.pop(0)
        result = "bad" if generator.random() < bad else "good"
        monitor.end(name, now, result=result)
        monitor.begin(name, "Work", now)
        ends.append((now + duration.sample(generator) * factors(name, now), name))
    return monitor


@pytest.mark.long
@pytest.mark.parametrize("duration", [DURATIONS[0], DURATIONS[1], DURATIONS[5], DURATIONS[9]])
def test_a_run_as_planned_raises_no_more_alarms_than_stated(duration: Duration) -> None:
    attempts, alarms = 6000, 0
    for seed in (1, 2):
        plan = _plan(duration)
        seconds = attempts * duration.mean / 2
        alarms += len(_play(plan, attempts, every=seconds / 5, seed=seed).alarms)
    assert alarms <= 18  # 10 are stated; more than 18 of a Poisson number is one in 150


@pytest.mark.parametrize(
    "duration, most", [(DURATIONS[0], 2500), (DURATIONS[1], 60), (DURATIONS[9], 30)]
)
def test_a_slower_robot_is_named(duration: Duration, most: int) -> None:
    start = 50 * duration.mean
    monitor = _play(
        _plan(duration),
        100 + 2 * most,
        every=30 * 86_400.0,
        factors=lambda robot, now: 1.3 if robot == "r2" and now > start else 1.0,
    )
    first = monitor.alarms[0]
    assert (first.robot, first.direction) == ("r2", "slower")
    assert first.at > start and first.at < start + 2.6 * most * duration.mean / 2
    assert first.change is not None and 0.1 < first.change < 0.5
    assert any(a.place == "Work" for a in monitor.alarms)
    assert "slower than planned" in first.describe()


@pytest.mark.long
def test_a_slower_robot_is_reported_once_and_not_overstated() -> None:
    """The alarms that last say the same thing once, by how much as far as is known by now."""
    now = []
    for seed in range(12):
        monitor = _play(
            _plan(DURATIONS[1], robots=4),
            1600,
            every=30 * 86_400.0,
            seed=seed,
            factors=lambda robot, now: 1.46 if robot == "r2" else 1.0,
        )
        (alarm,) = monitor.on
        assert (alarm.kind, alarm.robot, alarm.direction) == ("robot", "r2", "slower")
        assert alarm.change is not None
        now.append(alarm.change)
        others = [a for a in monitor.alarms if a.kind != "robot"]
        assert others and all(map(monitor.is_explained, others))
    assert sum(now) / 12 == pytest.approx(0.46, abs=0.05)


def test_what_follows_from_a_slower_robot_stands_under_it() -> None:
    monitor = _play(
        _plan(DURATIONS[1], robots=4),
        1600,
        every=30 * 86_400.0,
        factors=lambda robot, now: 1.46 if robot == "r2" else 1.0,
    )
    (cause,) = monitor.causes()
    assert (cause.alarm.kind, cause.alarm.robot) == ("robot", "r2")
    assert cause.follows and {alarm.kind for alarm in cause.follows} <= {"place", "team"}
    raised = [stream for stream in monitor.streams if stream.on and stream.alarms]
    assert len(raised) == 1 + len(cause.follows)
    assert cause.interval is not None and cause.interval[0] < 0.46 < cause.interval[1]
    assert cause.size().endswith("% (95 %)")
    again = cause.alarm._replace(kind="team", observed=9.0)
    assert cause._replace(follows=(*cause.follows, again)).others() == cause.others()


@pytest.mark.long
def test_the_interval_of_a_change_holds_the_true_one() -> None:
    """200 runs, in which a robot is slower by another factor and for another time each."""
    inside = known = 0
    for seed in range(200):
        factor = 1.3 + (seed % 10) * 0.1
        monitor = _play(
            _plan(DURATIONS[seed % 2]),
            400 + 20 * (seed % 7),
            every=86_400.0,
            seed=seed,
            factors=lambda robot, now: factor if robot == "r2" else 1.0,
        )
        for cause in monitor.causes():
            if cause.alarm.robot == "r2" and cause.interval is not None:
                known += 1
                inside += cause.interval[0] <= factor - 1 <= cause.interval[1]
    assert known >= 150
    assert inside / known >= 0.91  # 95 % but for the chance of so many cases


def test_a_change_of_which_little_was_seen_has_no_interval() -> None:
    """As soon as a slow robot is noticed, nothing that began later has ended."""
    slow = lambda robot, now: 2.0 if robot == "r2" else 1.0  # noqa: E731
    plans = (_play(_plan(DURATIONS[1]), n, 30 * 86_400.0, slow) for n in range(10, 400))
    (cause,) = next(monitor for monitor in plans if monitor.on).causes()
    assert cause.interval is None and cause.size() == ""


def test_a_faster_team_is_noticed() -> None:
    monitor = _play(_plan(DURATIONS[1]), 600, 30 * 86_400.0, factors=lambda r, now: 0.7)
    assert monitor.alarms[0].direction == "faster"
    assert monitor.alarms[0].change == pytest.approx(-0.3, abs=0.1)


def test_an_action_that_never_ends_is_noticed_while_it_goes_on() -> None:
    plan = _plan(Duration.gamma(59.0, 1.0), robots=1)
    monitor = Monitor(plan, ["r1"], {"Work": 1.0})
    monitor.begin("r1", "Work", 0.0)
    assert not monitor.advance(2.0)
    alarms = monitor.advance(100.0)
    assert [a.direction for a in alarms] == ["slower"]
    assert alarms[0].place == "Work" and alarms[0].observed == pytest.approx(100.0)
    assert monitor.on == alarms


def test_an_alarm_ends_when_the_run_is_as_planned_again() -> None:
    plan = _plan(Duration.deterministic(1.0), robots=1)
    monitor = Monitor(plan, ["r1"], {"Work": 1.0})
    monitor.begin("r1", "Work", 0.0)
    monitor.end("r1", 100.0, result="good")
    assert monitor.on
    for k in range(600):
        monitor.begin("r1", "Work", 100.0 + k)
        monitor.end("r1", 101.0 + k, result="good" if k % 10 else "bad")
    assert not monitor.on and len(monitor.alarms) == 1


def test_outcomes_that_become_more_frequent_are_noticed() -> None:
    monitor = _play(_plan(DURATIONS[1]), 2000, 30 * 86_400.0, bad=0.3)
    first = monitor.alarms[0]
    assert (first.kind, first.place, first.transition) == ("outcome", "Work", "good")
    assert first.direction == "less often"
    assert first.observed == pytest.approx(0.7, abs=0.12)


def test_failures_that_the_plan_does_not_know_are_noticed() -> None:
    plan = _plan(Duration.exponential(1.0), robots=1)
    monitor = Monitor(plan, ["r1"], {"Work": 1.0})
    alarms: List[Alarm] = []
    for k in range(400):
        monitor.begin("r1", "Work", float(k))
        failed = "aborted" if k % 5 == 0 else ""
        alarms += monitor.end("r1", k + 0.9, result="" if failed else "good", failed=failed)
    kinds = [a.kind for a in alarms]
    assert "failure" in kinds
    assert alarms[kinds.index("failure")].direction == "more often"


def test_attempts_cut_off_count_for_nothing_but_their_time() -> None:
    plan = _plan(Duration.exponential(1.0), robots=1)
    monitor = Monitor(plan, ["r1"], {"Work": 1.0})
    for k in range(2000):
        monitor.begin("r1", "Work", float(k))
        monitor.end("r1", k + 1e-4, completed=False)
    assert not monitor.alarms


def test_a_mean_within_its_interval_raises_no_alarm() -> None:
    duration = Duration.gamma(59.0, 1.0)
    evidence = {("durations", "Work"): Evidence(40, ("a",), (0.9, 1.1))}
    slower = lambda robot, now: 1.08  # noqa: E731
    sure = _play(_plan(duration), 4000, 86_400.0, slower)
    unsure = _play(_plan(duration, evidence=evidence), 4000, 86_400.0, slower)
    assert any(a.kind in ("place", "team", "robot") for a in sure.alarms)
    assert not any(a.kind in ("place", "team", "robot") for a in unsure.alarms)


def test_a_plan_without_times_has_nothing_to_watch() -> None:
    plan = replace(_plan(Duration.none()), durations={"Work": Duration.none()})
    monitor = Monitor(plan, ["r1", "r2"], {})
    monitor.begin("r1", "Work", 0.0)
    assert not monitor.advance(1e6) and not monitor.end("r1", 1e6)
    assert [s.kind for s in monitor.streams] == ["choice"]


# -- the policy's choices --------------------------------------------------------------------------


@pytest.mark.long
def test_choices_by_their_rows_raise_few_alarms() -> None:
    generator = np.random.default_rng(2)
    test = ChoiceTest(0.05 / BLOCK)  # one block in twenty, at one choice per second
    rows = [(("a", 0.7), ("b", 0.3)), (("a", 0.2), ("b", 0.5), ("c", 0.3))]
    alarms = 0
    for k in range(400 * BLOCK):
        row = rows[k % 2]
        name = row[generator.choice(len(row), p=[p for _, p in row])][0]
        alarms += test.count(row, name, float(k))
    assert 5 <= alarms <= 38


def test_other_choices_are_noticed() -> None:
    generator = np.random.default_rng(2)
    monitor = Monitor(_plan(DURATIONS[0]), ["r1"], {"Work": 1.0})
    alarms = []
    for k in range(2 * BLOCK):
        chosen = "left" if generator.random() < 0.75 else "right"
        alarms += monitor.choose("Rest", (("left", 0.5), ("right", 0.5)), chosen, float(k))
    assert alarms and alarms[0].kind == "choice" and alarms[0].place == "Rest"
    assert "Rest: the choice of" in alarms[0].describe()


def test_a_choice_that_no_row_allows_is_noticed() -> None:
    test = ChoiceTest(1e-9)
    alarms = [test.count((("a", 0.5), ("b", 0.5)), "c", float(k)) for k in range(BLOCK)]
    assert alarms[-1]


# -- prediction ------------------------------------------------------------------------------------


@pytest.mark.long
def test_long_runs_are_replicated_less_often_unless_it_was_asked(monkeypatch: Any) -> None:
    monkeypatch.setattr(prediction, "USUAL_FIRINGS", 8000)
    learned = {("durations", "Work"): Evidence(50, ("a",), (0.8, 1.3))}
    plan = _plan(Duration.gamma(4.0, 1.0), evidence=learned)
    sample = prediction.predict([prediction.Span(plan, 12.0)], seed=2)
    assert 100 < sample.size < 300
    assert len(np.unique(sample.group)) > 30  # as many draws of what is not known
    assert 6000 < sample.firings.sum() < 10000
    asked = prediction.predict([prediction.Span(plan, 12.0)], replications=300, seed=2)
    assert asked.size == 300


def test_parameters_are_drawn_from_their_intervals() -> None:
    evidence = {
        ("durations", "Work"): Evidence(50, ("a",), (0.8, 1.3)),
        ("outcomes", "Work"): Evidence(40, ("a",)),
    }
    plan = _plan(Duration.gamma(4.0, 1.0), evidence=evidence)
    generator = np.random.default_rng(3)
    drawn = [draw_parameters(plan, generator) for _ in range(2000)]
    means = [p.apply(plan).durations["Work"].mean for p in drawn]
    assert np.mean([0.8 <= m <= 1.3 for m in means]) == pytest.approx(0.95, abs=0.02)
    chances = [p.apply(plan).outcomes["Work"]["bad"] for p in drawn]
    assert np.mean(chances) == pytest.approx(4.5 / 41, abs=0.01)
    assert np.std(chances) == pytest.approx(math.sqrt(0.11 * 0.89 / 42), rel=0.1)
    assert all(math.isclose(sum(p.outcomes["Work"].values()), 1.0) for p in drawn)


def test_groups_draw_from_all_parts_of_a_distribution() -> None:
    """Even the 2.5 % tails of 40 values are there, which chance alone leaves out in every third."""
    for seed in range(5):
        groups = prediction._strata(40, np.random.default_rng(seed))
        drawn = np.array([[draw() for _ in range(3)] for draw in groups])
        parts = np.floor(40 * np.vectorize(NormalDist().cdf)(drawn))
        assert (np.sort(parts, axis=0) == np.arange(40)[:, np.newaxis]).all()
        assert np.abs(np.corrcoef(drawn.T) - np.eye(3)).max() < 0.6


def test_an_interval_holds_the_next_value() -> None:
    generator = np.random.default_rng(4)
    inside = 0
    for _ in range(600):
        low, high = interval(10 + generator.standard_normal(12))
        inside += low <= 10 + generator.standard_normal() <= high
    assert inside / 600 == pytest.approx(0.95, abs=0.03)


def test_a_count_grows_with_chance_and_with_doubt() -> None:
    generator = np.random.default_rng(5)
    groups, size, seconds = 200, 20, 100.0
    rates = 2.0 + 0.1 * generator.standard_normal(groups)
    counts = generator.poisson(np.repeat(rates, size) * seconds).astype(float)
    empty = np.zeros((groups * size, 0))
    sample = RunSample(
        np.full(groups * size, seconds),
        empty,
        empty,
        np.zeros(groups * size, dtype=bool),
        np.repeat(np.arange(groups), size),
    )
    found = growth(sample, counts)
    assert found.rate == pytest.approx(2.0, rel=0.02)
    assert found.chance == pytest.approx(2.0, rel=0.1)
    assert found.doubt == pytest.approx(0.01, rel=0.3)


def _flat_sample(plan: Plan, size: int, generator: Any) -> RunSample:
    return RunSample(
        np.full(size, 100.0),
        generator.poisson(50.0, (size, len(plan.net.transitions))).astype(float),
        100 * generator.random((size, len(plan.net.places))),
        np.zeros(size, dtype=bool),
        np.zeros(size),
    )


@pytest.mark.long
def test_runs_like_the_predicted_ones_depart_rarely() -> None:
    plan = _plan(DURATIONS[0])
    generator = np.random.default_rng(6)
    sample = _flat_sample(plan, 1000, generator)
    others = _flat_sample(plan, 500, generator)
    departed = 0
    for i in range(500):
        observed = Observed(
            100.0,
            {t.name: int(n) for t, n in zip(plan.net.transitions, others.firings[i])},
            {p.name: s for p, s in zip(plan.net.places, others.tokens[i])},
        )
        departed += compare(plan, sample, observed).departs
    assert departed <= 14  # 5 are expected


def test_a_run_with_other_throughput_departs_and_says_where() -> None:
    plan = _plan(DURATIONS[0])
    sample = _flat_sample(plan, 1000, np.random.default_rng(7))
    observed = Observed(
        100.0,
        {"good": 50, "bad": 120, "left": 50, "right": 50},
        {"Work": 50.0, "Rest": 50.0},
    )
    found = compare(plan, sample, observed)
    assert found.departs and found.farthest == "throughput bad"
    measure = next(m for m in found.measures if m.name == "throughput bad")
    data = measure.to_json()
    assert not measure.inside and data["direction"] == "more"
    assert data["change"] == pytest.approx(1.4, abs=0.1)


def test_the_resolution_of_the_clocks_is_no_departure() -> None:
    plan = _plan(DURATIONS[0])
    sample = _flat_sample(plan, 1000, np.random.default_rng(8))
    sample.tokens[:, 1] = 1e-4 * (1 + 0.01 * np.random.default_rng(9).standard_normal(1000))
    fired = {t.name: 50 for t in plan.net.transitions}
    found = compare(plan, sample, Observed(100.0, fired, {"Work": 50.0, "Rest": 0.0}))
    assert not found.departs and all(m.inside for m in found.measures if m.of == "Rest")
    found = compare(plan, sample, Observed(100.0, fired, {"Work": 50.0, "Rest": 1e-2}))
    assert found.departs and found.farthest == "mean tokens Rest"

"""Distributions of durations: moments, functions of a time, samples, the form in a plan file."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.formats.plan_json import schema
from gspn_framework_package.model.duration import (
    FAMILIES,
    KEYS,
    Duration,
    DurationPart,
    Family,
    Kind,
)
from gspn_framework_package.model.errors import PlanError
from gspn_framework_package.model.families import FOLLOWS, compose, duration_from_json

MEANS = st.floats(1e-3, 1e3)


def late(chance, delay):
    """Mostly prompt; else only after a delay."""
    return [
        DurationPart(1 - chance, 0.0, Duration.erlang(3, 2 * delay)),
        DurationPart(chance, delay, Duration.lognormal(0.5, delay)),
    ]


LATE = Family("late", {"chance": {"type": "number"}, "delay": {"type": "number"}}, ("delay",), late)


@pytest.fixture(scope="module", autouse=True)
def family_of_somebody_else():
    FAMILIES["late"] = LATE
    yield
    del FAMILIES["late"]


DURATIONS = st.one_of(
    st.builds(Duration.exponential, MEANS),
    st.builds(Duration.erlang, st.integers(1, 50), MEANS),
    st.builds(Duration.gamma, st.floats(0.2, 200), MEANS),
    st.builds(Duration.lognormal, st.floats(0.05, 2), MEANS),
    st.builds(lambda low, more: Duration.uniform(low, low + more), MEANS, MEANS),
    st.builds(
        lambda start, steps: Duration.empirical(list(np.cumsum([start, *steps, 0.5]))),
        st.floats(0, 10),
        st.lists(st.sampled_from([0.0, 0.1, 1.0, 3.0]), max_size=8),
    ),
    st.builds(
        lambda p, k, a, b: Duration.hyper_erlang([(p, k, a), (1 - p, 1, b)]),
        st.floats(0.01, 0.99),
        st.integers(1, 9),
        MEANS,
        MEANS,
    ),
    st.builds(
        lambda chance, delay: compose(LATE, {"chance": chance, "delay": delay}),
        st.floats(0.01, 0.99),
        st.floats(0.1, 5.0),
    ),
)


@given(DURATIONS)
def test_the_file_form_gives_the_same_distribution(duration):
    assert duration_from_json(duration.to_json()) == duration
    assert duration.kind.value.replace("-e", " E").lower()[:4] in duration.describe().lower()


@given(DURATIONS, st.floats(0.001, 0.999))
def test_functions_of_a_time_agree_with_each_other(duration, p):
    x = duration.quantile(p)
    step = duration.kind is Kind.EMPIRICAL  # equal quantiles make the distribution jump
    assert duration.cdf(x) >= p - 1e-6
    if not step:
        assert duration.cdf(x) == pytest.approx(p, abs=1e-6)
        h = min(1e-5 * math.sqrt(duration.variance), 1e-3 * x)
        slope = (duration.cdf(x + h) - duration.cdf(x - h)) / (2 * h)
        assert slope == pytest.approx(math.exp(duration.log_density(x)), rel=0.01)
    assert duration.survival(x) == pytest.approx(1 - duration.cdf(x), abs=1e-9)
    assert math.exp(-duration.hazard_integral(x)) == pytest.approx(duration.survival(x), abs=1e-9)
    assert list(duration.cdf(np.array([x, x]))) == [duration.cdf(x)] * 2


@pytest.mark.long
@settings(max_examples=30)
@given(DURATIONS)
def test_the_moments_are_those_of_the_quantiles(duration):
    times = duration.quantile((np.arange(5_000) + 0.5) / 5_000)
    assert times.mean() == pytest.approx(duration.mean, rel=0.06)
    assert duration.variance == pytest.approx((duration.variation * duration.mean) ** 2)
    assert duration.scaled(3.0).mean == pytest.approx(3 * duration.mean)
    assert duration.scaled(3.0).variance == pytest.approx(9 * duration.variance)


@pytest.mark.parametrize(
    "duration",
    [
        Duration.exponential(2.0),
        Duration.erlang(4, 2.0),
        Duration.gamma(59.3, 1.2),
        Duration.gamma(0.4, 1.2),
        Duration.lognormal(0.5, 2.0),
        Duration.uniform(1.0, 3.0),
        Duration.empirical([1.0, 1.0, 1.0, 2.0, 4.0, 4.0]),
        Duration.hyper_erlang([(0.3, 2, 1.0), (0.7, 1, 5.0)]),
        Duration.deterministic(2.0),
        compose(LATE, {"chance": 0.3, "delay": 1.5}),
    ],
    ids=lambda d: d.kind.value,
)
def test_samples_have_the_mean_and_the_variance(duration):
    drawn = duration.sample(np.random.Generator(np.random.PCG64(3)), 100_000)
    error = math.sqrt(duration.variance / len(drawn))
    assert abs(drawn.mean() - duration.mean) <= 5 * error
    assert drawn.var() == pytest.approx(duration.variance, rel=0.1)
    assert drawn.min() >= 0


def test_the_hazard_is_finite_far_out_in_the_tail():
    for duration in (
        Duration.gamma(59.3, 1.2),
        Duration.lognormal(0.1, 1.0),
        Duration.hyper_erlang([(0.5, 3, 1.0), (0.5, 40, 2.0)]),
        compose(LATE, {"chance": 0.3, "delay": 0.05}),
    ):
        near, far = duration.hazard_integral(np.array([100.0, 1000.0]))
        assert 100 < near < far < math.inf


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"mean": 0}, "0 is not a possible mean"),
        ({}, "'mean' is missing"),
        ({"mean": 1, "shape": 2}, "'shape' does not belong"),
        ({"mean": 1, "distribution": "gamma"}, "'shape' is missing"),
        ({"distribution": "uniform", "low": 2, "high": 2}, "is not below high"),
        ({"distribution": "uniform", "low": 1, "high": 3, "mean": 9}, "the mean is given as 9"),
        ({"distribution": "empirical", "quantiles": [2, 1]}, "do not increase"),
        (
            {
                "distribution": "hyper-erlang",
                "branches": [{"probability": 0.5, "phases": 1, "mean": 1}],
            },
            "sum to 0.5",
        ),
        ({"mean": 1, "distribution": "lognormal", "sigma": 11}, "too large"),
        ({"distribution": "late", "chance": 0.3}, "'delay' is missing"),
        ({"distribution": "late", "chance": 1.3, "delay": 2}, "the parts of the family 'late' are"),
        ({"distribution": "late", "chance": 0.5, "delay": 2, "mean": 9}, "the mean is given as 9"),
    ],
)
def test_what_is_wrong_is_said(data, message):
    with pytest.raises(PlanError, match=message):
        duration_from_json(data)


def test_a_family_that_does_not_scale_is_refused():
    """It has a time that is not a parameter."""

    def parts(rest):
        return [DurationPart(1.0, 2.0, Duration.exponential(rest))]

    rigid = Family("rigid", {"rest": {}}, ("rest",), parts)
    with pytest.raises(PlanError, match="the family 'rigid' cannot be scaled"):
        compose(rigid, {"rest": 1.0}).scaled(2.0)


def test_a_time_is_cut_off_where_its_survival_jumps():
    late = Family(
        "set", {"at": {}}, ("at",), lambda at: [DurationPart(1.0, at, Duration.deterministic(at))]
    )
    cut = compose(late, {"at": 0.7}).cut_off(2.0)
    assert (cut.mean, cut.variance) == pytest.approx((1.4, 0.0), abs=1e-9)


def test_the_schema_names_the_parameters_for_the_page():
    parameters = schema()["definitions"]["duration"]["parameters"]
    del parameters["late"]
    assert {kind: set(keys) for kind, keys in parameters.items()} == {
        kind.value: {*KEYS[kind], *(() if kind in FOLLOWS else ("mean",))} for kind in Kind
    }

"""Durations, outcomes and failures learned from attempts: estimators, intervals, tests, the plan."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any, List, NamedTuple

import numpy as np
import pytest
from scipy import stats

from gspn_framework_package.analysis.fitting import Sample, fit_duration, fit_plan
from gspn_framework_package.analysis.fitting.durations import (
    DurationFit,
    criterion,
    fit_empirical,
    fit_exponential,
    fit_gamma,
    fit_hyper_erlang,
    fit_lognormal,
    kaplan_meier,
    likelihood,
)
from gspn_framework_package.analysis.fitting.testing import (
    distance,
    groups_differ,
    outcomes_depend,
    rate_interval,
    test_of_fit,
    wilson,
)
from gspn_framework_package.analysis.simulation import simulate
from gspn_framework_package.cli.main import main
from gspn_framework_package.cli.plot import fit_figure
from gspn_framework_package.execution.event_log import header
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.logged_attempts import gather
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats import write_net
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.attempt import EventCount
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration, Kind
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.plan import Plan, RobotSpec


def source(seed: int = 1) -> Any:
    return np.random.Generator(np.random.PCG64(seed))


def cut(times: Any, limits: Any) -> Sample:
    """The times, cut off at the limits."""
    ended = times <= limits
    return Sample(times[ended], limits[~ended])


# -- estimators ------------------------------------------------------------------------------------


def test_the_exponential_mean_counts_what_was_cut_off() -> None:
    fit = fit_exponential(Sample([1.0, 2.0, 3.0], [4.0]))
    assert fit.duration.mean == pytest.approx(10 / 3)
    low, high = (2 * 10 / q for q in stats.chi2.ppf([0.975, 0.025], [8, 6]))
    assert fit.interval == pytest.approx((low, high))
    assert fit.likelihood == pytest.approx(3 * math.log(0.3) - 0.3 * 10)


def test_leaving_out_what_still_runs_makes_the_mean_too_short() -> None:
    """Sixty seconds of a robot whose action takes 2 s: the last attempt is cut off."""
    generator = source()
    with_it, without = [], []
    for _ in range(400):
        ends = np.cumsum(generator.exponential(2.0, 200))
        observed = np.diff(ends[ends <= 60.0], prepend=0.0)
        with_it.append(fit_exponential(Sample(observed, [60.0 - observed.sum()])))
        without.append(float(observed.mean()))
    # counted as if the robot had acted for less time than it did
    bias = np.mean([1 / mean for mean in without]) / 0.5 - 1
    assert 0.02 < bias < 0.06
    rates = [1 / fit.duration.mean for fit in with_it]
    assert abs(np.mean(rates) - 0.5) < 0.012


def test_the_gamma_fit_is_that_of_scipy() -> None:
    times = source().gamma(2.5, 0.8, 300)
    fit = fit_gamma(Sample(times))
    shape, _, scale = stats.gamma.fit(times, floc=0)
    assert fit.duration.parameters[0] == pytest.approx(shape, rel=1e-4)
    assert fit.duration.mean == pytest.approx(shape * scale, rel=1e-4)
    assert fit.likelihood == pytest.approx(likelihood(fit.duration, Sample(times)), abs=1e-6)


@pytest.mark.parametrize("shape", [0.4, 2.5, 59.0])
@pytest.mark.parametrize("family", [fit_gamma, fit_lognormal])
def test_no_other_parameters_are_more_likely(family: Any, shape: float) -> None:
    generator = source(int(shape * 10))
    times = generator.gamma(shape, 2.0 / shape, 200)
    sample = cut(times, generator.uniform(0.5, 5.0, 200))
    assert len(sample.censored) > 10
    fit = family(sample)
    make = Duration.gamma if family is fit_gamma else Duration.lognormal
    best, mean = fit.duration.parameters[0], fit.duration.mean
    for factor in (0.97, 0.995, 1.005, 1.03):
        for other in (make(best * factor, mean), make(best, mean * factor)):
            assert likelihood(other, sample) <= fit.likelihood + 1e-6


def test_the_interval_of_the_mean_is_a_profile_over_the_shape() -> None:
    sample = Sample(source(3).gamma(1.5, 2.0, 40), [1.0, 3.0])
    fit = fit_gamma(sample)
    t = stats.t.ppf(0.975, 39)
    allowed = 40 * math.log1p(t**2 / 39) / 2
    for mean in fit.interval:
        shapes = np.exp(np.linspace(-1.0, 2.0, 3_001))
        profile = max(likelihood(Duration.gamma(shape, mean), sample) for shape in shapes)
        assert fit.likelihood - profile == pytest.approx(allowed, abs=1e-3)


def test_what_hardly_varies_is_deterministic() -> None:
    fit = fit_duration(Sample(2.0 + source().uniform(-1e-6, 1e-6, 20), [1.5]))
    assert (fit.duration.kind, fit.duration.mean) == (Kind.DETERMINISTIC, pytest.approx(2.0))
    # one that was cut off later contradicts it
    assert fit_duration(Sample([2.0] * 20, [2.5])).duration.kind is not Kind.DETERMINISTIC


def test_a_whole_shape_is_an_erlang_distribution_of_few_phases() -> None:
    fit = fit_duration(Sample(source(5).gamma(3.0, 1.0, 400)))
    assert (fit.duration.kind, fit.shape) == (Kind.ERLANG, 3.0)
    assert fit_duration(Sample(source(5).gamma(59.0, 1.0, 400))).duration.kind is Kind.GAMMA


def test_lognormal_times_are_found_out() -> None:
    fit = fit_duration(Sample(source(6).lognormal(0.0, 0.9, 500)))
    assert (fit.duration.kind, fit.shape) == (Kind.LOGNORMAL, pytest.approx(0.9, rel=0.1))


@pytest.mark.parametrize("censored", [False, True])
def test_times_that_vary_more_than_exponential_ones_are_a_mixture(censored: bool) -> None:
    generator = source(7)
    times = np.where(
        generator.random(800) < 0.2, generator.exponential(10.0, 800), generator.gamma(2, 0.5, 800)
    )
    limits = generator.uniform(2.0, 40.0, 800) if censored else np.full(800, np.inf)
    sample = cut(times, limits)
    fit = fit_duration(sample)
    assert fit.duration.kind is Kind.HYPER_ERLANG
    assert fit.duration.variation > 1
    gamma = fit_gamma(sample)
    assert criterion(fit, sample.size) < criterion(gamma, sample.size)
    if not censored:  # the most likely mixture has the mean of the sample
        assert fit.duration.mean == pytest.approx(times.mean(), rel=1e-4)
    low, high = fit.interval
    assert low < 2.8 < high


def test_a_mixture_needs_data() -> None:
    assert fit_hyper_erlang(Sample(source().exponential(1.0, 20))) is None


def test_quantiles_keep_the_mean_and_the_form() -> None:
    generator = source(8)
    times = np.where(
        generator.random(600) < 0.5, generator.normal(1.0, 0.05, 600), generator.normal(5, 0.1, 600)
    )
    fit = fit_empirical(Sample(times))
    assert fit.duration.mean == pytest.approx(times.mean(), rel=1e-6)
    assert fit.duration.cdf(3.0) == pytest.approx((times < 3.0).mean(), abs=0.02)


def test_the_estimate_of_kaplan_and_meier() -> None:
    """The example of their paper's kind: 6, 6, 6, 7, 10 observed, 6, 9, 10 cut off."""
    times, after = kaplan_meier(Sample([6, 6, 6, 7, 10], [6, 9, 10]))
    assert times.tolist() == [6, 7, 10]
    assert after.tolist() == pytest.approx([5 / 8, 5 / 8 * 3 / 4, 5 / 8 * 3 / 4 / 2])


def test_many_censored_times_are_grouped_without_loss() -> None:
    generator = source(9)
    times = generator.gamma(3.0, 1.0, 12_000)
    sample = cut(times, generator.uniform(0.5, 5.0, 12_000))
    assert len(sample.censored) > 3_000 > len(sample.grouped[0])
    fit = fit_gamma(sample)
    assert fit.likelihood == pytest.approx(likelihood(fit.duration, sample), abs=0.01)
    low, high = fit.interval
    assert low < 3.0 < high
    assert high - low < 0.2


def test_an_interval_allows_for_the_other_family() -> None:
    """With few times, gamma and lognormal explain them equally well, and their means differ."""
    sample = Sample(source(10).lognormal(0.0, 0.8, 20))
    fit = fit_duration(sample)
    assert fit.duration.kind in (Kind.GAMMA, Kind.ERLANG)
    alone = fit_gamma(sample).interval
    assert fit.interval[0] <= alone[0]
    assert fit.interval[1] > alone[1] * 1.05


def test_too_little_is_an_error_and_nonsense_too() -> None:
    for observed, family in (([], "exponential"), ([1.0], "auto"), ([1.0], "gamma")):
        with pytest.raises(UsageError, match="too few"):
            fit_duration(Sample(observed), family)
    with pytest.raises(UsageError, match="negative"):
        Sample([-1.0])
    with pytest.raises(UsageError, match="not a number"):
        Sample([1.0], [math.nan])
    with pytest.raises(UsageError, match="no family"):
        fit_duration(Sample([1.0, 2.0]), "cauchy")


@pytest.mark.parametrize(
    "times", [[0.0, 0.0, 0.0, 1e-9], [1e-6, 1e6], [5.0, 5.0], [1e-3, 1.0, 1e3, 1e6], [3.0] * 9]
)
@pytest.mark.parametrize("family", ["auto", "gamma", "exponential"])
def test_strange_times_give_a_distribution_all_the_same(times: Any, family: str) -> None:
    fit = fit_duration(Sample(times, [2.0]), family)
    low, high = fit.interval
    assert 0 <= low <= high
    assert fit.duration.mean > 0


@pytest.mark.long
def test_intervals_cover_the_truth() -> None:
    """95 % intervals, for times of which some are cut off: 60 runs each, from one seed."""
    for truth, family, size in (
        (Duration.exponential(2.0), "auto", 30),
        (Duration.gamma(2.5, 2.0), "gamma", 15),
        (Duration.gamma(59.0, 2.0), "auto", 15),
    ):
        generator = source(11)
        hits = 0
        for _ in range(60):
            limits = truth.mean * generator.uniform(0.3, 3.3, size)
            low, high = fit_duration(cut(truth.sample(generator, size), limits), family).interval
            hits += low <= truth.mean <= high
        assert 53 <= hits <= 60, (truth, hits)  # binomial, 0.95


# -- tests -----------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_test_of_fit_has_its_size_and_the_naive_one_has_not() -> None:
    generator = source(12)
    rejected = naive = 0
    for _ in range(150):
        sample = Sample(generator.exponential(3.0, 40))
        fit = fit_exponential(sample)
        found = test_of_fit(fit, sample, generator, samples=59)
        assert found is not None
        rejected += found.p <= 0.05
        naive += stats.kstest(sample.observed, fit.duration.cdf).pvalue <= 0.05
    assert 2 <= rejected <= 16  # binomial, 0.05
    assert naive <= 2


@pytest.mark.parametrize("censored", [False, True])
def test_the_test_of_fit_has_power(censored: bool) -> None:
    generator = source(13)
    rejected = 0
    for _ in range(20):
        times = generator.gamma(2.0, 1.0, 60)
        limits = generator.uniform(1.0, 8.0, 60) if censored else np.full(60, np.inf)
        sample = cut(times, limits)
        found = test_of_fit(fit_exponential(sample), sample, generator, samples=59)
        assert found is not None
        rejected += found.p <= 0.05
    assert rejected >= (11 if censored else 15)


def test_the_distance_is_that_of_kolmogorov_and_smirnov() -> None:
    sample = Sample(source(14).exponential(1.0, 50))
    duration = Duration.exponential(1.2)
    expected = stats.kstest(sample.observed, duration.cdf).statistic
    assert distance(duration, sample) == pytest.approx(expected, rel=1e-9)


def test_a_large_sample_is_tested_in_part_and_repeatably() -> None:
    sample = Sample(source(15).uniform(1.0, 2.0, 20_000), [1.5])
    fit = fit_gamma(sample)
    found = [test_of_fit(fit, sample, source(2), samples=19) for _ in range(2)]
    assert found[0] == found[1]
    assert found[0] is not None and found[0].p == pytest.approx(0.05)


def test_groups_that_differ_are_told_from_those_that_do_not() -> None:
    generator = source(16)
    like = Duration.gamma(20.0, 1.0)

    def sample(mean: float) -> Sample:
        return cut(generator.gamma(20.0, mean / 20, 60), generator.uniform(0.5, 4.0, 60))

    assert groups_differ([sample(1.0), sample(1.0), sample(1.0)], like) > 0.01
    assert groups_differ([sample(1.0), sample(1.3), sample(1.0)], like) < 1e-4


def test_outcomes_of_a_race_do_not_depend_on_the_time() -> None:
    generator = source(17)
    times = generator.exponential(1.0, 300)
    first = generator.random(300) < 0.3
    assert outcomes_depend([times[first], times[~first]]) > 0.01
    assert outcomes_depend([times[first] + 1.0, times[~first]]) < 1e-6
    assert outcomes_depend([[1.0, 1.0], [1.0]]) == 1.0


def test_intervals_of_shares_and_rates() -> None:
    assert wilson(10, 100) == pytest.approx((0.05523, 0.17437), abs=1e-5)
    assert wilson(0, 10) == pytest.approx((0.0, 0.27753), abs=1e-5)
    assert wilson(10, 10) == pytest.approx((0.72247, 1.0), abs=1e-5)
    assert rate_interval(0, 2.0) == pytest.approx((0.0, 3.68888 / 2), abs=1e-5)
    assert rate_interval(10, 2.0) == pytest.approx((4.7954 / 2, 18.3904 / 2), abs=1e-4)


# -- a plan ----------------------------------------------------------------------------------------


class Seen(NamedTuple):
    """An attempt, as a log would have it."""

    robot: str
    place: str
    start: float
    end: float
    completed: bool = True
    result: str = ""
    failed: str = ""
    log: int = 0


def small_plan(**fields: Any) -> Plan:
    net = NetBuilder("small").place("A", tokens=2).place("B").place("R")
    net.exponential("ab", inputs="A", outputs="B", rate=3.0)
    net.exponential("aa", inputs="A", outputs="A").exponential("ba", inputs="B", outputs="A")
    net.exponential("made", outputs="R", rate=9.0, inhibitors={"R": 5})
    actions = {place: FunctionAction("actions.act", place) for place in "AB"}
    robots = (RobotSpec("r1", "A"), RobotSpec("r2", "A"))
    plan = Plan(
        net=net.build(), actions=actions, robots=robots, resource_places=frozenset("R"), **fields
    )
    return plan.validate()


def attempts(times: Any, place: str = "A", robot: str = "r1", **fields: Any) -> List[Seen]:
    ends = np.cumsum(times)
    return [Seen(robot, place, e - t, e, **fields) for t, e in zip(times, ends)]


def test_a_plan_learns_and_keeps_the_rest() -> None:
    generator = source(20)
    plan = small_plan(
        durations={"B": Duration.exponential(7.0)}, failures={"A": 0.5}, until="B >= 3", seed=4
    )
    seen = attempts(generator.gamma(30, 1 / 30, 80), result="ab")
    seen += attempts(generator.gamma(30, 1 / 30, 20), result="aa")
    seen += attempts([0.4] * 10, failed="aborted") + attempts([0.9] * 3, completed=False)
    seen += attempts([2.0], failed="timeout") + attempts([1.0, 2.0], place="B")
    report = fit_plan(plan, seen, {"made": EventCount(40, 20.0)})
    a, b = report.places["A"], report.places["B"]
    assert (a.n, a.censored, b.n, b.fit) == (100, 4, 2, None)
    assert {t: o.seen for t, o in a.outcomes.items()} == {"ab": 80, "aa": 20}
    assert (a.failure.seen, a.failure.total) == (10, 110)
    assert any("B: 2 observed durations are too few" in note for note in report.notes)
    assert any("attempts that fail take 0.4 s" in note for note in report.notes)
    new = report.apply(plan, ["one.jsonl"])
    assert new.durations["A"] == a.fit.duration
    assert new.durations["B"] == Duration.exponential(7.0)
    assert new.outcomes == {"A": {"ab": 0.8, "aa": 0.2}}
    assert new.failures["A"] == pytest.approx(10 / 110)
    assert new.rates == {"made": 2.0}
    assert new.net.transition("made").rate == 2.0
    assert new.evidence["durations", "A"] == (100, ("one.jsonl",), a.fit.interval)
    assert ("durations", "B") not in new.evidence
    assert (new.until, new.seed, new.net.transition("ab").rate) == ("B >= 3", 4, 3.0)


@pytest.mark.parametrize("reason", ["aborted", "timeout"])
@pytest.mark.parametrize("count", [62, 2])
def test_attempts_that_all_failed_are_learned(reason: str, count: int) -> None:
    """The plan with it does not predict that they succeed."""
    plan = small_plan(timeouts={"A": 0.4} if reason == "timeout" else {})
    report = fit_plan(plan, attempts([0.4] * count, failed=reason))
    failure = report.places["A"].failure
    assert failure is not None and (failure.seen, failure.total) == (count, count)
    assert failure.interval[0] < failure.probability < failure.interval[1]
    assert any("A: all %d attempts failed" % count in note for note in report.notes)
    new = report.apply(plan, ["one.jsonl"])
    assert new.failures["A"] == pytest.approx(1 - 0.5 / count)
    if count > 2:
        assert new.durations["A"].mean == pytest.approx(0.4)
        found = simulate(new, time=100.0, replications=20, seed=3)
        assert found.throughput["ab"].mean + found.throughput["aa"].mean < 0.05


def test_too_few_failures_are_reported() -> None:
    seen = attempts([0.4], failed="aborted") + attempts([0.5, 0.5], result="ab")
    report = fit_plan(small_plan(), seen)
    assert report.places["A"].failure is None
    assert any("A: 1 of 3 attempts failed, too few to learn" in note for note in report.notes)


def test_the_report_has_the_agreed_form() -> None:
    seen = attempts(source(21).exponential(1.0, 50), result="ab")
    data = fit_plan(small_plan(), seen).to_json()
    assert set(data) == {"places", "needs", "notes"}
    place = json.loads(json.dumps(data))["places"]["A"]
    assert set(place) == {
        *("n", "censored", "mean", "interval", "distribution", "shape", "test", "outcomes")
    }
    assert set(place["test"]) == {"statistic", "p"}
    assert set(place["outcomes"]["ab"]) == {"n", "probability", "interval"}
    assert place["outcomes"]["aa"]["probability"] == 0.0
    assert place["distribution"] == "exponential"
    assert place["shape"] == 1.0


def test_it_says_how_much_more_log_is_needed_and_that_is_enough() -> None:
    plan, rng = small_plan(), source(3)

    def learned(n: int) -> Any:
        seen = attempts(rng.exponential(2.0, n), result="ab")
        few = attempts([1.0] * 3, place="B")
        return fit_plan(
            plan, [*seen, *few], {"made": EventCount(2, 10.0)}, "exponential", samples=0
        )

    report = learned(100)
    needs = {(need.what, need.of): need for need in report.needs(0.1)}
    duration = needs.pop(("duration", "A"))
    assert duration.half_width == pytest.approx(0.2, rel=0.1) and 350 < duration.needed < 500
    assert duration.robot_seconds == report.robot_seconds * (duration.needed / 100 - 1)
    # with so many, it is known that well
    assert not [n for n in learned(duration.needed).needs(0.102) if n[:2] == ("duration", "A")]
    assert not [n for n in learned(400).needs(0.2) if n[:2] == ("duration", "A")]
    few, rare = needs.pop(("duration", "B")), needs.pop(("rate", "made"))
    assert (few.seen, few.needed, few.half_width) == (3, 5, None)
    assert few.robot_seconds == pytest.approx(report.robot_seconds * 2 / 3)
    assert (rare.seen, rare.needed) == (2, 5)
    assert "3 seen, at least 5 are needed" in few.text()
    assert report.to_json(0.1)["needs"][0]["needed"] == duration.needed


@pytest.mark.parametrize("choice", ["exponential", "gamma"])
def test_a_family_can_be_prescribed(choice: str) -> None:
    seen = attempts(source(22).gamma(3.0, 1.0, 60))
    found = fit_plan(small_plan(), seen, choice=choice).places["A"]
    assert found.fit is not None
    assert found.fit.duration.kind.value == choice


def test_robots_and_halves_that_differ_are_named_and_others_are_not() -> None:
    generator = source(23)
    alike = attempts(generator.gamma(30, 1 / 30, 120), place="B")
    alike += attempts(generator.gamma(30, 1 / 30, 120), place="B", robot="r2")
    slow = attempts(generator.gamma(30, 1 / 30, 60)) + attempts(
        generator.gamma(30, 1.3 / 30, 60), robot="r2"
    )
    notes = fit_plan(small_plan(), alike + slow).notes
    assert [note for note in notes if note.startswith("B:")] == []
    assert any("A: the robots differ: r2 takes 1.3" in n and "2 such tests" in n for n in notes)
    late = np.concatenate((generator.gamma(30, 1 / 30, 60), generator.gamma(30, 1.3 / 30, 60)))
    notes = fit_plan(small_plan(), attempts(late)).notes
    assert any("A: it changed during the run" in note for note in notes)


def test_an_outcome_that_depends_on_the_time_is_said() -> None:
    generator = source(24)
    seen = attempts(generator.gamma(9, 0.1, 50), result="ab")
    seen += attempts(generator.gamma(9, 0.3, 50), result="aa")
    notes = fit_plan(small_plan(), seen).notes
    assert any("duration and outcome depend on each other: aa takes 2." in n for n in notes)


def test_times_of_no_family_become_quantiles() -> None:
    generator = source(25)
    times = np.where(generator.random(400) < 0.5, 1.0, 5.0) + generator.uniform(0, 0.2, 400)
    report = fit_plan(small_plan(), attempts(times))
    found = report.places["A"]
    assert found.fit is not None
    assert found.fit.duration.kind is Kind.EMPIRICAL
    assert any("quantiles take its place" in note for note in report.notes)
    short = fit_plan(small_plan(), attempts(times[:50]))
    assert short.places["A"].fit.duration.kind is not Kind.EMPIRICAL
    assert any("do not follow" in note for note in short.notes)


def test_the_same_data_give_the_same_report() -> None:
    seen = attempts(source(26).gamma(2.0, 1.0, 80))
    assert fit_plan(small_plan(), seen).to_json() == fit_plan(small_plan(), seen).to_json()


def test_shape_of_each_family() -> None:
    assert DurationFit(Duration.uniform(0, 1), (0, 1), None, 2).shape is None
    assert DurationFit(Duration.erlang(3, 1.0), (0, 1), None, 2).shape == 3.0


# -- the verb --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: Any) -> Any:
    """A folder with a plan that names the files of its net and policy, and the log of a virtual run
    in which its actions take other times than it says."""
    folder = tmp_path_factory.mktemp("fit")
    net = NetBuilder("n").place("A", tokens=2).place("B")
    net.exponential("ab", inputs="A", outputs="B").exponential("aa", inputs="A", outputs="A")
    net.exponential("ba", inputs="B", outputs="A")
    write_net(net.build(), str(folder / "net.xml"), "pipe")
    plan = {
        "plan": "taught",
        "description": "kept",
        "net": "net.xml",
        "actions": {"A": "actions.act", "B": "actions.act"},
        "timeout": {"*": 30.0},
        "durations": {"B": {"mean": 9.0}},
    }
    (folder / "actions.py").write_text("def act():\n    pass\n")
    (folder / "plan.json").write_text(json.dumps(plan))
    truth = read_plan(str(folder))
    times = {"A": Duration.gamma(20.0, 2.0), "B": Duration.exponential(1.0)}
    chances = {"A": {"ab": 0.25, "aa": 0.75}}
    run = VirtualRun(replace(truth, durations=times, outcomes=chances).validate(), seed=2)
    first = header(truth, "taught", "", "log1", agents=True, virtual=True)
    log = EventLogWriter(str(folder / "log.jsonl"), first, clocks=run.clocks)
    run.record_to(log)
    run.run(300.0)
    log.close()
    return folder


@pytest.mark.long
def test_the_verb_writes_a_plan_with_what_it_learned(recorded, capsys) -> None:
    out = recorded / "new.json"
    code = main(["fit", str(recorded), str(recorded / "log.jsonl"), "-o", str(out), "--json"])
    report = json.loads(capsys.readouterr().out)
    assert code == 0
    assert report["places"]["A"]["distribution"] == "gamma"
    assert report["places"]["A"]["censored"] > 0
    low, high = report["places"]["A"]["interval"]
    assert low < 2.0 < high
    new = json.loads(out.read_text())
    old = json.loads((recorded / "plan.json").read_text())
    assert {k: new[k] for k in old if k != "durations"} == {
        k: old[k] for k in old if k != "durations"
    }
    assert set(new) - set(old) == {"outcomes"}
    assert new["durations"]["A"]["of"]["logs"] == ["log.jsonl"]
    assert new["durations"]["A"]["of"]["observations"] == report["places"]["A"]["n"]
    plan = read_plan(str(out))
    assert plan.durations["B"].mean == pytest.approx(1.0, rel=0.3)
    assert plan.evidence["outcomes", "A"].observations == report["places"]["A"]["n"]
    assert main(["check", str(out)]) == 0


@pytest.mark.long
def test_the_verb_says_how_much_more_log_it_needs(recorded, capsys) -> None:
    words = ["fit", str(recorded), str(recorded / "log.jsonl"), "-o", str(recorded / "needs.json")]
    assert main([*words, "--within", "100"]) == 0
    assert "every value is known to 100 %" in capsys.readouterr().out
    assert main([*words, "--force", "--within", "0.5"]) == 0
    told = capsys.readouterr().out
    assert "duration of A: known to" in told and "robot-hours more" in told


def test_the_verb_does_not_overwrite_unless_told_to(recorded, capsys, tmp_path) -> None:
    out = tmp_path / "new.json"
    out.write_text("mine")
    words = ["fit", str(recorded), str(recorded / "log.jsonl"), "-o", str(out)]
    assert main(words) == 2
    assert "--force" in capsys.readouterr().err
    assert out.read_text() == "mine"
    assert main([*words, "--force", "--durations", "exponential"]) == 0
    said = capsys.readouterr()
    assert "actions.py belongs beside the plan" in said.err
    assert "exponential" in said.out
    assert read_plan(str(out)).durations["A"].kind is Kind.EXPONENTIAL


@pytest.mark.long
@pytest.mark.parametrize("name", [".", "a/new"])
def test_the_verb_fills_a_folder(recorded, tmp_path, name) -> None:
    folder = tmp_path / name
    assert main(["fit", str(recorded), str(recorded), "-o", str(folder)]) == 0
    assert (folder / "actions.py").exists()
    assert read_plan(str(folder)).durations["A"].kind is Kind.GAMMA


@pytest.mark.long
def test_a_folder_that_cannot_be_made_is_reported(recorded, capsys) -> None:
    taken = recorded / "log.jsonl"
    words = ["fit", str(recorded), str(taken), "-o", str(taken / "new")]
    assert main(words) == 2
    assert "cannot create the folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("plan", "log", "message"),
    [
        ("plans/patrol/net.xml", "log.jsonl", "this is a net, not a plan"),
        ("plans/tokens", "log.jsonl", "its net differs"),
        (".", "plan.json", "not an event log"),
        (".", "missing.jsonl", "cannot be read"),
        (".", "empty", "contains no event logs"),
    ],
)
def test_wrong_input_is_reported_in_a_line(recorded, capsys, tmp_path, plan, log, message) -> None:
    (recorded / "empty").mkdir(exist_ok=True)
    out = tmp_path / "new.json"
    plan = str(recorded) if plan == "." else plan
    assert main(["fit", plan, str(recorded / log), "-o", str(out)]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_the_fit_is_plotted(recorded, capsys, tmp_path) -> None:
    log, picture = str(recorded / "log.jsonl"), tmp_path / "fit.svg"
    assert main(["plot", str(recorded), "--fit", log, "-o", str(picture)]) == 0
    assert picture.stat().st_size > 10_000
    words = ["plot", str(recorded), "--fit", log, "-o", str(picture)]
    for more, message in (
        (["--only", "Z"], "there is no 'Z'"),
        (["--what", "throughput"], "do not apply"),
    ):
        assert main([*words, *more]) == 2
        assert message in capsys.readouterr().err
    assert main(["plot", str(recorded / "net.xml"), "--fit", log, "-o", str(picture)]) == 2


def test_a_figure_has_a_row_for_each_place_even_if_nothing_varies() -> None:
    seen = attempts([2.0] * 9) + attempts(source(30).gamma(2, 1, 50), place="B")
    seen += attempts([1.0, 3.0], place="B", completed=False)
    figure = fit_figure(fit_plan(small_plan(), seen).places)
    assert len(figure.axes) == 4
    histogram = figure.axes[2].patches
    assert sum(bar.get_height() * bar.get_width() for bar in histogram) == pytest.approx(
        1, abs=0.05
    )


@pytest.mark.long
@pytest.mark.parametrize("hold", [False, True])
def test_the_rate_of_an_event_is_learned_and_what_it_cuts_off_is_censored(tmp_path, hold):
    net = (
        NetBuilder("guards")
        .place("Work", 3)
        .place("Charge")
        .place("Dock", 1)
        .exponential("finish", rate=1, inputs="Work", outputs="Work")
        .exponential("low", rate=0.3, inputs=["Work", "Dock"], outputs="Charge")
        .exponential("full", rate=1, inputs="Charge", outputs=["Work", "Dock"])
        .build()
    )
    act = FunctionAction("actions.work", "work")
    plan = Plan(
        net,
        actions={"Work": act, "Charge": act},
        resource_places=frozenset(["Dock"]),
        robots=tuple(RobotSpec("r%d" % i, "Work") for i in range(3)),
        durations={"Work": Duration.erlang(4, 3.0)},
        events={"low": EventSource("battery", "a/B", hold=hold)},
    ).validate()
    path = str(tmp_path / "run.jsonl")
    run = VirtualRun(plan, seed=7)
    log = run.record_in(path, "run", "1")
    run.run(time=1_500.0)
    log.close()
    found = gather([path])
    assert set(found.events) == {"low"}
    report = fit_plan(found.plan, found.attempts, found.events, samples=0)
    low, high = report.rates["low"].interval
    assert low < 0.3 < high and report.rates["low"].seen > 100
    work = report.places["Work"]
    assert work.outcomes == {} and work.censored > 100
    assert work.fit.duration.mean == pytest.approx(3.0, rel=0.1)
    learned = report.apply(plan, [path])
    assert learned.rates == {"low": report.rates["low"].rate}

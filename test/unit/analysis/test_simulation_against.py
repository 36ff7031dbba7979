"""Two plans, simulated as they run: what is said about their difference is right."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gspn_framework_package.analysis.decisions.aims import Aim, Objective
from gspn_framework_package.analysis.simulation import against, kernel, paired_estimates, pairs
from gspn_framework_package.analysis.simulation.against import compare_plans
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import CancelledError, UsageError
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy

#: A robot takes the slow or the quick way, again and again; `trips` counts.
NET = (
    NetBuilder()
    .place("choose", 1)
    .place("slow")
    .place("quick")
    .place("trips")
    .immediate("take_slow", inputs="choose", outputs="slow")
    .immediate("take_quick", inputs="choose", outputs="quick")
    .exponential("slow_done", rate=0.5, inputs="slow", outputs=("choose", "trips"))
    .exponential("quick_done", rate=2.0, inputs="quick", outputs=("choose", "trips"))
    .build()
)
ACT = FunctionAction("actions.drive", "drive")


def choosing(**choices):
    return Policy.from_table((), [((), choices)])


SLOW = Plan(
    NET,
    policy=choosing(take_slow=1.0),
    actions={"choose": None, "slow": ACT, "quick": ACT},
    resource_places=frozenset(["trips"]),
    robots=(RobotSpec("r", "choose"),),
).validate()
QUICK = SLOW.with_policy(choosing(take_quick=1.0))
BOTH = SLOW.with_policy(choosing(take_slow=0.5, take_quick=0.5))
TRIPS = {"slow_done": 1.0, "quick_done": 1.0}


def near(measured, value, widths=2.0):
    """Whether a value is within so many half widths of the estimate."""
    half = (measured.high - measured.low) / 2
    return abs(measured.mean - value) <= widths * half and half > 0


@pytest.mark.long
@pytest.mark.parametrize(
    ("objective", "old", "new"),
    [
        (Objective.long_run(TRIPS), 0.5, 2.0),
        (Objective.long_run({"slow": 3.0, "quick_done": 1.0}), 3.0, 2.0),
        (Objective.time_to("trips >= 3"), 6.0, 1.5),
        (Objective.cost_to("trips >= 3", {"slow": 2.0, "take_quick": 0.25}), 12.0, 0.75),
        # one trip per 1 / rate seconds: the rate over the discount
        (Objective.discounted(TRIPS, 0.2), 2.5, 10.0),
    ],
)
def test_the_values_are_those_of_the_model(objective, old, new):
    found = compare_plans(SLOW, QUICK, objective, replications=150, seconds=None, seed=3)
    for measured, value in ((found.old, old), (found.new, new), (found.difference, new - old)):
        exact = measured.high - measured.low < 1e-9 * abs(value)
        assert measured.mean == pytest.approx(value) if exact else near(measured, value)
    assert found.significant and found.better == ((new > old) == objective.maximise)
    assert ("better" if found.better else "worse") in found.text


@pytest.mark.long
def test_the_durations_of_the_run_count():
    """Exponential rates favour the quick way; the learned durations do not."""
    plans = [
        replace(
            plan,
            durations={"slow": Duration.gamma(30.0, 1.0), "quick": Duration.deterministic(4.0)},
        )
        for plan in (SLOW, QUICK)
    ]
    found = compare_plans(*plans, Objective.long_run(TRIPS), replications=30, seconds=None)
    assert found.old.mean == pytest.approx(1.0, rel=0.05)
    assert found.new.mean == pytest.approx(0.25, rel=0.02)
    assert found.significant and found.better is False


def test_equal_plans_do_not_differ_at_all():
    found = compare_plans(BOTH, BOTH, Objective.long_run(TRIPS), replications=20, seconds=None)
    assert found.difference[:3] == (0.0, 0.0, 0.0)
    assert not found.significant and found.better is None
    assert "no difference at all" in found.text
    assert found.old.high > found.old.low


@pytest.mark.long
def test_a_small_difference_is_not_claimed_and_its_price_is_reported():
    # in the other order, so that the same random numbers do not make the same choices
    almost = SLOW.with_policy(choosing(take_quick=0.498, take_slow=0.502))
    found = compare_plans(
        BOTH, almost, Objective.long_run(TRIPS), replications=40, seconds=None, expected=0.002
    )
    assert not found.significant and found.better is None
    assert "not significant" in found.text and "detecting a difference of 0.002" in found.text
    assert found.needed["size"] == 0.002 and found.needed["pairs"] > 40
    # four times the size takes a sixteenth of the runs
    bigger = compare_plans(
        BOTH, almost, Objective.long_run(TRIPS), replications=40, seconds=None, expected=0.008
    )
    assert bigger.needed["pairs"] == pytest.approx(found.needed["pairs"] / 16, rel=0.01)
    json.dumps(found.to_json(), allow_nan=False)


@pytest.mark.long
def test_intervals_cover_what_they_should():
    """95 % intervals of a known difference, 200 times; the slow way varies 16 times as much."""
    hits = 0
    for seed in range(200):
        found = compare_plans(
            SLOW,
            QUICK,
            Objective.time_to("trips >= 4"),
            replications=20,
            seconds=None,
            seed=seed,
        )
        hits += found.difference.low <= 2.0 - 8.0 <= found.difference.high
    assert 0.9 <= hits / 200 <= 0.985


def test_intervals_of_paired_shares_cover_what_they_should():
    generator = np.random.default_rng(5)
    for common, odd in ((0.4, 0.1), (0.9, 0.02), (0.0, 0.5)):
        hits = 0
        for _ in range(1000):
            u = generator.random(60)
            old, new = u < common, u < common + odd
            found = paired_estimates.paired_shares(old, new, 0.95)
            hits += found.low <= odd <= found.high
        assert 0.93 <= hits / 1000


#: A risky way fails three times of ten, for good.
RISK = (
    NetBuilder()
    .place("choose", 1)
    .place("risky")
    .place("there")
    .place("lost")
    .immediate("dare", inputs="choose", outputs="risky")
    .immediate("walk", inputs="choose", outputs="there")
    .exponential("good", rate=0.7, inputs="risky", outputs="there")
    .exponential("bad", rate=0.3, inputs="risky", outputs="lost")
    .build()
)
DARE = Plan(
    RISK,
    policy=choosing(dare=1.0),
    actions={"choose": None, "risky": ACT, "there": None, "lost": None},
    robots=(RobotSpec("r", "choose"),),
).validate()
WALK = DARE.with_policy(choosing(walk=1.0))


def test_the_probability_to_reach():
    found = compare_plans(
        DARE, WALK, Objective.reach("there == 1"), replications=400, seconds=None, seed=1
    )
    assert near(found.old, 0.7) and found.new.mean == 1.0 and found.new.low > 0.98
    assert near(found.difference, 0.3) and found.significant and found.better
    assert not any("are unfinished" in note for note in found.notes)


def test_what_is_never_reached_has_no_mean_time():
    found = compare_plans(
        DARE, WALK, Objective.time_to("there == 1"), replications=50, seconds=None
    )
    assert found.old.mean is None and "never reach the condition" in found.old.why
    assert found.new.mean == 0.0 and not found.significant
    assert found.text.startswith("not decided") and "never reach" in found.text
    data = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert data["difference"]["mean"] is None and data["old"]["why"]


def test_a_run_that_never_ends_is_given_up(monkeypatch):
    monkeypatch.setattr(pairs, "_PATIENCE", 0.2)
    found = compare_plans(SLOW, QUICK, Objective.time_to("slow == 2"), seconds=0.5)
    assert found.difference.mean is None and not found.significant
    assert "is unfinished after" in found.text and any("abandoned" in note for note in found.notes)


@pytest.mark.long
def test_a_slow_start_is_left_out():
    """100 robots enter a ring through one place; in the long run they are spread evenly."""
    net = NetBuilder()
    for k in range(4):
        net.place("p%d" % k, 20 if k == 0 else 0)
    for k in range(4):
        net.exponential(
            "t%d" % k, rate=0.05, inputs="p%d" % k, outputs="p%d" % ((k + 1) % 4), servers=None
        )
    plan = Plan(
        net.build(),
        actions={"p%d" % k: ACT for k in range(4)},
        robots=tuple(RobotSpec("r%d" % k, "p0") for k in range(20)),
    ).validate()
    found = compare_plans(
        plan, plan, Objective.long_run({"p0": 1.0}), replications=20, seconds=None
    )
    assert found.warmup > 20.0
    assert near(found.old, 5.0, 2.5) and any("MSER" in note for note in found.notes)
    cut = compare_plans(
        plan,
        plan,
        Objective.long_run({"p0": 1.0}),
        replications=40,
        seconds=None,
        warmup=0.0,
        time=60.0,
    )
    assert any("have not settled" in note for note in cut.notes)


@pytest.mark.long
def test_a_team_that_starts_in_one_place_has_unbiased_means():
    """All robots of the patrol begin in one place; 1.28168 is the exact value."""
    plan = read_plan(Path(__file__).parents[3] / "plans" / "patrol")
    aim = Objective.long_run({t.name: 1.0 for t in plan.net.transitions if ":Go_Check" in t.name})
    misses = []
    for seed in range(10):
        old = compare_plans(plan, plan, aim, replications=20, seconds=None, seed=seed).old
        misses.append(2 * (old.mean - 1.28168) / (old.high - old.low))
    # half of a half width is a standard deviation, and the mean of ten varies a third of that
    assert abs(np.mean(misses)) < 0.6


def test_a_run_that_ends_keeps_its_marking():
    found = compare_plans(
        DARE, WALK, Objective.long_run({"there": 2.0}), replications=200, seconds=None, seed=2
    )
    assert near(found.old, 1.4) and found.new.mean == pytest.approx(2.0)
    assert any("the marking then stays" in note for note in found.notes)


@pytest.mark.long
def test_the_budget_and_the_precision_end_it():
    quick = compare_plans(SLOW, QUICK, Objective.long_run(TRIPS), seconds=1e-9)
    assert quick.pairs == against.LEAST_PAIRS
    wide = compare_plans(BOTH, QUICK, Objective.long_run(TRIPS), seconds=None, precision=0.1)
    half = (wide.difference.high - wide.difference.low) / 2
    assert half <= 0.1 * wide.old.mean and 40 <= wide.pairs < 1000


@pytest.mark.long
def test_the_same_seed_gives_the_same_answer():
    def run(seed):
        return compare_plans(
            BOTH, QUICK, Objective.long_run(TRIPS), replications=20, seconds=None, seed=seed
        ).to_json()

    assert run(4) == run(4) != run(5)


@pytest.mark.long
def test_it_can_be_cancelled_and_tells_its_progress(monkeypatch):
    with pytest.raises(CancelledError):
        compare_plans(BOTH, QUICK, Objective.long_run(TRIPS), cancel=lambda: True)
    told = []
    compare_plans(
        BOTH,
        QUICK,
        Objective.long_run(TRIPS),
        seconds=1.2,
        progress=lambda what, count, seconds: told.append((what, count)),
    )
    assert told and told[-1][0] == "firings" and told[-1][1] > 100


@pytest.mark.long
def test_pairs_with_the_same_random_numbers_show_small_differences():
    almost = SLOW.with_policy(choosing(take_slow=0.502, take_quick=0.498))
    found = compare_plans(
        BOTH, almost, Objective.long_run(TRIPS), replications=40, seconds=None, time=400.0, warmup=9
    )
    # by the model: 1 / 1.253 - 1 / 1.25
    assert found.correlation > 0.9 and near(found.difference, 1 / 1.253 - 1 / 1.25)
    alone = (found.old.high - found.old.low) / 2
    assert (found.difference.high - found.difference.low) / 2 < alone / 3


@pytest.mark.long
def test_a_warm_up_that_is_too_short_is_lengthened():
    """A robot leaves for good after a hundred seconds or so: the first runs do not show it."""
    net = NetBuilder().place("busy", 1).place("gone")
    net.exponential("work", rate=1.0, inputs="busy", outputs="busy")
    net.exponential("leave", rate=0.01, inputs="busy", outputs="gone")
    plan = Plan(
        net.build(), actions={"busy": ACT, "gone": None}, robots=(RobotSpec("r", "busy"),)
    ).validate()
    aim = Objective.long_run({"work": 1.0})
    found = compare_plans(plan, plan, aim, seconds=None, replications=100)
    assert found.old.low <= 0.01 and found.warmup > 150.0
    assert any("later ones that still changed" in note for note in found.notes)


@pytest.mark.parametrize(
    ("objective", "options", "message"),
    [
        (Objective.long_run({"nowhere": 1.0}), {}, "'nowhere'"),
        (Objective.long_run({"no*": 1.0}), {}, "nothing in the net matches 'no"),
        (Objective.long_run(TRIPS), {"replications": 1}, "are too few for an interval"),
        (Objective.long_run(TRIPS), {"confidence": 1.0}, "confidence of 1"),
        (Objective.long_run(TRIPS), {"seconds": 0.0}, "a time of 0 s"),
        (Objective.long_run(TRIPS), {"warmup": 5.0, "time": 5.0}, "warm-up of 5"),
        (Objective.time_to("slow == 1"), {"time": 5.0}, "end by themselves"),
        (Objective.reach("slow == 1"), {"warmup": 5.0}, "for the long run only"),
    ],
)
def test_what_makes_no_sense_is_refused(objective, options, message):
    with pytest.raises(UsageError, match=message):
        compare_plans(SLOW, QUICK, objective, **options)


def test_a_pattern_of_rewards_has_to_match_the_same_in_both_plans():
    aim = Objective.long_run({"*_done": 1.0})
    found = compare_plans(BOTH, QUICK, aim, replications=4, seconds=None, time=20.0)
    assert found.objective == Objective.long_run(TRIPS)
    more = NetBuilder().place("choose", 1).exponential("done", rate=1.0, inputs="choose")
    other = Plan(more.exponential("more_done", rate=1.0, inputs="choose").build())
    with pytest.raises(UsageError, match="which one of the two plans lacks"):
        compare_plans(SLOW, other, aim, replications=4, seconds=None)


@pytest.mark.long
def test_other_durations_are_pointed_out():
    other = replace(QUICK, durations={"quick": Duration.deterministic(1.0)})
    found = compare_plans(SLOW, other, Objective.long_run(TRIPS), replications=5, seconds=None)
    assert "the plans differ in more than their policies" in found.notes


def test_the_rule_for_the_warm_up():
    generator = np.random.default_rng(1)
    settled = generator.normal(5.0, 1.0, 40)
    assert paired_estimates.truncation(settled) < 10
    falling = settled + 100.0 * np.exp(-np.arange(40) / 2.0)
    assert 6 <= paired_estimates.truncation(falling) <= 20
    assert paired_estimates.truncation(np.arange(40.0)) == 40  # it never settles


def test_the_pairs_that_are_needed():
    # (1.96 + 0.84)^2 for a difference of one standard deviation
    assert paired_estimates.pairs_needed(1.0, 1.0, 0.95) == math.ceil(7.849)
    assert Objective.long_run({}).aim is Aim.LONG_RUN and kernel.MORE == 0

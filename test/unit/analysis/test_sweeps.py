"""Sweeps: the grid, what is varied, and what is measured at each point."""

import pytest
from running_plans import WORK

from gspn_framework_package.analysis.executors import LocalExecutor, open_executor
from gspn_framework_package.analysis.simulation import Asked, simulate
from gspn_framework_package.analysis.sweeps.sweep import Sweep, chosen, measures_of
from gspn_framework_package.analysis.sweeps.variation import grid, read_variation, varied
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import CancelledError, RefusedError, UsageError
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy

NET = (
    NetBuilder()
    .place("up", tokens=1)
    .place("down")
    .place("spare", tokens=2)
    .exponential("fail", rate=1.0, inputs="up", outputs="down")
    .exponential("repair", rate=3.0, inputs="down", outputs="up")
    .exponential("use", rate=1.0, inputs="spare", outputs="spare")
    .place("never")
    .immediate("skip", inputs="never", outputs="up")
    .build()
)
FOREVER = (
    NetBuilder().place("a", 1).place("b").exponential("go", rate=1.0, inputs="a", outputs="b")
).build()


def a_plan(**more):
    net = (
        NetBuilder()
        .place("work", 1)
        .place("rest")
        .place("tool", 1)
        .exponential("done", rate=2.0, inputs="work", outputs="rest")
        .exponential("rested", rate=1.0, inputs="rest", outputs="work")
        .exponential("wear", rate=1.0, inputs="tool", outputs="tool")
        .build()
    )
    return Plan(
        net,
        actions={"work": WORK, "rest": WORK},
        robots=(RobotSpec("r", "work"),),
        resource_places=frozenset({"tool"}),
        **more,
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("robots", "write robots=1..20"),
        ("robots=", "write robots"),
        ("robots:r=1", "write robots"),
        ("rate=1", "write robots"),
        ("speed:x=1", "write robots"),
        ("robots=0", "'0' is not a number of robots"),
        ("robots=1..2.5", "'1..2.5' is not"),
        ("robots=3..1", "'3..1' is not"),
        ("robots=1,1..3", "a value twice"),
        ("rate:x=0", "'0' is not a rate above 0"),
        ("rate:x=nan", "'nan' is not"),
        ("rate:x=inf", "'inf' is not"),
        ("failure:x=1", "'1' is not a probability"),
        ("policy=a,,b", "'' is not a file"),
    ],
)
def test_what_is_no_variation_is_refused(text, message):
    with pytest.raises(UsageError, match="--vary.*" + message.replace("..", r"\.\.")):
        read_variation(text)


def test_the_grid_has_every_combination():
    variations = [read_variation("robots=1..2"), read_variation("rate:x=0.5,1")]
    assert grid(variations) == [(1, 0.5), (1, 1.0), (2, 0.5), (2, 1.0)]
    with pytest.raises(UsageError, match="robots is given twice"):
        grid([variations[0], read_variation("robots=7")])
    with pytest.raises(UsageError, match="100,000 are possible"):
        grid([read_variation("tokens:x=1..1000"), read_variation("tokens:y=1..1000")])


def one(subject, text, timing="run", policies=None):
    variation = read_variation(text)
    return varied(subject, [variation], variation.values, policies or {}, timing)


def test_each_kind_changes_what_it_says():
    plan = a_plan(durations={"work": Duration.gamma(4.0, 2.0)})
    assert len(one(plan, "robots=3").robots) == 3
    assert one(plan, "rate:wear=5").net.transition("wear").rate == 5
    found = one(plan, "duration:work=8").durations["work"]
    assert (found.mean, found.variation) == (8, plan.durations["work"].variation)
    assert one(plan, "failure:work=0.25").failures == {"work": 0.25}
    assert one(plan, "tokens:tool=4").net.initial_marking == (1, 0, 4)
    policy = Policy()
    assert one(plan, "policy=a.json", policies={"a.json": policy}).policy is policy
    assert one(NET, "rate:fail=9").transition("fail").rate == 9
    assert one(NET, "tokens:up=2").initial_marking == (2, 0, 2, 0)


@pytest.mark.parametrize(
    ("subject", "text", "message"),
    [
        (NET, "robots=2", "this is a net"),
        (NET, "rate:skip=2", "no exponential transition 'skip' .there are: fail, repair, use"),
        (NET, "tokens:x=2", "no place 'x'"),
        (a_plan(), "tokens:work=2", "vary robots"),
        (a_plan(), "duration:work=2", "no effective duration there"),
        (a_plan(), "failure:tool=0.5", "no action in a place 'tool' .there are: work, rest"),
        (
            a_plan(durations={"work": Duration.exponential(1.0)}),
            "rate:done=2",
            "the duration of the action in work counts, not the rate .vary duration:work",
        ),
    ],
)
def test_what_does_not_fit_is_refused_by_name(subject, text, message):
    with pytest.raises(UsageError, match="^%s.*: .*%s" % (text.split("=")[0], message)):
        one(subject, text)


@pytest.mark.long
def test_each_point_is_what_a_simulation_of_it_says():
    asked = Asked(time=20.0, replications=60, seed=5)
    sweep = Sweep(NET, [read_variation("rate:fail=1,2")], asked)
    points = sorted(sweep.run())
    assert [point.values for point in points] == [(1.0,), (2.0,)]
    for point in points:
        net = NET.with_rates({"fail": point.values[0]})
        result = simulate(net, time=20.0, replications=60, seed=5)
        assert point.measures == measures_of(result)
        assert point.replications == 60
    assert sweep.title(1) == "rate:fail=2"


def test_points_come_as_they_are_measured_and_known_ones_first():
    sweep = Sweep(NET, [read_variation("tokens:up=1..3")], Asked(time=5.0, replications=60))
    first = next(sweep.run())
    again = list(sweep.run({first.key: first._replace(number=9, values=())}))
    assert again[0] == first
    assert sorted(again) == sorted(sweep.run())


def test_a_key_says_all_that_a_point_depends_on():
    def keys(subject=NET, text="rate:fail=1,2", exact=False, **asked):
        return Sweep(subject, [read_variation(text)], Asked(5.0, **asked), exact=exact).keys

    every = [keys(), keys(seed=1), keys(exact=True), keys(replications=3), keys(warmup=1.0)]
    every += [keys(NET.with_rates({"repair": 4.0})), keys(text="rate:fail=5,7")]
    flat = [key for found in every for key in found]
    assert len(set(flat)) == len(flat)
    assert keys() == keys()
    assert keys(text="rate:fail=2,8")[0] == keys()[1]


def test_a_precision_is_reached_at_every_point():
    asked = Asked(time=5.0, precision=0.3, measures=("fail",))
    sweep = Sweep(NET, [read_variation("rate:fail=0.2,5")], asked)
    runs = {point.values[0]: point.replications for point in sweep.run()}
    assert runs[0.2] > runs[5.0] >= 30


def test_exact_points_are_those_of_the_chain():
    sweep = Sweep(NET, [read_variation("rate:fail=1,3")], exact=True)
    found = {point.values[0]: point.measures["throughput"]["fail"] for point in sweep.run()}
    assert found[1.0] == (pytest.approx(0.75), 0.0)
    assert found[3.0] == (pytest.approx(1.5), 0.0)


@pytest.mark.long
def test_workers_give_the_same_points():
    plan = a_plan(durations={"work": Duration.gamma(4.0, 2.0)})
    variations = [read_variation("robots=1..2"), read_variation("rate:wear=1,2")]
    for exact in (False, True):
        sweep = Sweep(plan, variations, Asked(time=5.0, replications=70), exact=exact)
        with open_executor("processes:2") as executor:
            assert sorted(sweep.run(on=executor)) == sorted(sweep.run())


def test_an_error_names_its_point():
    sweep = Sweep(FOREVER, [read_variation("rate:go=1,2")], Asked(until="a = 9"))
    with pytest.raises(RefusedError, match="^rate:go=1: a run stays in .b: 1."):
        list(sweep.run())


def test_a_sweep_can_be_cancelled_and_what_was_told_is_kept():
    sweep = Sweep(NET, [read_variation("tokens:up=1..3")], Asked(time=5.0, replications=60))
    told = []
    with pytest.raises(CancelledError):
        for point in sweep.run(on=LocalExecutor(), watch=Watch(cancel=lambda: bool(told))):
            told.append(point)
    assert len(told) == 1


def test_names_and_patterns_choose_measures():
    assert chosen(NET, ["fail", "up", "end_time"], True) == [
        ("throughput", "fail"),
        ("mean_tokens", "up"),
        ("end_time", ""),
    ]
    assert chosen(NET, ["*e*"], False)[:2] == [("throughput", "repair"), ("throughput", "use")]
    assert len(chosen(NET, [], False)) == 4
    assert chosen(NET, [], True) == [("end_time", ""), ("reached", "")]
    with pytest.raises(UsageError, match="no 'x' to measure"):
        chosen(NET, ["x"], False)

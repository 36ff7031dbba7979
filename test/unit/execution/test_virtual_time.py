"""The token game in virtual time: it follows a run's rules, and its log is a real one."""

import contextlib
import math
from collections import Counter
from dataclasses import replace

import pytest
from game_driver import make_plan
from test_reacting import guard_net, shop_net
from test_task_orders import net_with_way_out, plan_of

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import Plan, RobotSpec

pytestmark = pytest.mark.long

ACT = FunctionAction("actions.work", "work")


def two_places(**settings):
    net = (
        NetBuilder()
        .place("a", 1)
        .place("b")
        .exponential("t", rate=1, inputs="a", outputs="b")
        .exponential("u", rate=1, inputs="b", outputs="a")
        .build()
    )
    return Plan(
        net, actions={"a": ACT, "b": ACT}, robots=(RobotSpec("r", "a"),), **settings
    ).validate()


FIXED = {"a": Duration.deterministic(2.0), "b": Duration.deterministic(3.0)}


def test_tokens_and_firings_are_counted_by_time():
    result = VirtualRun(two_places(durations=FIXED)).run(time=50.0)
    assert result.firings == {"t": 10, "u": 10}
    assert result.mean_tokens == {"a": pytest.approx(0.4), "b": pytest.approx(0.6)}
    late = VirtualRun(two_places(durations=FIXED)).run(time=50.0, warmup=11.0)
    assert late.firings["t"] == 8
    assert late.seconds == 39.0


def test_a_partner_is_waited_for_while_the_own_action_goes_on():
    """Both robots act at the same time, so a meeting takes as long as the longer of the two."""
    net = (
        NetBuilder()
        .place("a", 1)
        .place("b", 1)
        .exponential("meet", rate=1, inputs=["a", "b"], outputs=["a", "b"])
        .build()
    )
    plan = Plan(
        net,
        actions={"a": ACT, "b": ACT},
        robots=(RobotSpec("r1", "a"), RobotSpec("r2", "b")),
        durations=FIXED,
    ).validate()
    assert VirtualRun(plan).run(time=31.0).firings["meet"] == 10


def test_failures_retries_and_timeouts():
    plan = two_places(
        durations=FIXED,
        timeouts={"b": 1.0},
        on_failure={
            "a": FailureRule.retry(1000, 0.5),
            "b": FailureRule.fire("u"),
        },
        failures={"a": 0.5},
    )
    run = VirtualRun(plan, seed=5)
    result = run.run(time=20_000.0)
    # in a: as many attempts as a geometric variable, 2 s each and 0.5 s between; in b: 1 s
    cycle = 2.0 * 2 + 0.5 + 1.0
    assert result.throughput("u") == pytest.approx(1 / cycle, rel=0.05)


def test_a_lost_robot_takes_no_further_part():
    plan = Plan(
        two_places().net.with_marking({"a": 2}),
        actions={"a": ACT, "b": ACT},
        robots=(RobotSpec("r1", "a"), RobotSpec("r2", "a")),
        durations=FIXED,
    ).validate()
    result = VirtualRun(plan, agents=False, loss_rate=1.0, seed=1).run(time=1000.0)
    assert result.firings["t"] == pytest.approx(200, abs=10)  # the last robot stays


def test_the_log_is_verified_and_has_virtual_times(tmp_path):
    plan = two_places(until=None)
    run = VirtualRun(plan, seed=3)
    path = str(tmp_path / "run.jsonl")
    writer = run.record_in(path, "run", "1")
    result = run.run(firings=200)
    writer.close()
    log = read_log(path)
    assert log.header["clock"] == "virtual"
    assert log.records[0]["mono"] == 0.0
    assert log.records[-1]["mono"] == pytest.approx(result.time, abs=1e-6)
    assert sum(len(r.get("firings", ())) for r in log.records) == 200
    verdict = verify([log])
    assert verdict.violation is None
    assert verdict.firings == 200


def test_a_run_is_made_once_and_repeats_with_its_seed():
    first = VirtualRun(two_places(), seed=9).run(time=100.0)
    assert first == VirtualRun(two_places(), seed=9).run(time=100.0)
    assert first != VirtualRun(two_places(), seed=10).run(time=100.0)
    run = VirtualRun(two_places())
    run.run(time=1.0)
    with pytest.raises(UsageError, match="started before"):
        run.run(time=1.0)
    assert math.isfinite(first.time)


# -- events and tasks --------------------------------------------------------------------------


def charging(robots=1, hold=False, seconds=1e6, **settings):
    """Robots work for that long, unless an event sends them to the charger, which has one dock."""
    return make_plan(
        guard_net(),
        ["Work"] * robots,
        ["Dock"],
        durations={"Work": Duration.exponential(seconds), "Charge": Duration.exponential(1.0)},
        outcomes={"Work": {"finish": 1.0}},
        events={"low": EventSource("battery", "a/B", hold=hold)},
        **settings,
    )


def test_events_come_at_their_rate_and_cancel_actions():
    result = VirtualRun(charging()).run(time=30_000.0)
    assert result.throughput("low") == pytest.approx(1 / 11, rel=0.05)
    assert result.firings["finish"] == 0
    # they come whatever the robot is up to, and how often its action is done
    result = VirtualRun(charging(seconds=1.0)).run(time=10_000.0)
    assert result.throughput("low") == pytest.approx(1 / 11, rel=0.05)
    assert result.throughput("finish") == pytest.approx(10 / 11, rel=0.05)


def test_a_robot_that_waits_is_interrupted_too():
    net = (
        NetBuilder()
        .place("a", 1)
        .place("b")
        .place("gone")
        .place("key")
        .immediate("go", inputs=["a", "key"], outputs="b")
        .exponential("called", rate=0.5, inputs="a", outputs="gone")
        .build()
    )
    plan = make_plan(net, ["a"], ["key"], idle=["a", "gone"], events={"called": EventSource()})
    result = VirtualRun(plan, seed=1).run(time=1000.0)
    assert result.firings == {"go": 0, "called": 1}
    assert result.ended is not None and result.ended.finished


def test_an_event_that_cannot_fire_is_lost_unless_it_is_held():
    lost = VirtualRun(charging(2), seed=2).run(time=12_000.0)
    assert lost.throughput("low") == pytest.approx(1 / 6, rel=0.03)
    held = VirtualRun(charging(2, hold=True), seed=2).run(time=12_000.0)
    assert held.throughput("low") == pytest.approx(1.1 / 6.1, rel=0.03)


def test_events_of_time_are_exact():
    plan = replace(charging(), events={"low": EventSource(after=5.0)}).validate()
    plan = replace(plan, durations={**plan.durations, "Charge": Duration.deterministic(2.0)})
    result = VirtualRun(plan).run(time=701.0)
    assert result.firings["low"] == 100
    assert result.mean_tokens["Work"] == pytest.approx(5 / 7, rel=0.01)


def test_tasks_come_in_at_their_rate_with_ids(tmp_path):
    plan = make_plan(
        shop_net(),
        ["Idle"],
        ["Orders"],
        idle=["Idle"],
        tasks=Tasks(("Orders",), ("delivered",)),
        durations={"Deliver": Duration.exponential(0.5)},
        outcomes={"Deliver": {"delivered": 1.0}},
    )
    run = VirtualRun(plan, seed=3)
    path = str(tmp_path / "run.jsonl")
    with contextlib.closing(run.record_in(path, "run", "1")):
        result = run.run(time=1000.0)
    # a shop with one clerk and room for four customers: rate 1 in, rate 2 out
    room = 1 - (1 / 2) ** 4 / (2 - (1 / 2) ** 4)
    assert result.throughput("delivered") == pytest.approx(room, rel=0.05)
    moves = [m for r in read_log(path).records for f in r.get("firings", ()) for m in f["tasks"]]
    done = [task for task, _, target in moves if target == "done"]
    assert len(done) == len(set(done)) == result.firings["delivered"]


def test_a_log_with_events_plays_again_alike(tmp_path):
    plan = replace(charging(2, hold=True, seconds=3.0), seed=4)
    run = VirtualRun(plan)
    path = str(tmp_path / "run.jsonl")
    with contextlib.closing(run.record_in(path, "run", "1")):
        result = run.run(firings=300)
    steps = list(replay(read_log(path)))
    assert any(isinstance(e, log_entries.Interrupt) for step in steps for e in step.entries)
    fired = Counter(firing.transition for step in steps for firing in step.firings)
    assert fired["low"] == result.firings["low"] > 10
    assert VirtualRun(plan).run(firings=300).firings == result.firings


def test_tasks_are_cancelled_as_often_as_the_plan_says():
    plan = plan_of(net_with_way_out(), on_cancel={"Deliver": "give_up"})
    run = VirtualRun(replace(plan, events={"give_up": EventSource()}).validate(), seed=5)
    fired = run.run(firings=6_000).firings
    assert fired["give_up"] == pytest.approx(fired["delivered"], rel=0.15)  # both have rate 1
    ended = {e.outcome for e in run.state.ended_tasks}
    assert ended == {"done", "cancelled"}

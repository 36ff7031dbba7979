"""The token game in virtual time: it follows a run's rules, and its log is a real one."""

import math

import pytest

from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.history import verify
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import FailureKind, FailureRule, Plan, RobotSpec

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
            "a": FailureRule(FailureKind.RETRY, 1000, 0.5),
            "b": FailureRule(FailureKind.FIRE, transition="u"),
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

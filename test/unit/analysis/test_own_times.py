"""Robots that differ: each has its own durations, outcomes and failures, which are learned from
logs and followed by runs in virtual time, simulations and comparisons."""

from __future__ import annotations

import copy
import json
from typing import Any, Dict

import numpy as np
import pytest
from scipy import stats

from gspn_framework_package.analysis.fitting import fit_plan
from gspn_framework_package.analysis.fitting.testing import largest_clear, shares_differ
from gspn_framework_package.analysis.monitoring.prediction import Parameters, draw_parameters
from gspn_framework_package.analysis.simulation import simulate
from gspn_framework_package.analysis.sweeps.variation import read_variation, varied
from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.logged_attempts import gather
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json
from gspn_framework_package.model.errors import PlanError

NET = {
    "places": [{"name": "Drive", "tokens": 2}, {"name": "Load"}],
    "transitions": [
        {"name": name, "timed": True, "rate": 0.2} for name in ("there", "loaded", "empty")
    ],
    "arcs": [
        {"from": "Drive", "to": "there"},
        {"from": "there", "to": "Load"},
        {"from": "Load", "to": "loaded"},
        {"from": "loaded", "to": "Drive"},
        {"from": "Load", "to": "empty"},
        {"from": "empty", "to": "Drive"},
    ],
}

TEAM: Dict[str, Any] = {
    "plan": "two",
    "net": NET,
    "actions": {"Drive": "actions.drive", "Load": "actions.load"},
    "robots": {"robot_1": "Drive", "robot_2": "Drive"},
    "on_failure": {"*": "retry 9"},
    "durations": {"Drive": {"mean": 15.0}, "Load": {"mean": 5.0}},
    "outcomes": {"Load": {"probabilities": {"loaded": 0.5, "empty": 0.5}}},
    "failures": {"Drive": {"probability": 0.1}},
}

OWN: Dict[str, Any] = {
    "robot_1": {
        "durations": {"Drive": {"mean": 10.0, "distribution": "gamma", "shape": 4.5}},
        "outcomes": {"Load": {"probabilities": {"loaded": 0.9, "empty": 0.1}}},
        "failures": {"Drive": {"probability": 0.0}},
    },
    "robot_2": {
        "durations": {
            "Drive": {"mean": 20.0, "of": {"observations": 7, "logs": ["a"], "interval": [15, 25]}}
        },
        "failures": {"Drive": {"probability": 0.25}},
    },
}

TRUTH = {1: 1 / (10 + 5), 2: 1 / (20 / 0.75 + 5)}
"""Robot -> how often it is there (1/s): an attempt that fails is made again."""


def differing(**changes: Any) -> Dict[str, Any]:
    return copy.deepcopy({**TEAM, "own_times": OWN, **changes})


def write(folder: Any, data: Dict[str, Any], name: str = "plan.json") -> str:
    (folder / name).write_text(json.dumps(data), encoding="utf-8")
    (folder / "actions.py").write_text("def drive(): pass\ndef load(): pass\n", encoding="utf-8")
    return str(folder / name)


def throughputs(
    plan: Any, robots: int = 2, seed: int = 3, replications: int = 200
) -> Dict[str, Any]:
    asked = {"time": 2_000.0, "replications": replications, "seed": seed}
    result = simulate(plan.for_robots(robots), **asked)
    return dict(result.throughput)


def recorded(folder: Any, plan: Any, seconds: float, seed: int = 5) -> str:
    path = str(folder / ("log_%d.jsonl" % seed))
    run = VirtualRun(plan, seed=seed)
    log = run.record_in(path, "run", "1")
    run.run(time=seconds)
    log.close()
    return path


def test_a_plan_keeps_them_and_runs_as_before() -> None:
    plan = plan_from_json(differing())
    again = plan_from_json(plan_to_json(plan))
    assert again.own_times == plan.own_times and again.own_times["robot_2"].evidence
    assert plan.hash() == plan_from_json(differing(own_times={})).hash()
    nominal = plan.nominal().own_times
    assert nominal["robot_1"] == plan.own_times["robot_1"]
    assert nominal["robot_2"].durations == {} and nominal["robot_2"].failures == {"Drive": 0.25}
    assert "robot_2" not in plan_to_json(plan.for_robots(1))["own_times"]


@pytest.mark.parametrize(
    "robot, own, said",
    [
        ("robot_9", {}, "own_times.robot_9: the plan has no robot 'robot_9'"),
        ("robot_1", {"durations": {"Yard": {"mean": 1}}}, "the net has no place 'Yard'"),
        (
            "robot_1",
            {"durations": {"Load": {"mean": 0, "distribution": "deterministic"}}},
            "cannot",
        ),
        ("robot_1", {"outcomes": {"Load": {"probabilities": {"there": 1}}}}, "does not leave"),
        ("robot_1", {"outcomes": {"Load": {"probabilities": {"loaded": 0.9}}}}, "sum to 0.9"),
        ("robot_1", {"failures": {"Load": {"probability": 0.1}}}, "give failures.Load, too"),
        ("robot_1", {"rates": {"there": {"rate": 1}}}, "rates"),
    ],
)
def test_what_does_not_fit_is_an_error_that_names_it(
    tmp_path: Any, capsys: Any, robot: str, own: Any, said: str
) -> None:
    path = write(tmp_path, differing(own_times={robot: own}))
    assert main(["check", path]) == 2
    error = capsys.readouterr().err
    assert said in error and "own_times" in error and len(error.splitlines()) == 1


def test_an_outcome_that_the_team_never_has_is_refused() -> None:
    always = {"Load": {"probabilities": {"loaded": 1}}}
    with pytest.raises(PlanError, match="that the team lacks"):
        plan_from_json(differing(outcomes=always))


@pytest.mark.long
def test_the_simulation_and_virtual_time_follow_each_robot() -> None:
    plan = plan_from_json(differing())
    found = throughputs(plan)["there"]
    assert abs(found.mean - sum(TRUTH.values())) < 3 * found.half_width
    alone = throughputs(plan, robots=1)
    assert abs(alone["there"].mean - TRUTH[1]) < 3 * alone["there"].half_width
    assert abs(alone["loaded"].mean - 0.9 * TRUTH[1]) < 3 * alone["loaded"].half_width


@pytest.mark.long
def test_virtual_time_follows_each_robot(tmp_path: Any) -> None:
    plan = plan_from_json(differing())
    attempts = gather([recorded(tmp_path, plan, 60_000.0)]).attempts
    for number, share in ((1, 0.9), (2, 0.5)):
        mine = [a for a in attempts if a.robot == "robot_%d" % number and a.completed]
        there = [a for a in mine if a.place == "Drive" and not a.failed]
        assert len(there) == pytest.approx(60_000 * TRUTH[number], rel=0.06)
        named = [a.result for a in mine if a.place == "Load"]
        assert named.count("loaded") / len(named) == pytest.approx(share, abs=0.05)


@pytest.mark.long
def test_what_robots_differ_in_is_learned_and_predicts_the_truth(
    tmp_path: Any, capsys: Any
) -> None:
    log = recorded(tmp_path, plan_from_json(differing()), 20_000.0)
    team, learned = write(tmp_path, TEAM, "team.json"), str(tmp_path / "learned.json")
    assert main(["fit", team, log, "-o", learned, "--per-robot", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report["own"]["robot_1"]) == {"durations", "outcomes", "failures"}
    plan = read_plan(learned)
    for robot, mean in (("robot_1", 10.0), ("robot_2", 20.0)):
        low, high = plan.own_times[robot].evidence["durations", "Drive"].interval
        error = (high - low) / 2 / 1.96
        assert abs((low + high) / 2 - mean) < 3.5 * error < 0.16 * mean
    assert set(plan.own_times["robot_1"].durations) == {"Drive"}, "they do not differ in Load"
    # the truth is within what the logs leave open, for the team and for one robot alone
    for robots in (1, 2):
        rng = np.random.default_rng(robots)
        drawn = [
            throughputs(draw_parameters(plan, rng).apply(plan), robots, seed, 40)["there"].mean
            for seed in range(20)
        ]
        truth = sum(TRUTH[number] for number in range(1, robots + 1))
        error = float(np.std(drawn))
        assert abs(float(np.mean(drawn)) - truth) < 3.5 * error < 0.14 * truth
    # a fit that takes the robots to be alike is far off for one alone
    shared = str(tmp_path / "shared.json")
    assert main(["fit", team, log, "-o", shared]) == 0
    captured = capsys.readouterr()
    assert "robots differ" in captured.err and "robot_1 in Drive: mean" in captured.out
    assert read_plan(shared).own_times == {}
    assert throughputs(read_plan(shared), 1)["there"].mean < 0.9 * TRUTH[1]
    # and its monitor raises alarms, where that of the other has none
    fresh = recorded(tmp_path, plan_from_json(differing()), 20_000.0, seed=6)
    assert main(["compare", shared, fresh, "--replications", "2"]) == 1
    assert "ALARM" in capsys.readouterr().out
    assert main(["compare", learned, fresh, "--replications", "20"]) == 0
    assert "ALARM" not in capsys.readouterr().out


@pytest.mark.long
def test_robots_that_are_alike_seldom_get_their_own(tmp_path: Any) -> None:
    """All tests together have a level of 5 %, whatever robots may differ in."""
    plan = plan_from_json(differing(own_times={}))
    wrong = 0
    for seed in range(12):
        found = gather([recorded(tmp_path, plan, 3_000.0, seed)])
        wrong += bool(fit_plan(plan, found.attempts, samples=0).own)
    assert wrong <= 3, "5 % are to be expected; more than 3 of 12 have a probability of 0.002"


def test_the_smallest_p_values_are_clear_as_long_as_holm_rejects_them() -> None:
    assert largest_clear([0.03, 0.01, 0.02]) == 0.03  # 0.01 * 3, 0.02 * 2 and 0.03 * 1 are small
    assert largest_clear([0.03, 0.01, 0.026]) == 0.01
    assert largest_clear([0.02, 0.02, 0.02]) == largest_clear([]) == -1.0


@pytest.mark.long
def test_times_without_spread_are_told_apart(tmp_path: Any) -> None:
    own = {
        robot: {"durations": {"Drive": {"mean": mean, "distribution": "deterministic"}}}
        for robot, mean in (("robot_1", 10.0), ("robot_2", 20.0))
    }
    log = recorded(tmp_path, plan_from_json(differing(own_times=own)), 3_000.0)
    team, new = write(tmp_path, TEAM, "team.json"), str(tmp_path / "new.json")
    assert main(["fit", team, log, "-o", new, "--per-robot"]) == 0
    found = read_plan(new).own_times
    assert found["robot_1"].durations["Drive"].mean == pytest.approx(10.0)
    assert found["robot_2"].durations["Drive"].mean == pytest.approx(20.0)


@pytest.mark.long
def test_a_later_fit_forgets_what_no_longer_holds(tmp_path: Any) -> None:
    path = write(tmp_path, differing())
    log = recorded(tmp_path, plan_from_json(differing(own_times={})), 20_000.0)
    assert main(["fit", path, log, "-o", str(tmp_path / "new.json")]) == 0
    assert read_plan(str(tmp_path / "new.json")).own_times == {}


def test_what_does_not_distinguish_robots_refuses_them(tmp_path: Any, capsys: Any) -> None:
    path = write(tmp_path, differing())
    assert main(["check", path]) == 0
    why = "robots differ: robot_1 has its own times or outcomes in Drive (own_times)"
    capsys.readouterr()
    assert main(["analyse", path]) == 1
    assert "not decided: steady_state: " + why in capsys.readouterr().out
    for verb in (
        ["optimise", path, "--reward", "loaded=1", "-o", str(tmp_path / "best.json")],
        ["convert", path, str(tmp_path / "net.pnml"), "--run-net"],
    ):
        assert main(verb) in (1, 2)
        assert why in capsys.readouterr().err
    assert main(["analyse", path, "--timing", "net"]) == 0
    assert "0.0" in capsys.readouterr().out


@pytest.mark.long
def test_sweeps_and_factors_reach_each_robot() -> None:
    plan = plan_from_json(differing())
    slower = Parameters({"Drive": 2.0}, {}, {}, {}).apply(plan)
    assert slower.own_times["robot_2"].durations["Drive"].mean == 40.0
    assert slower.own_times["robot_2"].failures == {"Drive": 0.25}
    variations = [read_variation("duration:Drive=30"), read_variation("failure:Drive=0.5")]
    swept = varied(plan, variations, (30.0, 0.5), {})
    assert swept.own_times["robot_1"].durations["Drive"].mean == 20.0
    assert swept.failures == {"Drive": 0.5}
    assert swept.own_times["robot_1"].failures == {}


def test_the_test_of_shares_is_that_of_scipy_and_needs_data() -> None:
    counts = [[30, 70], [45, 55], [20, 30]]
    expected = stats.chi2_contingency(counts, correction=False, lambda_="log-likelihood")[1]
    assert shares_differ(counts) == pytest.approx(expected)
    assert shares_differ([[9, 1], [1, 9]]) < 0.01
    assert shares_differ([[6, 1], [1, 6]]) == 1.0


def test_the_test_of_shares_has_its_size() -> None:
    rng = np.random.default_rng(8)
    tables = [[[k, 200 - k] for k in rng.binomial(200, 0.1, size=3)] for _ in range(400)]
    assert 6 <= sum(shares_differ(table) < 0.05 for table in tables) <= 38

"""The parts of the scaling benchmark that need no ROS."""

import json
import random

import pytest

from benchmarks import policy, scaling
from benchmarks.__main__ import main
from benchmarks.figures import draw_figures
from benchmarks.machine import describe_machine, machine_line, table
from benchmarks.plans import INSTANT, ring_plan, tokens_plan
from benchmarks.results import Results
from benchmarks.token_game import game_rate, standalone_rate
from gspn_framework_package.model.errors import UsageError


def test_the_points_that_are_asked_for_are_run():
    tokens, one = scaling.EXPERIMENTS["tokens"], scaling.EXPERIMENTS["one"]
    assert tokens.chosen(False, ()) == tokens.points
    assert tokens.chosen(True, ()) == tokens.quick
    assert tokens.chosen(True, (2, 60)) == ((2, 7), (60, 7))
    assert one.chosen(False, (2000,)) == ((1, 2000),)
    assert scaling.EXPERIMENTS["large"].chosen(False, (100,)) == ((100, 20),)


def test_the_points_of_the_thesis_are_there():
    assert [n for n, _ in scaling.EXPERIMENTS["tokens"].points][:15] == list(range(1, 16))
    assert [n for _, n in scaling.EXPERIMENTS["places"].points][:15] == list(range(2, 17))
    assert {n for _, n in scaling.EXPERIMENTS["one"].points} >= {
        *range(2, 36),
        *range(40, 101, 5),
        1000,
    }


@pytest.mark.parametrize("name", sorted(scaling.EXPERIMENTS))
def test_every_plan_is_one_that_may_run(name):
    from gspn_framework_package.analysis.preflight import check

    experiment = scaling.EXPERIMENTS[name]
    for robots, places in experiment.quick:
        plan = experiment.plan(robots, places)
        assert len(plan.robots) == robots
        assert not check(plan).refused


def test_a_ring_deals_its_robots_over_the_places():
    plan = ring_plan(3, 5)
    assert [p.tokens for p in plan.net.places] == [2, 2, 1]


def test_figures_are_drawn_of_what_was_measured(tmp_path):
    rows = [
        {
            "experiment": name,
            "mode": "process",
            "robots": n,
            "places": n,
            "servers": n,
            "all_fired_s": 1.0 * n,
            "machine_cpu_percent": 5.0,
            "machine_memory_percent": 9.0,
            "cpu_percent_of_core": 2.0 * n,
            "baseline_cpu_percent": 1.0,
            "pss_mb": 20.0 * n,
            "baseline_memory_percent": 2.0,
        }
        for name in ("tokens", "places", "one")
        for n in (1, 2, 3)
    ]
    drawn = draw_figures(rows, str(tmp_path))
    names = {path.rsplit("/", 1)[1] for path in drawn}
    assert names == {"figure_%s_process.svg" % n for n in ("6_2", "6_4", "6_5", "6_6")} | {
        "start.svg"
    }
    assert all(b"<svg" in (tmp_path / name).read_bytes() for name in names)


def test_results_are_taken_up_again(tmp_path):
    point = {
        "experiment": "one",
        "mode": "process",
        "robots": 1,
        "places": 2,
        "synchronisation": "full",
    }
    results = Results(str(tmp_path))
    results.add({**point, "firings_per_s": 1.0, "note": "something went wrong"})
    assert not Results(str(tmp_path)).has(point)
    results.add({**point, "firings_per_s": 2.0, "note": ""})
    results.add({**point, "places": 3, "firings_per_s": 3.0})
    again = Results(str(tmp_path))
    assert [row["firings_per_s"] for row in again.of("one")] == [2.0, 3.0]
    assert again.has(point)
    assert not again.has({**point, "mode": "hosted"})
    assert len((tmp_path / "results.csv").read_text().splitlines()) == 3


def test_results_of_another_machine_are_not_mixed_in(tmp_path):
    Results(str(tmp_path)).add({"experiment": "one"})
    path = tmp_path / "results.json"
    report = json.loads(path.read_text())
    report["machine"]["cores"] = "a thousand"
    path.write_text(json.dumps(report))
    with pytest.raises(UsageError, match="another machine"):
        Results(str(tmp_path))
    path.write_text("[]")
    with pytest.raises(UsageError, match="no results"):
        Results(str(tmp_path))


def test_the_scan_of_the_policy_benchmark_finds_the_row_of_the_fewest_wildcards():
    net = policy.decision_net()
    made = policy.random_policy(net, 500, random.Random(5))
    bound = made.bind(net)
    for row in made.rows:
        marking = tuple(0 if count is None else count for count in row.counts)
        found = bound.distribution(marking, 0)
        assert found is not None and found.row == policy.scan(made, marking)


def test_the_token_game_benchmark_fires():
    plan = tokens_plan(INSTANT).for_robots(3)
    assert game_rate(plan, 0.01) > 0
    assert standalone_rate(plan, 0.3, record=True) > 0  # its functions are allowed


def test_the_machine_is_reported_with_every_result():
    described = describe_machine()
    assert {"cpu", "cores", "memory", "python"} <= set(described)
    assert described["python"] in machine_line(described)


def test_tables_are_aligned():
    lines = table(["name", "n"], [["a", 1000], ["longer", 0.5]]).splitlines()
    assert lines[2] == "| a      | 1,000 |"
    assert len({len(line) for line in lines}) == 1


def test_wrong_usage_is_reported(capsys, monkeypatch):
    assert main(["nonsense"]) == 2
    assert "there is no experiment 'nonsense'" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["--sizes", "0"])


def test_without_ros_it_says_so(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(scaling, "quiet_machine", lambda: scaling.MachineLoad(0.0, 0.0))
    assert main(["tokens", "--quick"]) == 2
    assert "ROS is not installed, or not sourced" in capsys.readouterr().err

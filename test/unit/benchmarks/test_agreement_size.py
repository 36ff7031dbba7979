"""The benchmark that measures how the cost of a decision grows with the team."""

import json

import pytest

from benchmarks.agreement_size import fits, linear_fit, main, measure


def test_the_line_through_values_and_how_far_they_are_off():
    assert linear_fit([5, 10, 20], [16, 31, 61]) == pytest.approx((3.0, 1.0, 0.0))
    slope, _, residual = linear_fit([5, 10, 20], [25, 100, 400])
    assert slope == pytest.approx(180 / 7)
    assert residual > 0.5


@pytest.mark.parametrize("partial, per_robot", [(False, 3), (True, 5)])
def test_a_decision_costs_each_robot_a_few_messages(partial, per_robot):
    rows = [measure(robots, partial, False, decisions=15) for robots in (10, 20, 30)]
    assert all(row["greetings_per_s"] > 0 for row in rows)  # apart, not in the bytes
    messages, size = fits(rows)
    assert messages["per_robot"] == pytest.approx(per_robot, rel=0.15)
    assert messages["largest_residual"] < 0.15
    assert size["of"] == "bytes" and size["per_robot"] > 100 * per_robot


def test_it_prints_rows_and_fits(capsys):
    assert main(["--robots", "2", "3", "4", "--load", "busy", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [row["robots"] for row in found["rows"]] == [2, 3, 4, 2, 3, 4]
    assert {fit["of"] for fit in found["fits"]} == {"messages", "bytes"}

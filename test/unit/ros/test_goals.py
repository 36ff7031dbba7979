"""``gspn check`` looks at the goals of action servers, where ROS knows their types."""

import json

import pytest

pytest.importorskip("rospy")
pytest.importorskip("actionlib.msg")

from gspn_framework_package.cli.main import main
from gspn_framework_package.ros import action_kinds


def check(tmp_path, capsys, action):
    """The exit code of the check of a plan with this action, and its items on goals."""
    plan = {
        "net": {
            "places": [{"name": "P", "tokens": 1}],
            "transitions": [{"name": "T", "timed": True, "servers": None}],
            "arcs": [{"from": "P", "to": "T"}, {"from": "T", "to": "P"}],
        },
        "actions": {"P": action},
        "robots": {"robot_1": "P"},
    }
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    code = main(["check", str(tmp_path), "--json"])
    items = json.loads(capsys.readouterr().out)["items"]
    return code, [(item["severity"], item["text"]) for item in items if item["check"] == "goals"]


SERVER = {"type": "actionlib/TestAction", "server": "test"}


def test_a_goal_that_fits_is_no_matter(tmp_path, capsys):
    assert check(tmp_path, capsys, {**SERVER, "goal": {"goal": 3}}) == (0, [])
    assert check(tmp_path, capsys, SERVER) == (0, [])


@pytest.mark.parametrize("goal", [{"gaol": 3}, {"goal": "three"}, {"goal": {"x": 1}}])
def test_a_goal_that_does_not_fit_is_refused_as_by_the_node(tmp_path, capsys, goal):
    code, ((severity, text),) = check(tmp_path, capsys, {**SERVER, "goal": goal})
    assert (code, severity) == (1, "refused")
    assert text.startswith("robot_1 in P: its goal does not fit actionlib/TestGoal: ")


def test_what_is_not_known_here_is_said(tmp_path, capsys):
    code, ((severity, text),) = check(
        tmp_path, capsys, {"type": "no_such_package/NoAction", "server": "x", "goal": {}}
    )
    assert (code, severity) == (0, "warning")
    assert (
        "no_such_package/NoAction" in text and "its fields were not checked (robot_1 in P)" in text
    )


def test_a_plan_of_commands_needs_no_types(tmp_path, capsys, monkeypatch):
    asked = []
    monkeypatch.setattr(action_kinds, "look_at_actions", asked.append)
    assert check(tmp_path, capsys, {"command": ["true"]}) == (0, [])
    assert asked == []

"""``gspn demo``: when it ends, and what it says then. That a team runs is tested by the node
tests."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Optional

import pytest

from gspn_framework_package.cli.demo import _Demo
from gspn_framework_package.formats.plan_file import read_plan


def ended_demo(node: str, code: Optional[int], ended: str = "", fault: bool = False) -> _Demo:
    """A demo of three robots, of which roslaunch has said that a process ended."""
    demo = _Demo(read_plan("plans/patrol").for_robots(3), "plans/patrol", 0, None, 8090, False)
    demo._monitor = SimpleNamespace(
        ended=ended,
        fault=fault,
        firings=5,
        doing=["robot_1"],
        moves=Counter(),
        transitions=Counter(t=5),
    )
    demo._node_ended(node, code)
    assert demo._ending.is_set()
    return demo


class _Quiet:
    """A monitor of a run that fires for the first time when it was asked five times."""

    asked = 0

    @property
    def firings(self) -> int:
        self.asked += 1
        return int(self.asked > 5)

    def rate(self) -> float:
        return 0.0

    def recent(self, since: float) -> list:
        return []

    def snapshot(self) -> dict:
        return {}


def test_the_seconds_count_from_the_first_firing() -> None:
    demo = _Demo(read_plan("plans/patrol"), "plans/patrol", 0.3, None, 8090, False)
    demo._monitor = _Quiet()
    demo.show()
    assert demo._first is not None and demo._ended >= demo._first + 0.3


@pytest.mark.parametrize(
    ("code", "ended"),
    [(0, "every robot is in a place without output arcs"), (1, "stopped on the page")],
)
def test_the_demo_ends_when_its_team_has(
    code: int, ended: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The robots are one process for roslaunch, however many they are."""
    demo = ended_demo("gspn_team_demo_1f00-2", code, ended)
    assert demo.summary() == 0
    said = capsys.readouterr().out
    assert "the run is over: " + ended in said and "error" not in said


@pytest.mark.parametrize(
    ("node", "code", "ended", "fault"),
    [
        ("gspn_team_demo_1f00-2", 1, "", False),
        ("gspn_team_demo_1f00-2", 1, "robot_1: the action of p1 failed (broken)", True),
        ("visualizer_8090_host_1_2-3", 0, "", False),
        ("world-4", -9, "", False),
    ],
)
def test_a_node_that_dies_is_named(
    node: str, code: int, ended: str, fault: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """And the exit code says it."""
    demo = ended_demo(node, code, ended, fault)
    pytest.importorskip("rospkg")
    assert demo.summary() == 1
    assert "the node %s died" % node.rsplit("-", 1)[0] in capsys.readouterr().out

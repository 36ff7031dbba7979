"""A live run that a test reports to the page."""

from __future__ import annotations

from typing import Any, Dict, Optional, Sequence

from gspn_framework_package.model.plan import Plan
from gspn_framework_package.visualizer.activity import Activity
from gspn_framework_package.visualizer.board import Board


class ReportedRun(Activity):
    """Begins with each robot of the plan in its place, at work; what happens then, the test
    publishes on ``hub``.

    :param status: more of the status of the team.
    :param environment: the environment's transitions, by name.
    :param commands: what operators may order.
    """

    mode = "LIVE"

    def __init__(
        self,
        plan: Plan,
        status: Optional[Dict[str, Any]] = None,
        environment: Sequence[str] = (),
        commands: Sequence[str] = ("stop",),
    ) -> None:
        super().__init__()
        self.plan = plan
        self._status = {"running": True, **(status or {})}
        self._environment = [plan.net.transition_number(name) for name in environment]
        self._commands = list(commands)

    def begin(self, hub: Any) -> None:
        self.hub = hub
        net = self.plan.net
        board = Board(
            len(net.transitions), net.initial_marking, self._environment, dict(self._status)
        )
        for robot in self.plan.robots:
            board.robots[robot.name] = {
                "name": robot.name,
                "place": net.place_index[robot.place],
                "phase": "doing",
                "since": 0.0,
            }
        hub.restart(self.mode, board, {"commands": self._commands})

"""A team of real nodes whose processes are killed, stopped and restarted."""

from __future__ import annotations

import os
import re
import sys
import time
from dataclasses import replace
from typing import Any, Callable, Dict, List, Optional, Sequence

from benchmarks.faults import dying_node
from benchmarks.harness.team import NodeTeam
from benchmarks.plans import BRIEF, tokens_plan
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import (
    Plan,
    Synchronisation,
    Timing,
)


class FaultyTeam(NodeTeam):
    """The nodes of a team that executes ``plans/tokens`` with actions of a tenth of a second, or
    another plan.

    :param robots: initial number of robots: ``robot_1`` and so on.
    :param evict_after: see :class:`~gspn_framework_package.model.plan.Timing`.
    :param plan: the other plan.
    """

    def __init__(
        self,
        robots: int,
        mode: Synchronisation,
        evict_after: float,
        plan: Optional[Plan] = None,
    ) -> None:
        # on a busy machine an action server may be slow to accept a goal; by default its robot
        # would wait for the operator
        again = FailureRule.retry(1000)
        plan = replace(
            (plan or tokens_plan(BRIEF)).for_robots(robots),
            on_failure={"*": again},
            synchronisation=mode,
            timing=Timing(evict_after=evict_after),
        )
        super().__init__(plan)

    def check(self) -> None:
        """See :class:`~benchmarks.harness.team.Team`: here robots may end."""

    def node_program(self) -> Sequence[str]:
        """See :class:`~benchmarks.harness.team.NodeTeam`."""
        return [sys.executable, "-m", dying_node.__name__]

    def start(self, robot: str, place: str = "", *words: str) -> None:
        """See :class:`~benchmarks.harness.team.NodeTeam`."""
        super().start(robot, place, dying_node.DEATH + self.death_file(robot), *words)

    def ended(self) -> List[str]:
        """The robots whose processes have ended although they have not left."""
        return [name for name in self.programs.ended() if name not in self.gone]

    def kill_at_write(self, name: str, told: int) -> str:
        """Make a robot's process die in the middle of a log write, or right after one; returns the
        kind of the record that it wrote.

        :param told: see :mod:`.dying_node`.
        :raises ExecutionError: it wrote nothing for a long time.
        """
        self.programs.signal(name, told)
        self.await_death(name)
        return self.last_written(name)

    def await_death(self, name: str) -> None:
        """Wait until a robot's process has ended.

        :raises ExecutionError: it is still running after a long time.
        """
        self.programs.await_end(name, self.patience)

    def death_file(self, name: str) -> str:
        """The file of a robot's :class:`~.dying_node.Death`."""
        return os.path.join(self.folder, name + ".death")

    def lose_log(self, name: str) -> None:
        """Move away the log of a robot that is not running; it is kept for the history checker."""
        log = self.log_file(name)
        if os.path.exists(log):
            os.replace(log, "%s.%d.jsonl" % (log[: -len(".jsonl")], time.monotonic_ns()))

    def last_written(self, name: str) -> str:
        """The kind of the last record of a robot's log; the record may be cut."""
        with open(self.log_file(name), "rb") as file:
            line = file.read().splitlines()[-1]
        found = re.match(rb'\{"kind":"(\w+)"', line)
        return found.group(1).decode() if found else "a first few bytes"

    # -- questions ---------------------------------------------------------------------------------

    def wait(self, condition: Callable[[], bool], what: str, seconds: float = 0.0) -> float:
        """See :class:`~benchmarks.harness.team.Team`; as long as a question is not answered, the
        condition does not hold."""
        unanswered = ""

        def holds() -> bool:
            nonlocal unanswered
            try:
                return condition()
            except ExecutionError as error:
                unanswered = str(error)
                return False

        try:
            return super().wait(holds, what, seconds)
        except ExecutionError as error:
            error.hint = unanswered or None
            raise

    def statuses(self) -> Dict[str, Dict[str, Any]]:
        """The status of every living node.

        :raises ExecutionError: one of them does not answer.
        """
        known = super().statuses()
        missing = [name for name in self.programs.alive() if name not in known]
        if missing:
            raise ExecutionError("no answer of %s" % ", ".join(missing))
        return {name: known[name] for name in self.programs.alive()}

    def is_complete(self) -> bool:
        """Whether every living node is active in the team."""
        return all(status["active"] for status in self.statuses().values())

    def alike(self) -> bool:
        """See :class:`~benchmarks.harness.team.Team`; here nobody may wait for a decision."""
        told = self.statuses().values()
        return super().alike() and all(s["active"] and not s["pending"] for s in told)

    def entries(self, kind: str, robot: str, since: float) -> List[Dict[str, Any]]:
        """The entries of a kind about a robot that any log has received after time ``since``."""
        logs = self.read()
        return [
            entry
            for name in self.present()
            for entry in logs[name].entries(kind, since)
            if entry["robot"] == robot
        ]

    def tracebacks(self) -> List[str]:
        """The robots whose nodes have printed a traceback."""
        return [name for name in self.logs if "Traceback" in self.programs.output(name)]


def require(holds: bool, otherwise: str) -> None:
    """Check that something holds.

    :raises ExecutionError: it does not.
    """
    if not holds:
        raise ExecutionError(otherwise)

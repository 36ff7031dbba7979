"""The parts of a plan that its tests have reached: places, transitions, rows of the policy."""

from __future__ import annotations

from typing import Any, Collection, Dict, List, Set

from gspn_framework_package.execution.firing import Firing
from gspn_framework_package.execution.rules import Rules
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.model.net import Marking
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import POLICY


class Coverage:
    """The parts of a plan that its runs have reached together.

    A place is reached when it has a token, a transition when it fires, a row of the policy when a
    robot's choice was drawn from it, or a robot waited because of it.

    :ivar places: the names of the places reached.
    :ivar transitions: the names of the transitions reached.
    :ivar rows: the numbers of the rows reached, as in error messages: the first is 1.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._rules = Rules(plan)
        self.places: Set[str] = set()
        self.transitions: Set[str] = set()
        self.rows: Set[int] = set()

    @property
    def missing(self) -> Dict[str, List[Any]]:
        """The parts that were not reached: ``places``, ``transitions`` and ``rows``, in their
        order."""
        net = self.plan.net
        return {
            "places": [p.name for p in net.places if p.name not in self.places],
            "transitions": [t.name for t in net.transitions if t.name not in self.transitions],
            "rows": [n for n in range(1, len(self.plan.policy.rows) + 1) if n not in self.rows],
        }

    def __str__(self) -> str:
        """A line for each kind: how many elements were reached, and which were not."""
        net = self.plan.net
        totals = {
            "places": len(net.places),
            "transitions": len(net.transitions),
            "rows": len(self.plan.policy.rows),
        }
        lines = []
        for kind, missing in self.missing.items():
            line = "%s: %d of %d" % (kind, totals[kind] - len(missing), totals[kind])
            lines.append(line + ("; not %s" % ", ".join(map(str, missing)) if missing else ""))
        return "\n".join(lines)

    def check(self, *, without: Collection[Any] = ()) -> None:
        """Require that everything was reached.

        :param without: names of places and transitions, and numbers of rows, that need not be
            reached.
        :raises AssertionError: something was not reached; the message is :meth:`__str__`.
        """
        __tracebackhide__ = True
        if any(name not in without for names in self.missing.values() for name in names):
            raise AssertionError("not everything in the plan was reached\n%s" % self)

    def take(self, firings: List[Firing], before: Marking, state: TeamState) -> None:
        """Record the elements reached by a step of a run.

        :param before: the marking before its firings.
        :param state: the state after them.
        """
        self._take_marking(before)
        for firing in firings:
            self.transitions.add(firing.transition)
            if firing.drawn is not None and firing.robot:
                source = next(m.source for m in firing.moves if m.robot == firing.robot)
                if source is not None:
                    self._take_row(before, self.plan.net.place_number(source))
            before = firing.marking
            self._take_marking(before)
        self._take_marking(state.marking)
        for name in state.waiting:
            robot = state.robots[name]
            if robot.request == POLICY and not robot.paused and not state.paused:
                self._take_row(state.marking, robot.place)

    def _take_marking(self, marking: Marking) -> None:
        self.places.update(p.name for p, n in zip(self.plan.net.places, marking) if n)

    def _take_row(self, marking: Marking, place: int) -> None:
        found = self._rules.policy.distribution(marking, place)
        if found is not None:
            self.rows.add(found.row + 1)

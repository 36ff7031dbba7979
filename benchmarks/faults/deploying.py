"""A running team adopts another plan while one of its robots is killed, at each step of staging.

A patrol of four places gets a fifth one, and loses it again. Each time one robot dies at one step,
in a write to its log or right after it, and is restarted. The team must end on one plan, and the
robot that was restarted must follow it.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from dataclasses import replace
from typing import Any, Callable, Dict, List, NamedTuple, Optional

from benchmarks.faults.dying_node import Death
from benchmarks.faults.each_in_turn import MOVES, Tell
from benchmarks.faults.team import FaultyTeam, require
from benchmarks.plans import BRIEF, ring_plan
from gspn_framework_package.execution.plan_change import stage_of
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.plan import Plan, Synchronisation

SHORT, LONG = 4, 5
"""Numbers of places of the two patrols."""


MOMENT = 5.0
"""Seconds within which a robot dies at its step, if it gets there."""


class StagingStep(NamedTuple):
    """A step of staging at which a robot dies: when it writes a record of a ``kind`` that has an
    ``entry``. ``cut`` says whether only a part of the record reaches the log."""

    name: str
    kind: str
    entry: str
    cut: bool = False


STEPS = (
    StagingStep("staged", "slot", "stage"),
    StagingStep("staged, in the write", "slot", "stage", cut=True),
    StagingStep("voted", "invoked", "staged"),
    StagingStep("adopting", "accepted", "adopt"),
    StagingStep("adopted", "slot", "adopt"),
    StagingStep("adopted, in the write", "slot", "adopt", cut=True),
)


def patrol_plan(places: int, robots: int) -> Plan:
    """A patrol of so many places with brief actions."""
    return ring_plan(places, robots, BRIEF)


class Deploying:
    """Kills each robot at each step, and checks each time that the team ends on the new plan.

    :param tell: called with a description of each step.

    :ivar injected: how often a robot died at each step.
    """

    def __init__(self, robots: int, mode: Synchronisation, tell: Tell) -> None:
        self._tell = tell
        self.injected: Counter[str] = Counter()
        # only the operator evicts: the team waits for the vote of the robot that died
        self.team = FaultyTeam(robots, mode, 0.0, patrol_plan(SHORT, robots))
        self._places = SHORT

    def run(self) -> None:
        """Do everything, then wait until the team is at rest.

        :raises ExecutionError: the team did not end on one plan.
        """
        team = self.team
        team.wait(team.is_complete, "the start")
        team.wait_for_moves(team.robots, MOVES)
        for step in STEPS:
            for number, name in enumerate(team.robots):
                self._deploy(step, name, team.robots[(number + 1) % len(team.robots)])
        team.rest()
        plans = {status["plan_name"] for status in team.statuses().values()}
        require(len(plans) == 1, "the team is on several plans: %s" % ", ".join(sorted(plans)))

    def _deploy(self, step: StagingStep, dying: str, at: str) -> None:
        """Deploy the other patrol by orders to the robot ``at``, while ``dying`` dies at a step."""
        team = self.team
        began = time.monotonic()
        places = LONG if self._places == SHORT else SHORT
        plan = replace(
            patrol_plan(places, len(team.robots)),
            synchronisation=team.plan.synchronisation,
            timing=team.plan.timing,
            on_failure=team.plan.on_failure,
        )
        mapping = {"p%d" % LONG: "p1", "t%d" % LONG: "t1"} if places == SHORT else {}
        entry = stage_of(plan, mapping)
        argument = {"plan": entry.plan, "map": mapping, "folder": ""}
        death = Death(team.death_file(dying))
        death.order(step.kind, step.entry, step.cut)
        died = self._wait_reviving(
            dying,
            lambda: (
                self._staged(at, entry.digest) is not None
                or not team.order("stage", "", at, json.dumps(argument))
            ),
            "the stage of a plan",
        )
        died = died or (step.entry != "adopt" and self._revived(death, dying))
        team.wait(lambda: self._all_voted(at, entry.digest), "all votes")
        # the check takes too long on a busy machine, or a robot that just died has to vote again
        died |= self._wait_reviving(
            dying,
            lambda: self._follows(at, plan.name) or not team.order("adopt", "", at),
            "the new plan",
        )
        died = died or self._revived(death, dying)
        team.wait(lambda: all(self._follows(name, plan.name) for name in team.robots), "one plan")
        self._places = places
        now = time.monotonic()
        team.wait_for_moves(team.robots, places + 1, now)  # the new place too
        self.injected[step.name if died else "not reached"] += 1
        self._tell(
            "%s %s at the step '%s'; on one plan after %.1f s"
            % (dying, "died" if died else "did not die", step.name, now - began)
        )

    def _revived(self, death: Death, name: str) -> bool:
        """Restart a robot that dies within a moment; returns whether it died."""
        try:
            self.team.programs.await_end(name, MOMENT)
        except ExecutionError:
            death.withdraw()
            return False
        self.team.start(name)
        return True

    def _wait_reviving(self, name: str, condition: Callable[[], bool], what: str) -> bool:
        """Wait for a condition; returns whether a robot died meanwhile. It is restarted at once: a
        team of two may need its answer."""
        died = False

        def holds() -> bool:
            nonlocal died
            if name not in self.team.programs.alive():
                died = True
                self.team.start(name)
            return condition()

        self.team.wait(holds, what)
        return died

    def _staged(self, at: str, digest: str) -> Optional[Dict[str, Any]]:
        """What a robot knows of the plan with that digest, if that is staged."""
        staged: Optional[Dict[str, Any]] = self.team.statuses()[at]["staged"]
        return staged if staged is not None and staged["digest"] == digest else None

    def _all_voted(self, at: str, digest: str) -> bool:
        staged = self._staged(at, digest)
        if staged is None:
            return False
        refused: List[str] = [why for why in staged["votes"].values() if why]
        require(not refused, "a robot cannot follow the plan: %s" % "; ".join(refused))
        return all(why == "" for why in staged["votes"].values())

    def _follows(self, name: str, plan: str) -> bool:
        status = self.team.statuses()[name]
        return bool(status["active"] and status["plan_name"] == plan)

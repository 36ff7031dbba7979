"""The check before any robot moves ("preflight"; thesis 4.3.5 and ``docs/semantics.md``).

The structure is checked first, in milliseconds. Markings are visited only for the questions that it
leaves open, up to a limit. Proofs then decide whether a run can get stuck. Questions still open
after that are reported as not decided.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Optional

from gspn_framework_package.analysis.preflight.names import NameChecks, ServerProbe
from gspn_framework_package.analysis.preflight.reacting import ReactingChecks
from gspn_framework_package.analysis.preflight.report import Checklist, PreflightReport, Severity
from gspn_framework_package.analysis.preflight.structure import StructureChecks
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming, rules_of

if TYPE_CHECKING:
    from gspn_framework_package.analysis.watch import Cancel, Progress

MARKING_LIMIT = 200_000
"""Default limit on the markings visited by the check."""

PROOF_SECONDS = 10.0
"""Default budget for deciding by proofs what they leave open (s)."""

__all__ = ["MARKING_LIMIT", "PROOF_SECONDS", "ServerProbe", "check"]


def check(
    plan: Plan,
    *,
    limit: int = MARKING_LIMIT,
    server_probe: Optional[ServerProbe] = None,
    standalone: bool = False,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    seconds: float = PROOF_SECONDS,
) -> PreflightReport:
    """Check a plan before it runs.

    :param limit: largest number of markings to visit.
    :param server_probe: see :data:`ServerProbe`; without it the servers are not checked.
    :param standalone: the tokens are agents, which a net may create and destroy, not robots.
    :param progress: receives the number of markings at intervals.
    :param cancel: called at intervals; returns whether to stop.
    :param seconds: the budget (s) for deciding what the markings leave open by proofs; 0 for none.
    :raises PlanError: the plan is invalid: a name does not exist, or a rule is invalid.
    :raises PolicyError: the policy is invalid in the same way.
    :raises CancelledError: ``cancel`` returned true.
    """
    start = time.perf_counter()
    plan.validate()
    checklist = Checklist()
    for t, function in plan.net.functions.items():
        transition = plan.net.transitions[t]
        if transition.timed and plan.moves_robots(t):
            checklist.add(
                "rates",
                Severity.REFUSED,
                "'%s' of %s depends on the marking: in a plan, the rate of a transition that moves "
                "robots may not" % (function, transition.name),
                transition=transition.name,
            )
    if checklist.items:  # the other checks need numbers
        return PreflightReport(
            plan.name, tuple(checklist.items), 0, False, time.perf_counter() - start
        )
    rules = rules_of(plan, PlanTiming(plan))
    by_name = NameChecks(rules, checklist)
    by_name.look_at_names()
    ReactingChecks(plan, checklist, standalone).look_at_reactions()
    by_structure = StructureChecks(rules, checklist, standalone)
    by_structure.look_at_structure()
    markings = None
    if by_structure.open:
        # most plans do not need it, nor the exploration that it imports
        from gspn_framework_package.analysis.preflight.markings import MarkingChecks

        by_marking = MarkingChecks(by_structure, checklist, limit, progress, cancel, seconds)
        markings = by_marking.look_at_markings()
    if server_probe is not None:
        by_name.look_at_servers(server_probe)
    order = list(Severity)[::-1]
    items = sorted(checklist.items, key=lambda item: order.index(item.severity))
    return PreflightReport(
        plan.name,
        tuple(items),
        len(markings.space) if markings else 0,
        markings.complete if markings else True,
        time.perf_counter() - start,
    )

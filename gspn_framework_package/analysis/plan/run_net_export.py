"""The run net of a plan as an ordinary net, with what had to be assumed."""

from __future__ import annotations

from typing import List, Tuple

from gspn_framework_package.analysis.plan.reading import (
    NET,
    RUN,
    checked_reading,
    net_notes,
    run_notes,
)
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming
from gspn_framework_package.run_net.compiling import compile_plan, one_phase_each
from gspn_framework_package.run_net.literal import LiteralNet, literal_net
from gspn_framework_package.run_net.phases import MOST_PHASES
from gspn_framework_package.run_net.size import PhasesOfDurations


def run_net_of(plan: Plan, reading: str = RUN) -> Tuple[LiteralNet, List[str]]:
    """The run net of a plan, with notes for people.

    :param plan: a validated plan.
    :param reading: how time is interpreted: as the plan runs, or as a race of its net's rates.
    :raises RefusedError: an ordinary net would not be exact, or too large.
    """
    timing = None if checked_reading(reading) == NET else PlanTiming(plan)
    if timing is not None and timing.differing:
        raise RefusedError(timing.differing, element="the run net of '%s'" % plan.name)
    run_net = compile_plan(plan, timing, phases=one_phase_each(plan))
    if timing is None:
        notes = net_notes(plan).assumptions
    else:
        phases = PhasesOfDurations(run_net)
        if phases.most > MOST_PHASES:
            raise RefusedError(phases.why_so_many(0, 0), element="the run net of '%s'" % plan.name)
        notes = run_notes(plan, timing, {}, [*run_net.assumptions, *phases.matches()]).assumptions
        run_net = compile_plan(plan, timing)
    if run_net.counters:
        notes.append("left out, since they only count: %s" % ", ".join(run_net.counters))
    return literal_net(run_net), notes

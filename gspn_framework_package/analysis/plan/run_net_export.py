"""The run net of a plan as an ordinary net, with what had to be assumed."""

from __future__ import annotations

from typing import List, Optional, Tuple

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
from gspn_framework_package.run_net.compiling import (
    compile_plan,
    no_time_if_tiny,
    one_phase_each,
)
from gspn_framework_package.run_net.literal import LiteralNet, literal_net
from gspn_framework_package.run_net.size import PhasesOfDurations


def run_net_of(
    plan: Plan, reading: str = RUN, most: Optional[int] = None
) -> Tuple[LiteralNet, List[str]]:
    """The run net of a plan, with notes for people.

    :param plan: a validated plan.
    :param reading: how time is interpreted: as the plan runs, or as a race of its net's rates.
    :param most: the most phases of each duration; None: as many as each needs, and fewer for those
        that need more than :data:`~gspn_framework_package.run_net.phases.MOST_PHASES`.
    :raises RefusedError: an ordinary net would not be exact, or too large.
    """
    timing = None if checked_reading(reading) == NET else PlanTiming(plan)
    if timing is not None and timing.differing:
        raise RefusedError(timing.differing, element="the run net of '%s'" % plan.name)
    if timing is None:
        run_net = compile_plan(plan, timing)
        notes = net_notes(plan).assumptions
    else:
        untimed = no_time_if_tiny(plan, timing)
        single = {**one_phase_each(plan), **untimed}
        durations = PhasesOfDurations(compile_plan(plan, timing, phases=single))
        chosen = durations.enough if most is None else dict.fromkeys(single, most)
        run_net = compile_plan(plan, timing, phases={**chosen, **untimed})
        assumed = [*run_net.assumptions, *durations.matches(chosen)]
        notes = run_notes(plan, timing, {}, assumed).assumptions
    if run_net.counters:
        notes.append("left out, since they only count: %s" % ", ".join(run_net.counters))
    return literal_net(run_net), notes

"""How the analysis interprets the time of a plan, and its assumptions, in words for people.

``run`` follows the run: a robot is doing its action for a duration, then done, and moves as soon as
it can. ``net`` is the classical reading of the plan's net: an exponential transition races while it
is enabled.
"""

from __future__ import annotations

from typing import Dict, List, NamedTuple

from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming, listed

RUN, NET = "run", "net"

READINGS = (RUN, NET)


class TimingNotes(NamedTuple):
    """The part of a report about time.

    :ivar reading: RUN or NET.
    :ivar splits: place -> reason for distinguishing doing and done there.
    :ivar assumptions: sentences for people.
    """

    reading: str
    splits: Dict[str, str] = {}
    assumptions: List[str] = []


def checked_reading(reading: str) -> str:
    """Check the name of a reading. :raises UsageError: there is no such reading."""
    if reading not in READINGS:
        raise UsageError(
            "there is no reading '%s' of time" % reading, hint="choose %s" % " or ".join(READINGS)
        )
    return reading


def net_notes(plan: Plan) -> TimingNotes:
    """The notes on the classical reading."""
    assumptions = ["the clock of an exponential transition runs only while it is enabled"]
    if _decides_with_action(plan):
        assumptions.append("robots take no time in a place with immediate outputs")
    if plan.durations or plan.outcomes:
        assumptions.append("durations and outcomes in the plan are ignored: the rates count")
    return TimingNotes(NET, {}, assumptions + _of_both(plan))


def run_notes(
    plan: Plan, timing: PlanTiming, splits: Dict[str, str], more: List[str]
) -> TimingNotes:
    """The notes on the reading as the plan runs, with ``more`` assumptions."""
    assumptions = [*timing.assumptions, *more]
    return TimingNotes(RUN, splits, assumptions + _of_both(plan))


def _decides_with_action(plan: Plan) -> bool:
    return any(
        not plan.net.transitions[t].timed and plan.actions.get(plan.net.places[p].name) is not None
        for p, leaving in enumerate(plan.net.consumers)
        for t in leaving
    )


def _of_both(plan: Plan) -> List[str]:
    """The assumptions of both readings."""
    assumptions = of_events(plan)
    if not plan.simulate_environment and any(
        t.timed and not flow.taken and t.name not in (*plan.submissions, *plan.clock)
        for t, flow in zip(plan.net.transitions, plan.flows)
    ):
        assumptions.append(
            "exponential transitions that only take resources fire at their rates (in a run, only "
            "with environment: simulate)"
        )
    return assumptions


def of_events(plan: Plan) -> List[str]:
    """The assumptions about events that interrupt and about the clock, in words for people."""
    net = plan.net
    interrupting = [(p, t) for p in plan.action_places for t in plan.interrupts(p)]
    timed = [t for _, t in interrupting if plan.events[t].comes_after is not None]
    held = [
        t
        for p, t in interrupting
        if plan.events[t].hold
        and not net.fires_alone(net.transition_number(t), net.place_number(p))
    ]
    found = []
    if plan.clock:
        found.append(
            "the transitions %s fire at their rates, not in their hours of the day (a run has the "
            "hours)" % listed(plan.clock)
        )
    if timed:
        found.append(
            "the events %s come at the rates of the net, not after a fixed time (the simulation "
            "has the time)" % listed(timed)
        )
    if held:
        found.append(
            "the events %s have no effect if they come while their transition is not enabled (the "
            "simulation holds them)" % listed(held)
        )
    return found

"""Predicts bands of firings for more robots, or for robots that are slower or called away more
often: in a first look that follows a slider, and in a simulation that takes some seconds; and
the exact mean, where the Markov chain is small enough.

Both bands come from the same simulation of the plan (:mod:`~.analysis.monitoring.prediction`). The
first look plays a few short runs, always with the same random numbers, so that what moves is the
effect of the slider.
"""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace
from typing import Any, Dict, List, Mapping, NamedTuple

from gspn_framework_package.analysis.monitoring.prediction import (
    Parameters,
    RunSample,
    Span,
    growth,
    predict,
)
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import OwnTimes, Plan
from gspn_framework_package.visualizer.activity import RequestFields, whole_field
from gspn_framework_package.visualizer.analysis_jobs import ALL_TRANSITIONS
from gspn_framework_package.visualizer.scene import is_environment

FIRST_LOOK = 0.1
"""Seconds of computing that a first look may take."""

_FIRST_RUNS, _FIRST_FIRINGS = 8, 1_500
"""Runs of a first look, and firings in all of them together at most."""

WHOLE_SECONDS = 1.6
"""Seconds of computing for the simulation that follows."""

EXACT_SECONDS = 1.5
"""Seconds of computing for the exact answer, which comes before that simulation."""

_WHOLE_RUNS = 60
"""Runs of that simulation."""

MOST_TIMES = 10.0
"""Largest factor by which times and rates change, and the inverse of the smallest."""


class WhatIf(NamedTuple):
    """How a plan is changed.

    :ivar robots: how many robots the team has.
    :ivar slower: a factor of the times of all actions.
    :ivar places: place -> a further factor of the time of its action.
    :ivar rates: transition -> a factor of its rate.
    :ivar each: robot -> a further factor of the times of its actions.
    """

    robots: int
    slower: float
    places: Mapping[str, float]
    rates: Mapping[str, float]
    each: Mapping[str, float]

    def apply(self, plan: Plan) -> Plan:
        """The changed plan, which runs without end. :raises PlanError: it cannot have that many
        robots."""
        times: Dict[str, float] = {}
        rates = dict(self.rates)
        for place in action_means(plan):
            factor = self.slower * self.places.get(place, 1.0)
            if place in plan.durations:
                times[place] = factor
            else:
                rates.update(dict.fromkeys(_rated(plan, place), 1 / factor))
        changed = Parameters(times, {}, {}, rates).apply(replace(plan, until=None))
        own = dict(changed.own_times)
        for robot, factor in self.each.items():
            its = own.get(robot, OwnTimes())
            durations = {**changed.durations, **its.durations}
            factors = dict.fromkeys(durations, factor)
            own[robot] = its._replace(durations=durations).scaled(factors)
        changed = replace(changed, own_times=own)
        same = self.robots == len(plan.robots)
        return changed if same else changed.for_robots(self.robots)


def _rated(plan: Plan, place: str) -> List[str]:
    """The transitions whose rates are the time of the action of a place without a duration."""
    net = plan.net
    of_action = [net.transitions[t] for t in plan.of_action(net.place_index[place])]
    return [t.name for t in of_action if t.timed and t.name not in plan.events]


def action_means(plan: Plan) -> Dict[str, float]:
    """Place -> mean time of its action (s), for actions that take time: the duration that the plan
    gives, or else what the rates in its net say."""
    means = {}
    for place in plan.action_places:
        if place in plan.durations:
            means[place] = plan.durations[place].mean
            continue
        rates = [plan.net.transition(name).rate for name in _rated(plan, place)]
        if rates and all(isinstance(rate, (int, float)) for rate in rates):
            means[place] = 1 / sum(map(float, rates))
    return means


def adjustable(plan: Plan) -> Dict[str, Any]:
    """What can be changed, for the page: the number of ``robots``, the mean time of actions by
    ``places`` (s), the ``rates`` of events and of the environment (1/s), and the names of ``each``
    robot that can have times of its own: the net's rates are those of all robots."""
    net = plan.net
    rates = {
        t.name: float(t.number)
        for i, t in enumerate(net.transitions)
        if t.timed
        and isinstance(t.rate, (int, float))
        and (t.name in plan.events or is_environment(net, plan, i))
    }
    each = [robot.name for robot in plan.robots] if plan.durations else []
    return {
        "robots": len(plan.robots),
        "places": action_means(plan),
        "rates": rates,
        "each": each,
    }


def what_if_in_form(fields: RequestFields, plan: Plan) -> WhatIf:
    """Read the changes that the page asks for. :raises UsageError: they make no sense."""
    known = adjustable(plan)
    if not known["places"]:
        raise UsageError("no action of the plan takes time, so its runs cannot be predicted")

    def factor(value: Any) -> float:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not 1 / MOST_TIMES <= value <= MOST_TIMES:
            raise UsageError("a factor must be from %g to %g" % (1 / MOST_TIMES, MOST_TIMES))
        return float(value)

    def factors(key: str) -> Dict[str, float]:
        given = fields.get(key, {})
        if not isinstance(given, dict) or not set(given) <= set(known[key]):
            raise UsageError("'%s' names what cannot be changed" % key)
        factors_of = {name: factor(value) for name, value in given.items()}
        # times that stay as they are do not make robots differ, and the chain cannot distinguish
        # robots
        return {name: number for name, number in factors_of.items() if number != 1}

    robots = whole_field(fields, "robots", known["robots"], 1, max(20, 3 * known["robots"]))
    slower = factor(fields.get("slower", 1.0))
    return WhatIf(robots, slower, factors("places"), factors("rates"), factors("each"))


def growths(plan: Plan, sample: RunSample) -> Dict[str, List[float]]:
    """How the number of firings grows with time, of all transitions together and of each."""
    counts = [(ALL_TRANSITIONS, sample.firings.sum(axis=1))]
    counts += [(t.name, sample.firings[:, i]) for i, t in enumerate(plan.net.transitions)]
    return {name: list(growth(sample, values)) for name, values in counts}


class FirstLooks:
    """Computes first looks, one at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()

    def at(self, plan: Plan) -> Dict[str, Any]:
        """A first look at the runs of a plan: ``growth``, ``runs`` and ``seconds``, their number
        and length, and ``next``: the number and length of runs for which there is time later."""
        with self._lock:
            longest = max(action_means(plan).values())
            begin = time.monotonic()
            probe = predict([Span(plan, 5 * longest)], replications=2)
            took = time.monotonic() - begin
            speed = max(float(probe.firings.sum()), 1.0) / max(took, 1e-4)
            rate = max(float(probe.firings.sum()) / float(probe.seconds.sum()), 1e-9)
            firings = min(_FIRST_FIRINGS, speed * FIRST_LOOK)
            length = max(firings / _FIRST_RUNS / rate, 2 * longest)
            sample = predict([Span(plan, length)], replications=_FIRST_RUNS)
        later = max(speed * WHOLE_SECONDS / _WHOLE_RUNS / rate, 2 * longest)
        return {
            "growth": growths(plan, sample),
            "runs": sample.size,
            "seconds": round(length, 3),
            "next": {"runs": _WHOLE_RUNS, "time": math.ceil(later)},
        }

"""Few phases for the durations of a plan, and the intervals of answers about time.

A chain can follow a duration only as exponential phases. Where those that it needs make too many
states, it gets fewer, with the same mean. All answers about time are then computed twice: as well
as possible, and with half as many phases, that is, with twice the squared variation. If an answer
is a linear function of the squared coefficients of variation, it is off by at most the difference
of the two; if of the coefficients themselves, by at most 1 + sqrt(2) times as much, the half width
of its interval. An answer that hardly differs by chance gets the share by which those of its table
differ together. That is an estimate, not a bound.

What was learned from logs is uncertain, too: values are drawn from their posterior distributions,
and the half width of a prediction interval (Student's t, 95 %) of the answers with one phase for
each duration, relative to their mean, is added.
"""

from __future__ import annotations

import math
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.monitoring.prediction import draw_parameters, is_uncertain
from gspn_framework_package.analysis.plan.space import ChoosePhases, PlanSpace
from gspn_framework_package.analysis.quantiles import student
from gspn_framework_package.analysis.report import Questions, ReportWork, titled
from gspn_framework_package.analysis.report_measures import Part
from gspn_framework_package.analysis.solution.steady_state import steady_state
from gspn_framework_package.model.errors import LimitError, RefusedError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.run_net.compiling import one_phase_each
from gspn_framework_package.run_net.run_net import State
from gspn_framework_package.run_net.size import PhasesOfDurations

FEW_STATES = 100_000
"""About so many states at most, if the number of phases is not given."""

_HALF_WIDTH = 1 + math.sqrt(2)
"""Half width of an interval, in differences of the two answers."""

_FEWEST_DRAWS, _MOST_DRAWS, _DRAWN_STATES = 8, 40, 120_000
"""Values that were learned are drawn so often at least and at most, and so that about so many
states are visited in all."""

_TABLES = ("mean_tokens", "throughput", "mean_waiting_time")


def phases_for(most: Optional[int] = None, limit: Optional[int] = None) -> ChoosePhases:
    """How many phases durations get.

    :param most: the most for each; None: as many as make about :data:`FEW_STATES` states.
    :param limit: the most states, if that is less.
    """
    few = min(FEW_STATES, limit or FEW_STATES)

    def choose(
        space: PlanSpace, many: PhasesOfDurations, states: Sequence[State]
    ) -> Mapping[str, float]:
        if most is not None:
            return dict.fromkeys([place.name for place in space.net.places], most)
        if many.states(states) <= few:
            return {}
        shares = np.zeros(len(space))
        if len(space) < few:
            try:
                chain = Chain.of(space)
                shares[chain.states] = steady_state(chain).distribution
            except (LimitError, RefusedError):
                pass  # the mean times decide
        return many.chosen(states, shares, few)

    return choose


def add_intervals(analysis: Analysis, data: Dict[str, Any], questions: Questions) -> None:
    """Add to a report the ``intervals`` that are due to the phases of durations, if they are not
    represented exactly, and to the logs that a plan was learned from, with ``interval_sources``:
    what they hold, in words for people."""
    plan, here = analysis.plan, _tables(data)
    if plan is None or not here:
        return
    space = analysis.space
    if not isinstance(space, PlanSpace) or not space.complete or space.refusal:
        return

    def answers(of: Plan, phases: Mapping[str, float]) -> Dict[str, Dict[str, float]]:
        other = Analysis(
            of,
            limits=analysis.limits._replace(states=None),
            timing=space.notes.reading,
            phases=lambda *_: phases,
            progress=analysis.while_working["progress"],
            cancel=analysis.while_working["cancel"],
        )
        work = ReportWork(other)
        work.basics()
        work.timed(questions)
        for key in work.undecided.keys() - data["undecided"].keys():
            data["undecided"]["intervals.%s" % key] = work.undecided[key]
        return _tables(work.data)

    halves = {key: dict.fromkeys(table, 0.0) for key, table in here.items()}
    sources = []
    if space.fewer_phases:
        sources.append("durations are replaced")
        there = answers(plan, space.fewer_phases)
        for key, table in here.items():
            for name, change in _changes(key, table, there.get(key, {})).items():
                halves[key][name] = _HALF_WIDTH * change
    draws = 0
    if is_uncertain(plan):
        draws = min(_MOST_DRAWS, _DRAWN_STATES // len(space.distinct(np.arange(len(space)))))
    if draws >= _FEWEST_DRAWS:
        sources.append("the logs that values were learned from are short")
        generator = np.random.Generator(np.random.PCG64(0))
        single = one_phase_each(plan)
        drawn = [
            answers(draw_parameters(plan, generator).apply(plan), single) for _ in range(draws)
        ]
        times = student(0.975, draws - 1) * math.sqrt(1 + 1 / draws)
        for key, table in here.items():
            for name, v in table.items():
                found = [other[key][name] for other in drawn if name in other.get(key, {})]
                if len(found) == draws and any(found):
                    relative = float(np.std(found, ddof=1) / abs(np.mean(found)))
                    halves[key][name] += times * relative * abs(v)
    if sources:
        data["interval_sources"] = sources
        ends = {
            key: {name: _ends(name, v, halves[key][name]) for name, v in table.items()}
            for key, table in here.items()
        }
        data["intervals"] = {key: of.get("", of) for key, of in ends.items()}


def _tables(data: Mapping[str, Any]) -> Dict[str, Dict[str, float]]:
    """The answers about time of a report: what they are of -> name -> number. The name of an answer
    that is a number by itself is empty."""
    found: Dict[str, Dict[str, Any]] = {}
    parts: List[Tuple[str, Any]] = [("steady_state", data.get("steady_state"))]
    parts += [("transient.%d" % i, part) for i, part in enumerate(data.get("transient") or ())]
    for key, part in parts:
        found.update(("%s.%s" % (key, of), part[of]) for of in _TABLES if of in (part or ()))
        if part and "reward" in part:
            found[key] = {"reward": part["reward"]}
    for key, _ in titled(data, Part.TIMING):
        value = data[key]
        found[key] = value if isinstance(value, dict) else {"": value}
    for i, passage in enumerate(data.get("mean_time_to") or ()):
        if passage:
            within = {
                "within.%d" % n: entry["probability"] for n, entry in enumerate(passage["within"])
            }
            first = {key: passage[key] for key in ("mean_time", "probability")}
            found["mean_time_to.%d" % i] = {**first, **within}
    numbers = {
        key: {
            name: v
            for name, v in table.items()
            if isinstance(v, (int, float)) and not isinstance(v, bool)
        }
        for key, table in found.items()
    }
    return {key: table for key, table in numbers.items() if table}


def _changes(key: str, here: Mapping[str, float], there: Mapping[str, float]) -> Dict[str, float]:
    """How much fewer phases change each answer of a table, or the table as a whole; infinite: not
    known."""
    both = [(v, there[name]) for name, v in here.items() if name in there]
    total = sum(abs(v) for v, _ in both)
    share = 0.0
    if total and not key.startswith("mean_time_to"):
        share = sum(abs(v - w) for v, w in both) / total
    return {
        name: max(abs(v - there[name]), share * abs(v)) if name in there else math.inf
        for name, v in here.items()
    }


def _ends(name: str, value: float, half: float) -> Optional[List[float]]:
    """The ends of an interval; None: there is none."""
    if math.isinf(half):
        return None
    low = value - half if name in ("", "reward") else max(value - half, 0.0)
    chance = name == "probability" or name.startswith("within.")
    return [low, min(value + half, 1.0) if chance else value + half]

"""The intervals of answers about the time of a plan.

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
import re
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.plan.space import PlanSpace
from gspn_framework_package.analysis.quantiles import student
from gspn_framework_package.analysis.report_measures import Part
from gspn_framework_package.analysis.report_rows import NODE_TABLES, titled
from gspn_framework_package.model.errors import LimitError, RefusedError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.run_net.compiling import one_phase_each

_REPLACED = "durations are replaced"
"""What an interval takes into account if durations are not represented exactly."""

_LEARNED = "the logs that values were learned from are short"

_HALF_WIDTH = 1 + math.sqrt(2)
"""Half width of an interval, in differences of the two answers."""

_FEWEST_DRAWS, _MOST_DRAWS, _DRAWN_STATES = 8, 40, 120_000
"""Least and most draws of learned values, and about how many states all draws may visit
together."""

_DISTRIBUTION = "token_distribution"

_MANY_STATES = (
    "how short the logs are is left out: with one phase for each duration there are more than "
    "%s states" % format(_DRAWN_STATES // _FEWEST_DRAWS, ",")
)

AnswerTables = Dict[str, Dict[str, float]]
"""Kind of answer -> name -> number. The name of an answer that is a single number is empty."""


class HalfWidths(NamedTuple):
    """Half the widths of the intervals of answers; infinite: not known.

    :ivar sources: what the intervals take into account, in words for people; empty if there are
        none.
    :ivar left_out: what they should take into account, but do not: a sentence; empty if nothing.
    """

    widths: AnswerTables
    sources: List[str]
    left_out: str = ""

    @property
    def notes(self) -> List[str]:
        """What they take into account, and what not: sentences for people."""
        held = "the intervals take into account that %s" % " and ".join(self.sources)
        return [*([held] if self.sources else []), *filter(None, [self.left_out])]


def half_widths(
    analysis: Analysis, here: AnswerTables, answers: Callable[[Analysis], AnswerTables]
) -> HalfWidths:
    """The half widths that are due to the phases of durations, if they are not represented exactly,
    and to the logs that a plan was learned from.

    :param here: the answers of this analysis.
    :param answers: the same of another one.
    """
    found = expected(analysis) if here else HalfWidths({}, [])
    found.widths.update((key, dict.fromkeys(table, 0.0)) for key, table in here.items())
    plan, space = analysis.plan, analysis.space
    if plan is None or not isinstance(space, PlanSpace):
        return found

    def with_phases(of: Plan, phases: Mapping[str, float]) -> AnswerTables:
        other = Analysis(
            of,
            limits=analysis.limits._replace(states=None),
            timing=space.notes.reading,
            phases=phases,
            progress=analysis.while_working["progress"],
            cancel=analysis.while_working["cancel"],
        )
        try:
            return answers(other)
        except (LimitError, RefusedError):
            return {}

    if _REPLACED in found.sources:
        there = with_phases(plan, space.fewer_phases)
        for key, table in here.items():
            for name, change in _changes(key, table, there.get(key, {})).items():
                found.widths[key][name] = _HALF_WIDTH * change
    if _LEARNED in found.sources:
        draws = _affordable_draws(space)
        _add_logs(found, plan, draws, here, lambda of: with_phases(of, one_phase_each(plan)))
    return found


def expected(analysis: Analysis) -> HalfWidths:
    """What the intervals of an analysis will take into account; no widths yet."""
    plan, space = analysis.plan, analysis.space
    found = HalfWidths({}, [])
    if plan is None or not isinstance(space, PlanSpace) or not space.complete or space.refusal:
        return found
    if space.fewer_phases:
        found.sources.append(_REPLACED)
    if plan.evidence:
        # few plans were learned from logs, and the simulation takes long to import
        from gspn_framework_package.analysis.monitoring.prediction import is_uncertain

        if is_uncertain(plan):
            if _affordable_draws(space) < _FEWEST_DRAWS:
                return found._replace(left_out=_MANY_STATES)
            found.sources.append(_LEARNED)
    return found


def _affordable_draws(space: PlanSpace) -> int:
    return min(_MOST_DRAWS, _DRAWN_STATES // len(space.distinct(np.arange(len(space)))))


def _add_logs(
    found: HalfWidths,
    plan: Plan,
    draws: int,
    here: AnswerTables,
    answers: Callable[[Plan], AnswerTables],
) -> None:
    from gspn_framework_package.analysis.monitoring.prediction import draw_parameters

    generator = np.random.Generator(np.random.PCG64(0))
    drawn = [answers(draw_parameters(plan, generator).apply(plan)) for _ in range(draws)]
    times = student(0.975, draws - 1) * math.sqrt(1 + 1 / draws)
    for key, table in here.items():
        for name, v in table.items():
            values = [other[key][name] for other in drawn if name in other.get(key, {})]
            if len(values) < draws:
                found.widths[key][name] = math.inf
            elif any(values):
                relative = float(np.std(values, ddof=1) / abs(np.mean(values)))
                found.widths[key][name] += times * relative * abs(v)


SteadyIntervals = Dict[str, Dict[str, Tuple[float, Optional[float]]]]
"""Mean tokens and throughputs: name -> number, and the half width of its interval; None: not
known."""


def steady_intervals(analysis: Analysis) -> Tuple[SteadyIntervals, List[str]]:
    """Mean tokens and throughputs in the steady state with their intervals, and what those hold:
    sentences for people."""

    def answers(of: Analysis) -> AnswerTables:
        return {
            "mean_tokens": of.measures.mean_tokens,
            "throughput": of.measures.throughput,
        }

    here = answers(analysis)
    found = half_widths(analysis, here, answers)

    def half(key: str, name: str) -> Optional[float]:
        width = found.widths[key][name]
        return width if math.isfinite(width) else None

    values = {
        key: {name: (v, half(key, name)) for name, v in table.items()}
        for key, table in here.items()
    }
    return values, found.notes


Ends = Dict[str, Dict[str, Optional[List[float]]]]
"""What answers are of -> name -> the ends of the interval; None: not known."""


def ends_of(here: AnswerTables, found: HalfWidths) -> Ends:
    """The ends of the intervals of answers."""
    return {
        key: {name: _ends(key, name, v, found.widths[key][name]) for name, v in table.items()}
        for key, table in here.items()
    }


def add_intervals(
    analysis: Analysis,
    data: Dict[str, Any],
    timed: Callable[[Analysis], Dict[str, Any]],
    before: Callable[[Dict[str, Any]], None],
) -> None:
    """Add to a report the ``intervals`` of its answers about time, with ``interval_sources``: what
    they take into account, in words for people. What they leave out is one of its assumptions.

    :param timed: that part of the report of another analysis.
    :param before: receives the report before the intervals, which take longer, but with their
        sources.
    """

    def answers(of: Analysis) -> AnswerTables:
        there = timed(of)
        for key in there["undecided"].keys() - data["undecided"].keys():
            data["undecided"]["intervals.%s" % key] = there["undecided"][key]
        return _tables(there)

    here = _tables(data)
    coming = expected(analysis) if here else HalfWidths({}, [])
    if coming.sources:
        data["interval_sources"] = coming.sources
    if coming.left_out:
        assumed = [*data["timing"]["assumptions"], coming.left_out]
        data["timing"] = {**data["timing"], "assumptions": assumed}
    before(data)
    if coming.sources:
        ends = ends_of(here, half_widths(analysis, here, answers))
        data["intervals"] = {key: of.get("", of) for key, of in ends.items()}


def _tables(data: Mapping[str, Any]) -> AnswerTables:
    """The answers about time of a report."""
    found: Dict[str, Dict[str, Any]] = {}
    parts: List[Tuple[str, Any]] = [("steady_state", data.get("steady_state"))]
    parts += [("transient.%d" % i, part) for i, part in enumerate(data.get("transient") or ())]
    for key, part in parts:
        found.update(("%s.%s" % (key, of), part[of]) for of in NODE_TABLES if of in (part or ()))
        for place, shares in (part or {}).get("token_distribution", {}).items():
            found["%s.%s.%s" % (key, _DISTRIBUTION, place)] = shares
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


def _ends(key: str, name: str, value: float, half: float) -> Optional[List[float]]:
    """The ends of an interval; None: it is not known."""
    if math.isinf(half):
        return None
    reward = re.fullmatch(r"steady_state|transient\.\d+", key)
    low = value - half if reward or name == "" else max(value - half, 0.0)
    chance = name != "mean_time" if key.startswith("mean_time_to.") else _DISTRIBUTION in key
    return [low, min(value + half, 1.0) if chance else value + half]

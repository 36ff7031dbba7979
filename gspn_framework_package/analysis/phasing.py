"""Few phases for the durations of a plan, and the intervals of the answers that follow.

A chain can follow a duration only as exponential phases. Where those that it needs make too many
states, it gets fewer, with the same mean. All answers about time are then computed twice: as well
as possible, and with half as many phases, that is, with twice the squared variation. If an answer
is a linear function of the squared coefficients of variation, it is off by at most the difference
of the two; if of the coefficients themselves, by at most 1 + sqrt(2) times as much, the half width
of its interval. An answer that hardly differs by chance gets the share by which those of its table
differ together. That is an estimate, not a bound.
"""

from __future__ import annotations

import math
from typing import Any, Dict, List, Mapping, Optional, Sequence

import numpy as np

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.plan.space import ChoosePhases, PlanSpace
from gspn_framework_package.analysis.report import Questions, report
from gspn_framework_package.analysis.solution.steady_state import steady_state
from gspn_framework_package.model.errors import LimitError, RefusedError
from gspn_framework_package.run_net.run_net import State
from gspn_framework_package.run_net.size import PhasesOfDurations

FEW_STATES = 100_000
"""About so many states at most, if the number of phases is not given."""

_HALF_WIDTH = 1 + math.sqrt(2)
"""Half width of an interval, in differences of the two answers."""

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
    """Add the ``intervals`` that are due to the phases to a report, unless all durations are
    represented exactly."""
    space = analysis.space
    if not isinstance(space, PlanSpace) or not space.fewer_phases or space.refusal:
        return
    fewer = space.fewer_phases
    assert analysis.plan is not None
    other = Analysis(
        analysis.plan,
        limits=analysis.limits._replace(states=None),
        timing=space.notes.reading,
        phases=lambda *_: fewer,
        progress=analysis.while_working["progress"],
        cancel=analysis.while_working["cancel"],
    )
    asked = questions._replace(structure=False, reach=(), cover=())
    again = report(other, asked)
    for key, reason in again["undecided"].items():
        if key not in data["undecided"]:
            data["undecided"]["intervals.%s" % key] = reason
    found: Dict[str, Any] = {}
    if data.get("steady_state") and again["steady_state"]:
        found["steady_state"] = _spans_of(data["steady_state"], again["steady_state"])
    for key in data["titles"].get("timing", ()):
        if data[key] and again[key]:
            found[key] = _spans(data[key], again[key])
    if data.get("transient") and again["transient"]:
        found["transient"] = [
            _spans_of(*pair) for pair in zip(data["transient"], again["transient"])
        ]
    if data.get("mean_time_to"):
        found["mean_time_to"] = [
            _passage(*pair) for pair in zip(data["mean_time_to"], again["mean_time_to"])
        ]
    data["intervals"] = found


def _spans_of(here: Mapping[str, Any], there: Mapping[str, Any]) -> Dict[str, Any]:
    """The intervals of the measures of one distribution."""
    found: Dict[str, Any] = {key: _spans(here[key], there[key]) for key in _TABLES if key in here}
    if "reward" in here:
        found["reward"] = _span(here["reward"], there["reward"], -math.inf)
    return found


def _passage(here: Any, there: Any) -> Any:
    if not here or not there:
        return None
    within = zip(here["within"], there["within"])
    return {
        "mean_time": _span(here["mean_time"], there["mean_time"]),
        "probability": _span(here["probability"], there["probability"], 0.0, 1.0),
        "within": [_span(a["probability"], b["probability"], 0.0, 1.0) for a, b in within],
    }


def _spans(here: Mapping[str, Any], there: Mapping[str, Any]) -> Dict[str, Optional[List[float]]]:
    """The intervals of the numbers of a table."""
    both = [(v, there[name]) for name, v in here.items() if _is_number(v, there[name])]
    total = sum(v for v, _ in both)
    share = sum(abs(v - w) for v, w in both) / total if total else 0.0
    return {name: _span(v, there[name], share=share) for name, v in here.items()}


def _span(
    here: Any, there: Any, low: float = 0.0, high: float = math.inf, share: float = 0.0
) -> Optional[List[float]]:
    """The ends of an interval; None: there is none."""
    if not _is_number(here, there):
        return None
    half = _HALF_WIDTH * max(abs(here - there), share * abs(here))
    return [max(here - half, low), min(here + half, high)]


def _is_number(*values: Any) -> bool:
    return all(isinstance(value, (int, float)) for value in values)

"""The answers of a report that counting the markings gives: those that need neither a path nor the
graph."""

from __future__ import annotations

from typing import Any, Dict, Mapping, Optional, Tuple, Union

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.plan.reading import NET, TimingNotes
from gspn_framework_package.analysis.report_measures import INFINITE, MEASURES, Part
from gspn_framework_package.analysis.symbolic.markings import MarkingCounts
from gspn_framework_package.analysis.symmetry.lumped_space import LumpedSpace
from gspn_framework_package.model.errors import LimitError

SYMBOLIC = "symbolic"
"""The engine of a report whose markings were counted."""

NOT_COUNTED = "not answered with --symbolic: it needs the graph of all markings"

_TOO_LITTLE_MEMORY = "not decided: there is too little memory (raise --limit-memory)"

_UNASKED = 30.0
"""Longest time (s) to count markings that were too many to visit, if nobody asked for it."""


def answer_by_counting(analysis: Analysis, data: Dict[str, Any], undecided: Dict[str, str]) -> None:
    """Put into a report what counting the markings of a net answers; see ``docs/analysis.md`` for
    the keys. No marking is visited.

    :raises CancelledError: the work was cancelled.
    """
    data["timing"] = TimingNotes(NET, {}, [])._asdict()
    data["engine"] = SYMBOLIC
    reason = NOT_COUNTED
    try:
        _put(analysis, analysis.counts(), data, undecided)
    except (LimitError, MemoryError) as error:
        reason = str(error) if isinstance(error, LimitError) else _TOO_LITTLE_MEMORY
        data.update(dict.fromkeys(("states", "deadlocks", "memory_bytes")))
        data["left_out"] = []
        data["bounded"], data["bounds"] = _bounds(analysis, {})
        undecided.update(states=reason, bounds=reason)
    keys = [measure.key for measure in MEASURES if measure.part is Part.BEHAVIOUR]
    for key in ("bounded", "deadlocks", *keys, "steady_state"):
        if data.setdefault(key, None) is None:
            undecided.setdefault(key, reason)


def count_instead(analysis: Analysis, data: Dict[str, Any], undecided: Dict[str, str]) -> None:
    """Add to a report the counts of markings that were too many to visit, unless it has them
    already, or they take too long to count.

    :raises CancelledError: the work was cancelled.
    """
    space = analysis.space
    if space.complete or analysis.plan is not None or isinstance(space, LumpedSpace):
        return
    found: Dict[str, Any] = {}
    reasons: Dict[str, str] = {}
    try:
        _put(analysis, analysis.counts(_UNASKED), found, reasons)
    except (LimitError, MemoryError):
        return  # the reasons are those of the visit
    if data["deadlocks"] is not None:  # with a path to it
        found["deadlocks"] = {**data["deadlocks"], "count": found["deadlocks"]["count"]}
    data.update(found)
    for key in (*found, "deadlocks.count"):
        undecided.pop(key, None)
    undecided.update(reasons)


def _put(
    analysis: Analysis, counts: MarkingCounts, data: Dict[str, Any], undecided: Dict[str, str]
) -> None:
    data["states"] = {
        "total": counts.total,
        "tangible": counts.tangible,
        "vanishing": counts.total - counts.tangible,
        "arcs": counts.arcs,
    }
    data["engine"] = SYMBOLIC
    data["memory_bytes"] = counts.memory
    data["left_out"] = list(analysis.uncounted)
    data["bounded"], data["bounds"] = _bounds(analysis, counts.bounds)
    most = data["bounds"].values()
    data["k_safe"] = (
        None if None in most else INFINITE if INFINITE in most else max(most, default=0)
    )
    for key in ("bounded", "bounds", "k_safe"):
        if data[key] is None or key == "bounds" and None in most:
            undecided[key] = "not decided: %s left out" % ", ".join(analysis.uncounted)
    data["deadlocks"] = {"count": counts.dead, "witness": None, "marking": counts.dead_marking}
    data["dead_transitions"] = counts.dead_transitions
    if counts.dead_transitions or counts.dead:
        data["live"] = False
    if counts.dead and counts.total > 1:
        data["reversible"] = False


def _bounds(
    analysis: Analysis, counted: Mapping[str, int]
) -> Tuple[Optional[bool], Dict[str, Union[None, int, str]]]:
    """Whether the net is bounded, and the bounds of its places, of which some were counted."""
    bounds: Dict[str, Union[None, int, str]] = {
        place.name: INFINITE if place.name in analysis.growing_places else counted.get(place.name)
        for place in analysis.net.places
    }
    if analysis.growing_places:
        return False, bounds
    return (None if None in bounds.values() else True), bounds

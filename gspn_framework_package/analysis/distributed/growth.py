"""Whether a net grows without end: what one rank finds out before all visit its markings."""

from __future__ import annotations

from typing import Any, Dict, List, NamedTuple, Optional, Tuple

from gspn_framework_package.analysis.analyse import BEGINNING, Analysis
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.report import INFINITE, Questions, report
from gspn_framework_package.analysis.state_space.space import INVARIANT_EFFORT
from gspn_framework_package.analysis.structure.invariants import invariant_bounds
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.net import Net


class NetToVisit(NamedTuple):
    """What is to be visited of a net.

    :ivar net: the net, without the places ``left_out``.
    :ivar bounds: for each place of it, the most tokens it can hold (None: unknown).
    :ivar left_out: places that nothing reads and that may grow without bound.
    :ivar bounded: whether the whole net is bounded, if places were left out (None: not decided, for
        this ``reason``).
    :ivar left_out_bounds: their bounds, as a report has them.
    :ivar report: if the net is unbounded otherwise, so that visiting it would not end: the report
        of an analysis by one process. Else None.
    """

    net: Net
    bounds: List[Optional[int]]
    left_out: Tuple[str, ...] = ()
    bounded: Optional[bool] = True
    reason: str = ""
    left_out_bounds: Dict[str, Any] = {}
    report: Optional[Dict[str, Any]] = None


def growth(
    net: Net,
    limits: Limits,
    *,
    timing: bool = True,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> NetToVisit:
    """Find out what grows, from P-invariants, or else as an analysis by one process does.

    :param timing: whether a report has the steady state.
    :raises GspnError: a limit was reached.
    """
    watch = Watch(progress, cancel, seconds=limits.seconds)
    bounds = list(invariant_bounds(net, INVARIANT_EFFORT, watch))
    if None not in bounds:
        return NetToVisit(net, bounds)
    beginning = BEGINNING if limits.states is None else min(limits.states, BEGINNING)
    first = Analysis(
        net, limits=limits._replace(states=beginning), progress=progress, cancel=cancel
    )
    found = first.boundedness
    left_out = first.left_out
    if found.bounded is False and not left_out:
        questions = Questions(structure=False, timing=timing)
        return NetToVisit(net, bounds, bounded=False, report=report(first, questions))
    if not left_out:
        return NetToVisit(net, bounds)
    kept = net.without_places(left_out)
    bound_of = dict(zip(net.place_index, bounds))
    return NetToVisit(
        kept,
        [bound_of[place.name] for place in kept.places],
        tuple(left_out),
        found.bounded,
        found.reason,
        {
            name: INFINITE if most is None and found.bounded is False else most
            for name, most in found.bounds.items()
            if name in left_out
        },
    )

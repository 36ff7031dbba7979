"""The change that fixes a finding of the check, where there is one obvious way."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Dict, Iterable, List, Mapping, Optional

from gspn_framework_package.analysis.preflight.report import SHARED_EFFORT
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.subnet import SEPARATOR

if TYPE_CHECKING:
    from gspn_framework_package.analysis.plan.markings import Finding

Mend = Dict[str, Any]
"""``{"label": what it does, "set": [[path, value], ...]}``. A path is a list of keys from the plan
file on, through its net and its policy wherever these are; in a list of nodes, a key is a name, and
``"-"`` is the end of a list."""

MENDED_ROOM = 20
"""Tokens that a place has room for once its growth is bounded."""


def mended(label: str, changes: Iterable[List[Any]]) -> Dict[str, Mend]:
    """The detail ``mend`` of a finding; nothing if there is no change, or if it is in a subnet."""
    listed = list(changes)
    inside = any(SEPARATOR in step for path, _ in listed for step in path if isinstance(step, str))
    return {"mend": {"label": label, "set": listed}} if listed and not inside else {}


def null_actions(places: Iterable[str]) -> Dict[str, Mend]:
    """Robots have nothing to do in these places."""
    return mended("no action there", ([["actions", place], None] for place in places))


def tokens_of_robots(robots: Mapping[str, int]) -> Dict[str, Mend]:
    """Each place begins with as many tokens as robots."""
    return mended(
        "a token for each robot",
        ([["net", "places", place, "tokens"], number] for place, number in robots.items()),
    )


def tasks_given_back(plan: Plan, places: Iterable[str]) -> Dict[str, Mend]:
    """A robot that is lost in one of these places gives its task back to the only queue."""
    if len(plan.tasks.queues) != 1:
        return {}
    (queue,) = plan.tasks.queues
    return mended(
        "give the task back to %s" % queue,
        ([["on_evict", place, queue], 1] for place in places),
    )


def resources_given_back(plan: Plan) -> Dict[str, Mend]:
    """A robot that is lost gives back what it holds in its place, as invariants say, where
    ``on_evict`` says nothing about that resource."""
    from gspn_framework_package.analysis.structure.invariants import place_invariants

    changes = []
    try:
        found = place_invariants(plan.net, SHARED_EFFORT)
    except LimitError:
        return {}
    for weights in (invariant.weights for invariant in found):
        held = [name for name in weights if name in plan.resource_places]
        for place in weights if len(held) == 1 else ():
            number, rest = divmod(weights[place], weights[held[0]])
            if place not in held and not rest and held[0] not in plan.on_evict.get(place, {}):
                changes.append([["on_evict", place, held[0]], number])
    return mended("give back what a lost robot held", changes)


def bounded(plan: Plan, places: Iterable[str]) -> Dict[str, Mend]:
    """The change that gives each of these places a capacity."""
    return mended(
        "room for %d tokens" % MENDED_ROOM,
        (
            [["net", "places", place, "capacity"], max(MENDED_ROOM, plan.net.place(place).tokens)]
            for place in places
        ),
    )


def rows_for_all_markings(plan: Plan, places: Iterable[str]) -> Dict[str, Mend]:
    """A row for the robots in each of these places, whatever the marking, which chooses by the
    weights."""
    net, rows = plan.net, []
    for place in places:
        leaving = net.immediate_from[net.place_number(place)]
        weights = {net.transitions[t].name: net.transitions[t].number for t in leaving}
        choose = _shares(weights)
        if choose is None or plan.policy.scopes:
            return {}
        rows.append({"marking": ["-"] * len(plan.policy.places), "choose": choose})
    label = "add a row for each of them" if len(rows) > 1 else "add a row for it"
    return mended(label, ([["policy", "rows", "-"], row] for row in rows))


def missing_row(plan: Plan, finding: Finding) -> Dict[str, Mend]:
    """A row for the marking of a finding, which chooses by the weights of what can fire there, all
    equal if there are no weights."""
    place = finding.place
    if place is None or plan.policy.scopes or SEPARATOR in place:
        return {}
    net = plan.net
    marking = [finding.marking.get(p.name, 0) for p in net.places]
    weights = {
        net.transitions[t].name: net.transitions[t].number
        for t in net.immediate_from[net.place_number(place)]
        if net.is_enabled(marking, t)
    }
    shares = _shares(weights)
    if shares is None:
        return {}
    cells = [finding.marking.get(name, 0) for name in plan.policy.places]
    row = {"marking": cells, "choose": shares}
    return mended("add a row for this marking", [[["policy", "rows", "-"], row]])


def _shares(weights: Mapping[str, float]) -> Optional[Dict[str, float]]:
    """Probabilities in proportion to weights, or equal if all are 0; None if nothing has one."""
    total = sum(weights.values())
    found = {t: round(w / total if total else 1 / len(weights), 12) for t, w in weights.items()}
    return {t: 1 if share == 1 else share for t, share in found.items() if share} or None

"""What would happen in a marking of an edited plan: which row of the policy applies to the robots
of each place, which transitions they would choose with which probability, and why."""

from __future__ import annotations

from typing import Any, Dict, Mapping, Sequence

from gspn_framework_package.formats.edited_document import EditedDocument, plan_of_document
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.model.net import MAX_COUNT, Marking
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.run_net.compiling import compile_plan
from gspn_framework_package.run_net.run_net import RunNet


def choices(document: EditedDocument, path: str, root: str, marking: Any) -> Dict[str, Any]:
    """Report what would happen in a marking.

    :param path: its plan file.
    :param root: the served folder, which its subnets may not leave.
    :param marking: place -> tokens; missing places have none. A subnet's place stands
        for its entry.
    :returns: ``places``: for each place with robots the ``row`` that applies (from 1, or null),
        the ``transitions`` with their probabilities, and ``why`` in words; ``enabled``: the names
        of all transitions that the marking enables.
    :raises GspnError: the document is not a valid plan, or the marking is not one of its net.
    """
    plan = plan_of_document(document, path, root)
    rules = compile_plan(plan, None)
    full = _marking(plan, marking)
    counts = dict(zip((p.name for p in plan.net.places), full))
    here = tuple(counts[p.name] for p in rules.net.places)
    return {
        "places": [
            _place(plan, rules, full, here, p)
            for p, place in enumerate(rules.net.places)
            if here[p] and rules.acts[p]
        ],
        "enabled": [
            plan.net.transitions[t].name for t in plan.net.enabled(full, by_priority=False)
        ],
        "over": rules.is_over(here),
    }


def _marking(plan: Plan, given: Any) -> Marking:
    if not isinstance(given, Mapping):
        raise InputError("a marking must be an object: place -> tokens", element="marking")
    counts = dict.fromkeys((p.name for p in plan.net.places), 0)
    for name, count in given.items():
        subnet = plan.subnets.get(name)
        place = subnet.entry if subnet is not None else name
        if place not in counts:
            raise InputError("the net has no place '%s'" % name, element="marking")
        if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count <= MAX_COUNT:
            raise InputError("%r is not a number of tokens" % (count,), element="marking.%s" % name)
        counts[place] += count
    return tuple(counts.values())


def _place(plan: Plan, rules: RunNet, full: Marking, here: Marking, p: int) -> Dict[str, Any]:
    """Describe what a robot in place ``p`` of the rules' net does once its action is over."""
    net, name = plan.net, rules.net.places[p].name
    place = net.place_number(name)
    table = plan.policy.bind(net)
    leaving = list(net.immediate_from[place])
    ready = {t for t in leaving if net.is_enabled(full, t)}
    drawn = dict(rules.draws.of(here, p, ready)) if leaving else {}
    found = table.distribution(full, place) if leaving else None
    return {
        "place": name,
        "tokens": full[place],
        "row": found.row + 1 if found is not None else None,
        "why": _why(plan, full, place, leaving),
        "transitions": [
            {
                "name": net.transitions[t].name,
                "probability": drawn.get(t, 0.0),
                "enabled": t in ready,
                "why": net.why_disabled(full, t),
            }
            for t in leaving
        ]
        or [
            {
                "name": net.transitions[t].name,
                "probability": None,
                "enabled": net.is_enabled(full, t),
                "why": net.why_disabled(full, t),
            }
            for t in net.consumers[place]
        ],
    }


def _why(plan: Plan, full: Marking, place: int, leaving: Sequence[int]) -> str:
    net, table = plan.net, plan.policy.bind(plan.net)
    if not net.consumers[place]:
        return "no transition leaves this place: a robot stays here"
    if not leaving:
        return "only timed transitions leave: the action's result or an event selects one"
    found = table.distribution(full, place)
    if found is not None and not found.choices:
        return "row %d of the policy applies: robots wait here" % (found.row + 1)
    if found is not None:
        others = _others(plan, full, place, found.row)
        return "row %d of the policy applies%s" % (found.row + 1, others)
    if table.matches(full, place):
        return "rows of the policy match, but none applies to this place: robots wait here"
    if plan.strict:
        return "no row of the policy matches and the plan is strict: robots wait here"
    if all(net.transitions[t].is_controllable for t in leaving if net.is_enabled(full, t)):
        enabled = any(net.is_enabled(full, t) for t in leaving)
        return (
            "no row of the policy matches, and the weights are 0: robots wait here"
            if enabled
            else "no transition is enabled: robots wait here"
        )
    rows = "no row of the policy matches" if plan.policy.rows else "there is no policy"
    return "%s: the weights decide among the enabled transitions" % rows


def _others(plan: Plan, full: Marking, place: int, row: int) -> str:
    """Name the other rows that match and apply to the place, and over which this row takes
    precedence."""
    table = plan.policy.bind(plan.net)
    also = [
        number + 1
        for number in sorted(table.deciding(place))
        if number != row and table.row_matches(number, full)
    ]
    if not also:
        return ""
    listed = ", ".join(map(str, also[:8])) + (", ..." if len(also) > 8 else "")
    return "; it takes precedence over row%s %s, which also match%s" % (
        "" if len(also) == 1 else "s",
        listed,
        "es" if len(also) == 1 else "",
    )

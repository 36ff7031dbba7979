"""Who chooses in a place: the policy, or chance (the action, or the weights). The computation of a
policy may only change choices of the policy, so every answer includes its reason."""

from __future__ import annotations

from typing import AbstractSet, Dict, NamedTuple, Sequence, Tuple

from gspn_framework_package.analysis.plan.reading import RUN
from gspn_framework_package.model.errors import RefusedError, UsageError
from gspn_framework_package.model.marking_function import Value
from gspn_framework_package.model.plan import Plan


class Decider(NamedTuple):
    """Who chooses in an action place with immediate outputs.

    :ivar policy: whether the policy chooses (where the action names no transition).
    :ivar reason: why, for people.
    :ivar chances: where chance does: (number of the transition, weight).
    """

    policy: bool
    reason: str
    chances: Tuple[Tuple[int, Value], ...] = ()


def who_decides(plan: Plan, reading: str, may_wait: AbstractSet[str]) -> Dict[str, Decider]:
    """Who chooses in each action place that immediate transitions leave.

    :param reading: how time is interpreted.
    :param may_wait: places in which a robot may wait although it could leave.
    :raises RefusedError: a place has immediate and exponential outputs, or chance has no weights.
    :raises UsageError: ``may_wait`` names a place in which no robot can wait.
    """
    net = plan.net
    table = plan.policy.bind(net)
    found: Dict[str, Decider] = {}
    for name in plan.action_places:
        p = net.place_number(name)
        leaving = plan.of_action(p)
        immediate = net.immediate_from[p]
        if not immediate:
            continue
        if len(immediate) < len(leaving) and not (reading == RUN and name in plan.outcomes):
            raise RefusedError(
                "immediate and exponential transitions leave it, so it is ambiguous who decides",
                element=name,
                hint="let the policy choose an immediate transition into a separate place"
                + (", or give its outcomes" if reading == RUN else ""),
            )
        spoken = bool(table.speaking(p) or table.waiting(p))
        found[name] = _decider(plan, name, immediate, reading, name in may_wait, spoken)
    for name in sorted(may_wait):
        if name not in found:
            raise UsageError(
                "there is no choice in '%s', so no robot waits there by choice" % name,
                hint="choose from: %s" % ", ".join(found) if found else "no policy decides here",
            )
        if not found[name].policy:
            raise UsageError(
                "a robot in '%s' cannot wait by choice: %s" % (name, found[name].reason)
            )
    return found


def _decider(
    plan: Plan, name: str, immediate: Sequence[int], reading: str, may_wait: bool, spoken: bool
) -> Decider:
    transitions = plan.net.transitions
    outcomes = plan.outcomes.get(name)
    named = {t: v for t, v in (outcomes or {}).items() if t and v > 0}
    by_weight = tuple(
        (t, transitions[t].weight) for t in immediate if not transitions[t].is_controllable
    )
    by_action = tuple(
        (t, named[transitions[t].name]) for t in immediate if transitions[t].name in named
    )
    leaves_it = outcomes is not None and outcomes.get("", 0) > 0
    if name in plan.chance:
        chances = by_weight if reading == RUN and by_weight else by_action or by_weight
        if not chances:
            raise RefusedError(
                "chance decides there, but no transition has a weight",
                element=name,
                hint="give the transitions weights, or take it out of the plan's 'chance'",
            )
        return Decider(False, "the plan's key 'chance' lists it", chances)
    if outcomes is not None and not named:
        return Decider(True, "its outcomes leave it to the policy")
    if named and not leaves_it:
        return Decider(False, "its outcomes are those that the action names", by_action)
    if named:
        if reading == RUN:
            return Decider(True, "its outcomes leave to the policy what the action does not name")
        return Decider(True, "the rates of the net count, not its outcomes")
    if may_wait:
        return Decider(True, "a robot may wait there")
    if plan.actions.get(name, True) is None:
        return Decider(True, "no action runs there")
    if len(by_weight) < len(immediate):
        return Decider(True, "a transition that leaves it has the weight 0")
    if spoken:
        return Decider(True, "the present policy has rows for it")
    if plan.strict:
        return Decider(True, "the plan is strict, so no weights decide")
    return Decider(False, "only the weights decide there", by_weight)

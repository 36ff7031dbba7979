"""Reasons why a transition cannot fire, or does not yet, according to the rules of the token game
and the policy. The page asks the server for them."""

from __future__ import annotations

from typing import Any, Dict, List, Optional

from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.visualizer.board import Board
from gspn_framework_package.visualizer.session import Session

NAMED = 4
"""Largest number of transitions named as taking precedence."""


def reasons_in(session: Session, transition: str, at: Optional[int] = None) -> Dict[str, Any]:
    """The reasons why a transition of an open net cannot fire.

    :param session: the open net.
    :param at: number of the event after which to evaluate; None for now.
    :returns: ``transition``, whether it is ``enabled``, the ``reasons`` as texts (for an enabled
        one: the robots that it still waits for, and what the policy says), and ``at``: the number
        of the event after which this holds.
    :raises NetError: the net has no transition of that name.
    """
    hub = session.hub
    board = hub.board() if at is None else hub.board_at(at)
    document = session.document_at(board.plan)
    net, plan = document.net, document.plan
    t = net.transition_number(transition)
    reasons = net.why_disabled(board.marking, t)
    # in a run, actions take time and priorities do not matter
    if not reasons and hub.mode == "SIMULATE":
        reasons = _who_goes_first(net, board, t)
    enabled = not reasons
    if enabled and plan is not None and hub.mode != "SIMULATE":
        reasons = _robots_awaited(net, plan, board, t) + _policy_says(net, plan, board, t)
    return {"transition": transition, "enabled": enabled, "reasons": reasons, "at": board.n}


def _who_goes_first(net: Net, board: Board, t: int) -> List[str]:
    first = net.enabled(board.marking)
    if t in first:
        return []
    names = ", ".join(net.transitions[u].name for u in first[:NAMED])
    if len(first) > NAMED:
        names += " and %d more" % (len(first) - NAMED)
    verb = "goes" if len(first) == 1 else "go"
    return [
        "%s %s first (%s)"
        % (names, verb, "immediate" if net.transitions[t].timed else "higher priority")
    ]


def _robots_awaited(net: Net, plan: Plan, board: Board, t: int) -> List[str]:
    """The robots that must finish their actions before ``t`` fires."""
    awaited = []
    for p, weight in net.inputs[t]:
        if net.places[p].name in plan.resource_places:
            continue
        here = [robot for robot in board.robots.values() if robot.get("place") == p]
        done = sum(
            robot.get("phase") == Phase.DONE.value and not robot.get("paused") for robot in here
        )
        if done < weight:
            robots = "robot is" if weight == 1 else "robots are"
            awaited.append("%s: %d of %d %s done" % (net.places[p].name, done, weight, robots))
    return awaited


def _policy_says(net: Net, plan: Plan, board: Board, t: int) -> List[str]:
    """What the policy chooses for the robots that could fire ``t``, for each place that ``t`` takes
    them from."""
    if net.transitions[t].timed or not plan.policy.rows:
        return []
    table = plan.policy.bind(net)
    said = []
    for p, _ in net.inputs[t]:
        place = net.places[p].name
        if place in plan.resource_places:
            continue
        found = table.distribution(board.marking, p)
        if found is None and table.matches(board.marking, p):
            said.append("no policy row applies to %s in this marking: robots wait there" % place)
        elif found is not None and not found.choices:
            said.append("row %d of the policy lets robots wait in %s" % (found.row + 1, place))
        elif found is not None:
            chosen = ", ".join(
                "%s (%g %%)" % (net.transitions[u].name, 100 * v) for u, v in found.choices[:NAMED]
            )
            said.append("row %d of the policy: from %s, %s" % (found.row + 1, place, chosen))
    return said

"""The fixed part of the picture as a JSON object: nodes and arcs with their positions and their
attributes from the plan."""

from __future__ import annotations

import math
from typing import Any, Dict, List, Optional, Sequence

from gspn_framework_package.execution.breakpoints import why_no_breakpoint
from gspn_framework_package.model.action import ServerAction
from gspn_framework_package.model.goal_pose import goal_pose
from gspn_framework_package.model.marking_function import written
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.visualizer.layout import Layout, lay_out, net_hash


def scene_to_json(net: Net, plan: Optional[Plan] = None) -> Dict[str, Any]:
    """The scene of a net, with the attributes from its plan."""
    layout = lay_out(net, **boxes_of(plan))
    return {
        "name": (plan.name if plan is not None else net.name) or "net",
        "hash": net_hash(net),
        "places": [
            {
                "name": p.name,
                "tokens": p.tokens,
                "capacity": p.capacity,
                "kind": _kind(p.name, plan),
                "action": _action(p.name, plan),
                "breakable": plan is not None and not why_no_breakpoint(plan, p.name, "place"),
                "queue": plan is not None and p.name in plan.tasks.queues,
                **_at(p.name, plan),
            }
            for p in net.places
        ],
        "transitions": [
            {
                "name": t.name,
                "timed": t.timed,
                "rate": written(t.rate),
                "weight": written(t.weight),
                "priority": t.priority,
                "servers": t.servers,
                "environment": plan is not None and is_environment(net, plan, i),
                "event": _event(t.name, plan),
                "breakable": plan is not None and not why_no_breakpoint(plan, t.name, "transition"),
                "submits": plan is not None and t.name in plan.submissions,
            }
            for i, t in enumerate(net.transitions)
        ],
        "arcs": [_arc(net, a) for a in range(len(net.arcs))],
        "layout": {**layout_to_json(net, layout), "bends": _bends(net, layout)},
        "subnets": _subnets(net, plan),
        "groups": _groups(net, plan),
        "plan": _plan(plan),
    }


def boxes_of(plan: Optional[Plan]) -> Dict[str, Any]:
    """The input of :func:`lay_out` from a plan: its subnets and groups."""
    return {} if plan is None else {"subnets": plan.subnets, "groups": plan.groups}


def layout_to_json(net: Net, layout: Layout) -> Dict[str, Any]:
    """The layout: centres in the order of places and transitions."""
    return {
        "engine": layout.engine,
        "places": [_rounded(layout.positions[p.name]) for p in net.places],
        "transitions": [_rounded(layout.positions[t.name]) for t in net.transitions],
    }


def _bends(net: Net, layout: Layout) -> Dict[int, List[List[float]]]:
    """Number of an arc -> its bends, from the middle between its ends, with which they move; none
    if the layout is not that of the file."""
    found: Dict[int, List[List[float]]] = {}
    if layout.engine != "file":
        return {}
    drawn = net.positions
    for number, arc in enumerate(net.arcs):
        ends = arc.source, arc.target
        if not arc.bends or not drawn.keys() >= set(ends):
            continue
        here = [drawn[name] for name in ends]
        apart = math.dist(*here)
        scale = math.dist(*(layout.positions[name] for name in ends)) / apart if apart else 1.0
        x, y = ((a + b) / 2 for a, b in zip(*here))
        found[number] = [_rounded((scale * (bx - x), scale * (by - y))) for bx, by in arc.bends]
    return found


def _rounded(point: Sequence[float]) -> List[float]:
    return [round(point[0], 1), round(point[1], 1)]


def _arc(net: Net, a: int) -> List[int]:
    """An arc: place, transition, direction (1: from the place), weight, inhibitor."""
    arc = net.arcs[a]
    if arc.source in net.place_index:
        place, transition = net.place_index[arc.source], net.transition_index[arc.target]
        return [place, transition, 1, arc.weight, int(arc.inhibitor)]
    return [net.place_index[arc.target], net.transition_index[arc.source], 0, arc.weight, 0]


def _kind(place: str, plan: Optional[Plan]) -> str:
    if plan is None:
        return "plain"
    return "resource" if place in plan.resource_places else "action"


def is_environment(net: Net, plan: Plan, t: int) -> bool:
    """Whether the environment, or the operator on its behalf, may fire transition ``t``: it takes
    no robot."""
    return all(net.places[p].name in plan.resource_places for p, _ in net.inputs[t])


def _action(place: str, plan: Optional[Plan]) -> Optional[str]:
    action = plan.actions.get(place) if plan is not None else None
    return None if action is None else action.label


def _at(place: str, plan: Optional[Plan]) -> Dict[str, Any]:
    """Where the goal of a place sends robots: ``at``, as x and y (m); nothing if it does not
    say."""
    action = plan.actions.get(place) if plan is not None else None
    found = goal_pose(action.goal) if isinstance(action, ServerAction) else None
    return {"at": [round(metres, 2) for metres in found.position[:2]]} if found is not None else {}


def _event(transition: str, plan: Optional[Plan]) -> Optional[str]:
    """The source of the event of a transition, in words; None if it has no event."""
    if plan is None or transition not in plan.events:
        return None
    source = plan.events[transition]
    modes = [mode for mode in ("edge", "hold", "resume") if getattr(source, mode)]
    return source.label + (" (%s)" % ", ".join(modes) if modes else "")


def _subnets(net: Net, plan: Optional[Plan]) -> List[Dict[str, Any]]:
    """The subnets, outer ones before those inside them."""
    if plan is None:
        return []
    return [
        {
            "name": name,
            "plan": subnet.plan,
            "entry": net.place_number(subnet.entry),
            "exit": net.place_number(subnet.exit),
            "places": [net.place_number(p) for p in subnet.places],
            "robots": [net.place_number(p) for p in subnet.places if p not in plan.resource_places],
            "transitions": [net.transition_number(t) for t in subnet.transitions],
        }
        for name, subnet in sorted(plan.subnets.items(), key=lambda item: len(item[0]))
    ]


def _groups(net: Net, plan: Optional[Plan]) -> List[Dict[str, Any]]:
    """The groups: ``name``, and the numbers of their ``places`` and ``transitions``."""
    return [
        {
            "name": name,
            "places": [net.place_index[n] for n in nodes if n in net.place_index],
            "transitions": [net.transition_index[n] for n in nodes if n in net.transition_index],
        }
        for name, nodes in (plan.group_nodes if plan is not None else {}).items()
    ]


def _plan(plan: Optional[Plan]) -> Optional[Dict[str, Any]]:
    if plan is None:
        return None
    return {
        "name": plan.name,
        "synchronisation": plan.synchronisation.value,
        "seed": plan.seed,
        "robots": [[r.name, r.place] for r in plan.robots],
        "policy_rows": len(plan.policy.rows),
        "environment": plan.simulate_environment,
        "notes": list(plan.notes),
    }

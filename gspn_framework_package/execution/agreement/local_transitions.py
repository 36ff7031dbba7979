"""Local transitions of partial synchronisation: transitions that concern one robot only.

Leaving a *private* place takes that robot and nothing else: its output transitions have it as their
only input, with weight 1, and one action place as output, and touch no resource, inhibitor or
capacity. Such a firing has a single writer and commutes with every firing of the other robots (Best
and Darondeau: a net is distributable where transitions at different locations share no input
place), so it needs no agreement about its order.

Depends only on the plan: owns no mutable state and calls no other part. Logs and messages mark such
a transition as ``private``.
"""

from __future__ import annotations

from typing import Dict, FrozenSet, Optional, Set, Tuple

from gspn_framework_package.execution.token_game import TokenGame


class LocalTransitions:
    """The private places of a plan, for one robot of it.

    A transition is not local if the rest of the run could notice it: if ``until``, an inhibitor
    arc, a capacity, a rate or a weight refers to one of its places, if a task may be completed
    there, if the robot would be done as soon as it arrives (and ask for more within the same step),
    or if the policy could withhold an immediate transition.
    """

    def __init__(self, game: TokenGame, robot: str) -> None:
        plan, net = game.plan, game.net
        watched: Set[int] = {p for arcs in net.inhibitors for p, _ in arcs}
        watched |= {p for p, place in enumerate(net.places) if place.capacity is not None}
        if plan.ending is not None:
            watched |= {net.place_number(name) for name in plan.ending.places}
        watched |= {net.place_number(name) for name in net.named_by_functions()}
        watched |= {p for t in plan.tasks.done for p, _ in net.inputs[net.transition_number(t)]}
        policy_decides = bool(plan.policy.rows) or plan.strict
        self._net = net
        self._target: Dict[Tuple[int, int], int] = {}
        self._only: Dict[int, int] = {}
        for p, leaving in enumerate(net.consumers):
            immediate = net.immediate_from[p]
            if not leaving or (immediate and (len(leaving) > 1 or policy_decides)):
                continue
            if any(net.transitions[t].is_controllable for t in immediate):
                continue
            targets = {}
            for t in leaving:
                ends = net.outputs[t]
                if net.inputs[t] != ((p, 1),) or net.inhibitors[t] or len(ends) != 1:
                    break
                ((target, weight),) = ends
                name = net.places[target].name
                if weight != 1 or name in plan.resource_places or {p, target} & watched:
                    break
                if plan.action(robot, name) is None:
                    break
                targets[p, t] = target
            else:
                self._target.update(targets)
                if len(leaving) == 1 and leaving[0] not in game.interrupts:
                    self._only[p] = leaving[0]

    @property
    def places(self) -> FrozenSet[str]:
        """The names of the private places."""
        return frozenset(self._net.places[p].name for p, _ in self._target)

    def find(self, place: int, result: str) -> Optional[Tuple[int, int]]:
        """The (transition, target) of a robot that is done in ``place`` with this result; None if
        the transition is not local or the result is invalid."""
        if result in ("", "None"):
            t = self._only.get(place)
        else:
            t = self._net.transition_index.get(result)
        if t is None or (place, t) not in self._target:
            return None
        return t, self._target[place, t]

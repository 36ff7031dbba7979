"""The rules for deploying a new plan to a running team: whether its state fits the plan, and how
the names of the old plan map to it.

A new plan is *staged*, each member votes on it, and it is *adopted* (see ``docs/semantics.md``).
This module only compares plans and states; the token game carries out the change.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from dataclasses import replace
from typing import Any, Dict, List, Mapping, Optional, Tuple

from gspn_framework_package.execution.log_entries import StagePlan
from gspn_framework_package.execution.team_state import StagedPlan, TeamState
from gspn_framework_package.execution.team_tasks import first_of
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json
from gspn_framework_package.model.compact_json import compact_sorted
from gspn_framework_package.model.errors import GspnError, PlanError
from gspn_framework_package.model.kept import Kept
from gspn_framework_package.model.plan import Plan, RobotSpec

KEPT_PLANS = 8
"""Number of parsed plans to cache."""

_plans: Kept[str, Plan] = Kept(KEPT_PLANS)


def digest_of(plan: Mapping[str, Any]) -> str:
    """A hash of everything in a plan (a JSON object), including its actions and times, which do not
    determine the course of a run and are not in ``Plan.hash``."""
    text = compact_sorted(plan)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def stage_of(plan: Plan, mapping: Mapping[str, str], folder: str = "") -> StagePlan:
    """Make the entry that stages a plan.

    :param mapping: names of places and transitions in the present net -> their names in ``plan``.
    :param folder: the folder where every robot finds the functions of the plan; "" to keep the
        present one.
    """
    data = json.loads(json.dumps(plan_to_json(plan)))
    return StagePlan(data, digest_of(data), dict(mapping), folder)


def plan_of(staged: StagedPlan) -> Plan:
    """Parse a staged plan.

    :raises GspnError: it is not a plan, or its digest differs.
    """

    def read() -> Plan:
        if digest_of(staged.plan) != staged.digest:
            raise PlanError("the digest of the staged plan differs from the recorded one")
        try:
            return plan_from_json(dict(staged.plan))
        except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
            raise PlanError("not a plan (%r)" % error) from None

    return _plans.get(staged.digest, read)


class NewNames:
    """The names of a plan's places and transitions in the next plan.

    Names not in ``mapping`` are unchanged.
    """

    def __init__(self, old: Plan, new: Plan, mapping: Mapping[str, str]) -> None:
        self._mapping = mapping
        self._old, self._new = old.net, new.net

    def place(self, name: str) -> Optional[str]:
        """The new name of a place; None if it no longer exists."""
        new = self._mapping.get(name, name)
        return new if new in self._new.place_index else None

    def transition(self, name: str) -> Optional[str]:
        """The new name of a transition; None if it no longer exists."""
        new = self._mapping.get(name, name)
        return new if new in self._new.transition_index else None

    def place_number(self, p: int) -> Optional[int]:
        """The new number of a place; None if it no longer exists."""
        name = self.place(self._old.places[p].name)
        return None if name is None else self._new.place_index[name]

    def transition_number(self, t: int) -> Optional[int]:
        """The new number of a transition; None if it no longer exists."""
        name = self.transition(self._old.transitions[t].name)
        return None if name is None else self._new.transition_index[name]


def home_of(plan: Plan, robot: str) -> str:
    """The place where a robot of this name starts in a plan."""
    own = next((r.place for r in plan.robots if r.name == robot), "")
    return own or next(iter((*plan.spawn, *plan.action_places)), "")


def why_never(old: Plan, new: Plan, mapping: Mapping[str, str]) -> List[str]:
    """Why a team that follows ``old`` cannot switch to ``new`` with this mapping in any state;
    empty if nothing forbids it."""
    why = []
    for what, a, b in (
        ("synchronisation", old.synchronisation.value, new.synchronisation.value),
        ("agreement.witnesses", list(old.witness), list(new.witness)),
        ("agreement.fsync", old.fsync, new.fsync),
        ("agreement.evict_after", old.timing.evict_after, new.timing.evict_after),
        ("agreement.fence_after", old.timing.fence_after, new.timing.fence_after),
    ):
        if a != b:
            why.append(
                "it changes '%s' from %s to %s, which is not possible during a run"
                % (what, json.dumps(a), json.dumps(b))
            )
    if not new.action_places:
        why.append("the plan has no place for a robot")
    for name, target in mapping.items():
        if name in old.net.place_index:
            why += _why_not_place(old, new, name, target)
        elif name not in old.net.transition_index:
            why.append("'%s' is mapped, but the present net has no such place or transition" % name)
        elif target not in new.net.transition_index:
            why.append(
                "the transition '%s' is mapped to '%s', which is not a transition of the new net"
                % (name, target)
            )
        elif name in new.net.transition_index and name != target:
            why.append(
                "the transition '%s' is mapped to '%s', but the new net has another '%s'"
                % (name, target, name)
            )
    return why


def _why_not_place(old: Plan, new: Plan, name: str, target: str) -> List[str]:
    resource = name in old.resource_places
    if not target:
        return (
            [] if resource else ["the robots of '%s' cannot be dropped: map it to a place" % name]
        )
    if target not in new.net.place_index:
        return [
            "the place '%s' is mapped to '%s', which is not a place of the new net" % (name, target)
        ]
    if resource != (target in new.resource_places):
        kinds = ("an action place", "a resource place")
        return ["'%s' is %s and '%s' is %s" % (name, kinds[resource], target, kinds[not resource])]
    return []


def new_marking(state: TeamState, old: Plan, new: Plan, names: NewNames) -> Dict[str, int]:
    """The marking of the new net: the robots in their places, the tokens of surviving resource
    places, and the initial tokens of new ones."""
    marking = {p.name: 0 for p in new.net.places}
    inherited = set()
    for place, tokens in zip(old.net.places, state.marking):
        target = names.place(place.name)
        resource = place.name in old.resource_places
        if target is None or resource != (target in new.resource_places):
            continue
        if resource:
            inherited.add(target)
            marking[target] += tokens
    for robot in state.active():
        target = names.place(old.net.places[robot.place].name)
        if target is not None:
            marking[target] += 1
    for place in new.net.places:
        if place.name in new.resource_places and place.name not in inherited:
            marking[place.name] = place.tokens
    return marking


def why_not(state: TeamState, old: Plan, new: Plan, mapping: Mapping[str, str]) -> List[str]:
    """Why the team cannot switch to ``new`` from this state; empty if it can."""
    why = why_never(old, new, mapping)
    if why:
        return why
    names = NewNames(old, new, mapping)
    robots = Counter(old.net.places[r.place].name for r in state.active())
    for place, tokens in zip(old.net.places, state.marking):
        target = names.place(place.name)
        if place.name in robots:
            if target is None or target in new.resource_places:
                who = [r.name for r in state.active() if old.net.places[r.place] is place]
                why.append(
                    "%s in '%s', which is not an action place of the new plan: map it"
                    % (_are(who), place.name)
                )
        elif (
            tokens
            and place.name in old.resource_places
            and mapping.get(place.name) != ""
            and (target is None or target not in new.resource_places)
        ):
            why.append(
                "'%s' holds %d tokens, but is not a resource place of the new plan: map it, or "
                "drop them with '%s='" % (place.name, tokens, place.name)
            )
    why += _tasks_without_place(state, old, new, names)
    if not why:
        marking = new_marking(state, old, new, names)
        for place in new.net.places:
            if place.capacity is not None and marking[place.name] > place.capacity:
                why.append(
                    "'%s' would hold %d tokens, more than its capacity of %d"
                    % (place.name, marking[place.name], place.capacity)
                )
    return why


def _are(robots: List[str]) -> str:
    return "%s %s" % (", ".join(robots), "is" if len(robots) == 1 else "are")


def _tasks_without_place(state: TeamState, old: Plan, new: Plan, names: NewNames) -> List[str]:
    """The tasks that would be lost."""
    why = []
    for p, queue in state.queues.items():
        place = old.net.places[p].name
        real = [task.id for task in queue if task.id]
        if real and names.place(place) not in new.tasks.queues:
            why.append(
                "%d tasks wait in '%s', which is not a queue in the new plan: %s"
                % (len(real), place, first_of(real))
            )
    waiting: Dict[str, List[str]] = {}
    for number, task in state.submitted:
        waiting.setdefault(old.net.transitions[number].name, []).append(task.id)
    for t, ids in waiting.items():
        if names.transition(t) not in new.submissions:
            why.append(
                "%d tasks wait for '%s', which does not take tasks in the new plan: %s"
                % (len(ids), t, first_of(ids))
            )
    return why


def tasks_in_hand(state: TeamState, new: Optional[Plan]) -> List[str]:
    """Why a plan without queues cannot be adopted now: robots carry tasks, which they could give
    back nowhere."""
    if new is None or new.tasks.queues:
        return []
    return [
        "%s has task %s, but the new plan has no queue: cancel the task, or let it be done first"
        % (robot.name, robot.task.id)
        for robot in state.active()
        if robot.task is not None and robot.task.id
    ]


def begun_here(state: TeamState, old: Plan, new: Plan, mapping: Mapping[str, str]) -> Plan:
    """The new plan with the team's present state as its start, for a check. The state must fit the
    plan, see :func:`why_not`."""
    names = NewNames(old, new, mapping)
    own = {spec.name: spec.actions for spec in new.robots}
    robots = [
        RobotSpec(r.name, names.place(old.net.places[r.place].name) or "", own.get(r.name, {}))
        for r in state.active()
    ]
    net = new.net.with_marking(new_marking(state, old, new, names))
    return replace(new, net=net).with_robots(robots)


def why_not_adopted(
    state: TeamState, present: Plan, stage: int, agents: bool = False
) -> Tuple[List[str], Optional[Plan]]:
    """Why the staged plan cannot be adopted now, and the plan (None if it cannot be read).

    :param agents: whether this is a standalone run, in which the executor ("") votes on the plan.
    """
    staged = state.staged
    if staged is None:
        return ["no plan is staged"], None
    if staged.number != stage:
        return ["stage %d is over; the present one is %d" % (stage, staged.number)], None
    why = []
    for member in [""] if agents else state.members():
        vote = vote_of(state, member)
        if vote is None:
            why.append("%s has not voted on the plan yet" % (member or "the executor"))
        elif vote:
            why.append("%s cannot follow the plan: %s" % (member or "the executor", vote))
    try:
        new = plan_of(staged)
    except GspnError as error:
        return [*why, str(error)], None
    return why + why_not(state, present, new, staged.mapping), new


def vote_of(state: TeamState, member: str) -> Optional[str]:
    """Why a member cannot follow the staged plan, "" if it can; None if it has not voted yet. Votes
    of earlier incarnations do not count."""
    if state.staged is None or member not in state.staged.votes:
        return None
    incarnation, why = state.staged.votes[member]
    robot = state.robots.get(member)
    return why if robot is None or robot.incarnation == incarnation else None


def renamed(
    before: Mapping[str, str], old: Plan, new: Plan, mapping: Mapping[str, str]
) -> Dict[str, str]:
    """The names of earlier plans that are different under ``new``."""
    names = {a: mapping.get(b, b) for a, b in before.items()}
    names.update(mapping)
    nodes = (*new.net.place_index, *new.net.transition_index)
    return {a: b for a, b in names.items() if b and a not in nodes}

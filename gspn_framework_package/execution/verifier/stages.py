"""The plans that were staged in a run according to its log, and whether one may be adopted.

This was written independently of the token game and shares no code with it (see
:mod:`.slot_check`).
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from typing import Dict, List, Mapping, Optional, Protocol, Sequence, Set, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.verifier.cargo import Cargo
from gspn_framework_package.formats.plan_json import plan_from_json
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.kept import Kept
from gspn_framework_package.model.plan import Plan

_read: Kept[str, Plan] = Kept(8)


class Speaker(Protocol):
    """The interface of a robot whose vote may count."""

    incarnation: int

    @property
    def here(self) -> bool:
        """Whether its token is in the net."""


class DeployedTeam(Protocol):
    """The interface of a team that may adopt another plan."""

    plan: Plan
    marking: Dict[str, int]
    cargo: Cargo

    @property
    def robots(self) -> Mapping[str, Speaker]:
        """The robots by name."""

    def members(self) -> List[str]:
        """The names of the voters."""


def starting_place(plan: Plan, robot: str) -> str:
    """The place where a robot of this name starts under a plan."""
    for spec in plan.robots:
        if spec.name == robot:
            return spec.place
    return [*plan.spawn, *plan.action_places][0]


class LoggedStages:
    """The staged plan of a run, the votes on it, and the names changed by plans.

    :param agents: whether this is a standalone run, in which only the executor ("") votes.
    """

    def __init__(self, agents: bool) -> None:
        self._agents = agents
        self._count = 0
        self._staged: Optional[log_entries.StagePlan] = None
        self._votes: Dict[str, Tuple[int, str]] = {}
        self._called: Dict[str, str] = {}
        """Name in an earlier plan -> name in the present one, if the latter has no such node."""
        self.closed: Set[str] = set()
        """The transitions that took tasks under a plan but not under the next, by all their
        names."""
        self.plans: List[Plan] = []
        """The plans that were adopted, in order."""

    def present_name(self, node: str) -> str:
        """The present name of a place or transition of this or an earlier plan."""
        return self._called.get(node, node)

    def in_present_names(self, entry: log_entries.Entry) -> log_entries.Entry:
        """The entry with the names of the present plan: entries pending when it was adopted use
        those of an earlier one."""
        if not self._called:
            return entry
        if isinstance(entry, log_entries.Done):
            return entry._replace(result=self._called.get(entry.result, entry.result))
        if isinstance(entry, (log_entries.Fire, log_entries.Interrupt, log_entries.Submit)):
            transition = self._called.get(entry.transition, entry.transition)
            return entry._replace(transition=transition)
        if isinstance(entry, (log_entries.SetPlace, log_entries.Join)):
            return entry._replace(place=self._called.get(entry.place, entry.place))
        return entry

    def apply(
        self, entry: log_entries.Entry, robot: Optional[Speaker], witnesses: Sequence[str]
    ) -> None:
        """Process an entry about staged plans.

        :param robot: the robot that it names.
        """
        if isinstance(entry, log_entries.StagePlan):
            self._count += 1
            self._staged, self._votes = entry, {}
        elif isinstance(entry, log_entries.Unstage) and entry.stage == self._count:
            self._staged = None
        elif isinstance(entry, log_entries.Staged) and entry.stage == self._count:
            if self._agents:
                current = entry.robot == ""
            else:
                current = (
                    robot is not None and robot.here and robot.incarnation == entry.incarnation
                )
            if current or entry.robot in witnesses:
                self._votes[entry.robot] = (entry.incarnation, entry.why)

    def joins(self, robot: str, witnesses: Sequence[str]) -> None:
        """Handle a join of a robot or witness: a witness's vote in an earlier incarnation does not
        count."""
        if robot in witnesses:
            self._votes.pop(robot, None)

    def adopted(
        self, entry: log_entries.Adopt, team: DeployedTeam
    ) -> Optional[Tuple[Plan, Mapping[str, str]]]:
        """The plan that the team adopts, and the new names for those of the old plan; None if the
        rules do not allow it."""
        staged = self._staged
        if staged is None or entry.stage != self._count or not self._all_agree(team):
            return None
        new = self._plan(staged)
        if new is None or not _fits(team, new, staged.mapping):
            return None
        after = {t: staged.mapping.get(t, t) for t in team.plan.submissions}
        gone = {t for t, name in after.items() if name not in new.submissions}
        self.closed |= gone | {a for a, b in self._called.items() if b in gone}
        nodes = {*new.net.place_index, *new.net.transition_index}
        chain = {a: staged.mapping.get(b, b) for a, b in self._called.items()}
        self._called = {
            a: b for a, b in {**chain, **staged.mapping}.items() if a not in nodes and b
        }
        # a dropped place is gone, even under its old name
        called = {a: b or "\0" for a, b in staged.mapping.items()}
        self._staged, self._votes = None, {}
        self.plans.append(new)
        return new, called

    def _all_agree(self, team: DeployedTeam) -> bool:
        for name in [""] if self._agents else team.members():
            vote = self._votes.get(name)
            if vote is None or vote[1]:
                return False
            if name in team.robots and team.robots[name].incarnation != vote[0]:
                return False
        return True

    @staticmethod
    def _plan(staged: log_entries.StagePlan) -> Optional[Plan]:
        text = json.dumps(staged.plan, sort_keys=True, separators=(",", ":"))
        if hashlib.sha256(text.encode("utf-8")).hexdigest()[:32] != staged.digest:
            return None
        try:
            return _read.get(staged.digest, lambda: plan_from_json(dict(staged.plan)))
        except (GspnError, KeyError, TypeError, ValueError, AttributeError):
            return None


def _fits(team: DeployedTeam, new: Plan, mapping: Mapping[str, str]) -> bool:
    """Whether the state of a team fits a plan."""
    old = team.plan

    def fixed(plan: Plan) -> Tuple[object, ...]:
        return plan.synchronisation, tuple(plan.witness), plan.fsync, plan.timing

    if fixed(old) != fixed(new) or not new.action_places:
        return False
    new_places, new_transitions = set(new.net.place_index), set(new.net.transition_index)
    for name, target in mapping.items():
        if name in old.net.place_index:
            resource = name in old.resource_places
            if not target and not resource:
                return False
            if target and target not in new_places:
                return False
            if target and resource != (target in new.resource_places):
                return False
        elif (
            name not in old.net.transition_index
            or target not in new_transitions
            or (name in new_transitions and name != target)
        ):
            return False
    after: Counter[str] = Counter()
    heirs = set()
    for place, tokens in team.marking.items():
        target = mapping.get(place, place)
        if place in old.resource_places:
            if target in new.resource_places:
                after[target] += tokens
                heirs.add(target)
            elif tokens and target:
                return False
        elif tokens:
            if target not in new.action_places:
                return False
            after[target] += tokens
    for node in new.net.places:
        if node.name in new.resource_places and node.name not in heirs:
            after[node.name] += node.tokens
        if node.capacity is not None and after[node.name] > node.capacity:
            return False
    queues = team.cargo.queues
    if any(
        any(task.id for task in queues[q]) and mapping.get(q, q) not in new.tasks.queues
        for q in queues
    ):
        return False
    return all(mapping.get(t, t) in new.submissions for t, _ in team.cargo.outside)

"""Facts from the structure of a plan's net, found in milliseconds without visiting markings."""

from __future__ import annotations

import math
from typing import Iterable, List, Set, Tuple

from gspn_framework_package.model.action import outcomes_of
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import LostKind, Plan
from gspn_framework_package.model.plan_timing import PlanRules
from gspn_framework_package.model.policy_cell import cell_fits, ranges


def may_lose_robots(plan: Plan, standalone: bool = False) -> bool:
    """Whether the others can continue without a robot: a robot that is not heard is evicted.

    :param standalone: the tokens are agents of one process, none of which is lost alone.
    """
    return plan.timing.evict_after > 0 and len(plan.robots) > 1 and not standalone


def terminal_places(plan: Plan) -> Set[int]:
    """Numbers of the action places without output arcs, where robots are Inactive."""
    leaving = plan.net.consumers
    return {p for p, acts in enumerate(plan.acts) if acts and not leaving[p]}


def always_leavable(net: Net, place: int) -> bool:
    """Whether one token in ``place`` enables some transition, whatever the rest of the marking."""
    return any(net.fires_alone(t, place) for t in net.consumers[place])


def may_be_named(plan: Plan, t: int, asking: Iterable[int]) -> bool:
    """Whether the plan says that an action in one of the places numbered ``asking`` may name
    transition number ``t``, or that a robot asks for it when its action fails or another robot is
    lost."""
    name = plan.net.transitions[t].name
    if plan.on_lost.kind is LostKind.FIRE and plan.on_lost.transition == name:
        return True
    places = {plan.net.places[p].name for p in asking}
    actions = [plan.actions, *(robot.actions for robot in plan.robots)]
    return (
        t in map(plan.fallback, asking)
        or any(plan.outcomes.get(place, {}).get(name, 0.0) > 0 for place in places)
        or any(
            name in outcomes_of(each[place]).values()
            for each in actions
            for place in places.intersection(each)
        )
    )


def timeless_transitions(rules: PlanRules, *, predicted: bool = False) -> List[int]:
    """Numbers of the transitions that can follow another one with no action in between: those that
    take robots only from places where some robot has no action, or, if they are immediate, no
    robot. A robot without an action immediately requests the only exponential transition of its
    place.

    :param predicted: also those that can follow at once in a prediction, which takes the times of
        actions from the plan: they leave only places whose action takes no time there.
    """
    idle = rules.idle_places()
    at_once = {p for visits in rules.visits for p, v in visits.items() if v.duration.mean == 0}
    found = []
    for t, robots in enumerate(rules.robots_of):
        if rules.urgency[t] >= 0:
            timeless = all(p in idle for p, _ in robots)
        else:
            timeless = bool(robots) and all(idle.get(p) == t for p, _ in robots)
        if predicted and robots and t not in rules.interrupted:
            timeless = timeless or all(p in at_once for p, _ in robots)
        if timeless:
            found.append(t)
    return found


def find_cycle(net: Net, transitions: List[int]) -> List[str]:
    """A cycle of places and transitions among ``transitions``, by name, or an empty list. A
    transition without input places counts as a cycle, since it can always fire."""
    chosen = set(transitions)
    for t in transitions:
        if not net.inputs[t]:
            return [net.transitions[t].name]
    leaving = {
        p: [
            (net.transitions[t].name, q)
            for t in net.consumers[p]
            if t in chosen
            for q, _ in net.outputs[t]
        ]
        for p in range(len(net.places))
    }
    finished: Set[int] = set()
    for start in leaving:
        # the places on the current path, with the transition that led to each
        way: List[Tuple[int, str]] = [(start, "")]
        left = [list(leaving[start])] if start not in finished else []
        while left:
            if not left[-1]:
                left.pop()
                finished.add(way.pop()[0])
                continue
            through, q = left[-1].pop()
            places = [p for p, _ in way]
            if q in places:
                names = [net.places[q].name]
                for p, transition in way[places.index(q) + 1 :]:
                    names += [transition, net.places[p].name]
                return [*names, through, net.places[q].name]
            if q not in finished:
                way.append((q, through))
                left.append(list(leaving[q]))
    return []


def places_in_cycles(net: Net, transitions: List[int]) -> Set[int]:
    """Numbers of the places that lie on a cycle of places and ``transitions``."""
    pairs = {(p, q) for t in transitions for p, _ in net.inputs[t] for q, _ in net.outputs[t]}
    while True:  # an arc without successors or predecessors is on no cycle
        begins, reached = {p for p, _ in pairs}, {q for _, q in pairs}
        on_none = {(p, q) for p, q in pairs if p not in reached or q not in begins}
        if not on_none:
            break
        pairs -= on_none
    if not pairs:
        return set()
    import numpy as np  # most checks do not need it

    from gspn_framework_package.analysis.graph import components

    sources, targets = np.array(sorted(pairs)).T
    of = components(len(net.places), sources, targets).of
    size = np.bincount(of)
    return {p for p in range(len(net.places)) if size[of[p]] > 1 or (p, p) in pairs}


class PolicyCover:
    """What the rows of a policy imply without visiting markings."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._table = plan.policy.bind(plan.net)
        self._robots = max(len(plan.robots), plan.team_size)
        # the rows that constrain at most one place: only those can match whatever the counts of the
        # other places are
        self._few_cells = {
            number: [(p, c) for p, c in zip(plan.policy.places, row.counts) if c is not None]
            for number, row in enumerate(plan.policy.rows)
            if row.counts.count(None) >= len(row.counts) - 1
        }

    def matches(self, place: int) -> bool:
        """Whether some row that applies to ``place`` matches every marking with a robot there."""
        return self._by_own_count(
            place, [n for n in self._few_cells if self._table.applies(n, place)]
        )

    def speaks(self, place: int) -> bool:
        """Whether, in every marking with a robot in ``place``, some row matches and decides for
        ``place``."""
        return self._by_own_count(place, self._table.speaking(place))

    def never_speaks(self, place: int) -> bool:
        """Whether no row decides for ``place`` although some row always matches: robots there wait
        indefinitely."""
        return not self._table.speaking(place) and self.matches(place)

    def always_moves(self, place: int) -> bool:
        """Whether the policy moves a robot out of ``place`` in every marking, whatever the other
        robots do: it always decides for ``place``, chooses only transitions that one robot alone
        can fire, and no row lets robots wait there."""
        return (
            self.speaks(place)
            and not self._may_wait(place)
            and all(
                self._plan.net.fires_alone(t, place)
                for number in self._table.speaking(place)
                for t, _ in self._table.choices_of_row(number, place)
            )
        )

    def _may_wait(self, place: int) -> bool:
        """Whether a row without choices might apply to ``place``, which other rows always cover."""
        rows = self._plan.policy.rows
        spoken = self._table.speaking(place)
        always = [n for n in spoken if all(c is None for c in rows[n].counts)]
        last = min(always, default=math.inf)
        name = self._plan.net.places[place].name
        for number in self._table.waiting(place):
            if rows[number].counts.count(None) < len(rows[number].counts):
                cells = dict(zip(self._plan.policy.places, rows[number].counts))
                if any(most > 0 for _, most in ranges(cells.get(name))):
                    return True
            elif number < last and not self._by_own_count(
                place, [n for n in spoken if n not in always]
            ):
                return True
        return False

    def _by_own_count(self, place: int, rows: Iterable[int]) -> bool:
        """Whether these rows match every marking with a robot in ``place`` without reading any
        other place."""
        name = self._plan.net.places[place].name
        counts: Set[int] = set()
        everyone = range(1, self._robots + 1)
        for number in rows:
            looks_at = self._few_cells.get(number)
            if looks_at is None:
                continue
            if not looks_at:
                return True
            if looks_at[0][0] == name:
                counts.update(n for n in everyone if cell_fits(looks_at[0][1], n))
        return bool(counts) and counts.issuperset(everyone)

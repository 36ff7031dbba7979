"""Completing a bare net to a plan: which tokens are robots, and which are counters.

The file of a net does not say, but the structure suggests it: robots are neither created nor
consumed, so the token sum of the robot places is constant (a P-invariant in which every weight is
1). Of several such sets, the non-overlapping ones with the most places in total are chosen; the
remaining places are counters. This is a guess, so the reasons are reported.
"""

from __future__ import annotations

from typing import Any, Dict, FrozenSet, List, Mapping, NamedTuple, Sequence, Set, Tuple

from gspn_framework_package.analysis.structure.invariants import Invariant, place_invariants
from gspn_framework_package.formats.net_json import net_to_json
from gspn_framework_package.formats.plan_json import deal_robots
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import MAX_ROBOTS

EFFORT = 500_000
"""Steps that the search for invariants may take."""

MOST_COMPARED = 16
"""Up to this number of sets of places, the best choice is found by trying all; while there are
more, the largest is taken."""


class Completion(NamedTuple):
    """A net that was completed to a plan.

    :ivar document: ``plan`` (the object of a plan file without net and policy), ``net`` (as
        ``net_to_json`` writes it) and ``policy`` (None: the weights of the net decide).
    :ivar notes: for the user: the assumptions and their reasons.
    """

    document: Dict[str, Any]
    notes: Tuple[str, ...]


def complete(net: Net) -> Completion:
    """Complete a net to a plan that can be read: action places without actions, resource places,
    and a robot for each token that moves like one.

    The plan need not pass its check: a net whose transitions create and consume tokens can only run
    standalone.
    """
    found = _Roles(net)
    resources = [p.name for p in net.places if p.name not in found.robots]
    plan: Dict[str, Any] = {"plan": net.name or "plan"}
    plan["actions"] = {p.name: None for p in net.places if p.name in found.robots}
    if resources:
        plan["resource_places"] = resources
    robots = deal_robots(net, set(resources))
    if robots:
        plan["robots"] = {robot.name: robot.place for robot in robots}
    if _runs_by_itself(net, found.robots):
        plan["environment"] = "simulate"
        found.notes.append(
            "exponential transitions that move no robot fire at their rates (environment: simulate)"
        )
    return Completion({"plan": plan, "net": net_to_json(net), "policy": None}, tuple(found.notes))


def _runs_by_itself(net: Net, robots: FrozenSet[str]) -> bool:
    """Whether an exponential transition moves no robot."""
    return any(
        transition.timed and not any(net.places[p].name in robots for p, _ in (*inputs, *outputs))
        for transition, inputs, outputs in zip(net.transitions, net.inputs, net.outputs)
    )


class _Roles:
    """The places with robots.

    :ivar robots: their names.
    :ivar notes: the reasons.
    """

    def __init__(self, net: Net) -> None:
        self._net = net
        self.notes: List[str] = []
        try:
            invariants = place_invariants(net, EFFORT)
        except LimitError:
            self.notes.append(
                "the net is too large to find its invariants, which would distinguish robots "
                "from counters"
            )
            self.robots = self._within_the_limit([self._reached()])
            return
        candidates = _choose(net, [i for i in invariants if set(i.weights.values()) == {1}])
        groups = self._that_move(candidates)
        self._say_groups(groups)
        if groups:
            counters = frozenset().union(*candidates) - frozenset().union(*groups)
            groups += self._forked(groups, invariants, counters)
        else:
            groups = [self._reached()]
            if groups[0]:
                self.notes.append(
                    "no set of places has a constant token count: %s, which tokens can reach, are "
                    "action places; transitions create and consume tokens there, so it can only "
                    "run standalone" % _names(self._in_order(groups[0]))
                )
        self.robots = self._within_the_limit(groups)
        self._say_resources(invariants)

    def _in_order(self, places: FrozenSet[str]) -> List[str]:
        return [p.name for p in self._net.places if p.name in places]

    def _tokens(self, places: FrozenSet[str]) -> int:
        return sum(self._net.place(p).tokens for p in places)

    def _that_move(self, groups: List[FrozenSet[str]]) -> List[FrozenSet[str]]:
        """The groups whose tokens move independently. If each transition that moves a token of a
        group also moves one of another group, the first group only accompanies the other, like the
        free and used slots of a store. Smaller groups are dropped first."""
        net = self._net
        of = {name: number for number, group in enumerate(groups) for name in group}
        moved: List[Set[int]] = []  # for each transition: the groups of which it moves a token
        moving: List[List[int]] = [[] for _ in groups]  # for each group: those transitions
        for t, (inputs, outputs) in enumerate(zip(net.inputs, net.outputs)):
            names = [net.places[p].name for p, _ in (*inputs, *outputs)]
            moved.append({of[name] for name in names if name in of})
            for number in moved[t]:
                moving[number].append(t)
        dropped: Set[int] = set()
        for number in sorted(range(len(groups)), key=lambda number: len(groups[number])):
            if not any(moved[t] == {number} for t in moving[number]):
                dropped.add(number)
                for t in moving[number]:
                    moved[t].discard(number)
                if moving[number]:
                    self.notes.append(
                        "the tokens in %s only move together with those of other places, so they "
                        "are taken for counters" % _names(self._in_order(groups[number]))
                    )
        return [group for number, group in enumerate(groups) if number not in dropped]

    def _say_groups(self, groups: Sequence[FrozenSet[str]]) -> None:
        for group in groups:
            tokens = self._tokens(group)
            self.notes.append(
                "%s: action places, because no firing changes the number of tokens in them (%s)"
                % (
                    _names(self._in_order(group)),
                    "%d robot%s" % (tokens, "" if tokens == 1 else "s") if tokens else "none yet",
                )
            )

    def _forked(
        self,
        groups: Sequence[FrozenSet[str]],
        invariants: Sequence[Invariant],
        counters: FrozenSet[str],
    ) -> List[FrozenSet[str]]:
        """Further action places: those into which a token of a group is split. Their sum with
        places of the group is constant too, but unlike counters they have no initial token."""
        robots: FrozenSet[str] = frozenset().union(*groups)
        found: Set[str] = set()
        for invariant in invariants:
            rest = frozenset(invariant.weights) - robots
            if not rest or len(rest) == len(invariant.weights) or not invariant.value:
                continue
            if self._tokens(rest) == 0 and not rest & counters:
                found |= rest
        if found:
            self.notes.append(
                "%s: action places too, because a token is split into several, one of which goes "
                "there (or are they counters "
                "of which none is free at first?); only a standalone run can do that"
                % _names(self._in_order(frozenset(found)))
            )
        return [frozenset(found)] if found else []

    def _reached(self) -> FrozenSet[str]:
        """The places that tokens of the initial marking can reach, arc by arc."""
        net = self._net
        found = {p for p, place in enumerate(net.places) if place.tokens}
        front = list(found)
        while front:
            for t in net.consumers[front.pop()]:
                for p, _ in net.outputs[t]:
                    if p not in found:
                        found.add(p)
                        front.append(p)
        return frozenset(net.places[p].name for p in found)

    def _within_the_limit(self, groups: Sequence[FrozenSet[str]]) -> FrozenSet[str]:
        """The places of the groups, without those that have more tokens than a team has robots."""
        kept = sorted(groups, key=self._tokens)
        while kept and sum(map(self._tokens, kept)) > MAX_ROBOTS:
            self.notes.append(
                "%s: counters, because a team has at most %d robots"
                % (_names(self._in_order(kept[-1])), MAX_ROBOTS)
            )
            kept.pop()
        return frozenset().union(*kept)

    def _say_resources(self, invariants: Sequence[Invariant]) -> None:
        """State for each resource place why it is one."""
        kept_with: Dict[str, List[str]] = {}
        for invariant in invariants:
            for name in invariant.weights:
                others = [other for other in invariant.weights if other != name]
                if name not in kept_with or len(others) < len(kept_with[name]):
                    kept_with[name] = others
        free: List[str] = []
        alone: List[str] = []
        for place in self._net.places:
            if place.name not in self.robots:
                (free if kept_with.get(place.name) else alone).append(place.name)
        if free:
            self.notes.append(
                "%s: resource places, because they count what the robots leave free in other "
                "places (%s with %s)" % (_names(free), free[0], _names(kept_with[free[0]]))
            )
        if alone:
            self.notes.append(
                "%s: resource places, because their tokens do not move from place "
                "to the next, as robots do" % _names(alone)
            )


def _names(names: Sequence[str], most: int = 6) -> str:
    more = " and %d more" % (len(names) - most) if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _choose(net: Net, invariants: Sequence[Invariant]) -> List[FrozenSet[str]]:
    """The non-overlapping sets of places with the most places in marked sets (sets with tokens),
    and among these the most places overall. Ties are broken by the order of the places in the
    net."""
    marked = len(net.places) + 1
    order = {p.name: number for number, p in enumerate(net.places)}
    worth = {frozenset(i.weights): len(i.weights) * (marked if i.value else 1) for i in invariants}
    sets = sorted(worth, key=lambda s: (-worth[s], min(order[name] for name in s)))
    found: List[FrozenSet[str]] = []
    for together in _overlapping(sets):
        while len(together) > MOST_COMPARED:
            found.append(together[0])
            together = [s for s in together[1:] if not s & found[-1]]
        found += _best(together, worth)
    return sorted(found, key=lambda s: min(order[name] for name in s))


def _overlapping(sets: Sequence[FrozenSet[str]]) -> List[List[FrozenSet[str]]]:
    """The sets, grouped by overlap (direct or through others), in order."""
    users: Dict[str, List[int]] = {}
    for number, places in enumerate(sets):
        for name in places:
            users.setdefault(name, []).append(number)
    groups: List[List[FrozenSet[str]]] = []
    seen: Set[int] = set()
    for start in range(len(sets)):
        if start in seen:
            continue
        seen.add(start)
        inside, front = [start], [start]
        while front:
            for name in sets[front.pop()]:
                for number in users.pop(name, ()):
                    if number not in seen:
                        seen.add(number)
                        inside.append(number)
                        front.append(number)
        groups.append([sets[number] for number in sorted(inside)])
    return groups


def _best(
    sets: Sequence[FrozenSet[str]], worth: Mapping[FrozenSet[str], int]
) -> List[FrozenSet[str]]:
    """The non-overlapping sets with the largest total value."""
    if not sets:
        return []
    first, rest = sets[0], sets[1:]
    taken = [first, *_best([s for s in rest if not s & first], worth)]
    left = _best(rest, worth)
    return taken if sum(worth[s] for s in taken) >= sum(worth[s] for s in left) else left

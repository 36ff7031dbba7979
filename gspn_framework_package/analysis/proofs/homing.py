"""Searches for a proof that robots can get back to their first places from every reachable marking,
so that the first marking is a *home marking*.

Whatever is in progress ends by itself. Where nothing is in progress, robots rest, and *ways* are
firings that take one of them nearer to the first place of some robot. A way is found for a robot
that is alone, and the proof says that one of them can be gone wherever not all robots are there:
nothing that the others hold, such as a narrow node, hinders the one that is next. From there, some
go back to other first places.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Deque, Dict, List, Optional, Tuple

from gspn_framework_package.analysis.proofs.checker import Problem, at_rest, firing_in_turn
from gspn_framework_package.analysis.proofs.prover import Candidate, Prover
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Marking

STEPS = (20, 80, 320, 1_280, 5_120, 20_480)
"""Largest numbers of markings to visit for a single robot from one place: each number is tried if
the robot did not get home within the one before."""

STEPS_FROM_EVERYWHERE = 80
"""Up to this number, all places without a way home are searched; above it, only those where robots
begin."""

Ways = Dict[int, Dict[int, List[int]]]
"""Place -> the places that firings lead to from there -> their numbers."""


class Homing:
    """The search for ways home, of a problem that asks for them.

    :param watch: may stop the search.
    :param prover: the earlier search for a proof.
    """

    def __init__(self, problem: Problem, watch: Watch, prover: Optional[Prover] = None) -> None:
        self._problem, self._watch, self._prover = problem, watch, prover
        net = problem.net
        self._chosen = problem.chosen or (lambda marking, t: t in problem.fires(marking))
        self._robots = frozenset(p for p, robots in enumerate(problem.robots) if robots)
        self._homes = [p for p in sorted(self._robots) if net.initial_marking[p]]
        self._settling = frozenset(problem.settling)
        # what continues without a robot, however many there are
        touched = ((t, (*net.inputs[t], *net.most_tokens(t))) for t in problem.settling)
        self._aside = [t for t, near in touched if self._robots.isdisjoint(p for p, _ in near)]

    def certificate(self) -> Dict[str, Any]:
        """Search for a certificate.

        :raises LimitError: none was found.
        """
        found, net, homes = self._ways(), self._problem.net, self._homes
        names = [place.name for place in net.places]
        inwards = _towards(found, homes[0])
        distances = {homes[0]: 0}
        for p, nearer in inwards.items():
            distances.setdefault(p, distances[nearer] + 1)
        ways = [self._names(found[p][nearer]) for p, nearer in inwards.items() if p != nearer]
        back: List[str] = []
        end = dict.fromkeys(homes, 0)
        for home in homes:
            end[homes[0]] += net.initial_marking[home]
            back += self._names(_route(found, homes[0], home)) * net.initial_marking[home]
        marking = tuple(end.get(p, n) for p, n in enumerate(net.initial_marking))
        possible = (firing_in_turn(self._problem, way)[0] for way in ways)
        resting = at_rest(self._problem, possible, marking)
        rest = Prover(resting, self._watch, self._prover).prove()
        if isinstance(rest, Candidate):
            raise LimitError("not decided: robots may have to wait elsewhere")
        furthest = 1 + max(distances.values())
        return {
            "ways": ways,
            "distances": {names[p]: distances.get(p, furthest) for p in sorted(self._robots)},
            "end": {names[p]: count for p, count in end.items()},
            "back": back,
            "rest": rest,
        }

    def _names(self, firings: List[int]) -> List[str]:
        return [self._problem.net.transitions[t].name for t in firings]

    def _ways(self) -> Ways:
        """Ways home from all places in which a robot that is alone may rest.

        :raises LimitError: there are none, or the time is over.
        """
        net, homes = self._problem.net, self._homes
        first = [0 if p in self._robots else n for p, n in enumerate(net.initial_marking)]
        going_on = {net.inputs[t][0][0] for t in self._settling if len(net.inputs[t]) == 1}
        guessed = {p for p in self._robots - going_on if p not in homes}
        starts = {p: (*first[:p], 1, *first[p + 1 :]) for p in sorted({*guessed, *homes})}
        found: Ways = {}
        for limit in STEPS if homes else ():
            inwards = _towards(found, homes[0])
            every = limit <= STEPS_FROM_EVERYWHERE
            waiting = [p for p in starts if p in homes or every and p not in inwards]
            while waiting:
                p = waiting.pop()
                for end, (way, marking) in self._explore(p, starts[p], limit).items():
                    found.setdefault(p, {}).setdefault(end, way)
                    if end in guessed and p not in guessed:
                        guessed.discard(end)
                        if starts[end] != marking:  # it holds something there
                            starts[end] = marking
                            found.pop(end, None)
                            waiting.append(end)
            inwards = _towards(found, homes[0])
            onwards = (homes[0] in _towards(found, home) for home in homes)
            if all(p in inwards for p in (starts if every else homes)) and all(onwards):
                return found
        raise LimitError("not decided: a robot that is alone does not get home")

    def _explore(
        self, start: int, first: Marking, limit: int
    ) -> Dict[int, Tuple[List[int], Marking]]:
        """The places in which a robot that is alone comes to rest within ``limit`` markings, with
        the firings to each and the marking there. What continues without it ends last."""
        net = self._problem.net
        seen = {first}
        ends: Dict[int, Tuple[List[int], Marking]] = {}
        waiting: Deque[Tuple[int, Marking, List[int]]] = deque([(start, first, [])])
        while waiting and len(seen) < limit:
            self._watch.step("ways of one robot", len(seen))
            p, marking, way = waiting.popleft()
            for t in net.consumers[p]:
                to = [q for q, _ in net.outputs[t] if q in self._robots]
                if len(to) != 1 or not net.is_enabled(marking, t) or not self._chosen(marking, t):
                    continue
                after, on = net.fire(marking, t), [*way, t]
                if after in seen:
                    continue
                seen.add(after)
                waiting.append((to[0], after, on))
                able = self._aside
                while able:
                    able = [u for u in self._aside if net.is_enabled(after, u)][:1]
                    after, on = (net.fire(after, able[0]), on + able) if able else (after, on)
                goes_on = self._settling.intersection(net.consumers[to[0]])
                if to[0] not in (start, *ends) and not any(
                    net.is_enabled(after, u) for u in goes_on
                ):
                    ends[to[0]] = on, after
        return ends


def _towards(edges: Dict[int, Dict[int, Any]], goal: int) -> Dict[int, int]:
    """The places from which edges lead to the goal, the nearest first, each with the next place on
    a way there."""
    before: Dict[int, List[int]] = {}
    for p, ends in edges.items():
        for end in ends:
            before.setdefault(end, []).append(p)
    following, waiting = {goal: goal}, deque([goal])
    while waiting:
        after = waiting.popleft()
        for p in before.get(after, ()):
            if p not in following:
                following[p] = after
                waiting.append(p)
    return following


def _route(ways: Ways, p: int, goal: int) -> List[int]:
    """The firings of ways from a place to the goal, one after another."""
    onwards, route = _towards(ways, goal), []
    while p != goal:
        route += ways[p][onwards[p]]
        p = onwards[p]
    return route

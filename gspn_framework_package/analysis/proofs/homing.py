"""Searches for a proof that robots can get back to their first places from every reachable marking,
so that the first marking is a *home marking*.

The proof has two parts. *Rest*: what goes on ends by itself, one after another. Where nothing goes
on any more, all other places have their first counts, all robots are there, and each is in one of
some *places to rest*. *Ways*: firings that take a robot that is alone from such a place to another,
after which the other places have their first counts again. They need nothing of robots that rest
elsewhere, and those do not hinder them. So the robots get home one after another, if ways lead from
each place to rest to each place in which robots are at first.
"""

from __future__ import annotations

from collections import deque
from functools import lru_cache, partial
from typing import Any, Deque, Dict, List, Optional, Tuple

from gspn_framework_package.analysis.proofs.checker import (
    Problem,
    alone,
    at_rest,
    fires_alone,
    keeps_their_number,
)
from gspn_framework_package.analysis.proofs.prover import Candidate, Prover
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Marking

STEPS = (5, 20, 80, 320, 1_280, 5_120, 20_480)
"""Numbers of markings of a robot that is alone that are visited from a place from which it does not
get home in fewer."""

STEPS_FROM_EVERYWHERE = 80
"""How many of these are visited from places that are no first ones."""

Ways = Dict[int, Dict[int, List[int]]]
"""Place -> the places that firings lead to from there -> their numbers."""


class Homing:
    """The search for ways home, of a problem that asks for them.

    :param watch: may stop the search.
    :param prover: what searched for a proof before.
    """

    def __init__(self, problem: Problem, watch: Watch, prover: Optional[Prover] = None) -> None:
        self._problem, self._watch, self._prover = problem, watch, prover
        net = problem.net
        self._alone = lru_cache(maxsize=None)(partial(alone, problem))
        self._robots = frozenset(p for p, robots in enumerate(problem.robots) if robots)
        self._homes = [p for p in sorted(self._robots) if net.initial_marking[p]]
        # what goes on without a robot, however many there are
        touched = ((t, (*net.inputs[t], *net.most_tokens(t))) for t in problem.settling)
        self._aside = [t for t, near in touched if self._robots.isdisjoint(p for p, _ in near)]

    def certificate(self) -> Dict[str, Any]:
        """Search for a certificate.

        :raises LimitError: none was found.
        """
        found, net = self._ways(), self._problem.net
        resting = at_rest(self._problem, {*found, *self._homes})
        rest = Prover(resting, self._watch, self._prover).prove()
        if isinstance(rest, Candidate):
            raise LimitError("not decided: robots may have to wait elsewhere")
        names = [place.name for place in net.places], [t.name for t in net.transitions]
        ways = [
            [names[0][p], *(names[1][t] for t in way)]
            for p, ends in found.items()
            for way in ends.values()
        ]
        return {"ways": ways, "rest": rest}

    def _ways(self) -> Ways:
        """Ways home from all places from which there are any.

        :raises LimitError: there are none from a first place to another, or the time is over.
        """
        net, homes, settling = self._problem.net, self._homes, self._problem.settling
        going_on = {net.inputs[t][0][0] for t in settling if len(net.inputs[t]) == 1}
        found: Ways = {p: {} for p in sorted(self._robots - going_on)}
        for limit in STEPS if homes and keeps_their_number(self._problem) else ():
            leading = [_towards(found, home) for home in homes]
            for p in homes if limit > STEPS_FROM_EVERYWHERE else found:
                enough = all if p in homes else any
                if not enough(p in each for each in leading):
                    found[p].update(self._explore(p, limit))
        inwards = _towards(found, homes[0]) if homes else {}
        kept: Ways = {p: {after: found[p][after]} for p, after in inwards.items() if p != after}
        for home in homes[1:]:
            onwards, p = _towards(found, home), homes[0]
            if p not in onwards or home not in inwards:
                raise LimitError("not decided: a robot that is alone does not get home")
            while p != home:
                kept.setdefault(p, {})[onwards[p]] = found[p][onwards[p]]
                p = onwards[p]
        return kept

    def _explore(self, start: int, limit: int) -> Dict[int, List[int]]:
        """The places to which a robot that is alone gets within ``limit`` markings, and the firings
        to each. What goes on without it ends last."""
        net, first = self._problem.net, self._alone(start)
        seen = {first}
        ends: Dict[int, List[int]] = {}
        waiting: Deque[Tuple[int, Marking, List[int]]] = deque([(start, first, [])])
        while waiting and len(seen) < limit:
            self._watch.step("ways of one robot", len(seen))
            p, marking, way = waiting.popleft()
            for t in net.consumers[p]:
                to = [q for q, _ in net.outputs[t] if q in self._robots]
                if len(to) != 1 or not fires_alone(self._problem, marking, t):
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
                if to[0] not in (start, *ends) and after == self._alone(to[0]):
                    ends[to[0]] = on
        return ends


def _towards(edges: Dict[int, Dict[int, Any]], goal: int) -> Dict[int, int]:
    """The places from which edges lead to the goal, each with the next place on a way there."""
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

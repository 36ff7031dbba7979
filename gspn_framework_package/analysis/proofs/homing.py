"""Whether robots can get back to their first places from every reachable marking, so that the first
marking is a *home marking*.

The proof has two parts. *Rest*: what goes on ends by itself, one after another. Where nothing goes
on any more, all other places have their first counts, all robots are there, and each is in one of
some *places to rest*. *Ways*: firings that take a robot that is alone from such a place to another,
after which the other places have their first counts again. They need nothing of robots that rest
elsewhere, and those do not hinder them. So the robots get home one after another, if ways lead from
each place to rest to each place in which robots are at first.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Deque, Dict, FrozenSet, Iterable, List, Tuple

from gspn_framework_package.analysis.proofs.checker import (
    All,
    Atom,
    Formula,
    Problem,
    ProofError,
    Some,
    check_certificate,
    guard,
    opposite,
)
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
    """What is asked about the first marking of a plan without an end of the run.

    The counts of robots decide on no firing, other than that it needs one.

    :param problem: the net, and what fires in it.
    :param robots: the numbers of the places of robots.
    :param settling: the transitions that fire as soon as they are enabled, and end what goes on.
    """

    def __init__(self, problem: Problem, robots: FrozenSet[int], settling: Tuple[int, ...]) -> None:
        self.problem, self.robots, self.settling = problem, robots, settling
        net = problem.net
        self._none = [0 if p in robots else n for p, n in enumerate(net.initial_marking)]
        self._homes = [p for p in sorted(robots) if net.initial_marking[p]]
        # what goes on without a robot, however many there are
        touched = ((t, (*net.inputs[t], *net.most_tokens(t))) for t in settling)
        self._aside = [t for t, near in touched if robots.isdisjoint(p for p, _ in near)]

    def alone(self, p: int) -> Marking:
        """The first marking, with one robot in place number ``p``."""
        return (*self._none[:p], 1, *self._none[p + 1 :])

    def rest(self, places: Iterable[int]) -> Problem:
        """The question whether a marking can be reached in which nothing goes on, but not all
        robots rest in these ``places``, or others have not their first counts."""
        net = self.problem.net
        first, robots = net.initial_marking, sorted(self.robots)
        wrong: List[Formula] = [Atom(((p, 1),), 1) for p in robots if p not in places]
        for p in set(range(len(first))).difference(robots):
            wrong += [Atom(((p, 1),), first[p] + 1), Atom(((p, -1),), 1 - first[p])]
        ended = (opposite(All(guard(net, t))) for t in self.settling)
        return self.problem._replace(facts=(*ended, Some(tuple(wrong))))

    @property
    def keeps_robots(self) -> bool:
        """Whether no firing changes the number of robots."""
        effects = map(self.problem.net.effect, self.problem.transitions)
        return not any(sum(n for p, n in each if p in self.robots) for each in effects)

    def _may_fire(self, marking: Marking, t: int) -> bool:
        """Whether transition number ``t`` may fire, however many robots are elsewhere."""
        net, chosen = self.problem.net, self.problem.chosen
        return (
            self.robots.isdisjoint(p for p, _ in net.most_tokens(t))
            and net.is_enabled(marking, t)
            and (chosen is None or chosen(marking, t))
        )

    def check(self, certificate: Any) -> str:
        """Require that a certificate proves it: ``ways``, lists of the name of a place and those of
        transitions, and ``rest``, the certificate of that question.

        :returns: what was checked, for people.
        :raises ProofError: it does not.
        """
        net = self.problem.net
        edges: Dict[int, Dict[int, Any]] = {}
        if not self.keeps_robots:
            raise ProofError("the number of robots may change")
        for place, *names in certificate["ways"]:
            start = net.place_index[place]
            marking = self.alone(start)
            for name in names:
                t = net.transition_index[name]
                if not self._may_fire(marking, t):
                    raise ProofError("%s cannot fire on the way from %s" % (name, place))
                marking = net.fire(marking, t)
            end = next((p for p in self.robots if marking[p]), -1)
            if marking != self.alone(end):
                raise ProofError("the way from %s leads to no place to rest" % place)
            edges.setdefault(start, {})[end] = names
        rest = {*edges, *self._homes}
        if any(rest.difference(_towards(edges, home)) for home in self._homes):
            raise ProofError("no way leads home from a place to rest")
        how = check_certificate(self.rest(rest), certificate["rest"])
        return "%d ways, %s" % (len(certificate["ways"]), how)

    # -- the search --------------------------------------------------------------------------------

    def certificate(self, watch: Watch) -> Dict[str, Any]:
        """Search for a certificate.

        :raises LimitError: none was found.
        """
        # who checks a proof needs no solver
        from gspn_framework_package.analysis.proofs.prover import Candidate, Prover

        found, net = self._ways(watch), self.problem.net
        rest = Prover(self.rest({*found, *self._homes}), watch).prove()
        if isinstance(rest, Candidate):
            raise LimitError("not decided: robots may have to wait elsewhere")
        names = [place.name for place in net.places], [t.name for t in net.transitions]
        ways = [
            [names[0][p], *(names[1][t] for t in way)]
            for p, ends in found.items()
            for way in ends.values()
        ]
        return {"ways": ways, "rest": rest}

    def _ways(self, watch: Watch) -> Ways:
        """Ways home from all places from which there are any.

        :raises LimitError: there are none from a first place to another, or the time is over.
        """
        net, homes = self.problem.net, self._homes
        going_on = {net.inputs[t][0][0] for t in self.settling if len(net.inputs[t]) == 1}
        found: Ways = {p: {} for p in sorted(self.robots - going_on)}
        for limit in STEPS if homes and self.keeps_robots else ():
            leading = [_towards(found, home) for home in homes]
            for p in homes if limit > STEPS_FROM_EVERYWHERE else found:
                enough = all if p in homes else any
                if not enough(p in each for each in leading):
                    found[p].update(self._explore(p, limit, watch))
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

    def _explore(self, start: int, limit: int, watch: Watch) -> Dict[int, List[int]]:
        """The places to which a robot that is alone gets within ``limit`` markings, and the firings
        to each. What goes on without it ends last."""
        net, first = self.problem.net, self.alone(start)
        seen = {first}
        ends: Dict[int, List[int]] = {}
        waiting: Deque[Tuple[int, Marking, List[int]]] = deque([(start, first, [])])
        while waiting and len(seen) < limit:
            watch.step("ways of one robot", len(seen))
            p, marking, way = waiting.popleft()
            for t in net.consumers[p]:
                to = [q for q, _ in net.outputs[t] if q in self.robots]
                if len(to) != 1 or not self._may_fire(marking, t):
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
                if to[0] not in (start, *ends) and after == self.alone(to[0]):
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

"""The search for firings that lead to a bad marking, guided by a solution of the state equation:
how often each transition fires on the way, but not in which order."""

from __future__ import annotations

import heapq
import math
import random
from contextlib import suppress
from typing import Callable, Dict, Iterator, List, Optional, Sequence, Tuple

from gspn_framework_package.analysis.proofs.checker import Problem, ProofError
from gspn_framework_package.analysis.proofs.prover import Candidate
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Marking

MOST_SEARCHED = 100_000
"""Maximum number of markings that the search visits in order."""

FIRST_MARKINGS = 3_000
"""The number of these that are visited before the random walks."""

MOST_WALKS, LONGEST_WALK = 1_000, 3_000
"""Maximum number of random walks, and of firings in each."""

_DETOUR = 2
"""How much a firing that is not in the solution costs, in firings that are."""

_LOOK_EVERY = 20
"""Firings of a walk between two checks whether a robot is stuck."""

_ON_THE_WAY = 0.7
"""The probability that a walk takes a firing of the solution, where it can."""


class GuidedSearch:
    """The search for firings that lead to a bad marking, from the markings that lack the fewest
    firings of a solution. If that does not lead there soon, random walks are tried, which get stuck
    where a team does, and then again the search."""

    def __init__(self, problem: Problem, candidate: Candidate) -> None:
        firings = {t: round(n) for t, n in candidate.firings.items() if round(n) > 0}
        self._problem, self._firings, self._draw = problem, firings, random.Random(1)
        start = problem.net.initial_marking
        self._came: Dict[Marking, Tuple[Optional[Marking], int]] = {start: (None, -1)}
        self._waiting: List[Tuple[int, int, int, Marking, Dict[int, int]]] = [
            (sum(firings.values()), 0, 0, start, firings)
        ]

    def go_on(self, watch: Watch) -> Optional[List[str]]:
        """Continue the search: the transitions whose firings lead to a bad marking; None if none
        were found within the limits."""
        found = None
        with suppress(LimitError):  # the time is over
            found = self._search(FIRST_MARKINGS, watch)
            if found is None:
                with suppress(LimitError):
                    found = _walk(self._problem, self._firings, watch.part(0.5), draw=self._draw)
            if found is None:
                found = self._search(MOST_SEARCHED, watch)
        names = [transition.name for transition in self._problem.net.transitions]
        return None if found is None else [names[t] for t in found]

    def _search(self, limit: int, watch: Watch) -> Optional[List[int]]:
        """Search until a bad marking or ``limit`` markings are known.

        :raises LimitError: the time is over.
        """
        problem = self._problem
        while self._waiting and len(self._came) < limit:
            watch.step("markings of a guided search", len(self._came))
            missing, length, _, marking, left = heapq.heappop(self._waiting)
            if problem.is_bad(marking):
                return self._way(marking)
            for t in problem.fires(marking):
                after = problem.net.fire(marking, t)
                if after in self._came:
                    continue
                self._came[after] = marking, t
                rest, lacks = left, missing + _DETOUR
                if left.get(t, 0) > 0:
                    rest, lacks = {**left, t: left[t] - 1}, missing - 1
                item = lacks, length + 1, len(self._came), after, rest
                heapq.heappush(self._waiting, item)
        return None

    def _way(self, end: Marking) -> List[int]:
        way: List[int] = []
        before, t = self._came[end]
        while before is not None:
            way.append(t)
            before, t = self._came[before]
        return way[::-1]


def played_to(problem: Problem, sequence: Sequence[str]) -> Marking:
    """The marking that a firing sequence leads to.

    :raises ProofError: a firing is not possible, or that marking is not bad.
    """
    marking = problem.net.initial_marking
    for name in sequence:
        t = problem.net.transition_index.get(name, -1)
        if t not in problem.fires(marking):
            raise ProofError("%s cannot fire" % name)
        marking = problem.net.fire(marking, t)
    if not problem.is_bad(marking):
        raise ProofError("the firings do not lead to what they should show")
    return marking


def walk_until_stuck(
    problem: Problem, watch: Watch, firings: float = math.inf
) -> Optional[List[str]]:
    """The names of transitions whose firings lead to a bad marking, found by random walks; None if
    none were found in the time.

    Where the problem says so of a marking, all that follow are bad, once whatever is in progress
    has ended: then the first such marking of the walk is taken, and what goes on there is ended.

    :param firings: the most firings of all walks together.
    """
    found: Optional[List[int]]
    try:
        if problem.surely is None:
            found = _walk(problem, {}, watch, firings)
        else:
            found = _walk_to_a_trap(problem, problem.surely, watch, firings)
    except LimitError:
        return None
    return None if found is None else [problem.net.transitions[t].name for t in found]


def shortened(problem: Problem, names: List[str], watch: Watch) -> List[str]:
    """The firings that are left of a way to a bad marking when those that it does not need are
    taken out: each in turn, with those that then cannot fire, such as all that one robot did.

    :param names: the names of the transitions.
    :param watch: how long it may take; more than is needed may be left then.
    """
    net = problem.net
    chosen = problem.chosen or (lambda marking, t: t in problem.fires(marking))
    way = [net.transition_index[name] for name in names]
    markings = _markings_on(problem, net.initial_marking, way)
    at = kept = 0  # how many were tried since one was taken out
    try:
        while kept < len(way):
            rest: List[int] = []
            after = [markings[at]]
            for t in way[at + 1 :]:
                watch.step("shorter ways", len(way))
                if net.is_enabled(after[-1], t) and chosen(after[-1], t):
                    rest.append(t)
                    after.append(net.fire(after[-1], t))
            if _leads_to_bad(problem, after[-1]):
                way, markings, kept = way[:at] + rest, markings[:at] + after, 0
            else:
                at, kept = at + 1, kept + 1
            at = at if at < len(way) else 0
    except LimitError:
        pass
    if problem.surely is not None:
        way = way + _settle(problem, markings[-1])
    try:
        if problem.is_bad(_markings_on(problem, net.initial_marking, way)[-1]):
            return [net.transitions[t].name for t in way]
    except LimitError:
        pass  # too much follows there to see that it is bad
    return names


def _leads_to_bad(problem: Problem, marking: Marking) -> bool:
    """Whether a marking is bad, or certainly is once whatever is in progress has ended."""
    if problem.surely is not None:
        return problem.surely(marking)
    try:
        return problem.is_bad(marking)
    except LimitError:
        return False


def _markings_on(problem: Problem, marking: Marking, way: List[int]) -> List[Marking]:
    markings = [marking]
    for t in way:
        markings.append(problem.net.fire(markings[-1], t))
    return markings


def _walk_to_a_trap(
    problem: Problem, surely: Callable[[Marking], bool], watch: Watch, firings: float
) -> Optional[List[int]]:
    for markings, way, is_stuck in _walks(problem, {}, watch, firings):
        if is_stuck and problem.is_bad(markings[-1]):
            return _without_loops(markings, way)
        look = is_stuck or way and len(way) % _LOOK_EVERY == 0
        if look and surely(markings[-1]):
            first, last = 0, len(way)
            while first < last:  # once it holds, it keeps holding
                middle = (first + last) // 2
                if surely(markings[middle]):
                    last = middle
                else:
                    first = middle + 1
            way = _without_loops(markings[: first + 1], way) + _settle(problem, markings[first])
            end = _markings_on(problem, problem.net.initial_marking, way)[-1]
            return way if problem.is_bad(end) else None
    return None


def _without_loops(markings: List[Marking], way: List[int]) -> List[int]:
    """The firings of a walk, without those between two visits of the same marking.

    :param markings: those that the walk visits.
    """
    last = {marking: number for number, marking in enumerate(markings)}
    short, number = [], last[markings[0]]
    while number < len(markings) - 1:
        short.append(way[number])
        number = last[markings[number + 1]]
    return short


def _settle(problem: Problem, marking: Marking) -> List[int]:
    """Firings that end whatever is in progress."""
    way: List[int] = []
    ending = set(problem.settling)
    able = [t for t in problem.fires(marking) if t in ending]
    while able:
        way.append(able[0])
        marking = problem.net.fire(marking, able[0])
        able = [t for t in problem.fires(marking) if t in ending]
    return way


def _walk(
    problem: Problem,
    firings: Dict[int, int],
    watch: Watch,
    most: float = math.inf,
    draw: Optional[random.Random] = None,
) -> Optional[List[int]]:
    """Random walks until one reaches a bad marking; None if none of them does.

    :raises LimitError: the time is over.
    """
    for markings, way, _ in _walks(problem, firings, watch, most, draw):
        if problem.is_bad(markings[-1]):
            return _without_loops(markings, way)
    return None


def _walks(
    problem: Problem,
    firings: Dict[int, int],
    watch: Watch,
    most: float,
    draw: Optional[random.Random] = None,
) -> Iterator[Tuple[List[Marking], List[int], bool]]:
    """Random walks, one after another: before each firing the markings and the firings so far, and
    whether none is possible.

    :param firings: those that a walk prefers, and how often.
    :param most: the most firings of all walks together.
    :param draw: chooses; by default the same as ever.
    """
    draw, net = draw or random.Random(1), problem.net
    for walks in range(MOST_WALKS):
        markings, left = [net.initial_marking], dict(firings)
        way: List[int] = []
        while len(way) < LONGEST_WALK:
            watch.step("random walks", walks)
            able = list(problem.fires(markings[-1]))
            yield markings, way, not able
            most -= 1
            if most < 0:
                return
            if not able:
                break
            wanted = [t for t in able if left.get(t, 0) > 0]
            t = draw.choice(wanted if wanted and draw.random() < _ON_THE_WAY else able)
            left[t] = left.get(t, 0) - 1
            way.append(t)
            markings.append(net.fire(markings[-1], t))

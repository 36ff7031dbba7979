"""What can be reached again from every reachable marking (``AG EF``), as a question about single
markings.

Take a weight for every place, whole and not negative, and the transitions whose firing makes the
weighted sum of tokens smaller. A run that fires only these ends. So if some reachable marking can
never come to the goal, then so can one in which the goal does not hold and none of these
transitions can fire. That no such marking is reachable is a question like others, which a proof may
answer at any size; whether one of them can come to the goal, a search from there tells. The weights
used here are distances to the places in which the goal wants tokens, and between markings of the
same distance, weights by which the actions that are going on end one after another. Where too many
markings follow, the state equation may prove from there that the goal is never reached.
"""

from __future__ import annotations

from collections import deque
from typing import Callable, Deque, Dict, Iterable, Iterator, List, Optional, Sequence, Set, Tuple

from gspn_framework_package.analysis.proofs.checker import (
    Atom,
    Formula,
    Problem,
    ProofError,
    check_certificate,
    fulfils,
)
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Marking, Net

MOST_FOLLOWED = 20_000
"""Maximum number of markings to visit from one whose way to the goal is asked for."""

FEW_FOLLOWED = 1_000
"""Number of markings that are visited before a proof is tried."""

MOST_PROOFS = 5
"""Maximum number of markings of a question from which a proof is tried."""

SECONDS_OF_PROOF = 1.0
"""Time for each of them (s)."""


def nearing(
    net: Net,
    goal: Formula,
    moving: Iterable[int],
    transitions: Sequence[int],
    by_themselves: Iterable[int] = (),
) -> List[int]:
    """Those of the transitions whose firing brings tokens nearer to the goal, or settles
    what is in progress without changing their distance.

    :param moving: the places whose tokens have distances; others count 0.
    :param by_themselves: the transitions on which nobody decides.
    """
    inside = set(moving)
    atoms = [atom for atom in _atoms(goal) if atom.least > 0 or any(w < 0 for _, w in atom.terms)]
    wanted = {p for atom in atoms for p, weight in atom.terms if weight > 0} & inside
    if not wanted:
        wanted = inside - {p for atom in atoms for p, _ in atom.terms}
    distance = dict.fromkeys(wanted, 0)
    producing: Dict[int, List[int]] = {p: [] for p in inside}
    for t in transitions:
        for p, _ in net.outputs[t]:
            if p in inside:
                producing[p].append(t)
    waiting: Deque[int] = deque(wanted)
    while waiting:
        after = waiting.popleft()
        for t in producing[after]:
            for p, _ in net.inputs[t]:
                if p in inside and p not in distance:
                    distance[p] = distance[after] + 1
                    waiting.append(p)
    far = max(distance.values(), default=0) + 1
    settled = frozenset(settling(net, by_themselves))
    found = []
    for t in transitions:
        change = sum(distance.get(p, far) * n for p, n in net.effect(t) if p in inside)
        if change < 0 or change == 0 and t in settled:
            found.append(t)
    return found


def settling(net: Net, transitions: Iterable[int]) -> List[int]:
    """Those of the transitions of which each firing makes a weighted sum of tokens smaller: all,
    unless some lead around in a circle.

    A place has a larger weight than all together that a firing puts elsewhere for its token.
    """
    effects = {t: net.effect(t) for t in transitions}
    leaving: Dict[int, List[int]] = {}
    for t, effect in effects.items():
        for p, change in effect:
            if change < 0:
                leaving.setdefault(p, []).append(t)
    weight: Dict[int, int] = {}
    begun: Set[int] = set()
    for first in leaving:
        waiting = [first]
        while waiting:
            p = waiting[-1]
            made = [[(o, n) for o, n in effects[t] if n > 0] for t in leaving.get(p, ())]
            if p not in begun:
                begun.add(p)
                waiting += {o for put in made for o, _ in put if o not in begun}
                continue
            waiting.pop()
            if p not in weight:
                sums = [sum(weight.get(o, 0) * n for o, n in put) for put in made]
                weight[p] = 1 + max(sums, default=-1)
    return [t for t in effects if sum(weight.get(p, 0) * n for p, n in effects[t]) < 0]


class FiringsLeft:
    """Which transitions may still fire from a marking on, by what lasts.

    Assume that all empty places stay empty and all marked ones keep a token, and give up what some
    transition would change that may fire under what is still assumed, until none does. What is left
    lasts: the firing that ended it first would be one of these transitions.

    :param transitions: those that may fire.
    :param ways: for a transition that a policy chooses, when it may: sets of places (bits of their
        numbers), of which the first have to be empty and the second marked; None for others.
    """

    def __init__(
        self,
        net: Net,
        transitions: Iterable[int],
        ways: Callable[[int], Optional[Sequence[Tuple[int, int]]]],
    ) -> None:
        self._inputs = {t: [p for p, _ in net.inputs[t]] for t in transitions}
        self._outputs = {t: [p for p, _ in net.outputs[t]] for t in self._inputs}
        self._less = {t: sum(1 << p for p, n in net.effect(t) if n < 0) for t in self._inputs}
        self._ways = {t: ways(t) for t in self._inputs}
        self._taking: List[List[int]] = [[] for _ in net.places]
        for t, inputs in self._inputs.items():
            for p in inputs:
                self._taking[p].append(t)

    def of(self, marking: Marking) -> Set[int]:
        """The transitions that may fire in the marking or later; no others do."""
        empty = sum(1 << p for p, count in enumerate(marking) if not count)
        marked = ~empty
        lacks = {t: sum(not marking[p] for p in self._inputs[t]) for t in self._inputs}
        waiting = [t for t, count in lacks.items() if not count]
        found: Set[int] = set()
        changed = True
        while changed:
            changed = False
            refused = []
            while waiting:
                t = waiting.pop()
                ways = self._ways[t]
                if ways is not None and all(e & marked or m & empty for e, m in ways):
                    refused.append(t)
                    continue
                changed = True
                found.add(t)
                marked &= ~self._less[t]
                for p in self._outputs[t]:
                    if empty >> p & 1:
                        empty &= ~(1 << p)
                        for other in self._taking[p]:
                            lacks[other] -= 1
                            if not lacks[other]:
                                waiting.append(other)
            waiting = refused
        return found


def never_returns(
    net: Net,
    facts: Sequence[Formula],
    holds: Callable[[Marking], bool],
    fires: Callable[[Marking], Iterable[int]],
    watch: Watch,
    goal: Optional[Formula] = None,
    surely: Optional[Callable[[Marking], bool]] = None,
) -> Callable[[Marking], bool]:
    """Whether a marking fulfils the facts, and the goal ``holds`` in none that it can come to.

    The function raises LimitError if that takes too many markings, or too long.

    :param watch: the watch of the whole question; results that are known already need no time.
    :param goal: what holds in every marking of the goal, for a proof that there is none.
    :param surely: says of some markings, quickly, that none of the goal follows.
    """
    returning: Set[Marking] = set()
    never: Set[Marking] = set()
    proofs = [MOST_PROOFS]

    def is_proven(marking: Marking, goal: Formula) -> bool:
        """Whether a proof shows that no marking that follows is one of the goal."""
        # checking a proof needs no solver
        from gspn_framework_package.analysis.proofs.prover import Candidate, Prover

        proofs[0] -= 1
        everything = tuple(range(len(net.transitions)))
        start = net.with_marking(marking)
        problem = Problem(start, everything, (goal,), holds, fires, step=watch.step)
        try:
            found = Prover(problem, watch.part(1.0, SECONDS_OF_PROOF)).prove()
            if not isinstance(found, Candidate):
                check_certificate(problem, found)
                return True
        except (LimitError, ProofError):
            pass
        return False

    def is_bad(marking: Marking) -> bool:
        if marking in returning or not all(fulfils(fact, marking) for fact in facts):
            return False
        if marking in never or surely is not None and surely(marking):
            return True
        came: Dict[Marking, Optional[Marking]] = {marking: None}
        waiting: Deque[Marking] = deque([marking])
        tries = True
        while waiting:
            watch.step("markings that follow", len(came))
            now = waiting.popleft()
            if now in never:
                continue
            if now in returning or holds(now):
                back: Optional[Marking] = now
                while back is not None:
                    returning.add(back)
                    back = came[back]
                return False
            for t in fires(now):
                after = net.fire(now, t)
                if after not in came:
                    came[after] = now
                    waiting.append(after)
            if len(came) > FEW_FOLLOWED and tries and proofs[0] > 0 and goal is not None:
                tries = False
                if is_proven(marking, goal):
                    break
            if len(came) > MOST_FOLLOWED:
                raise LimitError("not decided: too many markings follow one of those in question")
        never.update(came)
        return True

    return is_bad


def _atoms(formula: Formula) -> Iterator[Atom]:
    waiting: List[Formula] = [formula]
    while waiting:
        part = waiting.pop()
        if isinstance(part, Atom):
            yield part
        else:
            waiting += part.parts

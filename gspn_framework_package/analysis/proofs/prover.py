"""Searches for a proof that no reachable marking fulfils the facts of a problem, which
:mod:`~gspn_framework_package.analysis.proofs.checker` then checks.

The search narrows the counts of places by facts and lemmas, and divides into cases where that is
not enough. In each case a linear program asks the *state equation*: every reachable marking is
``m0 + C x`` for some counts ``x >= 0`` of firings. If no such marking is in the case, the program
gives a weighted sum of places that no firing lowers and that excludes the case: a new lemma, which
is rounded to whole numbers and checked. If there is one that fulfils the facts, it is a candidate:
a marked trap may exclude it, otherwise somebody has to find out whether it can be reached.
"""

from __future__ import annotations

import math
from collections import deque
from fractions import Fraction
from typing import (
    Any,
    Deque,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

import numpy as np
import scipy
from scipy import sparse

from gspn_framework_package.analysis.proofs.checker import (
    Atom,
    CountBox,
    Formula,
    Problem,
    Some,
    guard,
)
from gspn_framework_package.analysis.structure.invariants import Invariant, place_invariants
from gspn_framework_package.analysis.structure.siphons import Directions, largest_set
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net

INVARIANT_STEPS = 200_000
"""Longest search for the invariants that bound the places, in steps."""

FEW_PLACES = (30, 6)
"""Numbers of places to which invariants are limited, if there are too many."""

MOST_INVARIANTS = 5_000
"""Maximum number of invariants that a proof starts with."""

DEEPEST = 400
"""Maximum depth of nested cases."""

Reason = List[List[int]]
"""Items ``[times, fact, which]``, as in a certificate; lemmas have the numbers -1, -2, ..."""


class Candidate(NamedTuple):
    """A marking that the facts, the lemmas and the state equation allow.

    :ivar marking: its counts.
    :ivar firings: number of a transition -> about how often it fires on the way.
    """

    marking: Tuple[int, ...]
    firings: Dict[int, float]


class _FoundError(Exception):
    """Ends the search: there is a candidate."""

    def __init__(self, candidate: Candidate) -> None:
        super().__init__()
        self.candidate = candidate


def solver_available() -> bool:
    """Whether this SciPy (1.7 or newer) solves linear programs and returns the prices of rows."""
    return tuple(map(int, scipy.__version__.split(".")[:2])) >= (1, 7)


class Prover:
    """The search for a proof of one problem.

    :param watch: may stop the search.
    :param other: a search that ended, about the same net and transitions: what it found out about
        them is reused.
    :ivar programs: the number of linear programs that were solved.
    :ivar cases: the number of cases.
    """

    def __init__(self, problem: Problem, watch: Watch, other: Optional[Prover] = None) -> None:
        self._problem, self._watch = problem, watch
        self._net = problem.net
        self._lemmas: List[Some] = []
        self._traps: Set[int] = set()  # the lemmas that do not follow from the state equation
        self._near: List[List[int]] = [[] for _ in self._net.places]
        for number, fact in enumerate(problem.facts):
            self._listen(number, fact)
        self._state_equation: Optional[_StateEquation] = None
        self._arcs: Optional[Directions] = None
        if other is not None:
            self._state_equation, self._arcs = other._state_equation, other._arcs
            self._traps = set(other._traps)
        elif solver_available():
            self._state_equation = _StateEquation(problem)
        for lemma in _first_lemmas(problem, watch) if other is None else other._lemmas:
            self._add(lemma)
        self.programs = self.cases = 0

    def prove(self) -> Any:
        """A certificate, or a :class:`Candidate`.

        :raises LimitError: neither was found.
        """
        everything = [*range(-len(self._lemmas), len(self._problem.facts))]
        try:
            tree = self._refute(CountBox.of(self._net), everything, 0)
        except _FoundError as found:
            return found.candidate
        return self._certificate(tree)

    # -- facts and lemmas --------------------------------------------------------------------------

    def _fact(self, number: int) -> Formula:
        return self._problem.facts[number] if number >= 0 else self._lemmas[-1 - number]

    def _listen(self, number: int, formula: Formula) -> None:
        for p in set(_places(formula)):
            self._near[p].append(number)

    def _add(self, lemma: Some) -> int:
        """Add a lemma, and return its number."""
        self._lemmas.append(lemma)
        self._listen(-len(self._lemmas), lemma)
        return -len(self._lemmas)

    def _certificate(self, root: Any) -> Dict[str, Any]:
        """The certificate of a tree, with the lemmas that it uses."""
        nodes = [root]
        items: List[List[int]] = []
        for node in nodes:
            for reason in (*(step[3] for step in node["steps"]), node.get("end", ())):
                items += reason
            if "cases" in node:
                children = node["cases"][2:]
                node["cases"][2:] = len(nodes), len(nodes) + 1
                nodes += children
        used: Dict[int, int] = {}
        for item in items:
            if item[1] < 0:
                used.setdefault(item[1], len(used))
        for item in items:
            item[1] = used[item[1]] if item[1] < 0 else item[1] + len(used)
        lemmas = [written_lemma(self._net, self._lemmas[-1 - number]) for number in used]
        return {"lemmas": lemmas, "tree": nodes}

    # -- the search --------------------------------------------------------------------------------

    def _refute(self, box: CountBox, queue: Iterable[int], depth: int) -> Any:
        """A tree that shows that the box has no marking with the facts.

        :raises _FoundError: it may have one.
        """
        self.cases += 1
        if depth > DEEPEST:
            raise LimitError("not decided: more than %d cases within each other" % DEEPEST)
        steps: List[Any] = []
        while True:
            end = self._settle(box, queue, steps)
            if end is None:
                end, point, firings = self._ask(box)
            if end is not None:
                return {"steps": steps, "end": end}
            place, count = self._branch(box, point)
            if place >= 0:
                break
            trap = self._trap(point)
            if trap is None:
                marking = tuple(int(round(n)) for n in point)
                raise _FoundError(Candidate(marking, firings))
            queue = [trap]
        lower, upper = box.copy(), box.copy()
        lower.narrow(place, False, count)
        upper.narrow(place, True, count + 1)
        below, above = (self._refute(b, self._near[place], depth + 1) for b in (lower, upper))
        return {"steps": steps, "cases": [place, count, below, above]}

    def _settle(self, box: CountBox, queue: Iterable[int], steps: List[Any]) -> Optional[Reason]:
        """Narrow the box by all facts, from those in ``queue`` on.

        :returns: the reason why it is empty, if it becomes so.
        """
        waiting: Deque[int] = deque(queue)
        queued = set(waiting)
        while waiting:
            self._watch.step("steps of a proof", len(steps))
            number = waiting.popleft()
            queued.discard(number)
            fact = self._fact(number)
            if not box.allows(fact):
                return [[1, number, 0]]
            for atom in box.implied(fact):
                for p, is_low, count in list(_narrowed(box, atom)):
                    steps.append([p, is_low, count, [[1, number, 0]]])
                    box.narrow(p, is_low, count)
                    if box.empty:
                        return [[1, number, 0]]
                    fresh = [n for n in self._near[p] if n not in queued]
                    queued.update(fresh)
                    waiting.extend(fresh)
        return None

    def _ask(self, box: CountBox) -> Tuple[Optional[Reason], Any, Dict[int, float]]:
        """Ask the state equation: a reason why it excludes the box, or a point in the box and the
        firings that lead there."""
        if self._state_equation is None:
            raise LimitError("not decided: the state equation needs SciPy 1.7 or newer")
        self._watch.step("linear programs", self.programs)
        self.programs += 1
        sums = [
            (number, which, atom)
            for number in range(-len(self._lemmas), len(self._problem.facts))
            for which, atom in enumerate(box.implied(self._fact(number)))
            if len(atom.terms) > 1 and (number >= 0 or number in self._traps)
        ]
        found = self._state_equation.solve(box, [atom for _, _, atom in sums], self._watch.left)
        if found.excluded_by is None:
            return None, found.point, found.firings
        weights, times = found.excluded_by
        reason: Reason = [[n, number, which] for n, (number, which, _) in zip(times, sums) if n]
        if weights:
            least = sum(w * self._net.initial_marking[p] for p, w in weights)
            reason.append([1, self._add(Some((Atom(tuple(weights), least),))), 0])
        return reason, None, {}

    def _branch(self, box: CountBox, point: Sequence[float]) -> Tuple[int, int]:
        """A place and a count to divide the box at; -1 if ``point`` is a marking with the facts."""
        best: Tuple[float, int, int] = (math.inf, -1, 0)
        for fact in self._problem.facts:
            found = _unsettled(fact, box, point)
            if found is not None and found[0] < best[0]:
                best = found
                if best[0] <= 2:
                    break
        if best[1] >= 0:
            return best[1:]
        for p, n in enumerate(point):
            if abs(n - round(n)) > 1e-6:
                return p, math.floor(n)
        return -1, 0

    def _trap(self, point: Sequence[float]) -> Optional[int]:
        """The number of a new lemma: some place of a trap is marked that is empty in ``point``."""
        net = self._net
        self._arcs = self._arcs or Directions(net)
        empty = [place.name for place, n in zip(net.places, point) if n < 0.5]
        places = [
            net.place_number(name)
            for name in largest_set(net, empty, kind="traps", arcs=self._arcs)
        ]
        if not any(net.places[p].tokens for p in places):
            return None
        number = self._add(Some((Atom(tuple((p, 1) for p in places), 1),)))
        self._traps.add(number)
        return number


def written_lemma(net: Net, lemma: Some) -> Dict[str, Any]:
    """A lemma as plain JSON values."""
    return {
        "some": [
            [{net.places[p].name: weight for p, weight in atom.terms}, atom.least]
            for atom in lemma.parts
        ]
    }


def _places(formula: Formula) -> Iterator[int]:
    if isinstance(formula, Atom):
        yield from (p for p, _ in formula.terms)
        return
    for part in formula.parts:
        yield from _places(part)


def _narrowed(box: CountBox, atom: Atom) -> Iterator[Tuple[int, bool, int]]:
    """The bounds that an inequality sets on single places: place, whether it is a lower
    bound, count."""
    slack = box.largest(atom.terms) - atom.least
    if slack == math.inf:
        unlimited = [(p, w) for p, w in atom.terms if w > 0 and box.high[p] == math.inf]
        if len(unlimited) == 1:
            ((p, weight),) = unlimited
            rest = box.largest(term for term in atom.terms if term[0] != p)
            count = -((int(rest) - atom.least) // weight)
            if count > box.low[p]:
                yield p, True, count
        return
    for p, weight in atom.terms:
        if weight > 0:
            count = int(box.high[p]) - int(slack) // weight
            if count > box.low[p]:
                yield p, True, count
        else:
            count = box.low[p] + int(slack) // -weight
            if count < box.high[p]:
                yield p, False, count


def _unsettled(
    formula: Formula, box: CountBox, point: Sequence[float]
) -> Optional[Tuple[float, int, int]]:
    """Where to divide a box to settle a formula that does not hold at a point of it: the number of
    its open parts, a place and a count. None if it holds there."""
    if isinstance(formula, Atom):
        if sum(w * point[p] for p, w in formula.terms) >= formula.least - 1e-6:
            return None
        for p, w in formula.terms:
            if box.low[p] < box.high[p]:
                count = math.floor(point[p] + 1e-6)
                if len(formula.terms) == 1:
                    count = formula.least - 1 if w > 0 else -formula.least
                return 1, p, int(min(max(count, box.low[p]), box.high[p] - 1))
        return None  # its value is known: settling the box uses it
    found = [_unsettled(part, box, point) for part in formula.parts if box.allows(part)]
    if isinstance(formula, Some):
        if not found or None in found:
            return None
        return len(found), *found[0][1:]  # type: ignore[index]
    return next((each for each in found if each is not None), None)


# -- lemmas to start with --------------------------------------------------------------------------


def _first_lemmas(problem: Problem, watch: Watch) -> Iterator[Some]:
    """Bounds of places from what produces there, and invariants: some transitions only take tokens,
    such as the losses of robots, and the sums that all others keep are upper bounds."""
    net = problem.net
    effects = {t: dict(net.effect(t)) for t in problem.transitions}
    for p in range(len(net.places)):
        bound = _own_bound(net, effects, p)
        if bound is not None:
            yield Some((Atom(((p, -1),), -bound),))
    kept = [t for t in problem.transitions if any(n > 0 for n in effects[t].values())]
    lowered = {p for t in set(effects).difference(kept) for p in effects[t]}
    names = {net.transitions[t].name for t in kept}
    moving = Net(
        net.places,
        [net.transitions[t] for t in kept],
        [arc for arc in net.arcs if arc.source in names or arc.target in names],
    )
    for invariant in _some_invariants(moving, watch):
        terms = tuple((net.place_number(name), w) for name, w in invariant.weights.items())
        value = sum(w * net.initial_marking[p] for p, w in terms)
        yield Some((Atom(tuple((p, -w) for p, w in terms), -value),))
        if lowered.isdisjoint(p for p, _ in terms):
            yield Some((Atom(terms, value),))


def _some_invariants(net: Net, watch: Watch) -> List[Invariant]:
    """The invariants of a net; if these are too many, those of few places."""
    for largest in (None, *FEW_PLACES):
        try:
            return place_invariants(net, INVARIANT_STEPS, watch, largest)[:MOST_INVARIANTS]
        except LimitError:
            continue
    return []


def _own_bound(net: Net, effects: Dict[int, Dict[int, int]], p: int) -> Optional[int]:
    """The maximum number of tokens of a place, if whatever produces there needs few of them."""
    bound = net.initial_marking[p]
    for t in net.producers[p]:
        more = effects.get(t, {}).get(p, 0)
        if more <= 0:
            continue
        limits = [-need.least for need in guard(net, t) if need.terms == ((p, -1),)]
        if not limits:
            return None
        bound = max(bound, min(limits) + more)
    return bound


# -- the state equation ----------------------------------------------------------------------------


class _Answer(NamedTuple):
    """The result of the state equation for a box.

    :ivar excluded_by: whole weights of places, of which no firing lowers the sum, and whole
        multiples of the inequalities asked with it, which together exclude the box.
    :ivar point: otherwise, a marking in the box.
    :ivar firings: how often each transition fires on the way there.
    """

    excluded_by: Optional[Tuple[List[Tuple[int, int]], List[int]]]
    point: Sequence[float] = ()
    firings: Dict[int, float] = {}


class _StateEquation:
    """The linear programs of the state equation of a problem's net."""

    def __init__(self, problem: Problem) -> None:
        net = problem.net
        self._places, self._transitions = len(net.places), problem.transitions
        self._start = [int(n) for n in net.initial_marking]
        entries = [(row, p, n) for row, t in enumerate(self._transitions) for p, n in net.effect(t)]
        rows, columns, values = zip(*entries) if entries else ((), (), ())
        self._changes = sparse.csr_matrix(
            (np.array(values, dtype=float), (rows, columns)),
            shape=(len(self._transitions), self._places),
        )
        self._effects = [net.effect(t) for t in self._transitions]

    def solve(self, box: CountBox, atoms: Sequence[Atom], seconds: float) -> _Answer:
        """Ask whether a marking of the box is ``m0 + C x`` and fulfils ``atoms``.

        :param seconds: the longest time for it.

        The dual program is solved: weights of places, of which no firing lowers the sum, and
        multiples of the atoms, so that the sum of all of them is as far as possible above what the
        box allows. If that is nowhere above, the prices of its rows are the firings ``x``.

        :raises LimitError: the solver has no answer, or rounding it to whole numbers fails.
        """
        from scipy.optimize import linprog

        start, high = np.array(self._start, dtype=float), np.array(box.high, dtype=float)
        low = np.array(box.low, dtype=float)
        given = np.zeros((len(atoms), self._places))
        for k, atom in enumerate(atoms):
            for p, weight in atom.terms:
                given[k, p] += weight
        leasts = np.array([atom.least for atom in atoms], dtype=float)
        # columns: what the sum has above 0, below 0, and the multiples of the atoms
        cost = np.concatenate([np.where(np.isinf(high), 0, high) - start, start - low])
        cost = np.concatenate([cost, given @ start - leasts])
        changes = self._changes
        sides = [-changes, changes]
        if len(atoms):
            sides.append(sparse.csr_matrix(changes @ given.T))
        matrix = sparse.hstack(sides, format="csr")
        matrix = sparse.vstack([matrix, np.ones((1, matrix.shape[1]))], format="csr")
        bounds = [(0.0, 0.0 if math.isinf(n) else None) for n in box.high]
        bounds += [(0.0, None)] * (self._places + len(atoms))
        right = np.zeros(len(self._transitions) + 1)
        right[-1] = 1.0
        answer = linprog(
            cost, matrix, right, bounds=bounds, method="highs", options={"time_limit": seconds}
        )
        if answer.x is None or answer.status == 1:
            raise LimitError("not decided: the solver of linear programs gave up")
        if answer.fun > -1e-9:
            firings = np.maximum(-answer.ineqlin.marginals[:-1], 0)
            point = start + changes.T @ firings
            return _Answer(
                None,
                point.tolist(),
                {t: n for t, n in zip(self._transitions, firings.tolist()) if n > 1e-9},
            )
        above, below = answer.x[: self._places], answer.x[self._places : 2 * self._places]
        times = answer.x[2 * self._places :]
        for numbers in _whole([*(above - below).tolist(), *times.tolist()]):
            total = numbers[: self._places]
            multiples = numbers[self._places :]
            if self._excludes(box, atoms, total, multiples):
                for n, atom in zip(multiples, atoms):
                    for p, weight in atom.terms:
                        total[p] -= n * weight
                return _Answer(([(p, w) for p, w in enumerate(total) if w], multiples))
        raise LimitError("not decided: a proof could not be rounded to whole numbers")

    def _excludes(
        self, box: CountBox, atoms: Sequence[Atom], total: List[int], multiples: List[int]
    ) -> bool:
        """Whether these whole numbers exclude the box, exactly."""
        if min(multiples, default=0) < 0:
            return False
        weights = total[:]
        least = 0
        for n, atom in zip(multiples, atoms):
            least += n * atom.least
            for p, weight in atom.terms:
                weights[p] -= n * weight
        least += sum(w * n for w, n in zip(weights, self._start))
        if box.largest((p, w) for p, w in enumerate(total) if w) >= least:
            return False
        return all(sum(weights[p] * n for p, n in effect) >= 0 for effect in self._effects)


def _whole(values: Sequence[float]) -> Iterator[List[int]]:
    """Whole numbers in about these proportions, in several ways."""
    sizes = [abs(v) for v in values]
    largest = max(sizes)
    values = [v if size > 1e-9 * largest else 0.0 for v, size in zip(values, sizes)]
    smallest = min(abs(v) for v in values if v)
    for times in range(1, 61):
        scaled = [v / smallest * times for v in values]
        rounded = [round(v) for v in scaled]
        if all(abs(v - n) < 1e-4 for v, n in zip(scaled, rounded)):
            yield rounded
    for size in (largest, smallest):
        for finest in (12, 100, 1000, 100_000):
            fractions = [Fraction(v / size).limit_denominator(finest) for v in values]
            scale = 1
            for fraction in fractions:
                scale *= fraction.denominator // math.gcd(scale, fraction.denominator)
            yield [int(fraction * scale) for fraction in fractions]

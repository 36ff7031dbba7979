"""Checks proofs about all markings that a net can reach, in exact arithmetic.

A question asks for a reachable marking that fulfils some *facts*. A proof that there is none has
two parts. First come *lemmas*, which hold in every reachable marking: at the start, and after every
firing if before it; for that, a lemma may need the others and a proof. Then a *tree* shows that no
marking fulfils lemmas and facts. Each of its nodes narrows the counts of places, until one fact, or
a weighted sum of several, cannot hold any more. Or all markings are visited again, or robots are
shown to get *home*, one after another. Nothing of a solver is believed.

Facts and lemmas are linear inequalities (:class:`Atom`) joined by :class:`All` and :class:`Some`.
Counts are whole numbers, so the opposite of ``sum >= n`` is ``-sum >= 1 - n``.
This module is all that checks proofs, and needs neither NumPy nor a solver. It reads untrusted
files: whatever does not fit is a :class:`ProofError`.
"""

from __future__ import annotations

import math
from itertools import islice
from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple, Union

from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.net import Marking, Net


class ProofError(GspnError):
    """A certificate proves nothing; the message says where it fails."""


class Atom(NamedTuple):
    """The sum of weight times count over ``terms`` (pairs of place number and weight) is at least
    ``least``. All numbers are whole."""

    terms: Tuple[Tuple[int, int], ...]
    least: int


class All(NamedTuple):
    """All of ``parts`` hold."""

    parts: Tuple[Any, ...]


class Some(NamedTuple):
    """One of ``parts`` holds, or more."""

    parts: Tuple[Any, ...]


Formula = Union[Atom, All, Some]
Count = Union[int, float]
"""A number of tokens; infinity is the only one that is not an integer."""

TRUE, FALSE = All(()), Some(())

CheckStep = Callable[[str, int], None]
"""Called with what was done, and how much of it; may raise an exception to end the work."""


MOST_VISITED = 1_000_000
"""Maximum number of markings that the checker visits."""

_UNREADABLE = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


class Problem(NamedTuple):
    """A question about a net: is there a reachable marking that is *bad*?

    :ivar net: the net.
    :ivar transitions: the numbers of the transitions that may fire.
    :ivar facts: what every bad marking fulfils.
    :ivar is_bad: whether a marking is.
    :ivar fires: the transitions that may fire in a marking: fewer than the net enables, where
        priorities or a policy decide.
    :ivar surely: says of some markings that every marking that follows, if whatever is in progress
        ends, is bad; None if nothing quick says so.
    :ivar settling: the transitions that end whatever is in progress.
    :ivar chosen: whether an enabled transition is one of ``fires``; None if nothing quicker says.
    :ivar robots: for each place whether it holds robots, if no reachable marking is bad where every
        one leads back to the first and that is not bad; otherwise nothing.
    :ivar step: called at intervals of a check.
    :ivar needs: what holds where a transition fires.
    """

    net: Net
    transitions: Tuple[int, ...]
    facts: Tuple[Formula, ...]
    is_bad: Callable[[Marking], bool]
    fires: Callable[[Marking], Iterable[int]]
    surely: Optional[Callable[[Marking], bool]] = None
    settling: Tuple[int, ...] = ()
    chosen: Optional[Callable[[Marking, int], bool]] = None
    robots: Tuple[bool, ...] = ()
    step: CheckStep = lambda what, count: None
    needs: Callable[[int], Iterable[Formula]] = lambda t: ()


class CountBox:
    """The markings in which each place has at least ``low`` and at most ``high`` tokens."""

    def __init__(self, low: List[int], high: List[Count], empty: bool = False) -> None:
        self.low, self.high, self.empty = low, high, empty

    @classmethod
    def of(cls, net: Net) -> CountBox:
        """Every marking of the net, capacities aside."""
        return cls([0] * len(net.places), [math.inf] * len(net.places))

    def copy(self) -> CountBox:
        """A copy."""
        return CountBox(self.low[:], self.high[:], self.empty)

    def narrow(self, p: int, is_low: bool, count: int) -> None:
        """Keep the markings in which place number ``p`` has at least (or most) ``count``."""
        if type(count) is not int or not 0 <= p < len(self.low):
            raise ValueError("%r tokens in place %r" % (count, p))
        if is_low:
            self.low[p] = max(self.low[p], count)
        else:
            self.high[p] = min(self.high[p], count)
        self.empty = self.empty or self.low[p] > self.high[p]

    def largest(self, terms: Iterable[Tuple[int, int]]) -> Count:
        """The largest value of a weighted sum."""
        return sum(w * (self.high[p] if w > 0 else self.low[p]) for p, w in terms)

    def allows(self, formula: Formula) -> bool:
        """Whether the formula may hold according to the counts of single places. False is
        certain."""
        if isinstance(formula, Atom):
            return self.largest(formula.terms) >= formula.least
        every = all if isinstance(formula, All) else any
        return every(map(self.allows, formula.parts))

    def implied(self, formula: Formula) -> List[Atom]:
        """Inequalities that hold wherever the formula does, in a fixed order: where only one part
        of a disjunction is possible, that one."""
        if isinstance(formula, Atom):
            return [formula]
        if isinstance(formula, All):
            return [atom for part in formula.parts for atom in self.implied(part)]
        possible = list(islice(filter(self.allows, formula.parts), 2))
        return self.implied(possible[0]) if len(possible) == 1 else []


def fulfils(formula: Formula, marking: Sequence[int]) -> bool:
    """Whether the formula holds in a marking."""
    if isinstance(formula, Atom):
        return sum(weight * marking[p] for p, weight in formula.terms) >= formula.least
    every = all if isinstance(formula, All) else any
    return every(fulfils(part, marking) for part in formula.parts)


def guard(net: Net, t: int) -> Tuple[Atom, ...]:
    """The condition for transition number ``t`` to be enabled, regardless of priorities."""
    return (
        *(Atom(((p, 1),), weight) for p, weight in net.inputs[t]),
        *(Atom(((p, -1),), -most) for p, most in net.most_tokens(t)),
    )


def opposite(formula: Formula) -> Formula:
    """The negation of the formula."""
    if isinstance(formula, Atom):
        return Atom(tuple([(p, -weight) for p, weight in formula.terms]), 1 - formula.least)
    parts = tuple(map(opposite, formula.parts))
    return Some(parts) if isinstance(formula, All) else All(parts)


def check_lemma(problem: Problem, lemma: Some, known: Sequence[Formula], kept: Any) -> None:
    """Require that a disjunction of inequalities holds at the start, and after a firing if all that
    are ``known`` hold before it: plainly, or by a certificate in ``kept``.

    :raises ProofError: it is not shown.
    """
    net = problem.net
    if not fulfils(lemma, net.initial_marking):
        raise ProofError("a lemma does not hold at the start")
    for t in may_break(problem, lemma):
        name = net.transitions[t].name
        if name not in kept:
            raise ProofError("a lemma may fail when %s fires" % name)
        check_certificate(breaking(problem, lemma, known, t), kept[name])


def may_break(problem: Problem, lemma: Some) -> List[int]:
    """The transitions by which a lemma is not plainly kept."""
    net, places = problem.net, {p for atom in lemma.parts for p, _ in atom.terms}
    near = {t for p in places for t in (*net.consumers[p], *net.producers[p])}
    return [t for t in near.intersection(problem.transitions) if not _is_kept(net, lemma, t)]


def breaking(problem: Problem, lemma: Some, known: Sequence[Formula], t: int) -> Problem:
    """The question whether a marking can be reached in which all that are ``known`` hold, and a
    firing of transition number ``t`` breaks the lemma."""
    fires = (*guard(problem.net, t), *problem.needs(t))
    facts = (*known, *fires, opposite(_before(problem.net, lemma, t)))
    return problem._replace(facts=facts, robots=())


def _before(net: Net, lemma: Some, t: int) -> Some:
    """The condition for the lemma to hold after a firing of transition number ``t``."""
    change = dict(net.effect(t))
    return Some(tuple(after(atom, change) for atom in lemma.parts))


def _is_kept(net: Net, lemma: Some, t: int) -> bool:
    """Whether a firing of transition number ``t`` weakens no inequality of the lemma, or one of
    them holds after it because of what the transition needs."""
    before = _before(net, lemma, t)
    if all(now.least <= then.least for now, then in zip(before.parts, lemma.parts)):
        return True
    box = CountBox.of(net)
    for need in guard(net, t):
        ((p, sign),) = need.terms
        box.narrow(p, sign > 0, sign * need.least)
    return box.empty or not box.allows(opposite(before))


def check_tree(box: CountBox, facts: Sequence[Formula], nodes: Any, step: CheckStep) -> None:
    """Require that a tree shows that no marking of ``box`` fulfils all ``facts``.

    The first of its ``nodes`` is the root. A node has ``steps``, each ``[place, is_low, count,
    reason]``: the place has at least (or most) that count, and the reason says why it cannot have
    less (or more). Then comes the reason of its ``end``, or its ``cases`` ``[place, count, node,
    node]``: the place has at most that count, or more. The numbers of these nodes are above its
    own.

    :raises ProofError: it does not.
    """
    waiting = [(box.copy(), 0)]
    while waiting:
        box, number = waiting.pop()
        try:
            for p, is_low, count, reason in nodes[number]["steps"]:
                step("nodes checked", number)
                rest = box.copy()
                rest.narrow(p, not is_low, count - 1 if is_low else count + 1)
                _check_reason(rest, facts, reason)
                box.narrow(p, is_low, count)
            if "cases" not in nodes[number]:
                _check_reason(box, facts, nodes[number]["end"])
                continue
            p, count, below, above = nodes[number]["cases"]
            if not number < below < above:
                raise ProofError("the nodes of the proof are not a tree")
            lower, upper = box.copy(), box.copy()
            lower.narrow(p, False, count)
            upper.narrow(p, True, count + 1)
        except _UNREADABLE as error:
            raise ProofError("a node of the proof cannot be read: %r" % error) from None
        waiting += [(lower, below), (upper, above)]


def _check_reason(box: CountBox, facts: Sequence[Formula], reason: Any) -> None:
    """Require that no marking of ``box`` fulfils all ``facts``, for a reason: items ``[times, fact,
    which]``. One of these facts cannot hold, or the sum of inequalities that they imply cannot:
    each of them, ``which`` in the list of its fact, that many times.

    :raises ProofError: it is none.
    """
    if box.empty or not all(box.allows(facts[fact]) for _, fact, _ in reason):
        return
    total: Dict[int, int] = {}
    least = 0
    for times, fact, which in reason:
        if type(times) is not int or times < 0:
            raise ProofError("an inequality is taken %r times" % (times,))
        atom = box.implied(facts[fact])[which]
        for p, weight in atom.terms:
            total[p] = total.get(p, 0) + times * weight
        least += times * atom.least
    if box.largest((p, weight) for p, weight in total.items() if weight) >= least:
        raise ProofError("a step of the proof does not follow")


def check_certificate(problem: Problem, certificate: Any) -> str:
    """Require that a certificate shows that no reachable marking is bad.

    It has ``lemmas`` and the nodes of a ``tree``, or the number of ``markings`` to be visited
    again, or ``ways`` home. A lemma has a list ``some`` of inequalities ``[{place: weight},
    least]``, one of which always holds.

    :returns: what was checked, for people.
    :raises ProofError: it does not.
    """
    try:
        if "markings" in certificate:
            return _visit(problem, certificate["markings"])
        if "ways" in certificate and problem.robots:
            return _check_ways(problem, certificate)
        known = [read_lemma(problem.net, written) for written in certificate["lemmas"]]
        for number, lemma in enumerate(known):
            problem.step("lemmas checked", number)
            check_lemma(problem, lemma, known, certificate["lemmas"][number].get("kept", ()))
        facts = (*known, *problem.facts)
        check_tree(CountBox.of(problem.net), facts, certificate["tree"], problem.step)
    except _UNREADABLE as error:
        raise ProofError("the certificate cannot be read: %r" % error) from None
    return "%d lemmas" % len(known)


def read_lemma(net: Net, written: Any) -> Some:
    """A lemma of a certificate."""
    atoms = []
    for weights, least in written["some"]:
        terms = tuple((net.place_index[name], weight) for name, weight in weights.items())
        if any(type(n) is not int for n in (least, *(weight for _, weight in terms))):
            raise ValueError("a number of a lemma is not whole")
        atoms.append(Atom(terms, least))
    return Some(tuple(atoms))


def _visit(problem: Problem, number: Any) -> str:
    """Require that the net has exactly this number of reachable markings, none of them bad."""
    if type(number) is not int or not 0 < number <= MOST_VISITED:
        raise ProofError("%r markings cannot be visited" % (number,))
    seen = {problem.net.initial_marking}
    waiting = [problem.net.initial_marking]
    while waiting and len(seen) <= number:
        problem.step("markings checked", len(seen))
        marking = waiting.pop()
        if problem.is_bad(marking):
            raise ProofError("a bad marking can be reached")
        new = {problem.net.fire(marking, t) for t in problem.fires(marking)} - seen
        seen |= new
        waiting += new
    if len(seen) != number:
        raise ProofError("%d markings were expected, and there are others" % number)
    return "%d markings visited" % number


def after(formula: Formula, change: Dict[int, int]) -> Formula:
    """The condition for the formula to hold after the counts of places have changed."""
    if isinstance(formula, Atom):
        weights = dict(formula.terms)
        more = sum(n * weights.get(p, 0) for p, n in change.items())
        return Atom(formula.terms, formula.least - more)
    return type(formula)(tuple(after(part, change) for part in formula.parts))


def firing_in_turn(problem: Problem, names: Iterable[str]) -> Tuple[Formula, Dict[int, int]]:
    """The condition for transitions to fire one after another, and the change of the counts."""
    net = problem.net
    change: Dict[int, int] = {}
    guards: List[Formula] = []
    others: List[Formula] = []
    for name in names:
        t = net.transition_index[name]
        guards += [after(need, change) for need in guard(net, t)]
        others += [after(need, change) for need in problem.needs(t)]
        for p, n in net.effect(t):
            change[p] = change.get(p, 0) + n
    return All((*dict.fromkeys(guards), *others)), change


def at_rest(problem: Problem, possible: Iterable[Formula], end: Sequence[int]) -> Problem:
    """The question whether a marking other than ``end`` can be reached in which nothing is in
    progress, and none of the formulas ``possible`` holds: no way can begin."""
    net = problem.net
    other = [Atom(((p, 1),), n + 1) for p, n in enumerate(end)]
    other += [Atom(((p, -1),), 1 - n) for p, n in enumerate(end) if n]
    going_on = (All(guard(net, t)) for t in problem.settling)
    facts = (Some(tuple(other)), *map(opposite, going_on), *map(opposite, possible))
    return problem._replace(facts=facts, robots=())


def _check_ways(problem: Problem, certificate: Any) -> str:
    """Require that every reachable marking leads to the first one. Whatever is in progress ends by
    itself. Then one of the ``ways``, each a list of firings, can be taken, except from the ``end``.
    From there, the firings ``back`` lead to the first marking. There are ``distances`` of places,
    so that each way makes the sum of them over all tokens smaller, and nothing that goes on makes
    it larger. ``rest`` is the certificate that nothing else is :func:`at_rest`."""
    net, ways = problem.net, [firing_in_turn(problem, way) for way in certificate["ways"]]
    distances = {net.place_index[name]: n for name, n in certificate["distances"].items()}
    end = dict(zip(net.place_index, net.initial_marking), **certificate["end"])
    marking = tuple(end[place.name] for place in net.places)
    if any(type(n) is not int or n < 0 for n in (*distances.values(), *marking)):
        raise ProofError("a distance or count is not a whole number")

    def further(change: Iterable[Tuple[int, int]]) -> int:
        return sum(distances.get(p, 0) * n for p, n in change)

    if any(further(net.effect(t)) > 0 for t in problem.settling):
        raise ProofError("what is in progress may lead further away")
    if any(further(change.items()) >= 0 for _, change in ways):
        raise ProofError("a way leads no nearer")
    resting = at_rest(problem, (possible for possible, _ in ways), marking)
    how = check_certificate(resting, certificate["rest"])
    for name in certificate["back"]:
        t = net.transition_index[name]
        if t not in problem.fires(marking):
            raise ProofError("%s cannot fire on the way back" % name)
        marking = net.fire(marking, t)
    if marking != net.initial_marking or problem.is_bad(marking):
        raise ProofError("the ways do not lead to the first marking, or it is bad")
    return "%d ways, %s" % (len(ways), how)

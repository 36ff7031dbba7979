"""Questions about the reachable markings of a net or a plan, as facts about the markings that they
ask for.

Both the search for a proof and its check ask here, so that a certificate is checked against the net
and the plan as they are. A net is asked about as GSPNs are played, with priorities. A plan is asked
about as in its check (``docs/semantics.md``): robots in decision places are busy while others move,
the policy decides, and robots may be lost.

Facts may hold in more markings than those that are asked for, where a condition cannot be written
as inequalities; ``Problem.is_bad`` is always exact.
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from functools import cached_property, lru_cache, partial
from operator import itemgetter
from typing import (
    Callable,
    Collection,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from gspn_framework_package.analysis.plan.edited_nets import counts_that_end, with_losses
from gspn_framework_package.analysis.plan.structure import may_be_named, terminal_places
from gspn_framework_package.analysis.proofs.checker import (
    FALSE,
    All,
    Atom,
    Formula,
    Problem,
    Some,
    fulfils,
    guard,
    opposite,
)
from gspn_framework_package.analysis.proofs.conditions import facts_of, formula_of
from gspn_framework_package.analysis.proofs.policy_rows import MOST_PROOF_ROWS, RowsOfPlaces
from gspn_framework_package.analysis.proofs.returning import (
    FiringsLeft,
    nearing,
    never_returns,
    settling,
)
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.condition import Condition, parse_condition
from gspn_framework_package.model.errors import LimitError, UsageError
from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.model.plan import Plan

DEAD, NEVER, ALWAYS, APART, FIRES, NO_ROW = "dead", "never", "always", "apart", "fires", "no_row"

AT_MOST, RETURNS, CAN_END, CAN_MOVE = "at_most", "returns", "ends", "moves"

FROM_EVERYWHERE = (RETURNS, CAN_END, CAN_MOVE)
"""Questions about what can be reached again from every marking. A marking that no firing leads
nearer to it is only a candidate."""

QUESTION_KINDS = (DEAD, NEVER, ALWAYS, APART, AT_MOST, FIRES, NO_ROW, *FROM_EVERYWHERE)

_STATEMENTS = {
    DEAD: "no dead marking can be reached",
    NO_ROW: "every marking that needs a decision has a row of the policy",
    NEVER: "never %s",
    ALWAYS: "always %s",
    APART: "never two tokens in %s",
    AT_MOST: "never more tokens than %s",
    FIRES: "%s never fires",
    RETURNS: "%s can be reached from every marking",
    CAN_MOVE: "every robot that is not at an end can move again, from every marking",
    CAN_END: "the end of the run, or of all robots, can be reached from every marking",
}


class MarkingQuestion(NamedTuple):
    """Whether a bad marking can be reached.

    :ivar kind: which markings are bad: ``dead`` ones, those with a condition that should hold
        ``never``, those without one that should ``always`` hold, those with two tokens in one of
        some places that should be ``apart``, or with more than these should have (``at_most``),
        those in which a transition ``fires``, those in which a robot needs a decision, and neither
        a row of the policy matches nor can only one transition fire (``no_row``), and those from
        which a condition cannot be reached (``returns``), or that all robots are in places where a
        plan ends (``ends``), or that a robot leaves its place (``moves``).
    :ivar about: the condition, the transition, a pattern (``At_*``) of the names of places, or a
        pattern and a number (``At_*=2``).
    :ivar losses: whether robots of a plan can be lost.
    """

    kind: str
    about: str = ""
    losses: bool = False

    @property
    def statement(self) -> str:
        """The statement that no bad marking can be reached, in words."""
        text = _STATEMENTS[self.kind]
        more = ", even if robots are lost" if self.losses else ""
        return (text % self.about if self.about else text) + more


def problem_of(
    subject: Union[Net, Plan], question: MarkingQuestion, watch: Optional[Watch] = None
) -> Problem:
    """The facts of a question.

    :param watch: may stop the examination of what follows a marking, which its ``is_bad`` needs.
    :raises UsageError: there is no such question about this subject.
    :raises GspnError: the condition cannot be read, or the transition does not exist.
    :raises LimitError: the policy is too large.
    """
    if question.kind not in QUESTION_KINDS:
        raise UsageError("there is no question '%s'" % question.kind)
    if question.kind == ALWAYS:
        question = question._replace(kind=NEVER, about="not (%s)" % question.about)
    watch = watch or Watch()
    if isinstance(subject, Plan):
        return _OfPlan(subject, question, watch).problem()
    if question.kind in (NO_ROW, CAN_END, CAN_MOVE) or question.losses:
        raise UsageError("a net has no policy, and no robots that end or can be lost")
    problem = _of_net(subject, question, watch)
    return problem._replace(step=watch.step, needs=partial(_first_in_line, subject))


def _of_net(net: Net, question: MarkingQuestion, watch: Watch) -> Problem:
    everything = tuple(range(len(net.transitions)))
    if question.kind == NEVER:
        condition = parse_condition(question.about, net.place_index)
        facts = facts_of(condition)
        return Problem(net, everything, facts, condition.holds, net.enabled)
    if question.kind in (APART, AT_MOST):
        facts = _too_many_in_one(net, question)
        return Problem(net, everything, facts, partial(fulfils, facts[0]), net.enabled)
    if question.kind == RETURNS:
        condition = parse_condition(question.about, net.place_index)
        facts = _never_back(condition, net)
        goal = opposite(facts[0]) if facts else None
        is_bad = never_returns(net, facts, condition.holds, net.enabled, watch, goal)
        return Problem(net, everything, facts, is_bad, net.enabled)
    if question.kind == FIRES:
        t = net.transition_number(question.about)
        facts = (*guard(net, t), *_first_in_line(net, t))
        return Problem(net, everything, facts, lambda m: t in net.enabled(m), net.enabled)
    facts = tuple(_disabled(net, t) for t in simplest_first(net, everything))
    return Problem(net, everything, facts, lambda m: not net.enabled(m), net.enabled)


def simplest_first(net: Net, transitions: Iterable[int]) -> List[int]:
    """Transitions, those of few conditions first: what they require simplifies those of others."""
    return sorted(transitions, key=lambda t: len(net.inputs[t]) + len(net.inhibitors[t]))


def _too_many_in_one(net: Net, question: MarkingQuestion) -> Tuple[Formula, ...]:
    """More tokens than there should be are in one of the places with such a name."""
    pattern, most = pattern_and_number(question)
    places = [p for p, place in enumerate(net.places) if fnmatchcase(place.name, pattern)]
    if not places:
        raise UsageError("no place has a name like '%s'" % pattern)
    return (Some(tuple(Atom(((p, 1),), most + 1) for p in places)),)


def pattern_and_number(question: MarkingQuestion) -> Tuple[str, int]:
    """The pattern of names in a question, and the most tokens of a place with such a name."""
    if question.kind == APART:
        return question.about, 1
    pattern, _, number = question.about.rpartition("=")
    if not (pattern and number.strip().isdecimal()):
        raise UsageError("'%s' is not a pattern and a number, such as 'At_*=2'" % question.about)
    return pattern.strip(), int(number)


def _never_back(condition: Condition, net: Net) -> Tuple[Formula, ...]:
    """The condition does not hold, and nothing that brings tokens nearer to it can fire; none if
    it cannot be written as inequalities."""
    try:
        goal = formula_of(condition)
    except LimitError:
        return ()
    steps = nearing(net, goal, range(len(net.places)), range(len(net.transitions)))
    nearer = set(steps)
    others = [u for u, o in enumerate(net.transitions) if not o.timed and u not in nearer]
    if len(steps) * len(others) > MOST_PROOF_ROWS:
        return ()

    def cannot_fire(t: int) -> Formula:
        before = (All(guard(net, u)) for u in _taking_precedence(net, t, others))
        return Some((_disabled(net, t), *before))

    return (opposite(goal), *map(cannot_fire, simplest_first(net, steps)))


def _taking_precedence(net: Net, t: int, others: Iterable[int]) -> List[int]:
    """Those of the others that fire before transition number ``t``."""
    mine, immediate = net.transitions[t], (u for u in others if not net.transitions[u].timed)
    return [u for u in immediate if mine.timed or net.transitions[u].priority > mine.priority]


def _first_in_line(net: Net, t: int) -> List[Formula]:
    """Nothing is enabled that fires before transition number ``t``."""
    return [_disabled(net, u) for u in _taking_precedence(net, t, range(len(net.transitions)))]


def _disabled(net: Net, t: int) -> Formula:
    return opposite(All(guard(net, t)))


# -- plans -----------------------------------------------------------------------------------------


class _OfPlan:
    """The facts of a question about a plan."""

    def __init__(self, plan: Plan, question: MarkingQuestion, watch: Watch) -> None:
        self._plan, self._question, self._watch = plan, question, watch
        named: Sequence[str] = ()
        if question.kind in (NEVER, RETURNS):
            named = parse_condition(question.about, plan.net.place_index).places
        if question.kind in (APART, AT_MOST):
            pattern, _ = pattern_and_number(question)
            named = [p for p in plan.counters if fnmatchcase(p, pattern)]
        left_out = [p for p in plan.counters if p not in named]
        net = plan.net.without_places(left_out)
        self._own = len(net.transitions)
        self._net = with_losses(net, plan, set(left_out)) if question.losses else net
        self._original = [plan.net.place_number(place.name) for place in self._net.places]
        own = {q: p for p, q in enumerate(self._original)}
        # the last count is 0; two numbers make a tuple
        self._of_all_places = itemgetter(*(own.get(q, -1) for q in range(len(plan.net.places))), -1)
        self._robots = {
            p for p, place in enumerate(self._net.places) if place.name not in plan.resource_places
        }
        # each transition is listed at the place where a token is rarest
        self._from: Dict[int, List[int]] = {p: [] for p in range(-1, len(self._net.places))}
        for t, inputs in enumerate(self._net.inputs):
            start, consumers = self._net.initial_marking, self._net.consumers
            rarest = min(inputs, key=lambda i: (start[i[0]], len(consumers[i[0]])), default=(-1,))
            self._from[rarest[0]].append(t)
        self._may_be_named: Dict[int, bool] = {}
        self._table = plan.policy.bind(plan.net)
        self._until: Optional[Condition] = None
        if plan.until:
            self._until = parse_condition(plan.until, self._net.place_index)
        ends = terminal_places(plan)
        self._exits = {
            p: frozenset(t for t in self._net.consumers[p] if t < self._own)
            for p in sorted(self._robots)
            if self._original[p] not in ends
        }
        self._rows = RowsOfPlaces(self._table, self._net, self._original)

    def problem(self) -> Problem:
        """The question as a problem."""
        kind, net = self._question.kind, self._net
        facts: Tuple[Formula, ...]
        is_bad: Callable[[Marking], bool]
        home = False
        if kind == NEVER:
            condition = parse_condition(self._question.about, net.place_index)
            facts, is_bad = facts_of(condition), condition.holds
        elif kind in (APART, AT_MOST):
            facts = _too_many_in_one(net, self._question)
            is_bad = partial(fulfils, facts[0])
        elif kind == CAN_MOVE:
            facts, is_bad = self._some_never_move()
            home = not self._question.losses and not any(
                net.is_enabled(net.initial_marking, t) for t in self._by_themselves()
            )
        elif kind in (RETURNS, CAN_END):
            facts, holds = self._never_back()
            goal = opposite(facts[0]) if facts else None
            is_bad = never_returns(net, facts, holds, self.fires, self._watch, goal)
            home = holds(net.initial_marking)
        else:
            how = {DEAD: self._dead, FIRES: self._fires, NO_ROW: self._gap}[kind]
            facts = (*self._not_over(), *(fact for fact in how() if not _is_true(fact)))
            is_bad = self._exactly(facts)
        surely = self._stuck if kind == CAN_MOVE and self._until is None else None
        home = home and self._until is None
        robots = tuple(p in self._robots for p in range(len(net.places))) if home else ()
        settles = settling(net, self._by_themselves()) if surely or robots else []
        needs = lru_cache(maxsize=None)(self._needs)
        more = surely, tuple(settles), self._chosen, robots, self._watch.step, needs
        return Problem(net, self._firing(), facts, is_bad, self.fires, *more)

    def _firing(self) -> Tuple[int, ...]:
        """The transitions that may ever fire."""
        return tuple(t for t in range(len(self._net.transitions)) if self._ever_fires(t))

    def _exactly(self, facts: Sequence[Formula]) -> Callable[[Marking], bool]:
        """Whether all facts hold in a marking of a run that is not over."""
        first = [0]  # the fact that failed last, which often fails in the next marking

        def is_bad(marking: Marking) -> bool:
            if facts and not fulfils(facts[first[0]], marking):
                return False
            for number, fact in enumerate(facts):
                if not fulfils(fact, marking):
                    first[0] = number
                    return False
            return not self._is_over(marking)

        return is_bad

    # -- the end of a run

    def _is_over(self, marking: Marking) -> bool:
        return self._until is not None and self._until.holds(marking)

    def _not_over(self) -> Tuple[Formula, ...]:
        if self._until is None:
            return ()
        try:
            return (opposite(formula_of(self._until)),)
        except LimitError:
            ends = counts_that_end(self._net, self._plan)
            return tuple(
                Atom(((self._net.place_number(name), -1),), 1 - count) for name, count in ends
            )

    # -- what fires

    def fires(self, marking: Marking) -> List[int]:
        """The transitions that may fire: those that the policy may choose, or that an action, a
        rule of failure, an event or the loss of a robot asks for."""
        if self._is_over(marking):
            return []
        full, net = self._with_all_places(marking), self._net
        return [
            t
            for p in (-1, *(p for p, count in enumerate(marking) if count))
            for t in self._from[p]
            if net.is_enabled(marking, t)
            and (not self._asking(t) or self._named(t) or self._chosen_in(full, t))
        ]

    def _chosen(self, marking: Marking, t: int) -> bool:
        """Whether a transition that is enabled is one of :meth:`fires`."""
        if self._is_over(marking):
            return False
        if not self._asking(t) or self._named(t):
            return True
        return self._chosen_in(self._with_all_places(marking), t)

    def _with_all_places(self, marking: Marking) -> Sequence[int]:
        """The marking of the plan's net, counters at 0."""
        return self._of_all_places((*marking, 0))

    def _asking(self, t: int) -> List[int]:
        """The places of the robots that ask the policy for ``t``; none for other transitions."""
        if t >= self._own or self._net.transitions[t].timed:
            return []
        return [p for p, _ in self._net.inputs[t] if p in self._robots]

    def _named(self, t: int) -> bool:
        if t not in self._may_be_named:
            asking = [self._original[p] for p in self._asking(t)]
            self._may_be_named[t] = may_be_named(self._plan, t, asking)
        return self._may_be_named[t]

    def _chosen_in(self, full: Sequence[int], t: int) -> bool:
        for p in self._asking(t):
            found = self._table.distribution(full, self._original[p])
            if found is not None:
                if any(chosen == t for chosen, _ in found.choices):
                    return True
            elif self._weights_decide(t) and not self._table.matches(full, self._original[p]):
                return True
        return False

    def _weights_decide(self, t: int) -> bool:
        return not self._plan.strict and not self._net.transitions[t].is_controllable

    def _ever_fires(self, t: int) -> bool:
        """False: nobody ever asks for ``t``."""
        asking = self._asking(t)
        if not asking or self._weights_decide(t) or self._named(t):
            return True
        return any(t in chosen for p in asking for _, chosen in self._rows.of(p))

    def _by_themselves(self) -> List[int]:
        """The transitions of the plan that no robot asks the policy for: they fire whenever they
        are enabled."""
        return [t for t in range(self._own) if not self._asking(t)]

    # -- the questions

    def _dead(self) -> Iterator[Formula]:
        yield self._some_are_busy()
        yield from self._nothing_fires(range(self._own))

    def _some_are_busy(self) -> Atom:
        """A robot is in a place where the plan does not end."""
        ends = {self._plan.net.places[p].name for p in terminal_places(self._plan)}
        busy = sorted(p for p in self._robots if self._net.places[p].name not in ends)
        return Atom(tuple((p, 1) for p in busy), 1)

    def _some_never_move(self) -> Tuple[Tuple[Formula, ...], Callable[[Marking], bool]]:
        """Facts that a robot cannot leave now, and a test whether one can never leave again."""
        over = self._not_over()
        is_over: Optional[Formula] = FALSE
        if self._until is not None:
            try:
                is_over = formula_of(self._until)
            except LimitError:
                is_over = None
        ended: List[Formula] = []
        if self._until is None:  # what is going on can end first, unless the run ends before
            steps = settling(self._net, self._by_themselves())
            ended += [_disabled(self._net, t) for t in steps]
        stuck: List[Formula] = []
        tests: Dict[int, Callable[[Marking], bool]] = {}
        for p, exits in self._exits.items():
            facts: List[Formula] = [Atom(((p, 1),), 1)]
            facts += [_disabled(self._net, t) for t in sorted(exits) if not self._asking(t)]
            facts += self._policy_moves_nobody(p, exits)
            facts[1:] = [_without(fact, opposite(facts[0])) for fact in facts[1:]]
            stuck.append(All(tuple(facts)))
            goal = None
            if is_over is not None:
                goal = Some((is_over, *(opposite(fact) for fact in facts[1:])))
            tests[p] = never_returns(
                self._net,
                facts,
                partial(self._some_fire, exits),
                self.fires,
                self._watch,
                goal,
                partial(self._stuck_in, p) if self._until is None else None,
            )

        def is_bad(marking: Marking) -> bool:
            return all(fulfils(fact, marking) for fact in (*over, *ended)) and any(
                marking[p] and test(marking) for p, test in tests.items()
            )

        return (*over, *ended, Some(tuple(stuck))), is_bad

    def _stuck(self, marking: Marking) -> bool:
        """Whether it is certain that some robot can never leave its place."""
        left = self._firings_left.of(marking)
        return any(marking[p] and left.isdisjoint(exits) for p, exits in self._exits.items())

    def _stuck_in(self, p: int, marking: Marking) -> bool:
        """Whether it is certain that robots in place number ``p`` can never leave it."""
        return self._firings_left.of(marking).isdisjoint(self._exits[p])

    @cached_property
    def _firings_left(self) -> FiringsLeft:
        return FiringsLeft(self._net, self._firing(), self._ways)

    def _ways(self, t: int) -> Optional[List[Tuple[int, int]]]:
        """When the policy may choose a transition: the places that have to be empty, and those that
        have to be marked; None if it may always fire."""
        asking = self._asking(t)
        if not asking or self._named(t):
            return None
        if self._weights_decide(t) and not all(_is_true(self._rows.any_matches(p)) for p in asking):
            return None
        return [
            self._rows.bits(number)
            for p in asking
            for number, chosen in self._rows.of(p)
            if t in chosen
        ]

    def _some_fire(self, transitions: Collection[int], marking: Marking) -> bool:
        """Some of the transitions can fire, or the run is over."""
        return self._is_over(marking) or any(t in transitions for t in self.fires(marking))

    def _nothing_fires(self, transitions: Collection[int]) -> Iterator[Formula]:
        """None of the transitions can fire, also not by the policy's choice."""
        for t in simplest_first(self._net, transitions):
            if not self._asking(t):
                yield _disabled(self._net, t)
        for p in sorted(self._robots):
            yield from self._policy_moves_nobody(p, transitions)

    def _never_back(self) -> Tuple[Tuple[Formula, ...], Callable[[Marking], bool]]:
        """The facts where nothing brings robots nearer to the goal, and whether it is reached; no
        facts if they cannot be written as inequalities."""
        until = self._until
        if self._question.kind == RETURNS:
            condition = parse_condition(self._question.about, self._net.place_index)
            holds: Callable[[Marking], bool] = condition.holds
        else:
            if until is None and not terminal_places(self._plan):
                raise UsageError("the plan has no end: no place without outputs, and no 'until'")
            ended = opposite(self._some_are_busy())
            holds = partial(self._has_ended, ended)
        try:
            over = FALSE if until is None else formula_of(until)
            goal = formula_of(condition) if self._question.kind == RETURNS else Some((ended, over))
            fired = [t for t in range(self._own) if self._ever_fires(t)]
            alone = self._by_themselves()
            steps = frozenset(nearing(self._net, goal, self._robots, fired, alone))
            stays = tuple(fact for fact in self._nothing_fires(steps) if not _is_true(fact))
        except LimitError:
            return (), holds
        if until is not None:  # nothing fires when a run is over
            stays = (Some((over, All(stays))),)
        return (opposite(goal), *stays), holds

    def _has_ended(self, ended: Formula, marking: Marking) -> bool:
        return fulfils(ended, marking) or self._is_over(marking)

    def _policy_moves_nobody(self, p: int, transitions: Collection[int]) -> Iterator[Formula]:
        """The policy lets no robot in place number ``p`` choose one that is enabled."""
        for _, cells, chosen, before in self._rows.by_precedence(p):
            fails = [*map(opposite, cells), *before]
            for t in chosen:
                if t in transitions:
                    yield Some((*fails, _disabled(self._net, t)))
        if self._plan.strict:
            return
        weighty = [t for t in self._leaving(p) if self._weights_decide(t) and t in transitions]
        if weighty:
            nothing = All(tuple(_disabled(self._net, t) for t in weighty))
            yield Some((nothing, self._rows.any_matches(p)))

    def _fires(self) -> Iterator[Formula]:
        t = self._plan.net.transition_number(self._question.about)
        yield from (*guard(self._net, t), *self._chosen_where(t))

    def _needs(self, t: int) -> Tuple[Formula, ...]:
        return (*self._not_over(), *self._chosen_where(t))

    def _chosen_where(self, t: int) -> Iterator[Formula]:
        """The policy may choose transition number ``t``."""
        if not self._asking(t) or self._named(t):
            return
        ways: List[Formula] = []
        for p in self._asking(t):
            for _, cells, chosen, before in self._rows.by_precedence(p):
                if t in chosen:
                    ways.append(All((*cells, *map(opposite, before))))
            if self._weights_decide(t):
                ways.append(opposite(self._rows.any_matches(p)))
        yield Some(tuple(ways))

    def _gap(self) -> Iterator[Formula]:
        """Some robot needs a decision, and no row of its scope matches."""
        asked: Dict[int, List[Formula]] = {}
        for p in sorted(self._robots):
            asked.setdefault(self._rows.scope(p), []).append(self._needs_decision(p))
        if len(asked) == 1:
            ((scope, places),) = asked.items()
            yield Some(tuple(places))
            yield from (opposite(self._rows.match(n)) for n in self._table.in_scope(scope))
            return
        silent = {scope: opposite(self._rows.matches(scope)) for scope in asked}
        yield Some(tuple(All((Some(tuple(ps)), silent[scope])) for scope, ps in asked.items()))

    def _needs_decision(self, p: int) -> Formula:
        """A row is needed for a robot in place number ``p``: in a strict plan, wherever one of its
        immediate transitions is enabled; in others, where two are, or only ones that no weight
        decides."""
        net = self._net
        leaving = self._leaving(p)
        enabled = [All(guard(net, t)) for t in leaving]
        if self._plan.strict:
            return Some(tuple(enabled))
        none_by_weight = [_disabled(net, t) for t in leaving if self._weights_decide(t)]
        ways: List[Formula] = [
            All((able, *none_by_weight))
            for t, able in zip(leaving, enabled)
            if not self._weights_decide(t)
        ]
        if self._table.rows_of(self._original[p]):  # a subnet cannot have its own policy
            ways += [All((e, Some(tuple(enabled[i + 1 :])))) for i, e in enumerate(enabled[:-1])]
        return Some(tuple(ways))

    def _leaving(self, p: int) -> List[int]:
        return [
            t
            for t in self._net.consumers[p]
            if t < self._own and not self._net.transitions[t].timed
        ]


def _without(formula: Formula, excluded: Formula) -> Formula:
    """A formula, for where ``excluded`` does not hold."""
    if isinstance(formula, Atom):
        return FALSE if formula == excluded else formula
    parts = tuple(_without(part, excluded) for part in formula.parts)
    return Some(parts) if isinstance(formula, Some) else All(parts)


def _is_true(formula: Formula) -> bool:
    """Whether a formula is always true. (Tuples of different kinds compare equal by item.)"""
    if isinstance(formula, Some):
        return any(map(_is_true, formula.parts))
    return isinstance(formula, All) and not formula.parts

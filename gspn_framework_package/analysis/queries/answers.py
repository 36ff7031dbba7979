"""Answers temporal queries about a net or a plan, with an interval for each number.

A formula ``EF c``, ``AG c`` or, of a net, ``AG EF c`` is first given to the ladder of proofs, which
can decide it however many markings there are. Otherwise the states are explored, and a formula that
those left unexplored could change is not decided. Probabilities come from the Markov chain. Their
interval also takes into account what :mod:`~gspn_framework_package.analysis.intervals` says of a
plan.

>>> from gspn_framework_package.model.builder import NetBuilder
>>> net = (NetBuilder("machine").place("up", tokens=1).place("down")
...        .exponential("fail", rate=1.0, inputs="up", outputs="down")
...        .exponential("repair", rate=3.0, inputs="down", outputs="up").build())
>>> found = answer_query(Analysis(net), "P=? [ F<=2 down = 1 ]")
>>> round(found.value, 9), found.interval[1] - found.interval[0] < 1e-9
(0.864664717, True)
>>> answer_query(Analysis(net), "AG EF up = 1").holds
True
"""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

import numpy as np

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.intervals import half_widths
from gspn_framework_package.analysis.proofs import questions
from gspn_framework_package.analysis.proofs.answers import decided
from gspn_framework_package.analysis.proofs.ladder import FEW_MARKINGS, PROVEN, VIOLATED
from gspn_framework_package.analysis.proofs.questions import MarkingQuestion
from gspn_framework_package.analysis.queries.grammar import (
    Branching,
    PathFormula,
    Quantity,
    StateFormula,
    parse_query,
)
from gspn_framework_package.analysis.queries.states import Known, StateSets, known_where
from gspn_framework_package.analysis.solution.passage import Passing
from gspn_framework_package.analysis.solution.transient import transient, truncation_and_rounding
from gspn_framework_package.analysis.state_space.space import StateSpace
from gspn_framework_package.analysis.symmetry.lumped_space import LumpedSpace
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.condition import Label
from gspn_framework_package.model.errors import LimitError, RefusedError, UsageError


class QueryAnswer(NamedTuple):
    """The answer to a query.

    :ivar query: as written.
    :ivar value: the probability or share of time, if one was asked for.
    :ivar interval: its bounds: the value, minus and plus the error of its computation, and the
        error from what ``interval_sources`` says, in words for people.
    :ivar holds: the answer to a query with yes or no; None if it is not decided.
    :ivar decided_by: what decided it: ``exploration``, a step of the ladder of proofs, or
        ``Markov chain``.
    :ivar sequence: firings that lead to a marking which decides a query ``EF`` or ``AG``.
    :ivar marking: that marking, without empty places.
    :ivar undecided: why it is not decided; "" if it is.
    :ivar left_out: what the interval does not take into account: a sentence; "" if nothing.
    """

    query: str
    value: Optional[float] = None
    interval: Optional[Tuple[float, float]] = None
    holds: Optional[bool] = None
    decided_by: str = ""
    sequence: Optional[Sequence[str]] = None
    marking: Optional[Dict[str, int]] = None
    undecided: str = ""
    interval_sources: Sequence[str] = ()
    left_out: str = ""

    def to_json(self) -> Dict[str, Any]:
        """As plain JSON values."""
        data = self._asdict()
        for key in ("interval", "sequence", "interval_sources"):
            data[key] = None if data[key] is None else list(data[key])
        return data


def answer_query(analysis: Analysis, text: str) -> QueryAnswer:
    """Answer a query about the subject of an analysis.

    :raises ExpressionError: it cannot be read, an operator is not supported, or a place is unknown.
    :raises UsageError: the analysis exchanges equal parts, which a query may distinguish.
    :raises CancelledError: the work was cancelled.
    """
    query = parse_query(text, [place.name for place in analysis.net.places])
    work = _Work(analysis, text)
    try:
        if isinstance(query, StateFormula):
            return work.formula(query)
        return work.quantity(query)
    except (LimitError, RefusedError) as error:
        return QueryAnswer(text, undecided=str(error))


class _Work:
    def __init__(self, analysis: Analysis, text: str) -> None:
        self._analysis, self._text = analysis, text

    # -- numbers

    def quantity(self, query: Quantity) -> QueryAnswer:
        """Answer a query with P or S."""
        value, error, passing = self._valued(query.asked)
        spread = half_widths(
            self._analysis,
            {"": {"probability": value}},
            lambda other: {"": {"probability": _Work(other, self._text)._valued(query.asked)[0]}},
        )
        error += spread.widths[""]["probability"]
        low, high = max(value - error, 0.0), min(value + error, 1.0)
        if passing is not None and passing.possible:
            low = max(low, float(np.nextafter(0.0, 1.0)))
        if passing is not None and passing.lost:
            high = min(high, float(np.nextafter(1.0, 0.0)))
        if isinstance(query.asked, PathFormula) and query.asked.operator == "G":
            value, low, high = 1.0 - value, 1.0 - high, 1.0 - low
        answer = QueryAnswer(
            self._text,
            value=min(max(value, 0.0), 1.0),
            interval=(low, high),
            decided_by="Markov chain",
            interval_sources=spread.sources,
            left_out=spread.left_out,
        )
        if query.bound is None:
            return answer
        holds = _compared(query.bound, low, high)
        why = "" if holds is not None else "the interval contains the bound"
        return answer._replace(holds=holds, undecided=why)

    def _valued(
        self, asked: Union[PathFormula, StateFormula]
    ) -> Tuple[float, float, Optional[Passing]]:
        """The probability of a path (of "G", that it ends), or a share of time, with its error,
        and the path there if time is unlimited."""
        if isinstance(asked, StateFormula):
            return (*self._long_run(asked), None)
        return self._probability(asked)

    def _probability(self, path: PathFormula) -> Tuple[float, float, Optional[Passing]]:
        space = self._space(path)
        graph = self._analysis.rated(space)
        sets = StateSets(space)
        goal, avoid = sets.holding(path.goal).must, None
        if path.operator == "G":
            goal = ~goal
        if path.stay is not None:
            avoid = ~goal & ~sets.holding(path.stay).must
        passing = Passing(graph, goal, avoid)
        if path.within is None:
            watch = Watch(**self._analysis.while_working)
            return (*passing.bounded_probability(watch), passing)
        (at,) = transient(passing.chain, [path.within], **self._analysis.while_working)
        value = float(at.distribution[passing.there].sum())
        return value, truncation_and_rounding(passing.chain, path.within), None

    def _long_run(self, formula: StateFormula) -> Tuple[float, float]:
        """The long-run share of time in which a formula holds, and its error."""
        self._refuse_counters(self._places([formula]))
        steady = self._analysis.steady
        holds = StateSets(self._whole()).holding(formula).must[steady.chain.states]
        value = float(steady.distribution[holds].sum())
        return value, min(float(steady.errors[part].sum()) for part in (holds, ~holds))

    # -- yes or no

    def formula(self, formula: StateFormula) -> QueryAnswer:
        """Answer a query that holds at the start, or does not."""
        net = self._analysis.net
        answers = {name: self._branching(part) for name, part in formula.parts.items()}
        labels = {name: _known(answer.holds) for name, answer in answers.items()}
        condition = formula.on(net.place_index)
        if "deadlock" in condition.labels:
            dead = self._analysis.space.is_dead[:1]
            labels["deadlock"] = Known(dead, dead)
        start = [np.array([count]) for count in net.initial_marking]
        found = known_where(condition, start, 1, labels)
        if found.must[0] != found.may[0]:
            return next(a for a in answers.values() if a.holds is None)._replace(query=self._text)
        ways = ", ".join(dict.fromkeys(answer.decided_by for answer in answers.values()))
        answer = QueryAnswer(self._text, decided_by=ways)
        if len(answers) == 1:
            (answer,) = answers.values()
        return answer._replace(query=self._text, holds=bool(found.must[0]))

    def _branching(self, formula: Branching) -> QueryAnswer:
        """Whether a formula with E or A holds at the start."""
        proven = self._by_proof(formula)
        if proven.holds is not None:
            return proven
        space = self._space(formula.path)
        sets = StateSets(space)
        found = sets.branching(formula)
        if found.must[0] != found.may[0]:
            why = ["not decided within %s (%s)" % (space.extent, space.hint)]
            why += filter(None, [proven.undecided])
            return QueryAnswer(self._text, undecided="; ".join(why))
        answer = QueryAnswer(self._text, holds=bool(found.must[0]), decided_by="exploration")
        if formula.path.operator == ("G" if formula.every else "F") and (
            answer.holds != formula.every
        ):
            goal = sets.holding(formula.path.goal)
            state = int(np.flatnonzero((goal.opposite() if formula.every else goal).must)[0])
            return answer._replace(sequence=space.path_to(state), marking=space.named(state))
        return answer

    def _by_proof(self, formula: Branching) -> QueryAnswer:
        """``EF`` or ``AG`` by the ladder of proofs, which needs no markings; what is reached is
        taken from it only for a net, since the robots of its plans take their time."""
        question = self._question(formula)
        undecided = QueryAnswer(self._text)
        if question is None:
            return undecided
        plan = self._analysis.plan
        found = decided(self._analysis, question, FEW_MARKINGS)
        if found.verdict == PROVEN:
            return undecided._replace(holds=formula.every, decided_by=found.decided_by)
        if found.verdict == VIOLATED and plan is None:
            return undecided._replace(
                holds=not formula.every,
                decided_by=found.decided_by,
                sequence=found.sequence,
                marking=found.marking,
            )
        if found.verdict == VIOLATED:
            way = ", ".join(found.sequence or ())
            why = "robots that take time to decide reach it by %s" % way
            return undecided._replace(undecided=why)
        return undecided

    def _question(self, formula: Branching) -> Optional[MarkingQuestion]:
        """A formula as a question about all markings, if it is one."""
        goal, every = formula.path.goal, formula.every
        if formula.path.operator != ("G" if every else "F"):
            return None
        if goal.parts:
            return self._return(goal) if every and self._analysis.plan is None else None
        condition = goal.on(self._analysis.net.place_index)
        if not condition.labels:
            return MarkingQuestion(questions.ALWAYS if every else questions.NEVER, goal.text)
        dead = (("label", "deadlock"),) + ((("not", 1),) if every else ())
        if self._analysis.plan is None and condition.program == dead:
            return MarkingQuestion(questions.DEAD)
        return None

    def _return(self, formula: StateFormula) -> Optional[MarkingQuestion]:
        """``EF c`` everywhere as a question about all markings of a net, if c is a condition."""
        inner = next(iter(formula.parts.values()))
        goal = inner.path.goal
        simple = isinstance(formula.tree, Label) and not inner.every and inner.path.operator == "F"
        if not simple or goal.parts or self._condition(goal).labels:
            return None
        return MarkingQuestion(questions.RETURNS, goal.text)

    # -- states

    def _whole(self) -> StateSpace:
        space = self._analysis.space
        if isinstance(space, LumpedSpace):
            raise UsageError("queries may distinguish equal parts, which the analysis exchanges")
        return space

    def _space(self, path: PathFormula) -> StateSpace:
        """The states for a question about paths."""
        whole = self._whole()
        nested = any(formula.parts for formula in path.formulas)
        labels = any(self._condition(formula).labels for formula in path.formulas)
        if nested or labels:
            self._refuse_counters(self._places(path.formulas))
            return whole
        return self._analysis.until(path.over)

    def _condition(self, formula: StateFormula) -> Any:
        return formula.on(self._analysis.net.place_index)

    def _places(self, formulas: Sequence[StateFormula]) -> Set[str]:
        return {name for each in _with_parts(formulas) for name in self._condition(each).places}

    def _refuse_counters(self, places: Set[str]) -> None:
        for place in self._analysis.left_out:
            if place in places:
                raise LimitError(
                    "not decided: %s can grow without bound" % place,
                    hint="ask about it in one F, G or U, without another operator inside",
                )


def _with_parts(formulas: Sequence[StateFormula]) -> Iterator[StateFormula]:
    """The formulas, and all that occur in them."""
    waiting: List[StateFormula] = list(formulas)
    while waiting:
        formula = waiting.pop()
        yield formula
        for part in formula.parts.values():
            waiting += part.path.formulas


def _known(holds: Optional[bool]) -> Known:
    return Known(np.array([holds is True]), np.array([holds is not False]))


def _compared(bound: Tuple[str, float], low: float, high: float) -> Optional[bool]:
    """Whether a number between ``low`` and ``high`` is on the right side of a bound."""
    operator, number = bound
    if operator in ("<", "<="):
        found = _compared((">=" if operator == "<" else ">", number), low, high)
        return None if found is None else not found
    if low > number or (operator == ">=" and low == number):
        return True
    if high < number or (operator == ">" and high == number):
        return False
    return None

"""Decides a question about all reachable markings of a net or a plan: the steps of a ladder, within
one budget of time.

Of a net with many places, short random walks come first, unless there may be ways home, and longer
ones after the guided search's first second: teams get stuck in them as in a run.

1. *Structure*: invariants and bounds of places, by which the facts of the question exclude each
   other.
2. *State equation*: linear programs, and marked traps, exclude what is left, case by case.
3. *Ways home*, where the question is whether the robots of a plan can get back to their first
   places, or move again: one after another, while the others rest.
4. *Exploration* of few markings, which finds the shortest firings that lead to a bad one.
5. *Guided search* for such firings, from a solution of the state equation, first for a second.
6. *Inductive invariants*: inequalities that z3 finds, if it is there, and that every firing keeps,
   one because of the others. Then the guided search has time.
7. *Exploration* of as many markings as the limit and the time allow.

The first step that decides ends it. What is *proven* has a certificate that
:mod:`~gspn_framework_package.analysis.proofs.checker` has accepted, or the number of all markings.
What is *violated* has firings that were played. Everything else is *not decided*.
"""

from __future__ import annotations

import math
import time
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np

from gspn_framework_package.analysis.arrays import Indices
from gspn_framework_package.analysis.plan.markings import PlanMarkings
from gspn_framework_package.analysis.proofs.checker import (
    All,
    Atom,
    Formula,
    Problem,
    ProofError,
    check_certificate,
)
from gspn_framework_package.analysis.proofs.homing import Homing
from gspn_framework_package.analysis.proofs.inductive import search_inductive
from gspn_framework_package.analysis.proofs.prover import Candidate, Prover
from gspn_framework_package.analysis.proofs.questions import (
    FROM_EVERYWHERE,
    MarkingQuestion,
    problem_of,
)
from gspn_framework_package.analysis.proofs.witness import (
    GuidedSearch,
    played_to,
    shortened,
    walk_until_stuck,
)
from gspn_framework_package.analysis.state_space.space import StateSpace, explore
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

SECONDS = 10.0
"""Default budget of a question (s)."""

QUESTION_MARKINGS = 200_000
"""Default limit on the markings that a question visits."""

FEW_MARKINGS = 2_000
"""Number of markings that are visited before the guided search."""

PLACES_EXPLORED = 150
"""Number of places up to which exploration finds what random walks would."""

FIRST_FIRINGS = 400
"""Number of firings of random walks before the state equation, for few robots."""

FIRINGS_OF_EACH = 20
"""Number of these firings for each robot, where that is more."""

FIRST_SHARE = 0.2
"""Maximum share of the time for them, where each of their markings may take long to examine."""

SHORTENING = 1.0
"""Maximum time (s) to shorten a path."""

PROVING = 0.6
"""Share of the remaining time for the state equation."""

SOON = 1.0
"""Maximum time (s) for the guided search before z3."""

Z3_SHARE = 0.3
"""The part of the remaining time for z3, which decides soon or not at all."""

PROVEN, VIOLATED, NOT_DECIDED = "proven", "violated", "not decided"


class LadderStep(NamedTuple):
    """The result of a step of the ladder: its ``name``, the ``outcome`` in words, and the time
    that it took (s)."""

    name: str
    outcome: str
    seconds: float


class Answer(NamedTuple):
    """The answer to a question.

    :ivar verdict: PROVEN (no bad marking can be reached), VIOLATED or NOT_DECIDED.
    :ivar steps: the steps that were taken; the last one decided, if any did.
    :ivar certificate: the proof, as plain JSON values.
    :ivar sequence: the firings that lead to a bad marking.
    :ivar marking: that marking, without empty places.
    """

    question: MarkingQuestion
    verdict: str
    steps: Tuple[LadderStep, ...]
    certificate: Optional[Dict[str, Any]] = None
    sequence: Optional[Tuple[str, ...]] = None
    marking: Optional[Dict[str, int]] = None

    @property
    def decided_by(self) -> str:
        """The step that decided; "" if none did."""
        return "" if self.verdict == NOT_DECIDED else self.steps[-1].name

    def to_json(self) -> Dict[str, Any]:
        """As plain JSON values."""
        data = {
            **self.question._asdict(),
            "verdict": self.verdict,
            "decided_by": self.decided_by,
            "steps": [step._asdict() for step in self.steps],
        }
        if self.sequence is not None:
            data.update(sequence=list(self.sequence), marking=self.marking)
        return data


def decide_question(
    subject: Union[Net, Plan],
    question: MarkingQuestion,
    *,
    seconds: float = SECONDS,
    limit: int = QUESTION_MARKINGS,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Answer:
    """Decide a question within a budget.

    :param seconds: the budget of all steps together (s).
    :param limit: the most markings to visit; 0 for no exploration.
    :param progress: receives what is being counted, which shows the step in progress.
    :param cancel: called at intervals; returns whether to stop.
    :raises CancelledError: ``cancel`` returned true.
    :raises GspnError: see :func:`~gspn_framework_package.analysis.proofs.questions.problem_of`.
    """
    watch = Watch(progress, cancel, seconds=seconds)
    try:
        problem = problem_of(subject, question, watch)
    except LimitError as error:
        return Answer(question, NOT_DECIDED, (LadderStep("structure", error.message, 0.0),))
    return _Ladder(subject, question, problem, watch, limit, progress, cancel).climb()


def decide_for_team(
    subject: Union[Net, Plan],
    question: MarkingQuestion,
    *,
    losses: bool,
    seconds: float = SECONDS,
    **more: Any,
) -> List[Answer]:
    """Decide a question for the whole team and, if that proves it, with losses of robots where
    these are possible: one answer if it is the same for both, else that for the whole team first.

    :param losses: whether robots can be lost.
    :param seconds: the budget of both together (s).
    :param more: see :func:`decide_question`.
    """
    end = time.monotonic() + seconds
    whole = decide_question(subject, question, seconds=seconds, **more)
    if not losses or whole.verdict != PROVEN:
        return [whole]
    question = question._replace(losses=True)
    left = max(end - time.monotonic(), 0.0)
    with_losses = decide_question(subject, question, seconds=left, **more)
    return [with_losses] if with_losses.verdict == PROVEN else [whole, with_losses]


class _Ladder:
    def __init__(
        self,
        subject: Union[Net, Plan],
        question: MarkingQuestion,
        problem: Problem,
        watch: Watch,
        limit: int,
        progress: Optional[Progress],
        cancel: Optional[Cancel],
    ) -> None:
        self._subject, self._question, self._problem = subject, question, problem
        self._limit, self._progress, self._cancel = limit, progress, cancel
        self._watch = watch
        self._steps: List[LadderStep] = []
        self._prover: Optional[Prover] = None
        self._begun = time.monotonic()

    def climb(self) -> Answer:
        """Take the steps until one decides."""
        try:
            if self._problem.is_bad(self._problem.net.initial_marking):
                return self._violated("exploration", ())
        except LimitError:
            pass  # there are too many markings to visit, but a proof may still be found
        large = len(self._problem.net.places) > PLACES_EXPLORED
        # an examination of all that follows each marking may not get far
        quick = self._problem.surely is not None
        first = 1.0 if quick else FIRST_SHARE
        # otherwise, what follows each marking is examined, but not yet
        if large and (quick or not self._problem.robots):
            answer = self._wander(first, self._first_firings())
            if answer is not None:
                return answer
        found = self._prove()
        if isinstance(found, Answer):
            return found
        if self._problem.robots:
            answer = self._go_home()
            if answer is not None:
                return answer
        few = min(self._limit, FEW_MARKINGS)
        answer = self._explore(few) if few else None
        search = None if found is None else GuidedSearch(self._problem, found)
        if answer is None and search is not None:
            answer = self._search(search, SOON)
        if answer is None and large:
            answer = self._wander(0.5)
        if answer is None and self._problem.facts:
            answer = self._induce()
        if answer is None and search is not None:
            answer = self._search(search)
        if answer is None and few < self._limit:
            answer = self._explore(self._limit)
        return answer or Answer(self._question, NOT_DECIDED, tuple(self._steps))

    def _first_firings(self) -> int:
        robots = len(self._subject.robots) if isinstance(self._subject, Plan) else 0
        return max(FIRST_FIRINGS, FIRINGS_OF_EACH * robots)

    def _step(self, name: str, outcome: str) -> None:
        now = time.monotonic()
        self._steps.append(LadderStep(name, outcome, round(now - self._begun, 3)))
        self._begun = now

    def _prove(self) -> Union[Answer, Candidate, None]:
        if not self._problem.facts:
            self._step("structure", "the condition is not linear")
            return None
        watch = self._watch.part(PROVING)
        try:
            self._prover = prover = Prover(self._problem, watch)
            found = prover.prove()
        except LimitError as error:
            self._step(_name_of(self._prover), error.message)
            return None
        if isinstance(found, Candidate):
            self._step(_name_of(prover), "it allows a marking that no trap excludes")
            return found
        more = ", %d cases, %d linear programs" % (prover.cases, prover.programs)
        return self._accepted(_name_of(prover), found, more)

    def _go_home(self) -> Optional[Answer]:
        try:
            watch = self._watch.part(PROVING)
            found = Homing(self._problem, watch, self._prover).certificate()
        except LimitError as error:
            self._step("ways home", error.message)
            return None
        return self._accepted("ways home", found)

    def _induce(self) -> Optional[Answer]:
        name = "inductive invariants"
        try:
            watch = self._watch.part(Z3_SHARE)
            found = search_inductive(self._problem, watch, self._prover)
            if isinstance(found, dict):
                return self._accepted(name, found)
            played_to(self._problem, found)
        except (LimitError, ProofError) as error:  # facts may hold where nothing is bad
            self._step(name, error.message)
            return None
        return self._found(name, found)

    def _accepted(self, name: str, found: Dict[str, Any], more: str = "") -> Optional[Answer]:
        """The answer with a proof, if the checker accepts it."""
        try:
            how = check_certificate(self._problem, found)
        except ProofError as error:  # not expected
            self._step(name, "its proof was not accepted: %s" % error)
            return None
        except LimitError as error:
            self._step(name, error.message)
            return None
        self._step(name, how + more)
        return Answer(self._question, PROVEN, tuple(self._steps), certificate=found)

    def _wander(self, part: float, firings: float = math.inf) -> Optional[Answer]:
        """Look for a bad marking by random walks, for a part of the time that is left."""
        sequence = walk_until_stuck(self._problem, self._watch.part(part), firings)
        return None if sequence is None else self._found("random walks", sequence)

    def _found(self, name: str, sequence: List[str]) -> Answer:
        """The answer with firings, perhaps more than are needed."""
        watch = self._watch.part(1.0, SHORTENING)
        return self._violated(name, shortened(self._problem, sequence, watch))

    def _violated(self, name: str, sequence: Sequence[str], more: str = "") -> Answer:
        marking = played_to(self._problem, sequence)
        self._step(name, "%d firings that were played%s" % (len(sequence), more))
        return Answer(
            self._question,
            VIOLATED,
            tuple(self._steps),
            sequence=tuple(sequence),
            marking=self._problem.net.named(marking, zeros=False),
        )

    def _search(self, search: GuidedSearch, most: float = math.inf) -> Optional[Answer]:
        # the candidate of such a question may not be bad: leave time to explore
        share = 0.5 if self._question.kind in FROM_EVERYWHERE else 1.0
        watch = self._watch.part(share, most)
        sequence = search.go_on(watch)
        if sequence is not None:
            return self._found("guided search", sequence)
        self._step("guided search", "no way to it was found")
        return None

    def _explore(self, limit: int) -> Optional[Answer]:
        seconds = self._watch.left
        if seconds <= 0:
            self._step("exploration", "no time was left")
            return None
        try:
            space, markings = self._visited(limit, seconds)
            bad = np.arange(len(space)) if markings is None else markings.nearest_first()
            bad = self._where(All(self._problem.facts), space, bad)
            for number, state in enumerate(bad.tolist()):
                self._watch.step("markings that may be bad", number)
                if self._problem.is_bad(space.marking(state)):
                    way = space.path_to(state) if markings is None else markings.way_to(state)
                    none = markings is None or space.complete
                    # a shorter way may lead through markings that were not visited
                    none = none or len(way) <= len(space.path_to(space.explored)) + 1
                    return self._violated("exploration", way, ", none are fewer" * none)
        except LimitError as error:
            self._step("exploration", error.message)
            return None
        number = len(space) if markings is None else int(markings.reached.sum())
        if not space.complete:
            self._step("exploration", "not within %s markings" % format(len(space), ","))
            return None
        self._step("exploration", "all of %s markings" % format(number, ","))
        return Answer(self._question, PROVEN, tuple(self._steps), certificate={"markings": number})

    def _visited(self, limit: int, seconds: float) -> Tuple[StateSpace, Optional[PlanMarkings]]:
        if isinstance(self._subject, Net):
            space = explore(
                self._subject,
                limit=limit,
                seconds=seconds,
                progress=self._progress,
                cancel=self._cancel,
            )
            return space, None
        markings = PlanMarkings(
            self._subject,
            limit,
            losses=self._question.losses,
            progress=self._progress,
            cancel=self._cancel,
            seconds=seconds,
            keep=[place.name for place in self._problem.net.places],
        )
        return markings.space, markings

    def _where(self, formula: Formula, space: StateSpace, states: Indices) -> Indices:
        """Those of the states in which a formula holds."""
        self._watch.step("markings that may be bad", len(states))
        if not len(states):
            return states
        if isinstance(formula, Atom):
            total = np.zeros(len(states), dtype=np.int64)
            for p, weight in formula.terms:
                total += weight * space.column(p, states)
            return states[total >= formula.least]
        if isinstance(formula, All):
            for part in formula.parts:
                states = self._where(part, space, states)
            return states
        fails = np.zeros(len(space), dtype=bool)
        fails[states] = True
        for part in formula.parts:
            fails[self._where(part, space, np.flatnonzero(fails))] = False
        return states[~fails[states]]


def _name_of(prover: Optional[Prover]) -> str:
    return "state equation" if prover is not None and prover.programs else "structure"

"""The whole way from a plan and a request to the plan with the best policy.

1. The decision problem of the plan, one for each team size (:mod:`.problem`).
2. Its solution with certified bounds (:mod:`.solving`).
3. A policy that sees markings only, and its exact value (:mod:`.grouping`).
4. Rows, merged and verified (:mod:`.export`).
5. The old and the new plan, simulated as they run.

"""

from __future__ import annotations

import math
from typing import AbstractSet, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats
from gspn_framework_package.analysis.decisions.aims import Request
from gspn_framework_package.analysis.decisions.automaton import Automaton, Rewards
from gspn_framework_package.analysis.decisions.export import Decided, policy_of
from gspn_framework_package.analysis.decisions.grouping import (
    Grouped,
    group,
    group_random,
    present_choices,
)
from gspn_framework_package.analysis.decisions.problem import Decisions, Team
from gspn_framework_package.analysis.decisions.report import (
    MOST_CHOICES,
    ConstraintResult,
    MarkingChoice,
    Report,
    Sensitivity,
    TeamResult,
)
from gspn_framework_package.analysis.decisions.solving import (
    Evaluated,
    Robust,
    constrained,
    evaluate,
    optimum,
    robust,
    sensitivities,
)
from gspn_framework_package.analysis.simulation.against import compare_plans
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.errors import LimitError, RefusedError
from gspn_framework_package.model.plan import Plan

SIMULATED = 5.0
"""Default time (s) of computing for the simulation of the old and the new plan."""


def optimise(
    plan: Plan,
    request: Request,
    *,
    simulated: float = SIMULATED,
    seed: int = 0,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Report:
    """Compute the best policy of a plan.

    :param plan: a validated plan.
    :param request: the aim, the constraints and how to read the plan.
    :param simulated: seconds of computing in which the old and the new plan are simulated as they
        run; 0: not at all.
    :param seed: seed of the simulation.
    :param progress: called with the progress of long computations.
    :param cancel: called at intervals; returns whether to stop.
    :raises UsageError: the request does not fit the plan.
    :raises RefusedError: there is no answer: the constraints cannot be kept, no policy reaches the
        goal, or it is open who decides.
    :raises CancelledError: ``cancel`` returned true.
    """
    request = request.resolved(plan.net)
    subject = plan if request.fitted else plan.nominal()
    report = _Exactly(subject, request, progress, cancel).report()
    if simulated > 0:
        found = compare_plans(
            subject,
            report.plan,
            request.objective,
            seconds=simulated,
            seed=seed,
            progress=progress,
            cancel=cancel,
        )
        report.simulation = found.to_json()
    report.plan = plan.with_policy(report.plan.policy)
    return report


class _Answer(NamedTuple):
    """The solution for one team: certified bounds of the best value, and what the policy does."""

    team: Team
    rewards: Optional[Rewards]
    goal: Optional[Booleans]
    lower: float
    upper: float
    grouped: Grouped
    row_values: Floats
    constraints: List[ConstraintResult]


class _Exactly:
    """The exact way."""

    def __init__(
        self, plan: Plan, request: Request, progress: Optional[Progress], cancel: Optional[Cancel]
    ) -> None:
        self._plan, self._request = plan, request
        self._objective = request.objective
        self._cancel = cancel
        self._watch = Watch(progress, cancel, seconds=request.limits.seconds)
        self._decisions = Decisions.of(
            plan,
            reading=request.reading,
            may_wait=request.may_wait,
            never=request.never,
            conditions=(self._objective.goal,) if self._objective.goal else (),
            team_sizes=request.team_sizes,
            limits=request.limits,
            progress=progress,
            cancel=cancel,
        )

    def report(self) -> Report:
        """Solve the problem of each team, and make one policy of the answers."""
        own = self._solve(self._decisions.teams[0])
        answers, results, missing = [own], [_result(own, self._request)], []
        decided = [own.grouped.decided]
        for team in self._decisions.teams[1:]:
            try:
                answer = self._solve(team)
            except LimitError:
                raise
            except RefusedError as error:
                decided.append(present_choices(team))
                size = len(team.automaton)
                results.append(TeamResult(team.robots, size, None, None, None, error.message))
                missing.append(team.robots)
                continue
            answers.append(answer)
            results.append(_result(answer, self._request))
            decided.append(answer.grouped.decided)
        policy = policy_of(self._plan, _joined(decided), cancel=self._cancel)
        report = Report(
            self._request,
            self._plan.with_policy(policy),
            results,
            len(policy.rows),
            sum(answer.grouped.silent for answer in answers),
            constraints=own.constraints,
            assumptions=list(self._decisions.assumptions),
            undecided=self._wide(own),
        )
        if missing:
            report.undecided.append(
                "teams of %s robots have no answer of their own: they do as under the present "
                "policy" % ", ".join(map(str, missing))
            )
        if self._request.uncertain:
            report.assumptions.append(
                "the present policy has its value at the rates of the plan, the others at the "
                "worst rates; at the rates of the plan the policy found is worth %.9g"
                % own.grouped.evaluated.value
            )
        self._add_present(report, own)
        self._add_sensitivities(report, own)
        return report

    def _solve(self, team: Team) -> _Answer:
        request, objective, decisions = self._request, self._objective, self._decisions
        rewards = decisions.rewards(team, objective) if objective.rewards else None
        goal = decisions.goal(team, objective.goal) if objective.goal else None
        allowed = decisions.allowed(team)
        if request.at_least:
            assert rewards is not None  # the request has been checked
            return self._constrained(team, rewards, allowed)
        if request.uncertain:
            return self._robust(team, rewards, goal, allowed)
        solved = optimum(
            team.automaton,
            objective.aim,
            rewards,
            goal=goal,
            discount=objective.discount,
            maximise=objective.maximise,
            width=request.width,
            allowed=allowed,
            watch=self._watch,
        )
        grouped = group(team, solved, rewards, objective, goal, allowed, watch=self._watch)
        return _Answer(
            team, rewards, goal, solved.lower, solved.upper, grouped, solved.row_values, []
        )

    def _constrained(self, team: Team, rewards: Rewards, allowed: Booleans) -> _Answer:
        request, objective = self._request, self._objective
        measures = [
            self._decisions.earnings(team, {constraint.name: 1.0})
            for constraint in request.at_least
        ]
        found = constrained(
            team.automaton,
            rewards,
            [(measure, c.bound) for measure, c in zip(measures, request.at_least)],
            names=[constraint.name for constraint in request.at_least],
            maximise=objective.maximise,
            width=request.width,
            allowed=allowed,
            watch=self._watch,
        )
        grouped = group_random(
            team, found.weights, rewards, objective, None, allowed, watch=self._watch
        )
        constraints = [
            ConstraintResult(
                constraint.name,
                _average(team.automaton, measure, grouped.evaluated),
                constraint.bound,
                price,
            )
            for constraint, measure, price in zip(request.at_least, measures, found.prices)
        ]
        return _Answer(
            team,
            rewards,
            None,
            found.lower,
            found.upper,
            grouped,
            grouped.evaluated.row_values,
            constraints,
        )

    def _robust(
        self,
        team: Team,
        rewards: Optional[Rewards],
        goal: Optional[Booleans],
        allowed: Booleans,
    ) -> _Answer:
        request, objective, automaton = self._request, self._objective, team.automaton
        net = self._plan.net
        factors = {}
        for name, (low, high) in request.uncertain.items():
            t = net.transition_number(name)
            rate = net.transitions[t].rate
            factors[t] = (low / rate, high / rate)

        def worst(rows: Booleans) -> Robust:
            return robust(
                automaton,
                objective.aim,
                rewards,
                factors,
                labels=self._decisions.rate_labels(team),
                goal=goal,
                discount=objective.discount,
                maximise=objective.maximise,
                width=request.width,
                allowed=rows,
                watch=self._watch,
            )

        found = worst(allowed)
        weights = np.zeros(len(automaton.choices))
        chosen = found.row_of[found.row_of >= 0]
        weights[chosen] = 1.0
        grouped = group_random(team, weights, rewards, objective, goal, allowed, watch=self._watch)
        # what the rows that were written guarantee, not what the solution would
        own = worst((grouped.weights > 0) | automaton.tangible[automaton.row_states])
        lower, upper = found.lower, found.upper
        if objective.maximise:
            lower = min(lower, own.lower)
        else:
            upper = max(upper, own.upper)
        return _Answer(team, rewards, goal, lower, upper, grouped, grouped.evaluated.row_values, [])

    def _wide(self, answer: _Answer) -> List[str]:
        """What to say if the policy may not be the best, as far as the interval tells."""
        missed = [c for c in answer.constraints if c.value < c.bound * (1 - 1e-6) - 1e-12]
        told = [
            "whether '%s' can be kept by a policy that sees only the marking: this one has %.6g of "
            "%g" % (constraint.name, constraint.value, constraint.bound)
            for constraint in missed
        ]
        if self._request.uncertain:
            return [*told, *self._open(answer)]
        value = answer.grouped.evaluated.value
        best = answer.upper if self._objective.maximise else answer.lower
        scale = max(abs(value), abs(best))
        gap = abs(best - value)
        if gap <= 2 * self._request.width * scale:
            return told
        return [
            *told,
            *answer.grouped.notes,
            "whether another policy is better by up to %.2g %%: that is what one could reach that "
            "sees not only the marking, but also which robots are done" % (100 * gap / scale),
        ]

    def _open(self, answer: _Answer) -> List[str]:
        """What to say about the interval of the best worst value."""
        scale = max(abs(answer.lower), abs(answer.upper))
        gap = answer.upper - answer.lower
        if gap <= 2 * self._request.width * scale:
            return []
        return [
            "how much better another policy is in the worst case: by at most %.2g %%. The bound on "
            "one side lets the rates differ from marking to marking" % (100 * gap / scale)
        ]

    # -- beside the answer -------------------------------------------------------------------------

    def _add_present(self, report: Report, own: _Answer) -> None:
        """The value of the present policy, and where the new one differs from it."""
        objective = self._objective
        try:
            report.present = evaluate(
                own.team.automaton,
                objective.aim,
                own.rewards,
                self._decisions.weights_of(own.team, self._plan.policy),
                goal=own.goal,
                discount=objective.discount,
                watch=self._watch,
            ).value
        except LimitError:
            raise
        except RefusedError as error:
            report.present_why = str(error)
        self._add_choices(report, own)

    def _add_choices(self, report: Report, own: _Answer) -> None:
        """What robots do by the present policy and by the new one, those that differ first."""
        team, decided = own.team, own.grouped.decided
        present = _by_marking(present_choices(team))
        net = self._plan.net
        leaving = {
            name: {
                net.transitions[t].name
                for t in net.consumers[net.place_number(name)]
                if not net.transitions[t].timed
            }
            for name in self._decisions.deciders
        }
        worth = _Worth(own, net.transition_index)
        known: Dict[Tuple[Tuple[str, float], ...], List[_Told]] = {}
        alike: List[MarkingChoice] = []
        different: List[Tuple[float, int, MarkingChoice]] = []
        in_all = 0
        for number, (marking, best) in enumerate(zip(decided.markings.tolist(), decided.choices)):
            before = present.get(tuple(marking), {})
            key = (*before.items(), ("", 0.0), *best.items())
            if key not in known:
                known[key] = _told(before, best, leaving)
            for place, old, new in known[key]:
                if not marking[net.place_index[place]]:
                    continue
                in_all += 1
                if old == new and len(alike) >= MOST_CHOICES:
                    continue
                tokens = {p.name: n for p, n in zip(net.places, marking) if n}
                choice = MarkingChoice(tokens, place, old, new)
                if old == new:
                    alike.append(choice)
                    continue
                loss, visits = worth.lost(marking, old, new)
                different.append((-(loss or 0.0) * visits, number, choice._replace(loss=loss)))
        different.sort(key=lambda item: item[:2])
        report.choices = ([choice for _, _, choice in different] + alike)[:MOST_CHOICES]
        report.choices_in_all, report.choices_that_differ = in_all, len(different)

    def _add_sensitivities(self, report: Report, own: _Answer) -> None:
        """How the value depends on each rate."""
        objective, transitions = self._objective, self._plan.net.transitions
        value = own.grouped.evaluated.value
        try:
            found = sensitivities(
                own.team.automaton,
                objective.aim,
                own.rewards,
                own.grouped.evaluated,
                np.array([t.rate if t.timed else 0.0 for t in transitions]),
                labels=self._decisions.rate_labels(own.team),
            )
        except RefusedError as error:
            report.undecided.append("how the value depends on the rates: %s" % error.message)
            return
        for transition, derivative in zip(transitions, found.tolist()):
            if transition.timed and derivative:
                elasticity = derivative * transition.rate / value if value else None
                report.sensitivities.append(
                    Sensitivity(transition.name, transition.rate, derivative, elasticity)
                )


_Told = Tuple[str, Mapping[str, float], Mapping[str, float]]
"""A place, and the choices for it by the old and by the new policy."""


def _told(
    before: Mapping[str, float], best: Mapping[str, float], leaving: Mapping[str, AbstractSet[str]]
) -> List[_Told]:
    """The places for which one of two sets of choices says something."""
    found: List[_Told] = []
    for place, names in leaving.items():
        old, new = _of_place(before, names), _of_place(best, names)
        if old or new:
            found.append((place, old, new))
    return found


class _Worth:
    """What choices in a marking are worth.

    :param answer: the solution, whose values of rows it compares.
    :param numbers: the number of each transition.
    """

    def __init__(self, answer: _Answer, numbers: Mapping[str, int]) -> None:
        team = answer.team
        automaton = team.automaton
        self._numbers = numbers
        self._width = len(numbers)
        chosen = np.flatnonzero((automaton.choices >= 0) & team.decides[automaton.row_states])
        marking = team.marking_of[automaton.row_states]
        keys = marking[chosen] * self._width + automaton.choices[chosen]
        self._keys, first = np.unique(keys, return_index=True)
        self._values = answer.row_values[chosen[first]]
        flow = np.nan_to_num(answer.grouped.evaluated.flow)
        self._visits = np.bincount(
            marking[chosen], weights=flow[chosen], minlength=len(team.distinct)
        )
        self._at = {tuple(row): i for i, row in enumerate(team.distinct.tolist())}

    def lost(
        self, marking: Sequence[int], old: Mapping[str, float], new: Mapping[str, float]
    ) -> Tuple[Optional[float], float]:
        """What one choice of ``old`` costs in place of ``new`` (None: not known), and how often
        robots choose in this marking."""
        at = self._at[tuple(marking)]
        values = [self._value(at, choices) for choices in (old, new)]
        loss = None
        if values[0] is not None and values[1] is not None:
            loss = abs(values[1] - values[0])
        return loss, float(self._visits[at])

    def _value(self, at: int, choices: Mapping[str, float]) -> Optional[float]:
        if not choices:
            return None
        total = 0.0
        for name, share in choices.items():
            key = at * self._width + self._numbers[name]
            found = int(np.searchsorted(self._keys, key))
            if found == len(self._keys) or self._keys[found] != key:
                return None
            total += share * float(self._values[found])
        return total if math.isfinite(total) else None


def _average(automaton: Automaton, measure: Rewards, evaluated: Evaluated) -> float:
    """The average per second of what ``measure`` counts, in the long run of a policy."""
    arcs = automaton.arc_rows
    tangible = automaton.tangible[automaton.row_states[arcs]]
    exits = np.where(tangible, automaton.exit_rates[arcs], 1.0)
    taken = evaluated.flow[arcs] * automaton.values / np.where(exits > 0, exits, 1.0)
    stays = np.where(automaton.tangible, evaluated.sojourn, 0.0)
    return float(stays @ measure.rate + np.nan_to_num(taken) @ measure.impulse)


def _by_marking(decided: Decided) -> Dict[Tuple[int, ...], Mapping[str, float]]:
    return {
        tuple(marking): choices
        for marking, choices in zip(decided.markings.tolist(), decided.choices)
    }


def _of_place(choices: Mapping[str, float], names: AbstractSet[str]) -> Dict[str, float]:
    """The choices for the robots in one place: those of ``names``, scaled to sum to 1."""
    mine = {name: share for name, share in choices.items() if name in names}
    total = sum(mine.values())
    return {name: share / total for name, share in mine.items()} if total > 0 else {}


def _joined(parts: Sequence[Decided]) -> Decided:
    return Decided(
        np.concatenate([part.markings for part in parts]),
        tuple(choices for part in parts for choices in part.choices),
    )


def _result(answer: _Answer, request: Request) -> TeamResult:
    value = answer.grouped.evaluated.value
    if request.uncertain:  # what it is worth whatever the rates are
        value = answer.lower if request.objective.maximise else answer.upper
    return TeamResult(
        answer.team.robots, len(answer.team.automaton), value, answer.lower, answer.upper
    )

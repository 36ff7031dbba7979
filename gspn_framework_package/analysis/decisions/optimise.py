"""The complete computation from a plan and a request to the plan with the best policy.

The exact method: decisions and their solution with certified bounds (:mod:`.decisions`), the plan
with the policy, and the old and the new plan simulated as they run. If there are too many states,
the policy is improved by simulation instead (:mod:`.rollout`).
"""

from __future__ import annotations

import math
from functools import partial
from typing import AbstractSet, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.decisions.aims import Request
from gspn_framework_package.analysis.decisions.decisions import Decisions, Solution, TeamSolution
from gspn_framework_package.analysis.decisions.export import Decided
from gspn_framework_package.analysis.decisions.grouping import present_choices
from gspn_framework_package.analysis.decisions.problem import DecisionProblem
from gspn_framework_package.analysis.decisions.report import (
    MOST_CHOICES,
    ConstraintResult,
    MarkingChoice,
    Report,
    Sensitivity,
    TeamResult,
)
from gspn_framework_package.analysis.decisions.rollout import improve
from gspn_framework_package.analysis.decisions.solving import evaluate_policy, sensitivities
from gspn_framework_package.analysis.decisions.storm import check_storm, storm_value
from gspn_framework_package.analysis.executors import Executor
from gspn_framework_package.analysis.simulation.against import compare_plans
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.errors import LimitError, RefusedError
from gspn_framework_package.model.plan import Plan

SIMULATED = 5.0
"""Default time (s) of computing for the simulation of the old and the new plan."""

_SEARCH = 12.0
"""Time of a search by simulation, as a multiple of the time of a simulation."""


def optimise(
    plan: Plan,
    request: Request,
    *,
    simulated: float = SIMULATED,
    seed: int = 0,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    on: Optional[Executor] = None,
    storm: bool = False,
) -> Report:
    """Compute the best policy of a plan.

    :param plan: a validated plan.
    :param request: the aim, the constraints and the interpretation of the plan.
    :param simulated: seconds of computing in which the old and the new plan are simulated as they
        run; 0: no simulation. If there are too many states, a policy is searched for by simulation
        for 12 times as long.
    :param seed: seed of the simulation.
    :param progress: called with the progress of long computations.
    :param cancel: called at intervals; returns whether to stop.
    :param on: where to simulate: by default in this process.
    :param storm: whether Storm computes the value, too, as a check.
    :raises UsageError: the request does not fit the plan, or Storm.
    :raises RefusedError: there is no answer: the constraints cannot be met, no policy reaches the
        goal, or it is ambiguous who decides.
    :raises CancelledError: ``cancel`` returned true.
    """
    request = request.resolved(plan.net)
    if storm:
        check_storm(request)
    subject = plan if request.fitted else plan.nominal()
    try:
        report = _Exactly(subject, request, progress, cancel).report(storm)
    except LimitError as error:
        report = _by_rollout(subject, request, error, simulated, seed, progress, cancel, on)

    def simulate() -> None:
        report.simulation = compare_plans(
            subject,
            report.plan,
            request.objective,
            seconds=simulated,
            seed=seed,
            progress=progress,
            cancel=cancel,
            on=on,
        ).to_json()

    if report.exact and simulated > 0:
        report.add("the simulation of both plans", simulate)
    report.plan = plan.with_policy(report.plan.policy)
    return report


def _by_rollout(
    plan: Plan,
    request: Request,
    error: LimitError,
    simulated: float,
    seed: int,
    progress: Optional[Progress],
    cancel: Optional[Cancel],
    on: Optional[Executor],
) -> Report:
    """The policy improved by simulation, instead of an exact answer.

    :param error: the reason why there is none.
    :param simulated: computing time (s) given by the user; 0: raise the error.
    """
    if simulated <= 0 or request.at_least or request.uncertain:
        raise error
    found = improve(
        plan,
        request,
        seed=seed,
        seconds=_SEARCH * simulated,
        progress=progress,
        cancel=cancel,
        on=on,
    )
    return Report(
        request,
        plan.with_policy(found.policy),
        [TeamResult(len(plan.robots), None, found.new.mean, found.new.low, found.new.high)],
        len(found.policy.rows),
        exact=False,
        present=found.old.mean,
        assumptions=list(found.notes),
        undecided=["the best policy: %s" % error],
        simulation=found.comparison.to_json(),
    )


class _Exactly:
    """The exact method."""

    def __init__(
        self, plan: Plan, request: Request, progress: Optional[Progress], cancel: Optional[Cancel]
    ) -> None:
        self._plan, self._request = plan, request
        self._objective = request.objective
        self._new_watch = partial(Watch, progress, cancel, seconds=request.limits.seconds)
        self._watch = self._new_watch()
        self._problem = DecisionProblem(
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
        self._decisions = Decisions(self._problem, self._new_watch(), cancel)

    def report(self, storm: bool) -> Report:
        """Solve the problem of each team, and report on the policy."""
        request = self._request
        solution = self._decisions.solve(
            self._objective,
            at_least=request.at_least,
            uncertain=request.uncertain,
            width=request.width,
        )
        own = solution.teams[0]
        report = Report(
            request,
            self._plan.with_policy(solution.policy),
            self._results(solution),
            len(solution.policy.rows),
            sum(team.grouped.silent for team in solution.teams),
            constraints=[*own.constraints],
            assumptions=list(self._problem.assumptions),
            undecided=self._wide(own),
        )
        if solution.without:
            report.undecided.append(
                "teams of %s robots have no separate answer: they follow the present "
                "policy" % ", ".join(map(str, solution.without))
            )
        if request.uncertain:
            report.assumptions.append(
                "the present policy has its value at the rates of the plan, the others at the "
                "worst rates; at the rates of the plan the policy found is worth %.9g"
                % own.grouped.evaluated.value
            )
        report.add("the cost of the rule", lambda: self._add_price_of_never(report, solution))
        if self._plan.policy.rows or self._plan.actions or self._plan.robots:
            report.add("the value of the present policy", lambda: self._add_present(report, own))
        else:
            report.present_why = "a net has none"
        worse = self._is_worse(report)
        if own.grouped.kept or worse:
            report.plan, report.teams = self._plan, report.teams[:1]
            report.rows, report.silent = len(self._plan.policy.rows), 0
        if worse:
            self._certify_nothing(report)
            return report
        for what, compute in (
            ("where the policies differ", lambda: self._add_choices(report, own)),
            (
                "how the value depends on the rates",
                lambda: self._add_sensitivities(report, own),
            ),
        ):
            report.add(what, compute)
        if storm:  # last, since nothing else should wait for it
            report.add("the value by Storm", lambda: self._add_storm(report, own))
        return report

    def _results(self, solution: Solution) -> List[TeamResult]:
        found = {team.team.robots: team for team in solution.teams}
        results = []
        for team in self._problem.teams:
            size = len(team.automaton)
            if team.robots not in found:
                why = solution.without[team.robots]
                results.append(TeamResult(team.robots, size, None, None, None, why))
                continue
            mine = found[team.robots]
            value = mine.value(self._request)
            results.append(TeamResult(team.robots, size, value, mine.lower, mine.upper))
        return results

    def _wide(self, answer: TeamSolution) -> List[str]:
        """The remark if, according to the interval, the policy may not be optimal."""
        missed = [constraint for constraint in answer.constraints if not constraint.kept]
        missing = [
            "whether '%s' can be kept by a policy that sees only the marking: this one has %.6g of "
            "%g" % (constraint.name, constraint.value or 0.0, constraint.bound or 0.0)
            for constraint in missed
        ]
        if self._request.uncertain:
            return [*missing, *self._open(answer)]
        value = answer.grouped.evaluated.value
        best = answer.upper if self._objective.maximise else answer.lower
        scale = max(abs(value), abs(best))
        gap = abs(best - value)
        if gap <= 2 * self._request.width * scale:
            return missing
        return [
            *missing,
            *answer.grouped.notes,
            "whether another policy is better, by at most %.2g %%: the bound is that of policies "
            "that also see which robots are done, and randomise among all that robots could do"
            % (100 * gap / scale),
        ]

    def _open(self, answer: TeamSolution) -> List[str]:
        """The remark on the interval of the best worst-case value."""
        scale = max(abs(answer.lower), abs(answer.upper))
        gap = answer.upper - answer.lower
        if gap <= 2 * self._request.width * scale:
            return []
        return [
            "how much better another policy is in the worst case: by at most %.2g %%. The bound on "
            "one side lets the rates differ from marking to marking" % (100 * gap / scale)
        ]

    # -- additional results ------------------------------------------------------------------------

    def _add_storm(self, report: Report, own: TeamSolution) -> None:
        report.storm = storm_value(
            own.team.automaton,
            self._objective.aim,
            self._objective.maximise,
            own.rewards,
            own.goal,
            self._problem.allowed(own.team),
            self._new_watch(),
        )

    def _add_price_of_never(self, report: Report, solution: Solution) -> None:
        """The cost of the forbidden conditions."""
        request = self._request
        if not request.never:
            return
        rule = ConstraintResult(" or ".join(request.never), None, None, None)
        report.constraints.append(rule)
        if request.at_least or request.uncertain:
            return
        try:
            price = self._decisions.price_of_never(self._objective, solution)
        except LimitError:
            raise
        except RefusedError:
            return  # without it, there is no finite value
        report.constraints[-1] = rule._replace(price=price)

    def _add_present(self, report: Report, own: TeamSolution) -> None:
        """The value of the present policy, and where the new one differs from it."""
        objective = self._objective
        try:
            report.present = evaluate_policy(
                own.team.automaton,
                objective.aim,
                own.rewards,
                self._problem.weights_of(own.team, self._plan.policy),
                goal=own.goal,
                discount=objective.discount,
                watch=self._watch,
            ).value
        except RefusedError as error:
            report.present_why = str(error)
            if isinstance(error, LimitError):
                raise

    def _is_worse(self, report: Report) -> bool:
        """Whether the present policy is better than the one found, although nothing forbids it."""
        request, gain = self._request, report.gain
        bound = request.never or request.at_least or request.uncertain
        return not bound and gain is not None and gain < -2 * request.width

    def _certify_nothing(self, report: Report) -> None:
        """Report the present policy as the best that is known."""
        report.teams[0] = report.teams[0]._replace(value=report.present, lower=None, upper=None)
        report.undecided.append(
            "whether another policy is better: the present one stays, since it is worth more than "
            "the best one found. The search lets robots that chance moves, and transitions of a "
            "higher priority, move before those for which the policy decides; a run does not always"
        )

    def _add_choices(self, report: Report, own: TeamSolution) -> None:
        """The decisions of robots under the present policy and the new one, those that differ
        first."""
        team, decided = own.team, own.grouped.decided
        present = _by_marking(present_choices(team))
        net = self._plan.net
        leaving = {
            name: {net.transitions[t].name for t in net.immediate_from[net.place_number(name)]}
            for name in self._problem.deciders
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
                known[key] = _choices(before, best, leaving)
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

    def _add_sensitivities(self, report: Report, own: TeamSolution) -> None:
        """How the value depends on each rate."""
        objective, transitions = self._objective, self._plan.net.transitions
        value = own.grouped.evaluated.value
        try:
            found = sensitivities(
                own.team.automaton,
                objective.aim,
                own.rewards,
                own.grouped.evaluated,
                np.array(
                    [t.number if t.timed and t.function is None else 0.0 for t in transitions]
                ),
                labels=self._problem.rate_labels(own.team),
            )
        except LimitError:
            raise
        except RefusedError as error:
            report.undecided.append("how the value depends on the rates: %s" % error.message)
            return
        for transition, derivative in zip(transitions, found.tolist()):
            if transition.timed and derivative:
                elasticity = derivative * transition.number / value if value else None
                report.sensitivities.append(
                    Sensitivity(transition.name, transition.number, derivative, elasticity)
                )


_Told = Tuple[str, Mapping[str, float], Mapping[str, float]]
"""A place, and the choices for it by the old and by the new policy."""


def _choices(
    before: Mapping[str, float], best: Mapping[str, float], leaving: Mapping[str, AbstractSet[str]]
) -> List[_Told]:
    """The places to which at least one of two sets of choices applies."""
    found: List[_Told] = []
    for place, names in leaving.items():
        old, new = _of_place(before, names), _of_place(best, names)
        if old or new:
            found.append((place, old, new))
    return found


class _Worth:
    """The values of choices in a marking.

    :param answer: the solution, whose values of rows it compares.
    :param numbers: the number of each transition.
    """

    def __init__(self, answer: TeamSolution, numbers: Mapping[str, int]) -> None:
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
        """The loss of one choice of ``old`` instead of ``new`` (None: unknown), and how often
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

"""Decisions of a plan and the best ones: the Python interface from a plan to a policy.

>>> from gspn_framework_package.analysis.decisions.aims import Objective
>>> from gspn_framework_package.model.builder import NetBuilder
>>> from gspn_framework_package.model.plan import Plan, RobotSpec
>>> net = (NetBuilder().place("choose", 1).place("near").place("far")
...        .immediate("walk", inputs="choose", outputs="far")
...        .immediate("drive", inputs="choose", outputs="near")
...        .exponential("walked", rate=0.5, inputs="far", outputs="choose")
...        .exponential("driven", rate=2.0, inputs="near", outputs="choose").build())
>>> plan = Plan(net, actions={"choose": None}, robots=(RobotSpec("r", "choose"),))
>>> aim = Objective.long_run({"walked": 1, "driven": 1})
>>> solution = Decisions(DecisionProblem(plan)).solve(aim)
>>> round(solution.lower, 5), round(solution.upper, 5), solution.policy.rows[0].choices
(2.0, 2.0, (('drive', 1.0),))
>>> plan.with_policy(solution.policy).policy == solution.policy
True
"""

from __future__ import annotations

from typing import List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.decisions.aims import AIM_WIDTH, AtLeast, Objective, Request
from gspn_framework_package.analysis.decisions.automaton import Automaton, Rewards
from gspn_framework_package.analysis.decisions.export import Decided, policy_of
from gspn_framework_package.analysis.decisions.grouping import (
    Grouped,
    Grouping,
    present_choices,
)
from gspn_framework_package.analysis.decisions.problem import DecisionProblem, SizedTeam
from gspn_framework_package.analysis.decisions.report import ConstraintResult
from gspn_framework_package.analysis.decisions.solving import (
    Evaluated,
    Robust,
    constrained,
    follow_policy,
    optimum,
    robust,
)
from gspn_framework_package.analysis.watch import Cancel, Watch
from gspn_framework_package.model.errors import LimitError, RefusedError, UsageError
from gspn_framework_package.model.policy import Policy

_STRICTER = 6
"""Number of attempts with stricter bounds."""


class TeamSolution(NamedTuple):
    """The solution for a team of one size.

    :ivar team: its decision problem.
    :ivar rewards: the rewards of its runs; None for TIME_TO and REACH.
    :ivar goal: boolean array over its states: the states where the aim is reached; None if it has
        no goal.
    :ivar lower: certified lower bound of the best value; ``upper``: the upper one.
    :ivar grouped: the decisions by marking, with their value.
    :ivar row_values: float array over the rows: the value of each.
    :ivar constraints: the values that the policy reaches for the constraints.
    """

    team: SizedTeam
    rewards: Optional[Rewards]
    goal: Optional[Booleans]
    lower: float
    upper: float
    grouped: Grouped
    row_values: Floats
    constraints: List[ConstraintResult]

    def value(self, request: Request) -> float:
        """The value of the policy; with uncertain rates: in the worst case."""
        if request.uncertain:
            return self.lower if request.objective.maximise else self.upper
        return self.grouped.evaluated.value


class Solution(NamedTuple):
    """The best policy for an aim.

    :ivar policy: the policy, for the plan's own team and the smaller ones.
    :ivar value: its value for the plan's own team; with uncertain rates, in the worst case.
    :ivar lower: certified lower bound of the best value; ``upper``: the upper one.
    :ivar teams: the solution for each team size, the plan's own first.
    :ivar without: the sizes of teams for which there is none, with the reason. They follow the
        present policy.
    """

    policy: Policy
    value: float
    lower: float
    upper: float
    teams: Tuple[TeamSolution, ...]
    without: Mapping[int, str]


class Decisions:
    """What the robots of a plan can decide.

    :param problem: the decision problems of its teams.
    """

    def __init__(
        self,
        problem: DecisionProblem,
        watch: Optional[Watch] = None,
        cancel: Optional[Cancel] = None,
    ) -> None:
        self.problem = problem
        self._watch, self._cancel = watch or Watch(), cancel

    def solve(
        self,
        objective: Objective,
        *,
        at_least: Sequence[AtLeast] = (),
        uncertain: Mapping[str, Tuple[float, float]] = {},
        width: float = AIM_WIDTH,
    ) -> Solution:
        """The best policy for an aim.

        :param at_least: constraints on the long run.
        :param uncertain: transition -> lowest and highest rate (1/s).
        :param width: width of the certified interval, relative to its value.
        :raises UsageError: the aim does not fit the plan.
        :raises RefusedError: there is no solution: the constraints cannot be met, or no policy
            reaches the goal.
        :raises LimitError: the interval did not become as narrow as requested, or not in time.
        """
        plan = self.problem.plan
        request = Request(
            objective, at_least=tuple(at_least), uncertain=uncertain, width=width
        ).resolved(plan.net)
        solver = _Solver(self.problem, request, self._watch)
        own = solver.solve(self.problem.teams[0])
        teams, without = [own], {}
        decided = [own.grouped.decided]
        for team in self.problem.teams[1:]:
            try:
                found = solver.solve(team)
            except LimitError:
                raise
            except RefusedError as error:
                without[team.robots] = error.message
                decided.append(present_choices(team))
            else:
                teams.append(found)
                decided.append(found.grouped.decided)
        policy = plan.policy
        # where the policy has nothing to decide, rows would only draw what cannot fire yet
        if self.problem.deciders and (without or not all(team.grouped.kept for team in teams)):
            policy = policy_of(plan, _joined(decided), cancel=self._cancel)
        return Solution(policy, own.value(request), own.lower, own.upper, tuple(teams), without)

    def price_of_never(self, objective: Objective, solution: Solution) -> float:
        """The gain in value, for the plan's own team, if the forbidden conditions were permitted.

        :param solution: the solution for it, without constraints and uncertain rates.
        :raises LimitError: see :meth:`solve`.
        """
        team, own = self.problem.teams[0], solution.teams[0]
        free = optimum(
            team.automaton,
            objective.aim,
            own.rewards,
            goal=own.goal,
            discount=objective.discount,
            maximise=objective.maximise,
            allowed=team.by_policy,
            watch=self._watch,
        )
        gain = 0.5 * (free.lower + free.upper - solution.lower - solution.upper)
        return max(gain if objective.maximise else -gain, 0.0)


class _Solver:
    """Solves the problems of the teams."""

    def __init__(self, problem: DecisionProblem, request: Request, watch: Watch) -> None:
        self._problem, self._request, self._watch = problem, request, watch

    def solve(self, team: SizedTeam) -> TeamSolution:
        """The solution for one team. :raises RefusedError: there is none."""
        request, problem = self._request, self._problem
        objective = request.objective
        rewards = problem.rewards(team, objective) if objective.rewards else None
        goal = problem.goal(team, objective.goal) if objective.goal else None
        allowed = problem.allowed(team)
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
        grouping = Grouping(team, rewards, objective, goal, allowed, self._watch)
        grouped = grouping.closest(solved)
        return TeamSolution(
            team, rewards, goal, solved.lower, solved.upper, grouped, solved.row_values, []
        )

    def _constrained(self, team: SizedTeam, rewards: Rewards, allowed: Booleans) -> TeamSolution:
        """The best policy that meets the constraints.

        Rows of a policy cannot randomise between going and waiting, nor between places, so they may
        fall short of a solution that does. In this case, the solution for stricter bounds is tried.
        """
        request = self._request
        found = self._within(team, rewards, allowed, [c.bound for c in request.at_least])
        lower, upper = found.lower, found.upper
        best, bounds = found, [constraint.bound for constraint in request.at_least]
        for _ in range(_STRICTER):
            short = [not constraint.kept for constraint in best.constraints]
            if not any(short):
                break
            bounds = [
                bound * (min(max(asked.bound / c.value, 1.01), 2.0) if less and c.value else 1.0)
                for bound, less, asked, c in zip(bounds, short, request.at_least, best.constraints)
            ]
            try:
                best = self._within(team, rewards, allowed, bounds)
            except RefusedError:
                break  # bounds this strict cannot be met
        if not all(constraint.kept for constraint in best.constraints):
            return found
        value = best.grouped.evaluated.value
        if request.objective.maximise:
            lower = min(lower, value)
        else:
            upper = max(upper, value)
        return best._replace(lower=lower, upper=upper)

    def _within(
        self, team: SizedTeam, rewards: Rewards, allowed: Booleans, bounds: Sequence[float]
    ) -> TeamSolution:
        """The best policy with these lower bounds instead of the requested ones."""
        request, objective = self._request, self._request.objective
        measures = [
            self._problem.earnings(team, {constraint.name: 1.0}) for constraint in request.at_least
        ]
        found = constrained(
            team.automaton,
            rewards,
            list(zip(measures, bounds)),
            names=[constraint.name for constraint in request.at_least],
            maximise=objective.maximise,
            width=request.width,
            allowed=allowed,
            watch=self._watch,
        )
        grouping = Grouping(team, rewards, objective, None, allowed, self._watch)
        grouped = grouping.drawn(found.weights)
        constraints = [
            ConstraintResult(
                constraint.name,
                _average(team.automaton, measure, grouped.evaluated),
                constraint.bound,
                price,
            )
            for constraint, measure, price in zip(request.at_least, measures, found.prices)
        ]
        return TeamSolution(
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
        team: SizedTeam,
        rewards: Optional[Rewards],
        goal: Optional[Booleans],
        allowed: Booleans,
    ) -> TeamSolution:
        request, automaton = self._request, team.automaton
        objective, net = request.objective, self._problem.plan.net
        labels = self._problem.rate_labels(team)
        factors = {}
        for name, (low, high) in request.uncertain.items():
            t = net.transition_number(name)
            rate = net.transitions[t].number
            if not (labels == t).any():
                raise UsageError(
                    "its rate has no effect: the plan gives the duration, or it never fires",
                    element=name,
                    hint="take it out of the uncertain rates, or use the nominal rates",
                )
            factors[t] = (low / rate, high / rate)

        def worst(
            part: Automaton, earned: Optional[Rewards], proportional: Indices, rows: Booleans
        ) -> Robust:
            return robust(
                part,
                objective.aim,
                earned,
                factors,
                labels=proportional,
                goal=goal,
                discount=objective.discount,
                maximise=objective.maximise,
                width=request.width,
                allowed=rows,
                watch=self._watch,
            )

        found = worst(automaton, rewards, labels, allowed)
        weights = np.zeros(len(automaton.choices))
        chosen = found.row_of[found.row_of >= 0]
        weights[chosen] = 1.0
        grouping = Grouping(team, rewards, objective, goal, allowed, self._watch)
        grouped = grouping.drawn(weights)
        # the guarantee of the rows as written, not of the solution
        part = follow_policy(automaton, rewards, grouped.weights, goal)
        own = worst(part.automaton, part.rewards, labels[part.arcs], part.speaks)
        lower, upper = found.lower, found.upper
        if objective.maximise:
            lower = min(lower, own.lower)
        else:
            upper = max(upper, own.upper)
        return TeamSolution(
            team, rewards, goal, lower, upper, grouped, grouped.evaluated.row_values, []
        )


def _average(automaton: Automaton, measure: Rewards, evaluated: Evaluated) -> float:
    """The average per second of what ``measure`` counts, in the long run of a policy."""
    arcs = automaton.arc_rows
    tangible = automaton.tangible[automaton.row_states[arcs]]
    exits = np.where(tangible, automaton.exit_rates[arcs], 1.0)
    taken = evaluated.flow[arcs] * automaton.values / np.where(exits > 0, exits, 1.0)
    stays = np.where(automaton.tangible, evaluated.sojourn, 0.0)
    return float(stays @ measure.rate + np.nan_to_num(taken) @ measure.impulse)


def _joined(parts: Sequence[Decided]) -> Decided:
    return Decided(
        np.concatenate([part.markings for part in parts]),
        tuple(choices for part in parts for choices in part.choices),
    )

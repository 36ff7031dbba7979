"""Improves a policy by simulation, for plans with too many states for the exact method.

A *rollout* tries another choice where a robot decides, and continues with the present policy (D. P.
Bertsekas, D. A. Castanon, *Rollout algorithms for stochastic scheduling problems*, J. Heuristics
1999). Here each rollout starts from the state of a run just before such a decision, including the
progress of its robots' actions. The candidates are single rows of a policy: *in these markings, a
robot in this place does that*. Both policies continue from the same states with the same random
numbers. Sequential halving (Z. Karnin, T. Koren, O. Somekh, *Almost optimal exploration in
multi-armed bandits*, ICML 2013) repeatedly drops the worse half of the candidates; the rest are
tested with new rollouts. Rows that pass are inserted before the old ones if runs from the plan's
initial state confirm that the whole policy is better. Then the next round begins.

The only guarantee is the result of independent runs from the plan's initial state at the end.
"""

from __future__ import annotations

import math
import time as clock
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.decisions.aims import Objective, Request
from gspn_framework_package.analysis.decisions.automaton import WAIT
from gspn_framework_package.analysis.decisions.rolling import (
    Rolled,
    Roller,
    Rollouts,
    copied,
    roll_out,
)
from gspn_framework_package.analysis.decisions.who_decides import who_decides
from gspn_framework_package.analysis.executors import Executor, LocalExecutor, WorkItem, Workload
from gspn_framework_package.analysis.plan.reading import RUN
from gspn_framework_package.analysis.simulation.against import compare_plans
from gspn_framework_package.analysis.simulation.against_result import Against
from gspn_framework_package.analysis.simulation.aimed_run import AimedRun, worth_compiling
from gspn_framework_package.analysis.simulation.paired_estimates import Measured, paired_mean
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.errors import LimitError, RefusedError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Policy, PolicyRow, PolicyScope
from gspn_framework_package.model.policy_cell import Cell

ROLLOUT_SECONDS = 60.0
"""Default time of the machine (s)."""

ROUNDS = 5
"""Largest number of rounds of improvement."""

SIGNIFICANCE = 0.05
"""Probability that a round adopts a row that is not better, over all its candidates."""

ROLLOUT_VISITS = 1500
"""Largest number of decisions considered in a round."""

PAIRS = 200
"""Number of pairs of runs that confirm a policy if their time is not limited."""

_GROUPS = 16
"""Number of groups of markings for which other choices are tried in a round."""

_STARTS = 24
"""Number of start states of rollouts per group."""

_FIRST_ROLLOUTS = 8
"""Initial number of rollouts of each candidate; it doubles with each halving."""

_LAST = 4
"""Number of candidates tested at the end."""

_TESTS = 100
"""Number of rollouts of each of them."""

_OFTEN = 5
"""Smallest number of visits for a group to be considered."""

_HORIZON = 0.4
"""Length of a rollout relative to the runs whose decisions are considered."""


class Rollout(NamedTuple):
    """A policy that was improved by simulation.

    :ivar policy: the policy; that of the plan if nothing better was found.
    :ivar old: the value of the plan's policy with its interval; ``new``: that of ``policy``;
      ``difference``: new minus old. They come from runs that were not used for any other decision.
    :ivar improved: whether the policy is significantly better.
    :ivar markings: number of rows, each for a group of markings, inserted before the old ones.
    :ivar comparison: the runs behind these values.
    :ivar notes: sentences for people.
    """

    policy: Policy
    old: Measured
    new: Measured
    difference: Measured
    improved: bool
    markings: int
    rounds: int
    comparison: Against
    notes: List[str]


def improve(
    plan: Plan,
    request: Request,
    *,
    seed: int = 0,
    seconds: Optional[float] = ROLLOUT_SECONDS,
    rounds: int = ROUNDS,
    visits: int = ROLLOUT_VISITS,
    pairs: int = PAIRS,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    on: Optional[Executor] = None,
) -> Rollout:
    """Improve the policy of a plan by simulation.

    :param plan: a validated plan.
    :param request: the aim; ``never`` and ``may_wait`` are respected to the extent stated in the
        notes.
    :param seed: seed of the random numbers.
    :param seconds: computing time (s); the answer may take slightly longer. None: no limit, and the
        same seed gives the same policy on every machine.
    :param rounds: largest number of rounds.
    :param visits: largest number of decisions considered in a round.
    :param pairs: pairs of runs that confirm a policy, if ``seconds`` is None.
    :param on: where to compute the rollouts and the pairs of runs: by default in this process.
    :raises RefusedError: the request has constraints or uncertain rates, or the plan cannot be
        played.
    :raises CancelledError: ``cancel`` returned true.
    """
    if request.at_least or request.uncertain:
        raise RefusedError(
            "a policy that is improved by simulation cannot respect constraints on the long run or "
            "uncertain rates",
            hint="leave them out, or raise the limits for the exact method",
        )
    if not request.fitted:
        plan = plan.nominal()
    executor = on or LocalExecutor()
    search = _Search(plan, request, seed, seconds, visits, pairs, progress, cancel, executor)
    return _improved(search, rounds)


def _improved(search: _Search, rounds: int) -> Rollout:
    plan = search.plan
    policy, notes = plan.policy, search.notes
    done = 0
    for number in range(rounds):
        if search.is_over():
            notes.append("the time ran out after %d of %d rounds" % (done, rounds))
            break
        better = search.better(number)
        done += 1
        if better is None:
            break
        policy = better
    found = search.compared(
        plan.policy, policy, max(search.left(), 0.2 * search.seconds), search.seed + 1
    )
    improved = bool(found.significant and found.better)
    rows = len(search.rows)
    if not improved:
        notes.append(
            "no better policy was found by simulation: the present one stays"
            if policy == plan.policy
            else "the policy that looked better is not significantly better in independent runs: "
            "the present one stays"
        )
        policy, rows = plan.policy, 0
    else:
        notes.append(
            "the policy was improved by simulation in %d round%s: it is better than the present "
            "one, but its distance from the optimum is unknown" % (done, "" if done == 1 else "s")
        )
    notes += found.notes
    new = found.new if improved else found.old
    difference = found.difference if improved else Measured(0.0, 0.0, 0.0)
    return Rollout(policy, found.old, new, difference, improved, rows, done, found, notes)


class _Visit(NamedTuple):
    """A decision in a run: the marking, the place of the robot, the choice (a transition, or WAIT),
    and the state before the event that led to it."""

    marking: Tuple[int, ...]
    place: int
    chosen: int
    state: Any


class _Group(NamedTuple):
    """Visits of a place whose markings agree in some ``cells``: pairs (place, count)."""

    place: int
    cells: Tuple[Tuple[int, int], ...]
    visits: List[_Visit]


@dataclass
class _Candidate:
    """Another choice in a group of markings, with the results of its rollouts."""

    group: _Group
    choice: int
    rows: List[PolicyRow]
    policy: Policy
    number: int
    gains: List[float] = field(default_factory=list)

    def starts(self) -> List[Any]:
        """The start states of its rollouts, in turn."""
        visits = self.group.visits
        return [visit.state for visit in visits[:: max(len(visits) // _STARTS, 1)]]

    def score(self) -> float:
        """Its estimated improvement, in standard errors."""
        gains = np.array(self.gains)
        spread = float(gains.std(ddof=1)) / math.sqrt(len(gains))
        middle = float(gains.mean())
        return middle / spread if spread > 0 else math.copysign(math.inf, middle) * bool(middle)


Key = Tuple[int, Tuple[Tuple[int, int], ...]]


class _Search:
    """Rounds of improvement of one plan.

    :ivar seed: of the random numbers.
    :ivar rows: (place, cells) -> the rows that were added for them.
    """

    def __init__(
        self,
        plan: Plan,
        request: Request,
        seed: int,
        seconds: Optional[float],
        visits: int,
        pairs: int,
        progress: Optional[Progress],
        cancel: Optional[Cancel],
        executor: Executor,
    ) -> None:
        self.plan, self.net = plan, plan.net
        self.objective: Objective = request.objective
        self.seconds = math.inf if seconds is None else seconds
        self.notes: List[str] = []
        self.rows: Dict[Key, List[PolicyRow]] = {}
        self._progress, self._cancel = progress, cancel
        self._watch, self._executor = Watch(progress, cancel), executor
        self.seed = seed
        self._visits, self._pairs = visits, pairs
        self._began = clock.monotonic()
        self._compiled = worth_compiling(self.seconds if seconds is not None else 0.0)
        self._places = list(plan.policy.places)
        table = plan.policy.bind(self.net)
        self._scope = list(map(table.scope, range(len(self.net.places))))
        self._policy = plan.policy
        names = [place.name for place in self.net.places]
        self._never = [parse_condition(text, names) for text in request.never]
        deciders = who_decides(plan, RUN, request.may_wait)
        self._deciding = [
            self.net.place_index[name] for name, who in deciders.items() if who.policy
        ]
        self._may_wait = {self.net.place_index[name] for name in request.may_wait}
        counters = set(plan.counters)
        self._read = [p for p, name in enumerate(names) if name not in counters]
        if request.reading != RUN:
            self.notes.append("the improvement by simulation reads the plan as it runs")
        if self._never:
            self.notes.append(
                "no choice was adopted that leads directly to a forbidden marking; nothing more is "
                "guaranteed about them"
            )

    def left(self) -> float:
        """The remaining time (s)."""
        return self._began + self.seconds - clock.monotonic()

    def is_over(self) -> bool:
        """Whether there is only enough time for the last runs."""
        return math.isfinite(self.seconds) and self.left() < 0.3 * self.seconds

    def compared(self, old: Policy, new: Policy, seconds: float, seed: int) -> Against:
        """Runs from the plan's initial state under two policies."""
        return compare_plans(
            self.plan.with_policy(old),
            self.plan.with_policy(new),
            self.objective,
            seconds=max(seconds, 0.1) if math.isfinite(seconds) else None,
            replications=None if math.isfinite(seconds) else self._pairs,
            seed=seed,
            progress=self._progress,
            cancel=self._cancel,
            on=self._executor,
        )

    def better(self, number: int) -> Optional[Policy]:
        """A better policy than the last one, if a round finds one."""
        seed = self.seed + 1000 * (number + 1)
        visits, horizon = self._sample(seed)
        candidates = self._candidates(visits)
        if not candidates:
            self.notes.append("round %d: there is no other choice to try" % (number + 1))
            return None
        passed = self._tested(self._halved(candidates, horizon, seed), horizon, seed)
        if not passed:
            self.notes.append(
                "round %d: none of %d other choices is significantly better"
                % (number + 1, len(candidates))
            )
            return None
        for chosen in dict.fromkeys((len(passed), 1)):
            rows = dict(self.rows)
            for candidate in passed[:chosen]:
                rows[candidate.group.place, candidate.group.cells] = candidate.rows
            policy = self._policy_of(rows)
            found = self.compared(self._policy, policy, 0.1 * self.seconds, seed)
            if found.significant and found.better:
                self.rows, self._policy = rows, policy
                return policy
        self.notes.append(
            "round %d: %d choice%s looked better, but whole runs do not confirm it"
            % (number + 1, len(passed), "" if len(passed) == 1 else "s")
        )
        return None

    # -- decisions of a run ------------------------------------------------------------------------

    def _run(self, policy: Policy) -> AimedRun:
        run = AimedRun(self.plan.with_policy(policy), self.objective, self._watch)
        if self._compiled:
            run.compile()
        return run

    def _sample(self, seed: int) -> Tuple[List[_Visit], float]:
        """Decisions in some runs of the present policy, and the length (s) of a rollout."""
        run = self._run(self._policy)
        robots = len(self.plan.robots)
        steps = 200 + 30 * robots
        visits: List[_Visit] = []
        spans: List[float] = []
        begun = clock.monotonic()
        number = 0
        while (
            len(visits) < self._visits
            and number < 50
            and clock.monotonic() - begun < 0.1 * self.seconds
        ):
            run.begin(seed, number)
            number += 1
            for _ in range(steps):
                before = copied(run.run.state)
                fired = np.array(before.firings)
                try:
                    run.go(most=1)
                except LimitError:
                    break
                visits += self._decisions(run, before, np.array(run.run.state.firings) - fired)
                if run.ended is not None:
                    break
            spans.append(run.now)
        horizon = _HORIZON * float(np.mean(spans)) if spans else 1.0
        return visits, horizon if horizon > 0 else 1.0

    def _decisions(self, run: AimedRun, before: Any, fired: Any) -> List[_Visit]:
        """The decisions between two states of a run: one that fired, if it is the only one, and
        those that let robots wait."""
        state, after = run.run.state, run.marking()
        found: List[_Visit] = []
        chosen = [
            (t, p)
            for t in np.flatnonzero(fired).tolist()
            if not self.net.transitions[t].timed
            for p, _ in self.net.inputs[t]
            if p in self._deciding
        ]
        if len(chosen) == 1 and fired[chosen[0][0]] == 1:
            t, p = chosen[0]
            marking = list(after)
            for place, change in self.net.effect(t):
                marking[place] -= change
            if self.net.is_enabled(marking, t):
                found.append(_Visit(tuple(marking), p, t, before))
        if not chosen and run.ended is None:
            arcs = len(run.tables.arcs)
            for p in self._deciding:
                if state.lists.head[arcs + p] >= 0 and any(
                    self.net.is_enabled(after, t) for t in self.net.immediate_from[p]
                ):
                    found.append(_Visit(after, p, WAIT, before))
        return found

    # -- candidates --------------------------------------------------------------------------------

    def _candidates(self, visits: Sequence[_Visit]) -> List[_Candidate]:
        groups = self._groups(visits)
        groups.sort(key=lambda group: -len(group.visits))
        found: List[_Candidate] = []
        for group in groups[:_GROUPS]:
            first = group.visits[0]
            enabled = [
                t for t in self.net.immediate_from[group.place] if self._fits(first.marking, t)
            ]
            top = max((self.net.transitions[t].priority for t in enabled), default=0)
            choices = [t for t in enabled if self.net.transitions[t].priority == top]
            if group.place in self._may_wait:
                choices.append(WAIT)
            always = {visit.chosen for visit in group.visits}
            for choice in choices:
                if always == {choice} or any(
                    self._forbidden(visit.marking, choice) for visit in group.visits
                ):
                    continue
                rows = self._rows_for(group, choice)
                policy = self._policy_of({**self.rows, (group.place, group.cells): rows})
                found.append(_Candidate(group, choice, rows, policy, len(found)))
        return found

    def _fits(self, marking: Sequence[int], t: int) -> bool:
        return bool(self.net.is_enabled(tuple(marking), t))

    def _forbidden(self, marking: Sequence[int], choice: int) -> bool:
        if choice == WAIT or not self._never or not self._fits(marking, choice):
            return False
        after = self.net.fire(tuple(marking), choice)
        return any(condition.holds(after) for condition in self._never)

    def _groups(self, visits: Sequence[_Visit]) -> List[_Group]:
        """The visits in groups: the finest of three groupings in which half of the visits are in
        large enough groups."""
        table = self._policy.bind(self.net)
        columns = [self.net.place_index[name] for name in self._policy.places]
        near: Dict[int, List[int]] = {}
        for p in self._deciding:
            around = {p}
            for t in self.net.immediate_from[p]:
                around.update(q for q, _ in self.net.inputs[t])
                around.update(q for q, _ in self.net.outputs[t])
            near[p] = sorted(around)
        groups: List[_Group] = []
        for level in range(3):
            by_key: Dict[Key, List[_Visit]] = defaultdict(list)
            for visit in visits:
                if level == 0:
                    places = self._read
                else:
                    spoken = table.distribution(visit.marking, visit.place)
                    row = () if spoken is None else self._policy.rows[spoken.row].counts
                    places = [q for q, cell in zip(columns, row) if cell is not None]
                    places = sorted({*places, *(near[visit.place] if level == 1 else ())})
                    places = sorted({*places, visit.place})
                cells = tuple((q, visit.marking[q]) for q in places)
                by_key[visit.place, cells].append(visit)
            groups = [_Group(p, cells, mine) for (p, cells), mine in by_key.items()]
            often = sum(len(g.visits) for g in groups if len(g.visits) >= _OFTEN)
            if 2 * often >= len(visits):
                break
        return [group for group in groups if len(group.visits) >= _OFTEN]

    def _rows_for(self, group: _Group, choice: int) -> List[PolicyRow]:
        """Rows, without their cells, that make the choice in the group."""
        marking = group.visits[0].marking
        table = self._policy.bind(self.net)
        others: Dict[str, float] = {}
        for p, leaving in enumerate(self.net.immediate_from):
            if p == group.place or marking[p] == 0 or not leaving:
                continue
            if self._scope[p] != self._scope[group.place]:
                continue  # rows of another scope decide there
            if not self.plan.acts[p]:
                continue
            spoken = table.choices(marking, p)
            if spoken is not None:
                if choice == WAIT:
                    others.update((self.net.transitions[t].name, v) for t, v in spoken)
            else:  # a row for one place disables the weights of the others
                others.update(
                    (self.net.transitions[t].name, self.net.value(marking, t))
                    for t in leaving
                    if not self.net.transitions[t].is_controllable
                )
        rows: List[Dict[str, float]] = []
        if choice != WAIT:
            rows.append(
                {**others, self.net.transitions[choice].name: max(others.values(), default=1.0)}
            )
        else:
            rows = [others, {}] if others else [{}]
        found = []
        for chances in rows:
            total = math.fsum(chances.values())
            found.append(PolicyRow((), tuple((t, v / total) for t, v in chances.items())))
        return found

    def _policy_of(self, rows: Dict[Key, List[PolicyRow]]) -> Policy:
        """The old policy with these rows before those of their scope, the newest first."""
        names = list(self._places)
        for _, cells in rows:
            for p, _ in cells:
                if self.net.places[p].name not in names:
                    names.append(self.net.places[p].name)
        column = {self.net.place_index[name]: i for i, name in enumerate(names)}
        old = self.plan.policy
        new: List[List[PolicyRow]] = [[] for _ in range(1 + len(old.scopes))]
        for (place, cells), mine in reversed(list(rows.items())):
            counts: List[Cell] = [None] * len(names)
            for p, count in cells:
                counts[column[p]] = count
            new[self._scope[place]] += [PolicyRow(tuple(counts), row.choices) for row in mine]
        padding = (None,) * (len(names) - len(self._places))
        table = old.bind(self.net)
        whole: List[PolicyRow] = []
        scopes: List[PolicyScope] = []
        for scope, added in enumerate(new):
            first = len(whole)
            whole += added
            kept = (old.rows[n] for n in table.in_scope(scope))
            whole += [PolicyRow(row.counts + padding, row.choices) for row in kept]
            if scope:
                scopes.append(PolicyScope(old.scopes[scope - 1].places, first, len(whole)))
        return Policy(names, whole, scopes)

    # -- rollouts ----------------------------------------------------------------------------------

    def _halved(self, candidates: List[_Candidate], horizon: float, seed: int) -> List[_Candidate]:
        """The most promising candidates, by sequential halving."""
        workload = self._rollouts(horizon, seed)
        count = _FIRST_ROLLOUTS
        left = list(candidates)
        while True:
            for _ in self._roll(workload, left, count):
                if self.is_over():
                    break
            left = [candidate for candidate in left if len(candidate.gains) > 1]
            left.sort(key=lambda candidate: -candidate.score())
            if len(left) <= _LAST or self.is_over():
                return left[:_LAST]
            left = left[: max(_LAST, len(left) // 2)]
            count *= 2

    def _tested(self, candidates: List[_Candidate], horizon: float, seed: int) -> List[_Candidate]:
        """The candidates that are significantly better in new rollouts, best first; one for each
        group."""
        passed: Dict[Key, _Candidate] = {}
        promising = [candidate for candidate in candidates if candidate.score() > 0]
        for candidate in promising:
            candidate.gains = []
        for _ in self._roll(self._rollouts(horizon, seed + 1), promising, _TESTS):
            pass
        for candidate in promising:
            low = paired_mean(np.array(candidate.gains), 1 - 2 * SIGNIFICANCE / len(promising)).low
            if low is not None and low > 0:
                passed.setdefault((candidate.group.place, candidate.group.cells), candidate)
        return sorted(passed.values(), key=lambda c: -c.score() * math.sqrt(len(c.group.visits)))

    def _rollouts(self, horizon: float, seed: int) -> Workload:
        plan = self.plan.with_policy(self._policy)
        shared = Rolled(plan, self.objective, horizon, seed, self._compiled)
        return Workload(Roller, roll_out, shared, Roller(shared))

    def _roll(self, workload: Workload, candidates: List[_Candidate], count: int) -> Iterator[None]:
        """Add rollouts of each candidate, from the states of its group in turn; the caller may
        pause after each."""
        items = [
            WorkItem(workload, Rollouts(c.number, c.policy, c.starts(), len(c.gains), count), count)
            for c in candidates
        ]
        for number, gains in self._executor.map(items, "rollouts", self._watch):
            candidates[number].gains += gains
            yield

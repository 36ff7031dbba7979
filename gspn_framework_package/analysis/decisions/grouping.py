"""Converts the solution of a decision problem to decisions by marking, which a policy can carry
out.

In each state, one row is best. A policy answers each robot that asks, so each place of a marking
gets the best of its transitions if that is as good as the best row of the state. Otherwise, the
place is *silent*: its robots wait, for zero time, until the others have moved.

Among equally good decisions, those of the present policy are kept, unless a run would cycle in them
forever: postponing the goal is only as good as approaching it if it ends. In this case, the
decision that leads closer to the goal is taken (de Alfaro, *Computing Minimum and Maximum
Reachability Times*, CONCUR 1999).

As the plan runs, several states may have the same marking, and a policy does not distinguish them.
If their best decisions differ, the marking's decision is improved for all of them together,
weighted by how often each is visited; the value of the result is then computed separately.
"""

# In one piece: the decisions of all places are improved together, on the same arrays

from __future__ import annotations

import itertools
import math
from typing import Any, Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.decisions.aims import Aim, Objective
from gspn_framework_package.analysis.decisions.automaton import WAIT, Rewards
from gspn_framework_package.analysis.decisions.decision_net import Stage
from gspn_framework_package.analysis.decisions.export import Decided
from gspn_framework_package.analysis.decisions.playing import answers_of
from gspn_framework_package.analysis.decisions.problem import SizedTeam
from gspn_framework_package.analysis.decisions.solving.evaluation import Evaluated, evaluate_policy
from gspn_framework_package.analysis.decisions.solving.graphs import reaching, rows_toward
from gspn_framework_package.analysis.decisions.solving.layers import arrows_of
from gspn_framework_package.analysis.decisions.solving.solved import Solved
from gspn_framework_package.analysis.plan.policy_answers import distinct_rows
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError, RefusedError
from gspn_framework_package.model.marking_function import MarkingFunction

_TIES = (1e-9, 1e-12, 0.0)
"""Two decisions whose values differ by less than this share of the largest value are equal. A loop
accumulates such differences: if the policy is then worse than the best, a smaller share is
tried."""

_SILENT, OPEN = -1, -2
"""Stand for the number of a transition: the robots wait; no transition is preferred."""

_ROUNDS = 12
"""Largest number of rounds that improve the decisions of markings."""

_COMBINATIONS = 256
"""Largest number of combinations of decisions of a marking for an exhaustive search."""


class Grouped(NamedTuple):
    """Decisions by marking.

    :ivar decided: the decisions.
    :ivar weights: float array: the probability of each row under them.
    :ivar evaluated: their value.
    :ivar silent: number of silent pairs of a marking and a place where a robot could move.
    :ivar notes: the compromises, as sentences for people.
    :ivar kept: whether these are the decisions of the present policy.
    """

    decided: Decided
    weights: Floats
    evaluated: Evaluated
    silent: int
    notes: List[str]
    kept: bool = False


def present_choices(team: SizedTeam) -> Decided:
    """The decision of the plan's present policy in each marking that needs one; if nothing decides,
    the first transition in file order that can fire."""
    table = _Table(team)
    problem = team.problem
    net = problem.plan.net
    policy_answers = answers_of(problem.plan, problem.plan.policy, problem.stages)
    states = team.states_in[_first_states(team)]
    chosen: List[Dict[int, float]] = [{} for _ in range(len(team.distinct))]
    for p in table.asking:
        numbers, answers = policy_answers.of(p, states)
        leaving = net.immediate_from[p]
        enabled = {t: table.enabled[t] for t in leaving}
        for g in np.flatnonzero(table.asks[p]).tolist():
            ready = [t for t in leaving if enabled[t][g]]
            found = [(t, v) for t, v in answers[numbers[g]] if v > 0]
            if numbers[g] == 0:
                marking = team.distinct[g].tolist()
                if not problem.plan.strict:
                    found = [(t, v) for t in ready for v in (net.value(marking, t),) if v > 0]
                found = found or [(ready[0], 1.0)]
            total = sum(v for _, v in found)
            for t, v in found:
                chosen[g][t] = chosen[g].get(t, 0.0) + v / total
    kinds = [_normalised(choice) for choice in chosen]
    needed = np.flatnonzero(table.needed)
    names = [t.name for t in net.transitions]
    return Decided(
        team.distinct[needed],
        tuple({names[t]: v for t, v in kinds[g].items()} for g in needed.tolist()),
    )


def _first_states(team: SizedTeam) -> Indices:
    """For each distinct marking, the first state with it."""
    _, first = np.unique(team.marking_of, return_index=True)
    return first


def _normalised(choice: Mapping[int, float]) -> Dict[int, float]:
    total = sum(choice.values())
    return {t: v / total for t, v in choice.items()}


_Followed = Tuple[Floats, Evaluated, Tuple[Decided, Indices, List[Dict[int, float]]]]
"""Decisions that a run can follow: the probability of each row, their value, and how they are
written."""


def reaches(evaluated: Evaluated, best: Any, objective: Objective) -> bool:
    """Whether the value of a policy is the best one, as far as the certified bounds of both show.

    :param best: an object with the bounds ``lower`` and ``upper`` of the best value.
    """
    if objective.maximise:
        return bool(evaluated.upper >= best.lower)
    return bool(evaluated.lower <= best.upper)


class _Table:
    """The markings of a team that need a decision, and what they enable.

    :ivar asking: the places (numbers of the plan's net) that immediate transitions leave.
    :ivar enabled: transition -> boolean array over the distinct markings.
    :ivar asks: place -> boolean array: some immediate transition that leaves it is enabled.
    :ivar needed: boolean array: the markings that ask.
    :ivar chance: for each chance place, per marking, the number of what chance may take there, and
        for each number the probabilities.
    """

    def __init__(self, team: SizedTeam) -> None:
        problem = team.problem
        net = problem.plan.net
        self.asking = [net.place_number(name) for name in problem.found]
        over = np.ones(len(team.distinct), dtype=bool)
        mine = np.flatnonzero(~team.twin)
        over[team.marking_of[mine]] = problem.stages.over[team.states_in[mine]]
        self.enabled: Dict[int, Booleans] = {}
        self.asks: Dict[int, Booleans] = {}
        self.needed = np.zeros(len(team.distinct), dtype=bool)
        for p in self.asking:
            asks = np.zeros(len(team.distinct), dtype=bool)
            for t in net.immediate_from[p]:
                if t not in self.enabled:
                    self.enabled[t] = problem.enabled(team, t) & ~over
                asks |= self.enabled[t]
            self.asks[p] = asks
            self.needed |= asks
        self.chance: List[Tuple[Indices, List[Dict[int, float]]]] = []
        for decider in problem.found.values():
            if decider.policy:
                continue
            top = np.full(len(team.distinct), -1, dtype=np.int64)
            for t, _ in sorted(decider.chances, key=lambda c: net.transitions[c[0]].priority):
                top[self.enabled[t]] = net.transitions[t].priority
            weights = np.zeros((len(team.distinct), len(decider.chances)))
            which = np.zeros(weights.shape, dtype=np.int64)  # of the weights in its column
            for i, (t, weight) in enumerate(decider.chances):
                able = self.enabled[t] & (top == net.transitions[t].priority)
                if isinstance(weight, MarkingFunction):
                    columns = {
                        name: team.distinct[able, net.place_index[name]].astype(np.float64)
                        for name in weight.places
                    }
                    weights[able, i] = weight.values(columns)
                    which[able, i] = 1 + np.unique(weights[able, i], return_inverse=True)[1]
                else:
                    weights[able, i] = weight
                    which[able, i] = 1
            first, kind = distinct_rows(which)
            sets = [
                _normalised({t: v for (t, _), v in zip(decider.chances, row) if v})
                for row in weights[first].tolist()
            ]
            self.chance.append((np.where(which.any(axis=1), kind, _SILENT), sets))


class Grouping:
    """Converts solutions for one team.

    :param rewards: those of the aim ``objective``, and ``goal`` its goal (boolean array over the
        states), if it has them.
    :param allowed: boolean array over the rows: those that may be taken.
    """

    def __init__(
        self,
        team: SizedTeam,
        rewards: Optional[Rewards],
        objective: Objective,
        goal: Optional[Booleans],
        allowed: Booleans,
        watch: Optional[Watch] = None,
    ) -> None:
        self._team = team
        self._rewards = rewards
        self._objective = objective
        self._goal = goal
        self._allowed = allowed
        self._watch = watch or Watch()
        self._sign = 1.0 if objective.maximise else -1.0
        self._table = _Table(team)
        self._collect()

    def closest(self, solved: Solved) -> Grouped:
        """The decisions by marking that come closest to a solution: those of the present policy if
        none found have a higher value.

        :raises RefusedError: they have no value, or one that the states cannot represent.
        """
        found: Optional[Grouped] = None
        refused: Optional[RefusedError] = None
        try:
            found = self.best(solved)
            if reaches(found.evaluated, solved, self._objective):
                return found
        except RefusedError as error:
            refused = error
        present = self.present()
        if present is not None and (found is None or self.better(present, found)):
            return present
        if found is None:
            assert refused is not None
            raise refused
        return found

    # -- possible requests of robots ---------------------------------------------------------------

    def _collect(self) -> None:
        """Collect the *entries*: a state, a place in which a robot asks, a transition for it."""
        team = self._team
        problem = team.problem
        stages, built = problem.stages, problem.built
        state_of = np.full(len(built.original), -1, dtype=np.int64)
        state_of[team.states_in] = np.arange(len(team.states_in))
        row_of = np.full(len(built.automaton.choices), -1, dtype=np.int64)
        row_of[team.rows_in] = np.arange(len(team.rows_in))
        self._places = sorted({p for askers in stages.net.askers for p in askers})
        number = {p: i for i, p in enumerate(self._places)}
        arcs: List[Indices] = []
        places: List[Indices] = []
        for label, askers in enumerate(stages.net.askers):
            if stages.net.steps[label] is not Stage.DECIDED:
                continue
            mine = stages.arcs_of(label)
            source = stages.sources[mine]
            mine = mine[~stages.over[source] & (state_of[source] >= 0)]
            for p in askers:
                arcs.append(mine)
                places.append(np.full(len(mine), number[p], dtype=np.int64))
        none = [np.zeros(0, dtype=np.int64)]
        self._arc = np.concatenate(arcs + none)
        self._place = np.concatenate(places + none)
        self._state = state_of[stages.sources[self._arc]]
        self._transition = np.array(stages.net.origins, dtype=np.int64)[stages.labels[self._arc]]
        self._priority = stages.priorities[stages.labels[self._arc]]
        row = built.arc_row[self._arc]
        self._row = np.where(row >= 0, row_of[np.maximum(row, 0)], -1)
        self._present = problem.present.shares[self._arc]
        self._legal = np.ones(len(self._arc), dtype=bool)
        if problem.safety is not None:
            safe = problem.safety.safe
            self._legal = safe[stages.targets[self._arc]] | ~safe[stages.sources[self._arc]]
        # transitions of lower priority are not among the choices (chance is handled below)
        stage = stages.stage[stages.sources[self._arc]]
        lower = (self._row >= 0) & (stage == Stage.DECIDED)
        lower[lower] = ~team.by_policy[self._row[lower]]
        self._legal &= ~lower
        # pairs of a marking and a place
        pair = team.marking_of[self._state] * max(len(self._places), 1) + self._place
        self._pairs, self._pair = np.unique(pair, return_inverse=True)
        self._pair = self._pair.reshape(-1)
        self._marking = self._pairs // max(len(self._places), 1)
        self._pair_place = self._pairs % max(len(self._places), 1)
        self._robots = np.zeros(len(self._arc))
        plan_places = np.array(self._places, dtype=np.int64)
        groups = {g.at: g.place for g in stages.net.groups if g.step is Stage.DECIDED}
        for p, place in enumerate(plan_places.tolist()):
            at = np.flatnonzero(self._place == p)
            if place in groups:
                self._robots[at] = stages.space.column(groups[place], stages.sources[self._arc[at]])
        # the row of waiting and of chance in each state; -1: none
        automaton = team.automaton
        waits = np.flatnonzero((automaton.choices == WAIT) & self._allowed)
        self._wait = np.full(len(automaton), -1, dtype=np.int64)
        self._wait[automaton.row_states[waits]] = waits
        chance = built.chance_row[np.minimum(team.states_in, len(stages) - 1)]
        chance = np.where(team.twin, -1, chance)
        self._chance = np.where(chance >= 0, row_of[np.maximum(chance, 0)], -1)

    # -- values ------------------------------------------------------------------------------------

    def _worth(self, found: Any) -> Floats:
        """The value of each row (more is better) of a solution or an evaluation, including rows
        that may not be chosen."""
        team, automaton = self._team, self._team.automaton
        values = np.nan_to_num(found.values, nan=0.0, posinf=math.inf, neginf=-math.inf)
        arcs = automaton.arc_rows
        rows = len(automaton.choices)
        with np.errstate(invalid="ignore"):
            each = automaton.values * values[automaton.targets]
            if self._rewards is not None and self._objective.rewards:
                each = each + automaton.values * self._rewards.impulse
            own = np.bincount(arcs, weights=each, minlength=rows)
            worth = self._sign * np.where(np.isnan(found.row_values), own, found.row_values)
        if found.gains is not None:
            gains = self._sign * np.nan_to_num(found.gains)
            after = np.bincount(
                arcs, weights=automaton.values * gains[automaton.targets], minlength=rows
            )
            loses = after < gains[automaton.row_states] - 1e-9 * max(1.0, np.abs(gains).max())
            worth[loses & ~automaton.tangible[automaton.row_states]] = -math.inf
        unknown = np.isnan(found.values)[automaton.targets]
        if unknown.any():
            lost = np.zeros(rows, dtype=bool)
            lost[arcs[unknown]] = True
            worth[lost] = -math.inf
        worth = np.where(np.isnan(worth), -math.inf, worth)
        if self._goal is not None:
            worth[self._goal[automaton.row_states]] = 0.0
        assert len(worth) == len(team.rows_in)
        return worth

    def _tolerance(self, worth: Floats, tie: float) -> float:
        finite = worth[np.isfinite(worth)]
        return tie * max(1.0, float(np.abs(finite).max()) if len(finite) else 1.0)

    # -- the best solution -------------------------------------------------------------------------

    def best(self, solved: Solved) -> Grouped:
        """The decisions that come closest to a solution."""
        worth = self._worth(solved)
        notes: List[str] = []
        found: Optional[_Followed] = None
        chosen: Indices = np.zeros(0, dtype=np.int64)
        torn = chosen
        for tie in _TIES:
            chosen, torn, good = self._choose(worth, tie)
            chosen = self._advanced(chosen, good)
            found = self._evaluated(chosen)
            if len(torn) or (found is not None and reaches(found[1], solved, self._objective)):
                break
        if len(torn):
            notes.append(
                "in %d markings, states that a policy does not distinguish would decide "
                "differently; they decide the same way" % len(torn)
            )
            found, chosen = self._improved(found, chosen, torn, worth)
        if found is None:
            raise RefusedError("no decisions by marking were found that a run can follow")
        weights, evaluated, (decided, _, _) = found
        return Grouped(decided, weights, evaluated, self._silent(chosen), notes)

    def present(self) -> Optional[Grouped]:
        """The decisions of the present policy; None: they have no value, or are not allowed."""
        team, problem = self._team, self._team.problem
        try:
            weights = problem.weights_of(team, problem.plan.policy)
            evaluated = self._value(weights)
        except LimitError:
            raise
        except RefusedError:
            return None
        if ((weights > 0) & team.by_policy & ~self._allowed).any():
            return None
        notes = ["the present policy stays: no decisions by marking were found that are better"]
        return Grouped(present_choices(team), weights, evaluated, 0, notes, True)

    def better(self, one: Grouped, other: Grouped) -> bool:
        """Whether the decisions of one have at least the value of those of another."""
        return self._sign * one.evaluated.value >= self._sign * other.evaluated.value

    def _choose(self, worth: Floats, tie: float) -> Tuple[Indices, Indices, Booleans]:
        """The decision of each pair of a marking and a place, the markings whose states would
        decide differently, and the entries (boolean array) that are as good as any in all states of
        their pair."""
        automaton = self._team.automaton
        tolerance = self._tolerance(worth, tie)
        open_rows = np.where(self._allowed, worth, -math.inf)
        best = np.maximum.reduceat(open_rows, automaton.rows[:-1])
        valued = self._row >= 0
        allowed_rows = self._allowed[np.maximum(self._row, 0)]
        mine = worth[np.maximum(self._row, 0)]
        good = valued & self._legal & (mine >= best[self._state] - tolerance)
        # before chance has decided, a place only decides if that changes nothing
        good &= allowed_rows | ~(mine > best[self._state] + tolerance)

        # how many states of each pair ask, and in how many of them each transition is best
        places = max(len(self._places), 1)
        asking = np.unique(self._state[valued] * places + self._place[valued])
        pair_of = np.searchsorted(
            self._pairs,
            self._team.marking_of[asking // places] * places + asking % places,
        )
        states = np.bincount(pair_of, minlength=len(self._pairs))
        width = len(self._team.problem.plan.net.transitions)
        keys, of = np.unique(self._pair * width + self._transition, return_inverse=True)
        of = of.reshape(-1)
        pair, transition = keys // width, keys % width
        best_in = np.bincount(of, weights=good, minlength=len(keys))
        legal = np.bincount(of, weights=~self._legal, minlength=len(keys)) == 0
        present = np.zeros(len(keys))
        np.maximum.at(present, of, self._present)
        priority = np.zeros(len(keys), dtype=np.int64)
        priority[of] = self._priority
        everywhere = legal & (best_in == states[pair]) & (states[pair] > 0)

        chosen = np.full(len(self._pairs), OPEN, dtype=np.int64)
        order = np.lexsort((transition, -present, ~everywhere, pair))
        first = order[np.unique(pair[order], return_index=True)[1]]
        sure = first[everywhere[first]]
        chosen[pair[sure]] = transition[sure]
        ever = np.bincount(pair, weights=best_in, minlength=len(self._pairs)) > 0
        chosen[(chosen == OPEN) & ~ever & (states > 0)] = _SILENT
        # something else happens first in zero time: any decision will do
        order = np.lexsort((transition, -present, -priority, ~legal, pair))
        first = order[np.unique(pair[order], return_index=True)[1]]
        never = first[(states[pair[first]] == 0) & legal[first]]
        chosen[pair[never]] = transition[never]
        chosen[(chosen == OPEN) & (states == 0)] = _SILENT
        torn = np.zeros(len(self._team.distinct), dtype=bool)
        torn[self._marking[chosen == OPEN]] = True
        # until that is improved, take the decision that is best most often
        order = np.lexsort((transition, -present, -best_in, ~legal, pair))
        first = order[np.unique(pair[order], return_index=True)[1]]
        unsure = first[chosen[pair[first]] == OPEN]
        chosen[pair[unsure]] = np.where(legal[unsure], transition[unsure], _SILENT)
        self._keep_waiting(chosen, worth, best, tolerance)
        torn[self._stuck(chosen)] = True
        return chosen, np.flatnonzero(torn), good & everywhere[of]

    def _advanced(self, chosen: Indices, good: Booleans) -> Indices:
        """The decisions, replaced by equally good ones where a run would never reach a reachable
        goal or would cycle in zero time.

        :param good: boolean array over the entries: those that are equally good.
        """
        team, objective = self._team, self._objective
        automaton = team.automaton
        arrows = arrows_of(automaton)
        ends = np.zeros(len(automaton), dtype=bool) if self._goal is None else self._goal
        targets = [automaton.tangible | ends]
        if self._goal is not None and objective.maximise == (objective.aim is Aim.REACH):
            targets.insert(0, ends)
        possible = ~team.decides[automaton.row_states]
        possible[self._row[good]] = True
        taken = self._taken(chosen)
        for target in targets:
            able, _ = reaching(arrows, target, possible)
            while taken is not None:
                does, _ = reaching(arrows, target, taken)
                missing = able & ~does
                if not missing.any():
                    break
                _, after = reaching(arrows, does, possible)
                toward = rows_toward(arrows, after, possible)
                settled = np.zeros(len(self._pairs), dtype=bool)
                settled[self._pair[does[self._state]]] = True
                leading = good & missing[self._state] & (self._row == toward[self._state])
                leading &= ~settled[self._pair] & (self._transition != chosen[self._pair])
                if not leading.any():
                    break
                first = np.flatnonzero(leading)
                # entries that lead there directly take precedence over those that lead to another
                # one that must change
                near = does[after[self._state[first]]]
                order = first[np.lexsort((self._transition[first], -self._present[first], ~near))]
                pairs, at = np.unique(self._pair[order], return_index=True)
                chosen = chosen.copy()
                chosen[pairs] = self._transition[order[at]]
                taken = self._taken(chosen)
        return chosen

    def _taken(self, chosen: Indices) -> Optional[Booleans]:
        """Boolean array: the rows taken under some decisions; None: a run cannot follow them."""
        _, kind, kinds = self._decided(chosen, {})
        try:
            weights = self._team.problem.weights_of_decided(self._team, kind, kinds)
        except RefusedError:
            return None
        automaton = self._team.automaton
        taken: Booleans = (weights > 0) | automaton.tangible[automaton.row_states]
        return taken

    def _keep_waiting(self, chosen: Indices, worth: Floats, best: Floats, tolerance: float) -> None:
        """Let robots wait where waiting is equally good and the present policy waits."""
        team, problem = self._team, self._team.problem
        wait = self._wait >= 0
        good = np.zeros(len(wait), dtype=bool)
        good[wait] = worth[self._wait[wait]] >= best[wait] - tolerance
        waits = np.zeros(len(wait), dtype=bool)
        own = np.flatnonzero(~team.twin)
        waits[own] = problem.present.waits[team.states_in[own]] > 0.5
        stays = np.ones(len(team.distinct), dtype=bool)
        stays[team.marking_of[team.decides & ~(good & waits)]] = False
        asked = np.zeros(len(team.distinct), dtype=bool)
        asked[team.marking_of[team.decides]] = True
        chosen[(stays & asked)[self._marking]] = _SILENT

    def _stuck(self, chosen: Indices) -> Indices:
        """The markings with a state in which robots would wait although they must not."""
        team = self._team
        speaks = np.zeros(len(team.automaton), dtype=bool)
        speaks[self._state[(chosen[self._pair] == self._transition) & (self._row >= 0)]] = True
        stuck = team.decides & ~speaks & (self._wait < 0)
        if team.problem.safety is not None:
            own = np.minimum(team.states_in, len(team.problem.stages) - 1)
            stuck &= team.problem.safety.safe[own]
        return np.unique(team.marking_of[stuck])

    # -- markings whose states disagree ------------------------------------------------------------

    def _improved(
        self,
        found: Optional[_Followed],
        chosen: Indices,
        torn: Indices,
        worth: Floats,
    ) -> Tuple[Optional[_Followed], Indices]:
        """Improve the decisions of the markings ``torn`` until no change is better."""
        best, best_chosen = found, chosen
        seen = {chosen.tobytes()}
        for _ in range(_ROUNDS):
            visits = np.ones(len(self._team.automaton))
            if best is not None:
                weights, evaluated, _ = best
                flow = np.bincount(
                    self._team.automaton.row_states,
                    weights=evaluated.flow,
                    minlength=len(self._team.automaton),
                )
                visits = np.maximum(flow, 1e-9 * max(float(flow.max()), 1e-12))
            chosen = self._better(best_chosen, torn, worth, visits)
            if chosen.tobytes() in seen:
                break
            seen.add(chosen.tobytes())
            now = self._evaluated(chosen)
            if now is not None and (
                best is None
                or self._sign * now[1].value
                > self._sign * best[1].value + 1e-13 * abs(best[1].value)
            ):
                best, best_chosen = now, chosen
            if best is None:
                break
            worth = self._worth(best[1])
        return best, best_chosen

    def _better(self, chosen: Indices, torn: Indices, worth: Floats, visits: Floats) -> Indices:
        """Better decisions of the markings ``torn``, one after the other."""
        chosen = chosen.copy()
        by_marking = np.argsort(self._marking[self._pair], kind="stable")
        markings = self._marking[self._pair][by_marking]
        for g in torn.tolist():
            self._watch.step("markings", g)
            first, last = np.searchsorted(markings, [g, g + 1])
            entries = by_marking[first:last]
            self._better_one(chosen, entries[self._row[entries] >= 0], worth, visits)
        return chosen

    def _better_one(self, chosen: Indices, entries: Indices, worth: Floats, visits: Floats) -> None:
        """Better decisions of one marking, with these entries."""
        pairs = np.unique(self._pair[entries]).tolist()
        options: List[List[int]] = []
        for pair in pairs:
            mine = entries[self._pair[entries] == pair]
            bad = set(self._transition[mine[~self._legal[mine]]].tolist())
            can = [t for t in np.unique(self._transition[mine]).tolist() if t not in bad]
            options.append([int(chosen[pair]), *(t for t in can if t != chosen[pair]), _SILENT])
        states = np.unique(self._state[entries]).tolist()
        rows: Dict[int, List[Tuple[int, int, float, float]]] = {s: [] for s in states}
        index = {pair: i for i, pair in enumerate(pairs)}
        arrays = self._state, self._pair, self._transition, self._robots
        listed = [array[entries].tolist() for array in arrays]
        for s, pair, t, robots, value in zip(*listed, worth[self._row[entries]].tolist()):
            rows[s].append((index[pair], t, robots, value))

        def total(way: Sequence[int]) -> float:
            whole = 0.0
            for s in states:
                ready = [(n, v) for i, t, n, v in rows[s] if way[i] == t]
                if ready:
                    robots = sum(n for n, _ in ready)
                    value = sum(n * v for n, v in ready if n) / robots
                elif self._chance[s] >= 0:
                    value = float(worth[self._chance[s]])
                elif self._wait[s] >= 0:
                    value = float(worth[self._wait[s]])
                else:
                    return -math.inf
                if value == -math.inf:
                    return value
                whole += float(visits[s]) * value
            return whole

        now = tuple(o[0] for o in options)
        best, way = total(now), now
        if math.prod([len(o) for o in options]) <= _COMBINATIONS:
            candidates: Iterable[Tuple[int, ...]] = itertools.product(*options)
        else:
            candidates = ((*now[:i], t, *now[i + 1 :]) for i, o in enumerate(options) for t in o)
        margin = 1e-12 * max(1.0, abs(best)) if math.isfinite(best) else 0.0
        for candidate in candidates:
            value = total(candidate)
            if value > best + margin:
                best, way = value, candidate
        for pair, t in zip(pairs, way):
            chosen[pair] = t

    # -- randomised policies -----------------------------------------------------------------------

    def drawn(self, weights: Floats) -> Grouped:
        """The decisions that come closest to a randomised policy. Where it mixes the decisions of
        several places, only one of them decides."""
        team, automaton = self._team, self._team.automaton
        evaluated = self._value(weights)
        flow = evaluated.flow
        visited = np.bincount(automaton.row_states, weights=flow, minlength=len(automaton))
        each = np.where(visited[automaton.row_states] > 0, flow, weights)
        mine = np.where(self._row >= 0, each[np.maximum(self._row, 0)], 0.0)
        # the place that decides in each state, and its share
        places = max(len(self._places), 1)
        keys, of = np.unique(self._state * places + self._place, return_inverse=True)
        strength = np.bincount(of.reshape(-1), weights=mine, minlength=len(keys))
        order = np.lexsort((-strength, keys // places))
        first = order[np.unique((keys // places)[order], return_index=True)[1]]
        winner = np.full(len(automaton), -1, dtype=np.int64)
        winner[(keys // places)[first]] = (keys % places)[first]
        wait = np.zeros(len(automaton))
        wait[automaton.row_states[automaton.choices == WAIT]] = each[automaton.choices == WAIT]
        moves = np.bincount(self._state, weights=mine, minlength=len(automaton))
        stays = wait > moves
        mixed = np.zeros(len(automaton), dtype=bool)
        second = np.bincount(keys // places, weights=strength > 0, minlength=len(automaton)) > 1
        mixed |= second | ((wait > 0) & (moves > 0))
        counts = (mine > 0) & (winner[self._state] == self._place) & ~stays[self._state]
        sure, _, _ = self._choose(self._worth(evaluated), _TIES[0])
        amount: Dict[int, Dict[int, float]] = {}
        for e in np.flatnonzero(counts).tolist():
            found = amount.setdefault(int(self._pair[e]), {})
            t = int(self._transition[e])
            found[t] = found.get(t, 0.0) + float(mine[e])
        spoken = np.zeros(len(team.distinct), dtype=bool)
        spoken[self._marking[[*amount]]] = True
        resting = np.zeros(len(team.distinct), dtype=bool)
        resting[team.marking_of[stays & team.decides]] = True
        chosen = np.where((spoken | resting)[self._marking], _SILENT, sure)
        single = {pair: next(iter(d)) for pair, d in amount.items() if len(d) == 1}
        for pair, t in single.items():
            chosen[pair] = t
        several = {pair: _normalised(d) for pair, d in amount.items() if len(d) > 1}
        result = self._evaluated(chosen, several)
        if result is None:
            raise RefusedError("no decisions by marking were found that a run can follow")
        own, found_value, (decided, _, _) = result
        notes = []
        if (mixed & team.decides & (visited > 0)).any():
            notes.append(
                "where the best policy randomises between places, or going and waiting, only "
                "one of them decides"
            )
        return Grouped(decided, own, found_value, self._silent(chosen), notes)

    # -- the result ----------------------------------------------------------------------------

    def _silent(self, chosen: Indices) -> int:
        return int((chosen == _SILENT).sum())

    def _value(self, weights: Floats) -> Evaluated:
        return evaluate_policy(
            self._team.automaton,
            self._objective.aim,
            self._rewards,
            weights,
            goal=self._goal,
            discount=self._objective.discount,
            watch=self._watch,
        )

    def _evaluated(
        self, chosen: Indices, several: Optional[Mapping[int, Mapping[int, float]]] = None
    ) -> Optional[_Followed]:
        """The rows, the value and the decisions; None if a run cannot follow them."""
        decided = self._decided(chosen, several or {})
        try:
            weights = self._team.problem.weights_of_decided(self._team, decided[1], decided[2])
            return weights, self._value(weights), decided
        except RefusedError:
            if several is not None:
                raise
            return None

    def _decided(
        self, chosen: Indices, several: Mapping[int, Mapping[int, float]]
    ) -> Tuple[Decided, Indices, List[Dict[int, float]]]:
        """The decisions: for export, and as the number of each marking's decision with the
        decisions."""
        team, table = self._team, self._table
        places = len(self._places)
        columns = np.full((len(team.distinct), places + len(table.chance)), _SILENT, dtype=np.int64)
        columns[self._marking, self._pair_place] = chosen
        width = len(team.problem.plan.net.transitions)
        drawn = sorted(several)
        for i, pair in enumerate(drawn):
            columns[self._marking[pair], self._pair_place[pair]] = width + i
        for i, (numbers, _) in enumerate(table.chance):
            columns[:, places + i] = numbers
        first, kind = distinct_rows(columns + 1)
        kinds: List[Dict[int, float]] = []
        for row in columns[first].tolist():
            parts: List[Mapping[int, float]] = []
            for t in row[:places]:
                if t >= 0:
                    parts.append({t: 1.0} if t < width else several[drawn[t - width]])
            for number, (_, sets) in zip(row[places:], table.chance):
                if number != _SILENT:
                    parts.append(sets[number])
            whole: Dict[int, float] = {}
            for part in parts:
                for t, v in part.items():
                    whole[t] = whole.get(t, 0.0) + v / len(parts)
            kinds.append(whole)
        names = [t.name for t in team.problem.plan.net.transitions]
        needed = np.flatnonzero(table.needed)
        texts = [{names[t]: v for t, v in choice.items()} for choice in kinds]
        decided = Decided(team.distinct[needed], tuple([texts[k] for k in kind[needed].tolist()]))
        return decided, kind, kinds

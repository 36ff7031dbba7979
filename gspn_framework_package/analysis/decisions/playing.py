"""What a policy does in the states of a decision problem: the probability that each request is the
first to fire, by the rules of the plan (``docs/semantics.md``)."""

from __future__ import annotations

from typing import Dict, List, Mapping, NamedTuple, Sequence, Tuple, Union

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.decisions.building import Stages
from gspn_framework_package.analysis.decisions.decision_net import Group, Stage
from gspn_framework_package.analysis.plan.policy_answers import PolicyAnswers, distinct_rows
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Choices, Policy
from gspn_framework_package.run_net.requests import Requests, candidates, first_to_fire

ROUNDING = 1e-12
"""A probability below this is a rounding error."""


class Play(NamedTuple):
    """What a policy does in each state in which robots ask.

    :ivar shares: float array, one value per arc: the probability that it is the first to fire.
    :ivar waits: float array, one value per state: the probability that none fires.
    :ivar unsettled: boolean array, one value per state: the run would have to know more than the
      state shows: what a robot has drawn before.
    """

    shares: Floats
    waits: Floats
    unsettled: Booleans


def answers_of(plan: Plan, policy: Policy, stages: Stages) -> PolicyAnswers:
    """The answers of a policy to a robot that asks for a decision. Where it says nothing, the
    weights of the net decide, or nothing if the plan is strict."""

    def counts(p: int, states: Indices) -> Indices:
        q = stages.net.place_of[p]
        tokens = plan.net.places[p].tokens
        return stages.space.column(q, states) if q >= 0 else np.full(len(states), tokens)

    return PolicyAnswers(plan.net, policy, counts)


class DecidedAnswers:
    """The answers of decisions, state by state.

    :param kind: int array: for each state the number of its decision; -1: none, so it waits.
    :param kinds: the decisions: transition (of the plan's net) -> probability.
    """

    def __init__(self, plan: Plan, kind: Indices, kinds: Sequence[Mapping[int, float]]) -> None:
        self._net = plan.net
        self._kind = kind
        self._kinds = kinds

    def of(self, place: int, states: Indices) -> Tuple[Indices, List[Choices]]:
        """As :meth:`PolicyAnswers.of`; the first answer is not used."""
        mine = self._net.immediate_from[place]
        numbers: Dict[Choices, int] = {}
        answers: List[Choices] = [()]
        number = np.zeros(len(self._kinds) + 1, dtype=np.int64)
        for k, decision in enumerate(({}, *self._kinds)):  # -1: waits
            here = [(t, v) for t, v in decision.items() if t in mine and v > 0]
            total = sum(v for _, v in here)
            choices = tuple((t, v / total) for t, v in here)
            if choices not in numbers:
                numbers[choices] = len(answers)
                answers.append(choices)
            number[k] = numbers[choices]
        return number[self._kind[states] + 1], answers


class _Askers(NamedTuple):
    """The robots of a group, in the states in which one of their requests can fire.

    :ivar states: these states.
    :ivar robots: their number.
    :ivar levels: the priority of their requests.
    :ivar able: the probability that a robot asks for something that can fire.
    :ivar arcs: what can fire.
    :ivar chances: the probability that a robot that asks for any of these asks for it.
    """

    states: Indices
    robots: Indices
    levels: Indices
    able: Floats
    arcs: Indices
    chances: Floats


def play_answers(
    plan: Plan,
    answers: Union[PolicyAnswers, DecidedAnswers],
    stages: Stages,
    draws_last: bool,
) -> Play:
    """What a policy does that gives these answers.

    :param draws_last: whether a draw holds until the marking changes, as in the run; in the
        classical reading it does not.
    """
    return _Player(plan, answers, stages, draws_last).play()


class _Player:
    def __init__(
        self,
        plan: Plan,
        answers: Union[PolicyAnswers, DecidedAnswers],
        stages: Stages,
        draws_last: bool,
    ) -> None:
        self._plan = plan
        self._reported = answers
        self._stages = stages
        self._draws_last = draws_last

    def play(self) -> Play:
        stages = self._stages
        count = len(stages)
        shares = np.zeros(len(stages.labels), dtype=np.float64)
        waits = np.zeros(count, dtype=np.float64)
        unsettled = np.zeros(count, dtype=bool)
        asked = (stages.stage == Stage.NAMED) | (stages.stage == Stage.DECIDED)
        groups = [g for g in stages.net.groups if g.step in (Stage.NAMED, Stage.DECIDED)]
        by_part: Dict[int, List[Group]] = {}
        for group in groups:
            by_part.setdefault(group.place, []).append(group)
        found = [(part[0], self._askers(part, asked)) for part in by_part.values()]
        waits[asked] = 1.0
        codes = np.zeros((count, len(found)), dtype=np.int32)
        kinds: List[Requests] = []
        levels: List[int] = []
        for i, (_, askers) in enumerate(found):
            ables, of_able = np.unique(np.round(askers.able, 15), return_inverse=True)
            wide = max(len(ables), 1)
            deep = int(askers.levels.max(initial=0)) + 1
            keys = (askers.robots * deep + askers.levels) * wide + of_able.reshape(-1)
            unique, of = np.unique(keys, return_inverse=True)
            codes[askers.states, i] = len(kinds) + 1 + of.reshape(-1)
            for key in unique.tolist():
                robots, level = divmod(key // wide, deep)
                kinds.append(Requests(robots, {i: float(ables[key % wide])}))
                levels.append(level)
        some = np.flatnonzero(codes.any(axis=1)) if found else np.zeros(0, dtype=np.int64)
        if len(some):
            first, kind = distinct_rows(codes[some])
            firsts = np.zeros((len(first), len(found)))
            stays = np.empty(len(first))
            for k, row in enumerate(codes[some[first]].tolist()):
                present = [c - 1 for c in row if c]
                urgency = [0] * len(found)
                for c in present:
                    for i in kinds[c].draw:
                        urgency[i] = levels[c]
                for chances in first_to_fire([kinds[c] for c in present], urgency):
                    for i, v in chances.items():
                        firsts[k, i] = v
                stays[k] = max(1.0 - firsts[k].sum(), 0.0)
                if stays[k] <= ROUNDING:
                    stays[k] = 0.0
                    firsts[k] /= firsts[k].sum()
            waits[some] = stays[kind]
            place = np.full(count, -1, dtype=np.int64)
            place[some] = kind
            for i, (_, askers) in enumerate(found):
                if len(askers.arcs):
                    source = stages.sources[askers.arcs]
                    shares[askers.arcs] += askers.chances * firsts[place[source], i]
            if self._draws_last:
                for _, askers in found:
                    chancy = (askers.able < 1 - ROUNDING) & (askers.able > ROUNDING)
                    unsettled[askers.states[chancy]] = True
        return Play(shares, waits, unsettled)

    def _askers(self, groups: List[Group], asked: Booleans) -> _Askers:
        """The robots of groups in one place."""
        stages = self._stages
        arcs, chances = stages.ways(groups)
        now = asked[stages.sources[arcs]]
        arcs, chances = arcs[now], chances[now]
        if groups[0].named:
            levels = stages.priorities[stages.labels[arcs]]
            states = stages.sources[arcs].astype(np.int64)
            able = np.ones(len(arcs))
        else:
            arcs, chances, states, levels, able = self._drawn(groups[0], arcs, chances)
        robots = stages.space.column(groups[0].place, states)
        return _Askers(states, robots, levels, able, arcs, chances)

    def _drawn(
        self, group: Group, arcs: Indices, ways: Floats
    ) -> Tuple[Indices, Floats, Indices, Indices, Floats]:
        """What robots at the policy draw: the arcs, the chance of each among those that can fire;
        their states, the priority there, and the probability of drawing any of them."""
        stages, net = self._stages, self._plan.net
        states = np.flatnonzero(stages.has(arcs))
        number = np.full(len(stages), -1, dtype=np.int64)
        number[states] = np.arange(len(states))
        of_arc = number[stages.sources[arcs]]
        answer, answers = self._reported.of(group.at, states)
        leaving = list(net.immediate_from[group.at])
        local = np.full(len(net.transitions), -1, dtype=np.int64)
        local[leaving] = np.arange(len(leaving))
        origins = local[np.array(stages.net.origins)[stages.labels[arcs]]]
        by_net = [[] if t in net.functions else [net.transitions[t].number] for t in leaving]
        value = np.ones(len(arcs), dtype=np.int64)  # of each arc: which of these, from 1
        for i in [i for i, t in enumerate(leaving) if t in net.functions]:
            mine = np.flatnonzero(origins == i)
            found, of = np.unique(stages.weights(arcs[mine]), return_inverse=True)
            by_net[i] = found.tolist()
            value[mine] += of.reshape(-1)
        # of each kind of states, with the same answer, the same transitions that can fire and the
        # same weights of the net: the share of each, the highest priority, and the probability of
        # drawing one of them
        most = max(len(answers), *map(len, by_net), 1)
        ready = np.zeros((len(states), len(leaving) + 1), dtype=np.min_scalar_type(most))
        ready[of_arc, origins] = value
        ready[:, -1] = answer
        first, kind = distinct_rows(ready)
        weights = np.zeros((len(first), len(leaving)))
        level = np.zeros(len(first), dtype=np.int64)
        able = np.zeros(len(first))
        for k, (*fires, answered) in enumerate(ready[first].tolist()):
            can = {t: values[i - 1] for t, values, i in zip(leaving, by_net, fires) if i}
            weighed = () if self._plan.strict else can.items()
            drawn = candidates(net, answers[answered] if answered else weighed, can.keys())
            for t, v in drawn:
                if t in can:
                    weights[k, local[t]] = v
                    level[k] = max(level[k], net.transitions[t].priority)
            able[k] = weights[k].sum()
            if able[k] > 0:
                weights[k] /= able[k]
                able[k] = min(able[k] / sum(v for _, v in drawn), 1.0)
        chances = weights[kind[of_arc], origins] * ways
        some = able[kind] > 0
        return (
            arcs[chances > 0],
            chances[chances > 0],
            states[some],
            level[kind[some]],
            able[kind[some]],
        )

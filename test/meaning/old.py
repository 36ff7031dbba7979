"""The statements that the package has today, as steps (see :class:`~meaning.numbers.Steps`)."""

from __future__ import annotations

from typing import Any, FrozenSet, Hashable, List, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.decisions.problem import DecisionProblem
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.plan.markings import PlanMarkings
from gspn_framework_package.analysis.plan.reading import RUN
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming
from gspn_framework_package.run_net.compiling import compile_plan
from gspn_framework_package.run_net.literal import literal_net
from gspn_framework_package.run_net.steps import Steps
from meaning.numbers import MOST_STATES, Marking, TooManyStatesError


class ExploredSteps:
    """Steps as ``analysis/plan/space.py`` explores them.

    :param plan: the plan.
    :param steps: an object with ``start``, ``expand`` and ``markings``, for the plan's net without
        the places ``left_out``. Numbers of transitions beyond those of the net are steps in which
        nothing fires.
    """

    def __init__(self, plan: Plan, steps: Any, left_out: Sequence[str]) -> None:
        self._steps, self._places = steps, plan.net.places
        left = plan.net.without_places(left_out)
        self._number = [plan.net.transition_number(t.name) for t in left.transitions]
        self._columns = [plan.net.place_number(p.name) for p in left.places]
        self.start: Hashable = steps.start

    def expand(self, state: Any) -> Tuple[bool, List[Tuple[Hashable, int, float]]]:
        """See :class:`~meaning.numbers.Steps`."""
        at_once, found = self._steps.expand(state)
        known = len(self._number)
        return at_once, [(s, self._number[t] if t < known else -1, v) for s, t, v in found]

    def marking(self, state: Any) -> Marking:
        """See :class:`~meaning.numbers.Steps`."""
        full = [0] * len(self._places)
        for p, count in zip(self._columns, self._steps.markings([state])[0].tolist()):
            full[p] = count
        return tuple(full)


def chain(plan: Plan) -> ExploredSteps:
    """The run net of the plan as it runs: ``--timing run``."""
    run_net = compile_plan(plan, PlanTiming(plan))
    return ExploredSteps(plan, Steps(run_net), run_net.counters)


def net_chain(plan: Plan) -> ExploredSteps:
    """The run net in the classical reading: ``--timing net``."""
    run_net = compile_plan(plan, None)
    return ExploredSteps(plan, Steps(run_net), run_net.counters)


class ClosedSteps:
    """The optimiser's net, in which the plan's own policy makes the choices.

    :raises RefusedError: it cannot express the plan, or what the policy does depends on more than
        its states show.
    """

    def __init__(self, plan: Plan, reading: str = RUN) -> None:
        problem = DecisionProblem(
            plan, reading=reading, team_sizes=None, limits=Limits(states=20 * MOST_STATES)
        )
        team = problem.teams[0]
        self._automaton = automaton = team.automaton
        self._weights = problem.weights_of(team, plan.policy)
        self._markings = team.markings
        self._counters = [plan.net.place_number(name) for name in problem.left_out]
        self._initial = automaton.initial
        self.start: Hashable = -1

    def expand(self, state: Any) -> Tuple[bool, List[Tuple[Hashable, int, float]]]:
        """See :class:`~meaning.numbers.Steps`."""
        automaton = self._automaton
        if state < 0:
            return True, [(s, -1, v) for s, v in self._initial]
        found: List[Tuple[Hashable, int, float]] = []
        for row in range(automaton.rows[state], automaton.rows[state + 1]):
            weight = float(self._weights[row])
            if weight > 0:
                for arc in range(automaton.arcs[row], automaton.arcs[row + 1]):
                    value = float(automaton.values[arc]) * weight
                    found.append((int(automaton.targets[arc]), int(automaton.fired[arc]), value))
        return not automaton.tangible[state], found

    def marking(self, state: Any) -> Marking:
        """See :class:`~meaning.numbers.Steps`."""
        full = np.array(self._markings[state])
        full[self._counters] = 0
        return tuple(full.tolist())


class LiteralSteps:
    """The run net as an ordinary net, by the firing rule of nets. States in which one step is
    certain, and nothing fires in the plan, are passed over.

    :raises RefusedError: an ordinary net cannot express the plan.
    """

    def __init__(self, plan: Plan, reading: str = RUN) -> None:
        literal = literal_net(compile_plan(plan, PlanTiming(plan) if reading == RUN else None))
        self._net = net = literal.net
        self._fired = [
            plan.net.transition_number(meaning.of) if meaning.fires else -1
            for meaning in (literal.transitions[t.name] for t in net.transitions)
        ]
        self._places = len(plan.net.places)
        self._columns = [
            (plan.net.place_number(place), net.place_number(name))
            for place, name in literal.counts.items()
        ]
        self.start: Hashable = self._settled(net.initial_marking)

    def expand(self, state: Any) -> Tuple[bool, List[Tuple[Hashable, int, float]]]:
        """See :class:`~meaning.numbers.Steps`."""
        net, enabled = self._net, self._net.enabled(state)
        at_once = bool(enabled) and not net.transitions[enabled[0]].timed
        values = [net.value(state, t) if at_once else net.effective_rate(state, t) for t in enabled]
        whole = sum(values) if at_once else 1.0
        return at_once, [
            (self._settled(net.fire(state, t)), self._fired[t], value / whole)
            for t, value in zip(enabled, values)
        ]

    def _settled(self, state: Any) -> Any:
        while True:
            enabled = self._net.enabled(state)
            if len(enabled) != 1 or self._fired[enabled[0]] >= 0:
                return state
            if self._net.transitions[enabled[0]].timed:
                return state
            state = self._net.fire(state, enabled[0])

    def marking(self, state: Any) -> Marking:
        """See :class:`~meaning.numbers.Steps`."""
        full = [0] * self._places
        for p, column in self._columns:
            full[p] = state[column]
        return tuple(full)


def untimed(plan: Plan, limit: int, losses: bool) -> FrozenSet[Marking]:
    """The markings that the check before a run reaches (``markings``); places that only count are
    0.

    :param limit: the most markings.
    :param losses: whether robots can be lost.
    :raises TooManyStatesError: there are more.
    """
    found = PlanMarkings(plan, limit, losses=losses)
    if not found.complete:
        raise TooManyStatesError
    ways = found._ways_with_losses if losses else found._ways
    states = np.flatnonzero(ways.reached)
    whole = np.zeros((len(states), len(plan.net.places)), dtype=np.int64)
    whole[:, [found.original(p) for p in range(len(found.net.places))]] = found.space.markings(
        states
    )
    return frozenset(map(tuple, whole.tolist()))

"""Comparisons of the statements of the meaning: each takes a plan and lists the differences.

Those between exact statements hold to the last digits. Those with a simulation are tests with a
budget for false alarms: a measure that is farther from its exact mean than ``SUSPECT`` standard
errors is measured again, with new random numbers and ``AGAIN`` times as many runs, and must then
be within ``CERTAIN`` ones. A measure without a fault passes the second test by chance with a
probability of less than ``FALSE_ALARM``; a fault shows the more there, since the errors shrink.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any, Callable, Dict, FrozenSet, List, NamedTuple, Optional, Sequence, Tuple
from unittest import mock

import numpy as np
from scipy.stats import norm

from gspn_framework_package.analysis.decisions.aims import Objective, Request
from gspn_framework_package.analysis.decisions.optimise import optimise
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.plan.reading import NET, RUN
from gspn_framework_package.analysis.simulation import machine, policy_book, simulate
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from meaning import old
from meaning.numbers import (
    END_RATES,
    MOST_STATES,
    EndlessError,
    Marking,
    Numbers,
    SolvedChain,
    Steps,
    TooManyStatesError,
    differences,
    numbers_of,
)
from meaning.plans import FAMILIES, WORK, Sample
from meaning.run_steps import NetRunSteps, RunSteps

TIME = 8.0
"""The length of a simulated run (s)."""

RUNS, AGAIN = 250, 16
"""The number of runs of a first test, and how many times as many a second one has."""

SUSPECT, CERTAIN = 3.0, 6.0
FALSE_ALARM = 2 * float(norm.sf(CERTAIN))
"""See the module. A million measures together give a false alarm with a probability of 0.002."""

Measure = Callable[[int, int], Any]
"""Called with a number of runs and a seed; returns an array with a row for each run: firings of
each transition, then token-seconds of each place."""


def compare(plan: Plan, one: Steps, other: Steps) -> List[str]:
    """What two statements say differently about a plan, for people; empty if they agree.

    :raises TooManyStatesError: one of them has too many states.
    """
    count = len(plan.net.transitions)
    return differences(numbers_of(one, count), numbers_of(other, count))


def exponential(plan: Plan) -> Plan:
    """The plan with exponential durations of the same means, as the optimiser takes them."""
    durations = {
        p: Duration.exponential(d.mean) if d.mean > 0 else d for p, d in plan.durations.items()
    }
    return replace(plan, durations=durations)


def busy(plan: Plan) -> Plan:
    """The plan as the check sees it: in every place where robots decide they are busy for a while,
    and priorities count for nothing."""
    net = plan.net
    deciding = {
        p: Duration.exponential(1.0)
        for p in plan.action_places
        if any(not net.transitions[t].timed for t in net.consumers[net.place_number(p)])
    }
    transitions = [t._replace(priority=1) for t in net.transitions]
    return replace(
        plan,
        net=Net(net.places, transitions, net.arcs, net.name),
        actions=dict.fromkeys(plan.action_places, WORK),
        durations={**deciding, **plan.durations},
    ).validate()


class Case:
    """A sample, with what the run says about it. That is computed once, on first use."""

    def __init__(self, sample: Sample) -> None:
        self.name, self.plan, self.losses = sample
        self.family = sample.name.split()[0]

    def numbers(self, steps: Steps) -> Numbers:
        """The numbers of a statement about the plan."""
        return numbers_of(steps, len(self.plan.net.transitions))

    @cached_property
    def run(self) -> Numbers:
        """The run."""
        return self.numbers(RunSteps(self.plan, failing=True))

    @cached_property
    def exponential_run(self) -> Numbers:
        """The same with exponential durations."""
        return self.numbers(RunSteps(exponential(self.plan), failing=True))

    @cached_property
    def net_run(self) -> Numbers:
        """The classical reading."""
        return self.numbers(NetRunSteps(self.plan))

    @cached_property
    def expected(self) -> Any:
        """Expected firings and token-seconds of a run of ``TIME`` seconds, in which actions fail and
        robots are lost."""
        steps = RunSteps(self.plan, losses=self.losses, failing=True)
        return self._means(steps, steps.over)

    @cached_property
    def expected_of_net(self) -> Any:
        """The same for the classical reading."""
        steps = NetRunSteps(self.plan)
        return self._means(steps, steps.over)

    @cached_property
    def markings(self) -> Tuple[FrozenSet[Marking], FrozenSet[Marking]]:
        """The markings of the run and of the ``busy`` plan's."""
        count = len(self.plan.net.transitions)
        steps = RunSteps(self.plan, losses=self.losses, failing=True)
        slow = RunSteps(busy(self.plan), failing=True)
        return (
            frozenset(SolvedChain(steps, count).markings),
            frozenset(SolvedChain(slow, count).markings),
        )

    def _means(self, steps: Steps, over: Callable[[Any], bool]) -> Any:
        chain = SolvedChain(steps, len(self.plan.net.transitions), over)
        tokens, fired = chain.until(TIME)
        return np.concatenate([fired, tokens])


# -- exact -----------------------------------------------------------------------------------------


def chain_and_run(case: Case) -> List[str]:
    """``--timing run`` against the run."""
    return differences(case.numbers(old.chain(case.plan)), case.run)


def literal_and_run(case: Case) -> List[str]:
    """The run net as an ordinary net against the run."""
    return differences(case.numbers(old.LiteralSteps(case.plan)), case.run)


def literal_and_net(case: Case) -> List[str]:
    """The same for the classical reading."""
    return differences(case.numbers(old.LiteralSteps(case.plan, NET)), case.net_run)


def net_and_run(case: Case) -> List[str]:
    """``--timing net`` against the choices of the run in the race of the net."""
    return differences(case.numbers(old.net_chain(case.plan)), case.net_run)


def optimiser_and_run(case: Case) -> List[str]:
    """The optimiser's net, closed by the plan's own policy, against the run."""
    plan = exponential(case.plan)
    return differences(case.numbers(old.ClosedSteps(plan, RUN)), case.exponential_run)


def optimiser_and_net(case: Case) -> List[str]:
    """The same for the classical reading. Not for plans in which an action always names what comes
    next: there the optimiser says that the action decides, ``--timing net`` that the weights do."""
    if any("" not in named for named in case.plan.outcomes.values()):
        return []
    return differences(case.numbers(old.ClosedSteps(case.plan, NET)), case.net_run)


def optimum_and_run(case: Case) -> List[str]:
    """The best policy is worth in the run what the optimiser says, and no less than the present
    one, unless the optimiser says that another may be better: until an end at a constant rate, which is
    what the optimiser calls a discount."""
    rate = END_RATES[1]
    present = case.exponential_run.fired[rate]
    number = max(range(len(present)), key=present.__getitem__)
    name = case.plan.net.transitions[number].name
    request = Request(Objective.discounted({name: 1.0}, rate), limits=Limits(states=MOST_STATES))
    report = optimise(exponential(case.plan), request, simulated=0.0)
    value = report.teams[0].value
    if not report.exact or value is None:
        return []
    worth = case.numbers(RunSteps(exponential(report.plan), failing=True)).fired[rate][number]
    found = []
    if abs(value - worth) > 1e-9 * max(1.0, worth):
        found.append(
            "%s is worth %.12g, says the optimiser; %.12g in the run" % (name, value, worth)
        )
    if worth < present[number] * (1.0 - 1e-9) and not report.undecided:
        found.append("%s: %.12g before, %.12g after" % (name, present[number], worth))
    return found


def check_and_run(case: Case) -> List[str]:
    """The untimed markings of the check hold those of the run. Where durations alone keep a robot
    from moving, they are those of the busy plan."""
    found: List[str] = []
    passed, slow = case.markings
    for what, plan, seen, losses, exact in (
        ("run", case.plan, passed, bool(case.losses), False),
        ("busy plan", busy(case.plan), slow, False, case.family in UNTIMED),
    ):
        told = old.untimed(plan, 10 * MOST_STATES, losses)
        if seen - told:
            found.append("markings of the %s alone: %s" % (what, sorted(seen - told)[:3]))
        if exact and told - seen:
            found.append("markings of the check alone: %s" % sorted(told - seen)[:3])
    return found


# -- simulated -------------------------------------------------------------------------------------


def simulation_and_run(case: Case) -> List[str]:
    """The kernel against the run."""

    # small plans have few rows: look in every other one's as if they were many
    few = 0 if int(case.name.split()[-1]) % 2 else policy_book.FEW_ENTRIES

    def measure(runs: int, seed: int) -> Any:
        with mock.patch.object(machine, "numba_is_there", lambda: False), mock.patch.object(
            policy_book, "FEW_ENTRIES", few
        ):
            samples = simulate(
                case.plan,
                time=TIME,
                replications=runs,
                seed=seed,
                losses=case.losses,
                samples=True,
            ).samples
        assert samples is not None
        return np.column_stack([samples.firings, samples.tokens])

    return _measured(case, measure, case.expected)


def table_and_run(case: Case) -> List[str]:
    """The simulation of the classical reading, by ``state_cache``."""

    net = case.plan.net
    left_out = case.plan.counters
    columns = [i for i, place in enumerate(net.places) if place.name not in left_out]

    def measure(runs: int, seed: int) -> Any:
        samples = simulate(
            case.plan, time=TIME, replications=runs, seed=seed, timing=NET, samples=True
        ).samples
        assert samples is not None
        tokens = np.zeros((runs, len(net.places)))
        tokens[:, columns] = samples.tokens
        return np.column_stack([samples.firings, tokens])

    return _measured(case, measure, case.expected_of_net)


def virtual_and_run(case: Case) -> List[str]:
    """``virtual_time`` against the run that it drives."""

    def measure(runs: int, seed: int) -> Any:
        rows = []
        for k in range(runs // 2):
            run = VirtualRun(case.plan, seed=seed * 1_000_003 + k, loss_rate=case.losses)
            result = run.run(time=TIME)
            tokens = [result.mean_tokens[p.name] * result.seconds for p in case.plan.net.places]
            fired = [result.firings[t.name] for t in case.plan.net.transitions]
            rows.append([*fired, *(tokens if result.seconds else [0.0] * len(tokens))])
        return np.array(rows, dtype=float)

    return _measured(case, measure, case.expected)


def _measured(case: Case, measure: Measure, expected: Any) -> List[str]:
    """The measures that are too far from what is expected of them."""
    net = case.plan.net
    names = [*(t.name for t in net.transitions), *(p.name for p in net.places)]
    left_out = case.plan.counters
    counted = np.array([name not in left_out for name in names])
    if not (_distance(measure(RUNS, 1), expected) * counted > SUSPECT).any():
        return []
    rows = measure(RUNS * AGAIN, 2)
    distance = _distance(rows, expected) * counted
    return [
        "%s: %.6g expected, %.6g simulated, %.1f standard errors apart"
        % (names[i], expected[i], rows[:, i].mean(), distance[i])
        for i in np.flatnonzero(distance > CERTAIN).tolist()
    ]


def _distance(rows: Any, expected: Any) -> Any:
    """How many standard errors the means are from what is expected. The variance of what is rare
    is taken to be at least that of a Poisson number."""
    variance = np.maximum(rows.var(axis=0, ddof=1), np.minimum(np.abs(expected), 0.5))
    error = np.sqrt(variance / len(rows)) + 1e-9 * (1.0 + np.abs(expected))
    return np.abs(rows.mean(axis=0) - expected) / error


# -- all of them -----------------------------------------------------------------------------------

UNTIMED = (
    "draw_again",
    "held_draws",
    "policy_rows",
    "policy_tests",
    "mixed_partners",
    "capacities",
    "inhibitors",
    "degrees",
    "counters",
    "ends",
    "failures",
)
"""The families in whose ``busy`` plans a robot may always wait until another one is done."""

OWN_WAYS = ("held_events", "identities")
"""The families with something that the chain leaves out: that events are held, and that robots
differ."""


class Comparison(NamedTuple):
    """A comparison, and the families that it applies to."""

    apply: Callable[[Case], List[str]]
    families: Sequence[str]

    @property
    def name(self) -> str:
        """Its name."""
        return self.apply.__name__


_STATED_BY_CHAIN = tuple(family for family in FAMILIES if family not in OWN_WAYS)

COMPARISONS: Dict[str, Comparison] = {
    function.__name__: Comparison(function, families)
    for function, families in (
        (chain_and_run, _STATED_BY_CHAIN),
        (literal_and_run, _STATED_BY_CHAIN),
        (literal_and_net, _STATED_BY_CHAIN),
        (net_and_run, _STATED_BY_CHAIN),
        (optimiser_and_run, _STATED_BY_CHAIN),
        (optimiser_and_net, _STATED_BY_CHAIN),
        (optimum_and_run, _STATED_BY_CHAIN),
        (check_and_run, tuple(f for f in FAMILIES if f != "identities")),
        (simulation_and_run, tuple(FAMILIES)),
        (table_and_run, _STATED_BY_CHAIN),
        (virtual_and_run, tuple(FAMILIES)),
    )
}
"""All comparisons, by name."""


def told_by(comparison: Comparison, case: Case) -> Optional[List[str]]:
    """The differences that a comparison finds; None if one of the statements refuses the plan or
    has too many states, or if robots may move for ever in zero time."""
    if case.family not in comparison.families:
        return None
    try:
        return comparison.apply(case)
    except (RefusedError, TooManyStatesError, EndlessError):
        return None

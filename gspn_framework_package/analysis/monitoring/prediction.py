"""Predicts runs of a plan by a sample of replications, and derives prediction intervals.

The parameters of a plan that were learned from logs are uncertain. Therefore the replications come
in groups, each simulated with parameters drawn from their posterior distributions: the mean of a
duration from a lognormal distribution with its 95 % interval (without an interval, with the
standard error that follows from the number of observations), the probabilities of outcomes and
failures from the Beta or Dirichlet distribution after that many observations (Jeffreys' prior), the
rate of an event like a mean. The intervals of the sample are then prediction intervals: they
account for chance in the run and for the uncertainty about the plan. Short logs give wide ones.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Callable, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis import quantiles
from gspn_framework_package.analysis.arrays import Booleans, Floats
from gspn_framework_package.analysis.executors import Executor, LocalExecutor, WorkItem, Workload
from gspn_framework_package.analysis.simulation import machine, simulate
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import OwnTimes, Plan

PREDICTION_REPLICATIONS = 1000
"""Default number of replications."""

_GROUPS = 40
"""Groups of replications with the same parameters, if some parameters are uncertain."""

_BATCH = 50
"""Largest number of replications computed together if no parameters are uncertain."""

LEAST_REPLICATIONS = 80
USUAL_FIRINGS = 500_000
"""Long runs are replicated less often, so that about this many firings are simulated: some seconds
in plain Python."""

MOST_FIRINGS = 20_000_000
"""The same if a number of replications was requested."""

_WORTH_WAITING = 2_000_000
"""More firings than this are worth the time to compile with numba, not only to load it."""

PREDICTION_PATIENCE = 10.0
"""A run that reached its condition is compared with runs that may take this many times as long."""

_NORMAL = 1.959963984540054

_Normal = Callable[[], float]
"""Draws from the standard normal distribution."""


class Span(NamedTuple):
    """What to predict: a run of ``plan``, whose robots and initial marking are those at its start,
    for ``seconds``; with ``to_condition``, until the condition of the plan holds, or until that
    time."""

    plan: Plan
    seconds: float
    to_condition: bool = False


class RunSample(NamedTuple):
    """Replications of some spans, added up: row i is the sum of their i-th replications.

    :ivar seconds: their durations.
    :ivar firings: number of firings, by transition.
    :ivar tokens: token-seconds, by place.
    :ivar came: whether all spans reached their conditions.
    :ivar group: the number of the parameter sample; all 0 if no parameters are uncertain.
    """

    seconds: Floats
    firings: Floats
    tokens: Floats
    came: Booleans
    group: Floats

    @property
    def size(self) -> int:
        """The number of replications."""
        return len(self.seconds)


def predict(
    spans: Sequence[Span],
    *,
    replications: Optional[int] = None,
    seed: int = 0,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    on: Optional[Executor] = None,
) -> RunSample:
    """Simulate runs like those of ``spans``.

    :param spans: runs of one net; the same parameters are drawn for all of them.
    :param replications: number of replications of each; fewer if they are very long. None: 1000, or
        fewer if they are long.
    :param on: where to compute: by default in this process. The result is the same.
    :raises RefusedError: the plan cannot be simulated, for example because of a timeless cycle.
    :raises CancelledError: ``cancel`` returned true.
    """
    if not spans or any(span.seconds <= 0 for span in spans):
        raise UsageError("a run of no length cannot be predicted")
    generator = np.random.Generator(np.random.PCG64(seed))
    uncertain = is_uncertain(spans[0].plan)
    workload = Workload(tuple, _play_group, tuple(spans))

    def group(number: int, size: int, normal: _Normal, *, compiled: bool) -> WorkItem:
        parameters = draw_parameters(spans[0].plan, generator, normal) if uncertain else None
        told = float(number if uncertain else 0)
        return WorkItem(workload, _Group(parameters, size, seed + number, told, compiled), size)

    executor = on or LocalExecutor()
    watch = Watch(progress, cancel)
    most = USUAL_FIRINGS if replications is None else MOST_FIRINGS
    wanted = PREDICTION_REPLICATIONS if replications is None else replications
    # a first estimate of how long they are
    first = min(math.ceil(wanted / _GROUPS) if uncertain else _BATCH, 10, wanted)
    plain = generator.standard_normal
    done = executor.ordered([group(0, first, plain, compiled=False)], "runs predicted", watch)
    each = max(done[0].firings.sum() / first, 1.0)
    affordable = max(int(most / each), min(wanted, LEAST_REPLICATIONS))
    rest = max(min(wanted, affordable) - first, 0)
    # few enough that the simulation of a single group would not choose to compile
    usual = min(_BATCH, max(int(machine.WORTH_COMPILING / each), 1))
    if uncertain:
        usual = max(math.ceil(rest / _GROUPS), 1)
    compiled = _worth_compiling(rest * each / executor.workers)
    begins = range(0, rest, usual)
    items = [
        group(number, min(usual, rest - made), normal, compiled=compiled)
        for number, (made, normal) in enumerate(zip(begins, _strata(len(begins), generator)), 1)
    ]
    done += executor.ordered(items, "runs predicted", watch)
    return RunSample(*(np.concatenate(parts) for parts in zip(*done)))


def _worth_compiling(firings: float) -> bool:
    """Whether the compiled kernel is faster for this many firings."""
    if firings <= machine.WORTH_COMPILING or not machine.numba_is_there():
        return False
    return firings > _WORTH_WAITING or machine.is_loaded() or machine.is_cached()


class _Group(NamedTuple):
    """Simulate replications with the same parameters; ``compiled``: whether the compiled kernel is
    worthwhile for them."""

    parameters: Optional[Parameters]
    size: int
    seed: int
    told: float
    compiled: bool


def _play_group(spans: Sequence[Span], group: _Group, watch: Watch) -> RunSample:
    size, parameters = group.size, group.parameters
    if group.compiled and machine.numba_is_there():  # also in a worker
        machine.compiled_kernel()
    seconds = np.zeros(size)
    came = np.ones(size, dtype=bool)
    net = spans[0].plan.net
    firings, tokens = np.zeros((size, len(net.transitions))), np.zeros((size, len(net.places)))
    for number, span in enumerate(spans):
        plan = span.plan if parameters is None else parameters.apply(span.plan)
        result = simulate(
            plan,
            time=span.seconds * (PREDICTION_PATIENCE if span.to_condition else 1.0),
            replications=size,
            seed=(group.seed * 1_000_003 + number) % 2**62,
            samples=True,
            cancel=watch.cancelled,
        )
        part = result.samples
        assert part is not None
        seconds += part.clock
        firings += part.firings
        tokens += part.tokens
        came &= part.over
    return RunSample(seconds, firings, tokens, came, np.full(size, group.told))


def expected_paces(plan: Plan, sample: RunSample) -> Dict[str, float]:
    """Place -> predicted visits per second."""
    seconds = float(sample.seconds.sum())
    paces = {}
    for name in plan.action_places:
        p = plan.net.place_index[name]
        weights = [sum(w for q, w in outputs if q == p) for outputs in plan.net.outputs]
        paces[name] = float((sample.firings @ weights).sum()) / seconds if seconds else 0.0
    return paces


# -- uncertain parameters ---------------------------------------------------------


class Parameters(NamedTuple):
    """Values of the uncertain parameters of a plan: factors of the durations and of the rates,
    outcomes and failures; ``own`` has those of robots that do not get the team's factors."""

    durations: Mapping[str, float]
    outcomes: Mapping[str, Mapping[str, float]]
    failures: Mapping[str, float]
    rates: Mapping[str, float]
    own: Mapping[str, Parameters] = {}

    def apply(self, plan: Plan) -> Plan:
        """The plan with these values."""
        plain = self._replace(outcomes={}, failures={})
        team = self._applied(plan.times)
        return replace(
            plan,
            net=plan.net.with_rates(
                {name: plan.net.transition(name).number * f for name, f in self.rates.items()}
            ),
            durations=team.durations,
            outcomes=team.outcomes,
            failures=team.failures,
            evidence={
                (key, name): of.scaled(self.rates.get(name, 1.0) if key == "rates" else 1.0)
                for (key, name), of in team.evidence.items()
            },
            own_times={
                robot: self.own.get(robot, plain)._applied(times)
                for robot, times in plan.own_times.items()
            },
        )

    def _applied(self, times: OwnTimes) -> OwnTimes:
        return times.scaled(self.durations)._replace(
            outcomes={**times.outcomes, **self.outcomes},
            failures={**times.failures, **self.failures},
        )


def is_uncertain(plan: Plan) -> bool:
    """Whether the plan states that a value was learned, and from how many observations."""
    return any(evidence.observations > 0 for evidence in plan.evidence.values())


def draw_parameters(
    plan: Plan, generator: np.random.Generator, normal: Optional[_Normal] = None
) -> Parameters:
    """Draw values of the parameters of a plan that were learned from logs; see the module.

    :param normal: draws from the standard normal distribution; None: the ``generator`` does.
    """
    draw = normal or generator.standard_normal
    drawn = _drawn(plan.times, plan.rates, generator, draw)
    own = plan.own_times.items()
    return drawn._replace(own={robot: _drawn(times, {}, generator, draw) for robot, times in own})


def _strata(count: int, generator: np.random.Generator) -> Iterator[_Normal]:
    """For each of ``count`` groups, the function that draws its normal numbers. The n-th numbers of
    all groups come one from each of ``count`` parts of equal probability (a Latin hypercube): so
    few independent numbers would often leave the tails empty, and intervals would be too narrow."""
    parts: List[Sequence[int]] = []

    def normals(group: int) -> Iterator[float]:
        for number in itertools.count():
            if number == len(parts):
                parts.append(generator.permutation(count).tolist())
            yield quantiles.normal_quantile((parts[number][group] + generator.random()) / count)

    for group in range(count):
        yield normals(group).__next__


def _drawn(
    times: OwnTimes,
    known_rates: Mapping[str, float],
    generator: np.random.Generator,
    normal: _Normal,
) -> Parameters:
    durations: Dict[str, float] = {}
    rates: Dict[str, float] = {}
    failures: Dict[str, float] = {}
    outcomes: Dict[str, Dict[str, float]] = {}
    for (key, name), evidence in sorted(times.evidence.items()):
        n = evidence.observations
        if n <= 0:
            continue
        if key == "durations" and name in times.durations:
            duration = times.durations[name]
            if duration.mean > 0:
                error = duration.variation / math.sqrt(n)
                durations[name] = _factor(duration.mean, evidence.interval, error, normal)
        elif key == "rates" and name in known_rates:
            error = 1 / math.sqrt(n)
            rates[name] = _factor(known_rates[name], evidence.interval, error, normal)
        elif key == "failures" and name in times.failures:
            p = times.failures[name]
            failures[name] = min(float(generator.beta(n * p + 0.5, n * (1 - p) + 0.5)), 1 - 1e-9)
        elif key == "outcomes" and name in times.outcomes:
            given = times.outcomes[name]
            counts = [n * p + 0.5 for p in given.values()]
            drawn = generator.dirichlet(counts) if len(counts) > 1 else np.ones(1)
            outcomes[name] = dict(zip(given, (drawn / drawn.sum()).tolist()))
    return Parameters(durations, outcomes, failures, rates)


def _factor(
    value: float,
    interval: Optional[Tuple[float, float]],
    error: float,
    normal: _Normal,
) -> float:
    """Draw the factor by which the true value exceeds the estimate. The two halves of the interval
    may differ."""
    z = float(normal())
    if interval is not None and 0 < interval[0] <= value <= interval[1] < math.inf:
        spread = math.log((interval[1] if z > 0 else value) / (value if z > 0 else interval[0]))
        return math.exp(z * spread / _NORMAL)
    return math.exp(z * min(error, 2.0))


# -- growth with time ------------------------------------------------------------------------------


class Growth(NamedTuple):
    """How a count grows with time: by ``rate`` per second on average, with the variance
    ``chance`` * time + ``doubt`` * time^2 (the second part for the uncertain parameters)."""

    rate: float
    chance: float
    doubt: float


def growth(sample: RunSample, counts: Floats) -> Growth:
    """Fit the growth of ``counts``, one per replication, with time. The parts of the variance come
    from an analysis of variance within and between the groups."""
    seconds = float(sample.seconds.mean())
    groups = np.unique(sample.group)
    rate = float(counts.sum() / sample.seconds.sum())
    if len(groups) < 2:
        return Growth(rate, _variance(counts) / seconds, 0.0)
    parts = [counts[sample.group == g] for g in groups]
    sizes = np.array([len(part) for part in parts], dtype=np.float64)
    freedom = float(np.maximum(sizes - 1, 0).sum())
    within = sum(float(((part - part.mean()) ** 2).sum()) for part in parts) / max(freedom, 1.0)
    between = _variance(np.array([part.mean() for part in parts]))
    doubt = max(between - within * float((1 / sizes).mean()), 0.0)
    return Growth(rate, within / seconds, doubt / seconds**2)


def _variance(values: Floats) -> float:
    return float(values.var(ddof=1)) if len(values) > 1 else 0.0

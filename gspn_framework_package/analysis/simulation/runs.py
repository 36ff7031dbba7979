"""Simulation of a net, or of a plan as it runs, with confidence intervals.

>>> from gspn_framework_package.model.builder import NetBuilder
>>> net = (NetBuilder().place("up", tokens=1).place("down")
...        .exponential("fail", rate=1.0, inputs="up", outputs="down")
...        .exponential("repair", rate=3.0, inputs="down", outputs="up").build())
>>> result = simulate(net, time=100.0, replications=200, seed=7)
>>> abs(result.mean_tokens["up"].mean - 0.75) < 2 * result.mean_tokens["up"].half_width
True
"""

from __future__ import annotations

import math
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np

from gspn_framework_package.analysis.executors import Executor, LocalExecutor, WorkItem, Workload
from gspn_framework_package.analysis.plan.reading import NET, RUN, checked_reading
from gspn_framework_package.analysis.simulation import estimates, machine
from gspn_framework_package.analysis.simulation.batches import (
    Played,
    RunBatch,
    Subject,
    added,
    join_batches,
    play_batch,
    player,
)
from gspn_framework_package.analysis.simulation.estimates import Estimate, Samples, Simulation
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.condition import either
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

PRECISION_GIVEN_UP_AT = 10**6
"""Largest number of replications for a requested precision."""

FIRST_REPLICATIONS = 30
"""Number of replications before the precision is first checked."""

RARE = 0.01
"""By default, the precision applies to all throughputs of at least this fraction of the largest."""


def simulate(
    subject: Union[Net, Plan],
    *,
    time: float = math.inf,
    replications: Optional[int] = None,
    seed: int = 0,
    warmup: float = 0.0,
    until: Optional[str] = None,
    confidence: float = 0.95,
    timing: str = RUN,
    losses: float = 0.0,
    precision: Optional[float] = None,
    measures: Sequence[str] = (),
    batches: Optional[int] = None,
    samples: bool = False,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    on: Optional[Executor] = None,
) -> Simulation:
    """Simulate many independent runs from the initial marking, or one long run.

    :param subject: a net, or a validated plan, which then follows its policy.
    :param time: length of a run (s).
    :param replications: number of runs (default 1000); with ``precision``, the largest number.
    :param seed: the same seed gives the same result, whichever form of the kernel is used.
    :param warmup: time (s) at the start of each run that the means exclude.
    :param until: a condition that ends a run; for a net, it may contain ``deadlock``.
    :param confidence: level of the confidence intervals.
    :param timing: for a plan: ``run`` plays the token game as it is executed, with the durations of
        the plan; ``net`` lets the rates of the net race. A net always uses the latter.
    :param losses: how often a robot is lost, per second and robot (only with ``run``).
    :param precision: stop when the half widths, relative to the means, are at most this.
    :param measures: names of the transitions (throughput) and places (mean tokens) to which the
        precision applies; by default all throughputs of at least a hundredth of the largest, or the
        time to the condition.
    :param batches: divide one run, after its warm-up, into this many batches (batch means).
    :param samples: whether the result contains the values of each run.
    :param on: where to compute: by default in this process. The result is the same to the last bit.
    :raises UsageError: a number is invalid, or neither ``time`` nor a condition is given.
    :raises ExpressionError: the condition cannot be parsed.
    :raises RefusedError: a choice is unresolved, there is a timeless cycle, or a run neither ends
        nor continues.
    :raises CancelledError: ``cancel`` returned true.
    """
    asked = Asked(
        time,
        replications,
        seed,
        warmup,
        until,
        confidence,
        timing,
        losses,
        precision,
        tuple(measures),
        batches,
    )
    executor = on or LocalExecutor()
    work = SimulationWork(subject, asked, executor.workers)
    for _ in finished([work], executor, Watch(progress, cancel)):
        pass
    return work.result(samples)


class Asked(NamedTuple):
    """The settings of a simulation; see :func:`simulate`."""

    time: float = math.inf
    replications: Optional[int] = None
    seed: int = 0
    warmup: float = 0.0
    until: Optional[str] = None
    confidence: float = 0.95
    timing: str = RUN
    losses: float = 0.0
    precision: Optional[float] = None
    measures: Tuple[str, ...] = ()
    batches: Optional[int] = None


class SimulationWork:
    """The simulation of one subject, in rounds of tasks.

    :param workers: number of workers computing in parallel.
    :param name: the subject of an error message; empty if obvious.
    :raises GspnError: see :func:`simulate`.
    """

    def __init__(
        self, subject: Union[Net, Plan], asked: Asked, workers: int = 1, name: str = ""
    ) -> None:
        plan = subject if isinstance(subject, Plan) else None
        as_run = checked_reading(asked.timing) == RUN and plan is not None
        few = 1000 if asked.precision is None else PRECISION_GIVEN_UP_AT
        self._most = few if asked.replications is None else asked.replications
        _check_numbers(subject, asked, self._most)
        _check_options(as_run, plan is not None and not as_run, asked)
        self._plan, self._as_run, self._asked, self._workers = plan, as_run, asked, workers
        self._name = name
        self._condition = asked.until if plan is None else either(plan.until, asked.until)
        played = Subject(
            subject,
            as_run,
            asked.time,
            asked.warmup,
            self._condition,
            asked.losses,
            asked.seed,
        )
        self._player = player(played)
        self._net = self._player.net
        self._workload = Workload(player, play_batch, played, self._player)
        known = set(self._net.place_index) | set(self._net.transition_index)
        for name in asked.measures:
            if name not in known:
                raise UsageError(
                    "there is no place or transition '%s'" % name,
                    hint="--measure takes names of places and transitions",
                )
        self._parts: List[Samples] = []
        self._spent: List[Dict[int, float]] = [{} for _ in self._net.places]
        self._events = self._done = 0
        self._precision: Optional[Dict[str, Any]] = None

    def tasks(self) -> List[WorkItem]:
        """The tasks of the next round; none if there is nothing more to do."""
        asked, done = self._asked, self._done
        if asked.batches is not None:
            return (
                []
                if done
                else [WorkItem(self._workload, RunBatch(0, 1, 1, asked.batches), 1, self._name)]
            )
        end = self._most
        if asked.precision is not None:
            reached = (self._precision or {}).get("reached")
            if reached is not None and reached <= asked.precision:
                return []
            end = min(done + max(FIRST_REPLICATIONS, done // 2), end)
        size = self._player.size
        planned = math.ceil(end / self._workers)
        return [
            WorkItem(self._workload, RunBatch(first, count, planned), count, self._name)
            for first in range(done, end, size)
            for count in (min(size, end - first),)
        ]

    def take(self, round_: Sequence[Played]) -> None:
        """Add the results of a round of tasks, in order."""
        for played in round_:
            self._parts.append(played.samples)
            added(self._spent, played.spent)
            self._events += played.events
            self._done += len(played.samples.clock)
        if self._asked.precision is not None:
            names, values = _wanted(self._net, self._samples(), self._asked, self._condition)
            reached = estimates.relative(values)
            self._precision = {
                "wanted": self._asked.precision,
                "reached": reached if math.isfinite(reached) else None,
                "measures": names,
            }

    def _samples(self) -> Samples:
        self._parts = [join_batches(self._parts)]
        return self._parts[0]

    def result(self, samples: bool = False) -> Simulation:
        """The estimates from the replications; ``samples``: whether to include the values of
        each."""
        asked = self._asked
        found = self._samples()
        notes = self._player.notes
        if asked.batches is not None:
            notes = notes + _correlated(found)
        if self._events > machine.MANY_FIRINGS and not machine.numba_is_there():
            notes = [*notes, machine.SLOW]
        whole = sum(found.seconds.tolist())
        result = estimates.summary(
            self._net,
            found,
            [spent if sum(spent.values()) > 0.999999 * whole else {} for spent in self._spent],
            self._condition is not None,
            plan=self._plan,
            events=self._events,
            time=asked.time,
            warmup=asked.warmup,
            replications=1 if asked.batches is not None else len(found.clock),
            seed=asked.seed,
            confidence=asked.confidence,
            timing=RUN if self._as_run else NET,
            batches=asked.batches,
            precision=self._precision,
            notes=tuple(notes),
        )
        return result._replace(samples=found) if samples else result


def finished(works: Sequence[SimulationWork], executor: Executor, watch: Watch) -> Iterator[int]:
    """Run several simulations together so that no worker is idle; yield the number of each as soon
    as it is done.

    :raises GspnError: see :func:`simulate`.
    """
    rounds = {number: work.tasks() for number, work in enumerate(works)}
    while rounds:
        places = [(number, k) for number, tasks in rounds.items() for k in range(len(tasks))]
        tasks = [rounds[number][k] for number, k in places]
        results: Dict[int, Dict[int, Played]] = {number: {} for number in rounds}
        following = {}
        for at, played in executor.map(tasks, "runs", watch):
            number, k = places[at]
            results[number][k] = played
            if len(results[number]) == len(rounds[number]):
                found = results.pop(number)
                works[number].take([found[k] for k in range(len(found))])
                more = works[number].tasks()
                if more:
                    following[number] = more
                else:
                    yield number
        rounds = following


def _check_numbers(subject: Union[Net, Plan], asked: Asked, replications: int) -> None:
    time, warmup, confidence = asked.time, asked.warmup, asked.confidence
    if math.isnan(time) or time <= 0:
        raise UsageError("a run of %g s is not possible" % time)
    ends = asked.until is not None or isinstance(subject, Plan) and subject.until is not None
    if math.isinf(time) and not ends:
        raise UsageError("how long is a run?", hint="give a time, or a condition that ends it")
    if replications < 1:
        raise UsageError("%d replications are not possible" % replications)
    if not 0 <= warmup < time:
        raise UsageError("a warm-up of %g s does not fit a run of %g s" % (warmup, time))
    if not 0 < confidence < 1:
        raise UsageError(
            "a confidence of %g is not possible" % confidence, hint="give a number between 0 and 1"
        )


def _check_options(as_run: bool, table: bool, asked: Asked) -> None:
    losses, precision, batches = asked.losses, asked.precision, asked.batches
    if not (math.isfinite(losses) and losses >= 0):
        raise UsageError("%g losses per second are not possible" % losses)
    if losses and not as_run:
        raise UsageError("only a plan that is simulated as it runs can lose robots")
    if precision is not None and not 0 < precision < 1:
        raise UsageError(
            "a relative precision of %g is not possible" % precision,
            hint="give a number between 0 and 1, e.g. 0.01",
        )
    if asked.measures and precision is None:
        raise UsageError("measures require a precision", hint="give --precision as well")
    if batches is None:
        return
    if table:
        raise UsageError("batches are for nets, and for plans that are simulated as they run")
    if batches < 2:
        raise UsageError("%d batches are too few for an interval" % batches, hint="take 20 or more")
    if math.isinf(asked.time):
        raise UsageError("how long is the run?", hint="give a time as well")
    if precision is not None or asked.replications is not None:
        raise UsageError("batches divide one run: they exclude a precision and replications")


# -- number of replications
# ------------------------------------------------------------------------------------


def _wanted(
    net: Net, samples: Samples, asked: Asked, condition: Optional[str]
) -> Tuple[List[str], List[Estimate]]:
    confidence = asked.confidence
    names: List[str] = list(asked.measures)
    if not names:
        if condition is not None and samples.over.all():
            return ["time_to_condition"], [estimates.mean(samples.clock, confidence)]
        counts = samples.firings.sum(axis=0)
        often = np.flatnonzero((counts > 0) & (counts >= RARE * counts.max(initial=0)))
        names = [net.transitions[t].name for t in often.tolist()]
    values = []
    for name in names:
        if name in net.transition_index:
            amounts = samples.firings[:, net.transition_index[name]]
        else:
            amounts = samples.tokens[:, net.place_index[name]]
        values.append(estimates.ratio(amounts, samples.seconds, confidence))
    return names, values


def _correlated(samples: Samples) -> List[str]:
    """A note if neighbouring batches are too similar to count as independent."""
    rates = samples.firings.sum(axis=1)
    rates = rates - rates.mean()
    square = float((rates**2).sum())
    if square == 0:
        return []
    lag = float((rates[1:] * rates[:-1]).sum()) / square
    if lag <= 2 / math.sqrt(len(rates)):
        return []
    return [
        "neighbouring batches are correlated (%.2f), so the intervals are too narrow: "
        "take fewer batches or a longer run" % lag
    ]


__all__ = ["Asked", "Estimate", "Samples", "Simulation", "SimulationWork", "simulate", "finished"]

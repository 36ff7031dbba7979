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
import time as clock
from dataclasses import replace
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple, Union

import numpy as np

from gspn_framework_package.analysis.plan.reading import NET, RUN, checked_reading
from gspn_framework_package.analysis.plan.rules import PlanRules
from gspn_framework_package.analysis.simulation import estimates, kernel, machine
from gspn_framework_package.analysis.simulation.estimates import Estimate, Samples, Simulation
from gspn_framework_package.analysis.simulation.kernel_run import KernelRun
from gspn_framework_package.analysis.simulation.marking_table import MarkingTable, TableRuns
from gspn_framework_package.analysis.simulation.plan_run import PlanRun
from gspn_framework_package.analysis.simulation.plan_tables import PlanTables
from gspn_framework_package.analysis.simulation.race_run import RaceRun
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.condition import Condition, either, parse_condition
from gspn_framework_package.model.errors import RefusedError, UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming

MOST_REPLICATIONS = 10**6
"""Most replications until a wanted precision is given up."""

FIRST_REPLICATIONS = 30
"""Replications before the precision is looked at."""

RARE = 0.01
"""By default, the precision is wanted of all throughputs of at least this part of the largest."""

_COMPILED_EVENTS = 500_000
_PLAIN_EVENTS = 5_000
"""Events between two looks at the watch."""

_PLAIN_SECONDS = 5.0
"""The compiled kernel takes over if plain Python would need this much longer."""


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
) -> Simulation:
    """Simulate many independent runs from the initial marking, or one long run.

    :param subject: a net, or a validated plan, which then follows its policy.
    :param time: length of a run (s).
    :param replications: number of runs (default 1000); with ``precision``, the most.
    :param seed: the same seed gives the same result, whichever form of the kernel runs.
    :param warmup: time (s) at the start of each run that the means exclude.
    :param until: a condition that ends a run; for a net, it may contain ``deadlock``.
    :param confidence: level of the confidence intervals.
    :param timing: for a plan: ``run`` plays the token game as it is executed, with the durations of
        the plan; ``net`` lets the rates of the net race. A net always has the latter.
    :param losses: how often a robot is lost, per second and robot (only with ``run``).
    :param precision: stop when the half widths, relative to the means, are at most this.
    :param measures: names of the transitions (throughput) and places (mean tokens) whose precision
        counts; by default all throughputs of at least a hundredth of the largest, or the time to
        the condition.
    :param batches: divide one run, after its warm-up, into so many batches (batch means).
    :param samples: whether the result has the values of each run.
    :raises UsageError: a number makes no sense, or neither ``time`` nor a condition is given.
    :raises ExpressionError: the condition cannot be parsed.
    :raises RefusedError: nothing decides a choice, there is a timeless cycle, or a run neither ends
        nor goes on.
    :raises CancelledError: ``cancel`` returned true.
    """
    plan = subject if isinstance(subject, Plan) else None
    as_run = checked_reading(timing) == RUN and plan is not None
    most = replications
    if most is None:
        most = 1000 if precision is None else MOST_REPLICATIONS
    _check_numbers(subject, time, most, warmup, until, confidence)
    _check_options(
        as_run,
        plan is not None and not as_run,
        time,
        replications,
        losses,
        precision,
        measures,
        batches,
    )
    condition = until if plan is None else either(plan.until, until)
    watch = Watch(progress, cancel)
    runner: Union[_KernelRunner, _TableRunner]
    if plan is None:
        assert isinstance(subject, Net)
        run: KernelRun = RaceRun(subject, _deadlock_or(condition, subject))
        runner = _KernelRunner(run, [], time, warmup, seed, watch)
    elif as_run:
        reading = PlanTiming(plan)
        run = PlanRun(PlanTables(plan, reading, condition, losses))
        runner = _KernelRunner(run, reading.assumptions, time, warmup, seed, watch)
    else:
        runner = _TableRunner(plan, time, warmup, condition, seed, watch)
    known = set(runner.net.place_index) | set(runner.net.transition_index)
    for name in measures:
        if name not in known:
            raise UsageError(
                "there is no place or transition '%s'" % name, hint="--measure takes their names"
            )
    notes = runner.notes
    if batches is not None:
        assert isinstance(runner, _KernelRunner)
        runner.batch(batches)
        notes += _correlated(runner.samples())
        reached = None
    elif precision is None:
        runner.add(most)
        reached = None
    else:
        reached = _add_until(runner, most, precision, measures, condition, confidence)
    found = runner.samples()
    result = estimates.summary(
        runner.net,
        found,
        runner.shares(),
        condition is not None,
        plan=plan,
        events=runner.events,
        time=time,
        warmup=warmup,
        replications=1 if batches is not None else len(found.clock),
        seed=seed,
        confidence=confidence,
        timing=RUN if as_run else NET,
        batches=batches,
        precision=reached,
        notes=tuple(notes),
    )
    return result._replace(samples=found) if samples else result


def _deadlock_or(condition: Optional[str], net: Net) -> Optional[Condition]:
    names = [p.name for p in net.places]
    return None if condition is None else parse_condition(condition, names, ["deadlock"])


def _check_numbers(
    subject: Union[Net, Plan],
    time: float,
    replications: int,
    warmup: float,
    until: Optional[str],
    confidence: float,
) -> None:
    if math.isnan(time) or time <= 0:
        raise UsageError("a run of %g s is not possible" % time)
    if math.isinf(time) and until is None and not (isinstance(subject, Plan) and subject.until):
        raise UsageError("how long is a run?", hint="give a time, or a condition that ends it")
    if replications < 1:
        raise UsageError("%d replications make no sense" % replications)
    if not 0 <= warmup < time:
        raise UsageError("a warm-up of %g s does not fit a run of %g s" % (warmup, time))
    if not 0 < confidence < 1:
        raise UsageError(
            "a confidence of %g is not possible" % confidence, hint="give a number between 0 and 1"
        )


def _check_options(
    as_run: bool,
    table: bool,
    time: float,
    replications: Optional[int],
    losses: float,
    precision: Optional[float],
    measures: Sequence[str],
    batches: Optional[int],
) -> None:
    if not (math.isfinite(losses) and losses >= 0):
        raise UsageError("%g losses per second are not possible" % losses)
    if losses and not as_run:
        raise UsageError("only a plan that is simulated as it runs can lose robots")
    if precision is not None and not 0 < precision < 1:
        raise UsageError(
            "a relative precision of %g is not possible" % precision,
            hint="give a number between 0 and 1, e.g. 0.01",
        )
    if measures and precision is None:
        raise UsageError("measures are for a wanted precision", hint="give --precision as well")
    if batches is None:
        return
    if table:
        raise UsageError("batches are for nets, and for plans that are simulated as they run")
    if batches < 2:
        raise UsageError("%d batches make no interval" % batches, hint="take 20 or more")
    if math.isinf(time):
        raise UsageError("how long is the run?", hint="give a time as well")
    if precision is not None or replications is not None:
        raise UsageError("batches divide one run: they exclude a precision and replications")


# -- how many ------------------------------------------------------------------------------------


def _add_until(
    runner: Any,
    most: int,
    precision: float,
    measures: Sequence[str],
    condition: Optional[str],
    confidence: float,
) -> Dict[str, Any]:
    """Add replications until the precision is reached or there are ``most``."""
    done = 0
    reached = math.inf
    while done < most and not reached <= precision:
        runner.add(min(max(FIRST_REPLICATIONS, done // 2), most - done))
        found = runner.samples()
        done = len(found.clock)
        names, values = _wanted(runner.net, found, measures, condition, confidence)
        reached = estimates.relative(values)
    return {
        "wanted": precision,
        "reached": reached if math.isfinite(reached) else None,
        "measures": names,
    }


def _wanted(
    net: Net,
    samples: Samples,
    measures: Sequence[str],
    condition: Optional[str],
    confidence: float,
) -> Tuple[List[str], List[Estimate]]:
    names: List[str] = list(measures)
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
    """A note if neighbouring batches are too much alike to be taken for independent ones."""
    rates = samples.firings.sum(axis=1)
    rates = rates - rates.mean()
    square = float((rates**2).sum())
    if square == 0:
        return []
    lag = float((rates[1:] * rates[:-1]).sum()) / square
    if lag <= 2 / math.sqrt(len(rates)):
        return []
    return [
        "neighbouring batches are alike (correlation %.2f), so that the intervals are too narrow: "
        "take fewer batches or a longer run" % lag
    ]


# -- by the kernel ---------------------------------------------------------------------------------


class _KernelRunner:
    """Replications of a plan as it runs, or of a net."""

    def __init__(
        self,
        run: KernelRun,
        notes: Sequence[str],
        time: float,
        warmup: float,
        seed: int,
        watch: Watch,
    ) -> None:
        self.net = run.net
        self.notes = list(notes)
        self.events = 0
        self._time, self._warmup, self._seed, self._watch = time, warmup, seed, watch
        self._run = run
        self._began = clock.monotonic()
        self._compile: Optional[Callable[[], None]] = None
        if machine.may_compile():
            if machine.is_loaded():
                self._run.compile()
            else:
                self._compile = self._run.compile
        self._rows: List[Tuple[float, float, Any, Any, bool]] = []
        self._spent: List[Dict[int, float]] = [{} for _ in self.net.places]

    def add(self, count: int) -> None:
        """Run so many further replications."""
        total = len(self._rows) + count
        for number in range(len(self._rows), total):
            self._begin(number)
            status = kernel.AT_STOP
            if self._warmup > 0:
                status = self._go(self._warmup, total)
                self._run.forget()
            if status == kernel.AT_STOP:
                status = self._go(self._time, total)
            self._keep(max(self._run.now - self._warmup, 0.0), status)
            self.events += self._run.firings_so_far

    def batch(self, count: int) -> None:
        """Run once, in so many batches."""
        self._begin(0)
        if self._warmup > 0:
            self._expect(self._go(self._warmup, 1))
            self._run.forget()
        length = (self._time - self._warmup) / count
        for k in range(count):
            self._expect(self._go(self._warmup + (k + 1) * length, 1))
            self._keep(length, kernel.AT_STOP)
            self._run.forget()
        self.events = self._run.firings_so_far

    def _begin(self, number: int) -> None:
        words = np.random.SeedSequence(self._seed % 2**64, spawn_key=(number,)).generate_state(
            4, np.uint32
        )
        self._run.begin(words.tolist())

    def _expect(self, status: int) -> None:
        if status != kernel.AT_STOP:
            raise RefusedError(
                "the run ends after %g s, so that it has no batches" % self._run.now,
                hint="take replications instead",
            )

    def _go(self, stop: float, total: int) -> int:
        """Go on until ``stop`` or the end of the run; ``total`` replications are planned."""
        run = self._run
        while True:
            status = run.go(stop, _COMPILED_EVENTS if run.compiled else _PLAIN_EVENTS)
            firings = self.events + run.firings_so_far
            self._watch.step("firings", firings)
            if self._compile is not None and firings > machine.WORTH_COMPILING:
                part = len(self._rows) / total
                if math.isfinite(self._time):
                    part += run.now / self._time / total
                spent = clock.monotonic() - self._began
                if math.isinf(self._time) or spent / max(part, 1e-9) - spent > _PLAIN_SECONDS:
                    self._compile()
                    self._compile = None
            if status == kernel.STUCK:
                marking = run.state.level[: len(self.net.places)]
                raise RefusedError(
                    "a run stays in (%s) without end, which does not satisfy the end condition"
                    % ", ".join(
                        "%s: %d" % item
                        for item in self.net.named(tuple(marking), zeros=False).items()
                    ),
                    hint="give a time as well",
                )
            if status != kernel.MORE:
                return status

    def _keep(self, seconds: float, status: int) -> None:
        state = self._run.state
        self._rows.append(
            (
                self._run.now,
                seconds,
                np.array(state.firings, dtype=np.float64),
                np.array(state.area),
                status == kernel.UNTIL,
            )
        )
        spent = np.array(state.spent)
        starts = np.array(state.spent_from)
        there = np.flatnonzero(spent)
        places = np.searchsorted(starts, there, side="right") - 1
        counts = there - starts[places]
        for p, count, time in zip(places.tolist(), counts.tolist(), spent[there].tolist()):
            self._spent[p][count] = self._spent[p].get(count, 0.0) + time

    def samples(self) -> Samples:
        """The values of each replication so far."""
        return Samples(
            np.array([row[0] for row in self._rows]),
            np.array([row[1] for row in self._rows]),
            np.array([row[2] for row in self._rows]),
            np.array([row[3] for row in self._rows]),
            np.array([row[4] for row in self._rows], dtype=bool),
        )

    def shares(self) -> List[Dict[int, float]]:
        """For each place, number of tokens -> seconds; empty where counts were too large."""
        whole = sum(row[1] for row in self._rows)
        return [spent if sum(spent.values()) > 0.999999 * whole else {} for spent in self._spent]


# -- by the table of markings ----------------------------------------------------------------------


class _TableRunner:
    """Replications of a plan that is read like a net."""

    def __init__(
        self,
        plan: Plan,
        time: float,
        warmup: float,
        condition: Optional[str],
        seed: int,
        watch: Watch,
    ) -> None:
        rules = PlanRules(replace(plan, until=condition))
        self.net = rules.net
        self.notes: List[str] = []
        self._table = MarkingTable(rules)
        self._time, self._warmup, self._watch = time, warmup, watch
        self._random = np.random.Generator(np.random.PCG64(seed))
        self._runs: List[TableRuns] = []

    def add(self, count: int) -> None:
        """Run so many further replications."""
        runs = TableRuns(self._table, count, self._time, self._warmup, self._random)
        runs.go(self._watch)
        self._runs.append(runs)

    @property
    def events(self) -> int:
        """The number of firings so far."""
        return sum(runs.events for runs in self._runs)

    def samples(self) -> Samples:
        """The values of each replication so far."""

        def joined(name: str) -> Any:
            return np.concatenate([getattr(runs, name) for runs in self._runs])

        ends = joined("clock")
        seconds = np.maximum(ends - self._warmup, 0.0)
        return Samples(ends, seconds, joined("firings"), joined("tokens"), joined("over"))

    def shares(self) -> List[Dict[int, float]]:
        """For each place, number of tokens -> seconds."""
        whole: List[Dict[int, float]] = [{} for _ in self.net.places]
        for runs in self._runs:
            for share, more in zip(whole, runs.shares):
                for count, seconds in more.items():
                    share[count] = share.get(count, 0.0) + seconds
        return whole


__all__ = ["Estimate", "Samples", "Simulation", "simulate"]

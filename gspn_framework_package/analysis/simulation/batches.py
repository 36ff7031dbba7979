"""Batches of replications: the tasks of a simulation, for any executor.

Each replication has its own random stream, chosen by its number. So a batch gives the same values
wherever it is computed, and the batches do not depend on the number of workers.
"""

from __future__ import annotations

import math
import time as clock
from dataclasses import replace
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np

from gspn_framework_package.analysis.simulation import kernel, machine
from gspn_framework_package.analysis.simulation.estimates import Samples
from gspn_framework_package.analysis.simulation.kernel_run import KernelRun
from gspn_framework_package.analysis.simulation.plan_run import PlanRun
from gspn_framework_package.analysis.simulation.plan_tables import PlanTables
from gspn_framework_package.analysis.simulation.race_run import RaceRun
from gspn_framework_package.analysis.simulation.state_cache import StateCache, TableRuns
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.condition import Condition, parse_condition
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming
from gspn_framework_package.run_net.compiling import compile_plan

_COMPILED_EVENTS = 500_000
_PLAIN_EVENTS = 5_000
"""Events between two checks of the watch."""

_PLAIN_SECONDS = 5.0
"""The compiled kernel takes over if plain Python would need this much longer."""


class Subject(NamedTuple):
    """The subject of a simulation: plain data.

    :ivar model: a net or a plan.
    :ivar as_run: whether the plan is played as it runs.
    :ivar time: length of a run (s); ``warmup``: the time excluded at its start.
    :ivar condition: the condition that ends a run; None if there is none.
    :ivar losses: how often each robot is lost (1/s).
    """

    model: Union[Net, Plan]
    as_run: bool
    time: float
    warmup: float
    condition: Optional[str]
    losses: float
    seed: int


class RunBatch(NamedTuple):
    """A number of ``runs``, starting from the replication with number ``first``.

    :ivar planned: the number of replications that the worker will probably get, for its choice
        between plain Python and the compiled kernel.
    :ivar parts: number of parts into which the run of one replication is divided, instead of
        ``runs`` replications; None if it is not divided.
    """

    first: int
    runs: int
    planned: int
    parts: Optional[int] = None


class Played(NamedTuple):
    """The result of a batch.

    :ivar samples: a row for each replication.
    :ivar spent: for each place, number of tokens -> seconds.
    :ivar events: number of firings.
    """

    samples: Samples
    spent: List[Dict[int, float]]
    events: int


def player(subject: Subject) -> Union[KernelPlayer, TablePlayer]:
    """Plays batches of a subject."""
    model = subject.model
    if isinstance(model, Net):
        return KernelPlayer(RaceRun(model, _deadlock_or(subject.condition, model)), [], subject)
    if subject.as_run:
        reading = PlanTiming(model)
        tables = PlanTables(model, reading, subject.condition, subject.losses)
        return KernelPlayer(PlanRun(tables), reading.assumptions, subject)
    return TablePlayer(model, subject)


def play_batch(prepared: Union[KernelPlayer, TablePlayer], batch: RunBatch, watch: Watch) -> Played:
    """Play a batch; see :class:`~gspn_framework_package.analysis.executors.Workload`."""
    return prepared.play(batch, watch)


def _deadlock_or(condition: Optional[str], net: Net) -> Optional[Condition]:
    return None if condition is None else parse_condition(condition, net.place_index, ["deadlock"])


def join_batches(parts: Sequence[Samples]) -> Samples:
    """The rows of several batches, one after the other."""
    return Samples(*(np.concatenate(arrays) for arrays in zip(*parts)))


def added(whole: List[Dict[int, float]], spent: Sequence[Dict[int, float]]) -> None:
    """Add times by number of tokens, for each place, to ``whole``."""
    for share, more in zip(whole, spent):
        for count, seconds in more.items():
            share[count] = share.get(count, 0.0) + seconds


class KernelPlayer:
    """Replications of a plan as it runs, or of a net, by the kernel.

    :ivar size: a good number of replications in a batch.
    """

    size = 50

    def __init__(self, run: KernelRun, notes: Sequence[str], subject: Subject) -> None:
        self.net = run.net
        self.notes = list(notes)
        self._subject = subject
        self._run = run
        self._began = clock.monotonic()
        self._compile: Optional[Callable[[], None]] = None
        if machine.numba_is_there():
            if machine.is_loaded():
                self._run.compile()
            else:
                self._compile = self._run.compile
        self._done = self._before = 0
        """Replications and firings so far, of all batches."""

        self._watch = Watch()
        self._begin_batch()

    def play(self, batch: RunBatch, watch: Watch) -> Played:
        """Play a batch."""
        self._watch = watch
        self._begin_batch()
        before = self._before
        if batch.parts is not None:
            self._divide(batch.parts)
        else:
            for number in range(batch.first, batch.first + batch.runs):
                self._replicate(number, max(batch.planned, batch.runs))
        samples = Samples(*(np.array(column) for column in zip(*self._rows)))
        return Played(samples, self._spent, self._before - before)

    def _begin_batch(self) -> None:
        self._rows: List[Tuple[float, float, Any, Any, bool]] = []
        self._spent: List[Dict[int, float]] = [{} for _ in self.net.places]

    def _replicate(self, number: int, total: int) -> None:
        self._begin(number)
        subject = self._subject
        status = kernel.AT_STOP
        if subject.warmup > 0:
            status = self._go(subject.warmup, total)
            self._run.forget()
        if status == kernel.AT_STOP:
            status = self._go(subject.time, total)
        self._keep(max(self._run.now - subject.warmup, 0.0), status)
        self._end()

    def _divide(self, count: int) -> None:
        """Run once, in the given number of parts."""
        subject = self._subject
        self._begin(0)
        if subject.warmup > 0:
            self._expect(self._go(subject.warmup, 1))
            self._run.forget()
        length = (subject.time - subject.warmup) / count
        for k in range(count):
            self._expect(self._go(subject.warmup + (k + 1) * length, 1))
            self._keep(length, kernel.AT_STOP)
            self._run.forget()
        self._end()

    def _begin(self, number: int) -> None:
        sequence = np.random.SeedSequence(self._subject.seed % 2**64, spawn_key=(number,))
        self._run.begin(sequence.generate_state(4, np.uint32).tolist())

    def _end(self) -> None:
        self._done += 1
        self._before += self._run.firings_so_far

    def _expect(self, status: int) -> None:
        if status != kernel.AT_STOP:
            raise RefusedError(
                "the run ends after %g s, so it cannot be divided into batches" % self._run.now,
                hint="take replications instead",
            )

    def _go(self, stop: float, total: int) -> int:
        """Continue until ``stop`` or the end of the run; ``total`` replications are planned."""
        run = self._run
        time = self._subject.time
        while True:
            status = run.go(stop, _COMPILED_EVENTS if run.compiled else _PLAIN_EVENTS)
            firings = self._before + run.firings_so_far
            self._watch.step("firings", firings)
            if self._compile is not None and firings > machine.WORTH_COMPILING:
                part = self._done / total
                if math.isfinite(time):
                    part += run.now / time / total
                spent = clock.monotonic() - self._began
                if math.isinf(time) or spent / max(part, 1e-9) - spent > _PLAIN_SECONDS:
                    self._compile()
                    self._compile = None
            if status == kernel.STUCK:
                raise RefusedError(
                    "a run stays in (%s) forever, which does not satisfy the end condition"
                    % ", ".join(
                        "%s: %d" % item for item in self.net.named(run.marking, zeros=False).items()
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
                np.array(state.counts.area),
                status == kernel.UNTIL,
            )
        )
        spent = np.array(state.counts.spent)
        starts = np.array(state.counts.spent_from)
        there = np.flatnonzero(spent)
        places = np.searchsorted(starts, there, side="right") - 1
        counts = there - starts[places]
        for p, count, time in zip(places.tolist(), counts.tolist(), spent[there].tolist()):
            self._spent[p][count] = self._spent[p].get(count, 0.0) + time


class TablePlayer:
    """Replications of a plan by the rates of its net, using the table of its markings.

    :ivar size: a good number of replications in a batch: they advance in step.
    """

    size = 500

    def __init__(self, plan: Plan, subject: Subject) -> None:
        run_net = compile_plan(replace(plan, until=subject.condition), None)
        self.net = run_net.net
        self.notes: List[str] = []
        self._table = StateCache(run_net)
        self._subject = subject

    def play(self, batch: RunBatch, watch: Watch) -> Played:
        """Play a batch."""
        subject = self._subject
        sequence = np.random.SeedSequence(subject.seed % 2**64, spawn_key=(batch.first,))
        random = np.random.Generator(np.random.PCG64(sequence))
        # the rounding of sums of times depends on the order in which the table discovered its
        # states
        self._table.forget()
        runs = TableRuns(self._table, batch.runs, subject.time, subject.warmup, random)
        runs.go(watch)
        seconds = np.maximum(runs.clock - subject.warmup, 0.0)
        samples = Samples(runs.clock, seconds, runs.firings, runs.tokens, runs.over)
        return Played(samples, runs.shares, runs.events)

"""Discrete-event simulation of a net, or of a plan under its policy, with confidence intervals.

Many independent replications advance in step: one round draws the next event of each of them. Each
marking is evaluated once, when a replication first reaches it, so that a round takes only a few
array operations.

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
from dataclasses import replace
from typing import Any, Dict, List, NamedTuple, Optional, Tuple, Union

import numpy as np
from scipy import stats

from gspn_framework_package.analysis.arrays import Floats, Indices
from gspn_framework_package.analysis.plan.rules import PlanRules
from gspn_framework_package.analysis.simulation.net_rules import NetRules
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.errors import RefusedError, UsageError
from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.model.plan import Plan

REMEMBERED = 500_000
"""Most markings in the cache before it is cleared."""

TIMELESS_FIRINGS = 10_000
"""More consecutive firings in zero time than this are treated as a timeless cycle."""

_WAIT = -1  # the transition of an arc on which robots only wait


class Estimate(NamedTuple):
    """A mean over the replications, with the half width of its confidence interval (infinite for
    one replication)."""

    mean: float
    half_width: float

    def __str__(self) -> str:
        return "%.6g ± %.2g" % (self.mean, self.half_width)


class Simulation(NamedTuple):
    """The results of the replications.

    :ivar mean_tokens: place -> time-averaged number of tokens.
    :ivar throughput: transition -> firings per second.
    :ivar token_distribution: place -> number of tokens -> share of time.
    :ivar end_time: when a replication ended (s): at the condition, or at ``time``.
    :ivar reached: share of the replications that reached the condition; None without one.
    :ivar time_to_condition: when (s) those replications reached it; None without a condition, or if
      none did.
    :ivar events: total number of firings.
    """

    time: float
    warmup: float
    replications: int
    seed: int
    confidence: float
    mean_tokens: Dict[str, Estimate]
    throughput: Dict[str, Estimate]
    token_distribution: Dict[str, Dict[int, float]]
    end_time: Estimate
    reached: Optional[Estimate]
    time_to_condition: Optional[Estimate]
    events: int

    def to_json(self) -> Dict[str, Any]:
        """Everything, as plain JSON values."""
        data = dict(self._asdict())
        for key in ("end_time", "reached", "time_to_condition"):
            data[key] = None if data[key] is None else _estimate_json(data[key])
        for key in ("mean_tokens", "throughput"):
            data[key] = {name: _estimate_json(value) for name, value in data[key].items()}
        data["token_distribution"] = {
            place: {str(n): share for n, share in counts.items()}
            for place, counts in self.token_distribution.items()
        }
        data["time"] = self.time if math.isfinite(self.time) else None
        return data


def simulate(
    subject: Union[Net, Plan],
    *,
    time: float = math.inf,
    replications: int = 1000,
    seed: int = 0,
    warmup: float = 0.0,
    until: Optional[str] = None,
    confidence: float = 0.95,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Simulation:
    """Simulate many independent runs from the initial marking.

    :param subject: a net, or a validated plan, which then follows its policy.
    :param time: length of a run (s).
    :param replications: number of runs.
    :param seed: the same seed gives the same result.
    :param warmup: time (s) at the start of each run that the means exclude.
    :param until: a condition that ends a run; for a net, it may contain ``deadlock``.
    :param confidence: level of the confidence intervals.
    :raises UsageError: a number makes no sense, or neither ``time`` nor a condition is given.
    :raises ExpressionError: the condition cannot be parsed.
    :raises RefusedError: nothing decides a choice, or there is a timeless cycle.
    :raises CancelledError: ``cancel`` returned true.
    """
    _check_numbers(subject, time, replications, warmup, until, confidence)
    plan = subject if isinstance(subject, Plan) else None
    if plan is not None:
        condition = (
            until
            if plan.until is None
            else plan.until
            if until is None
            else "(%s) or (%s)" % (plan.until, until)
        )
        rules: Union[PlanRules, NetRules] = PlanRules(replace(plan, until=condition))
    else:
        assert isinstance(subject, Net)
        names = [p.name for p in subject.places]
        condition = until
        rules = NetRules(
            subject, parse_condition(until, names, ["deadlock"]) if until is not None else None
        )
    runs = _Runs(
        _Graph(rules), replications, time, warmup, np.random.Generator(np.random.PCG64(seed))
    )
    runs.go(Watch(progress, cancel))
    return _summary(runs, rules.net, seed, confidence, condition is not None)


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


class _Graph:
    """The markings that the runs have reached so far, as arrays; states are numbered in order of
    discovery."""

    def __init__(self, rules: Union[PlanRules, NetRules]) -> None:
        self.rules = rules
        self.forget()

    def forget(self) -> None:
        """Forget all states."""
        places = len(self.rules.net.places)
        self._index: Dict[Tuple[Marking, bool], int] = {}
        self._keys: List[Tuple[Marking, bool]] = []
        capacity, width = 64, 4
        self.markings = np.zeros((capacity, places), dtype=np.int64)
        self.exit = np.zeros(capacity)
        """Exit rate (1/s) of each state; infinite for vanishing states, 0 for absorbing ones."""
        self.over = np.zeros(capacity, dtype=bool)
        self.steps = np.full((capacity, width), 2.0)  # cumulative probabilities, padded with 2
        self.targets = np.full((capacity, width), -1, dtype=np.int64)
        self.transitions = np.full((capacity, width), _WAIT, dtype=np.int64)

    def __len__(self) -> int:
        return len(self._keys)

    def key(self, state: int) -> Tuple[Marking, bool]:
        """The marking of a state, and whether robots wait in it."""
        return self._keys[state]

    def number(self, marking: Marking, waiting: bool) -> int:
        """The number of a state, which is evaluated if it is new."""
        key = marking, waiting
        known = self._index.get(key)
        if known is not None:
            return known
        number = self._index[key] = len(self._keys)
        self._keys.append(key)
        if number == len(self.exit):
            self._grow()
        self.markings[number] = marking
        self._work_out(number, marking, waiting)
        return number

    def target(self, state: int, arc: int) -> int:
        """Where an arc leads, which is evaluated on first use."""
        if self.targets[state, arc] < 0:
            marking, _ = self._keys[state]
            t = int(self.transitions[state, arc])
            if t == _WAIT:
                number = self.number(marking, True)
            else:
                number = self.number(self.rules.net.fire(marking, t), False)
            self.targets[state, arc] = number
        return int(self.targets[state, arc])

    def _work_out(self, number: int, marking: Marking, waiting: bool) -> None:
        rules = self.rules
        if rules.is_over(marking):
            self.over[number] = True
            return
        outcomes = [] if waiting else rules.outcomes(marking)
        if outcomes:
            arcs = [
                (_WAIT if o.transition is None else o.transition, o.probability) for o in outcomes
            ]
            self.exit[number] = math.inf
            total = 1.0
        else:
            arcs = rules.timed(marking)
            total = sum(rate for _, rate in arcs)
            self.exit[number] = total
        while len(arcs) > self.steps.shape[1]:
            self._widen()
        if arcs:
            chances = np.cumsum([value for _, value in arcs]) / total
            chances[-1] = 2.0  # rounding must not lead beyond the last one
            self.steps[number, : len(arcs)] = chances
            self.transitions[number, : len(arcs)] = [t for t, _ in arcs]

    def _grow(self) -> None:
        for name in ("markings", "exit", "over", "steps", "targets", "transitions"):
            array = getattr(self, name)
            fill = {"steps": 2.0, "targets": -1, "transitions": _WAIT}.get(name, 0)
            more = np.full_like(array, fill)
            setattr(self, name, np.concatenate([array, more]))

    def _widen(self) -> None:
        for name, fill in (("steps", 2.0), ("targets", -1), ("transitions", _WAIT)):
            array = getattr(self, name)
            setattr(self, name, np.concatenate([array, np.full_like(array, fill)], axis=1))


class _Runs:
    """The state of all replications."""

    def __init__(
        self, graph: _Graph, count: int, time: float, warmup: float, random: np.random.Generator
    ) -> None:
        net = graph.rules.net
        self.graph = graph
        self.time, self.warmup = time, warmup
        self.count = count
        self._random = random
        self.clock = np.zeros(count)
        self.tokens = np.zeros((count, len(net.places)))  # tokens times seconds, after the warm-up
        self.firings = np.zeros((count, len(net.transitions)))  # after the warm-up
        self.over = np.zeros(count, dtype=bool)
        self.shares: List[Dict[int, float]] = [{} for _ in net.places]
        self.events = 0

    def go(self, watch: Watch) -> None:
        """Run all replications to their ends."""
        graph = self.graph
        state = np.full(self.count, graph.number(graph.rules.net.initial_marking, False))
        timeless = np.zeros(self.count, dtype=np.int64)
        active = np.arange(self.count)
        spent = np.zeros(len(graph.exit))  # seconds in each state, over all runs
        rounds = 0
        while len(active):
            if len(graph) > REMEMBERED:
                self._fold(spent)
                state, spent = self._forget(state, active), np.zeros(len(graph.exit))
            here = state[active]
            over = graph.over[here]
            if over.any():
                self.over[active[over]] = True
                active, here = active[~over], here[~over]
                continue
            rates = graph.exit[here]
            with np.errstate(divide="ignore"):
                stay = self._random.standard_exponential(len(active)) / rates
            before = self.clock[active]
            after = np.minimum(before + stay, self.time)
            counted = np.maximum(after - np.maximum(before, self.warmup), 0.0)
            if np.isinf(after).any():
                raise RefusedError(
                    "a run stays in (%s) without end, which does not satisfy the end condition"
                    % ", ".join("%s: %d" % i for i in self._stuck(here[np.isinf(after)][0])),
                    hint="give a time as well",
                )
            if len(spent) < len(graph.exit):
                spent = np.concatenate([spent, np.zeros(len(graph.exit) - len(spent))])
            np.add.at(spent, here, counted)
            self.tokens[active] += counted[:, None] * graph.markings[here]
            self.clock[active] = after
            goes_on = before + stay <= self.time
            active, here = active[goes_on], here[goes_on]
            arcs = (graph.steps[here] <= self._random.random(len(here))[:, None]).sum(axis=1)
            fired = graph.transitions[here, arcs]
            late = (self.clock[active] >= self.warmup) & (fired != _WAIT)
            self.firings[active[late], fired[late]] += 1
            self.events += int((fired != _WAIT).sum())
            state[active] = self._follow(here, arcs)
            timeless[active] = np.where(np.isinf(graph.exit[here]), timeless[active] + 1, 0)
            if len(active) and timeless[active].max() > TIMELESS_FIRINGS:
                raise RefusedError(
                    "more than %d firings without time between them" % TIMELESS_FIRINGS,
                    hint="a cycle of immediate transitions must have a way out",
                )
            rounds += 1
            if rounds % 64 == 0:
                watch.step("events", self.events)
        self._fold(spent)

    def _follow(self, here: Indices, arcs: Indices) -> Indices:
        targets = self.graph.targets[here, arcs]
        for i in np.flatnonzero(targets < 0).tolist():
            targets[i] = self.graph.target(int(here[i]), int(arcs[i]))
        return targets

    def _stuck(self, state: int) -> List[Tuple[str, int]]:
        marking, _ = self.graph.key(int(state))
        return list(self.graph.rules.net.named(marking, zeros=False).items())

    def _fold(self, spent: Floats) -> None:
        """Add the time spent in states to the shares of token counts."""
        states = np.flatnonzero(spent)
        for p, share in enumerate(self.shares):
            counts = self.graph.markings[states, p]
            values, of = np.unique(counts, return_inverse=True)
            for count, seconds in zip(
                values.tolist(), np.bincount(of.reshape(-1), weights=spent[states]).tolist()
            ):
                share[count] = share.get(count, 0.0) + seconds

    def _forget(self, state: Indices, active: Indices) -> Indices:
        """Forget all states except the current ones; returns their new numbers."""
        keys = {int(s): self.graph.key(int(s)) for s in np.unique(state[active])}
        self.graph.forget()
        fresh = {old: self.graph.number(*key) for old, key in keys.items()}
        renumbered = np.zeros_like(state)
        renumbered[active] = [fresh[int(s)] for s in state[active]]
        return renumbered


def _summary(runs: _Runs, net: Net, seed: int, confidence: float, conditional: bool) -> Simulation:
    seconds = np.maximum(runs.clock - runs.warmup, 0.0)
    whole = seconds.sum()
    reached = _estimate(runs.over.astype(np.float64), confidence) if conditional else None
    came = runs.clock[runs.over]
    return Simulation(
        time=runs.time,
        warmup=runs.warmup,
        replications=runs.count,
        seed=seed,
        confidence=confidence,
        mean_tokens={
            p.name: _ratio(runs.tokens[:, i], seconds, confidence) for i, p in enumerate(net.places)
        },
        throughput={
            t.name: _ratio(runs.firings[:, i], seconds, confidence)
            for i, t in enumerate(net.transitions)
        },
        token_distribution={
            p.name: {n: s / whole for n, s in sorted(runs.shares[i].items())} if whole > 0 else {}
            for i, p in enumerate(net.places)
        },
        end_time=_estimate(runs.clock, confidence),
        reached=reached,
        time_to_condition=_estimate(came, confidence) if conditional and len(came) else None,
        events=runs.events,
    )


def _estimate(samples: Floats, confidence: float) -> Estimate:
    count = len(samples)
    mean = float(samples.mean())
    if count < 2:
        return Estimate(mean, math.inf)
    quantile = float(stats.t.ppf(0.5 + confidence / 2, count - 1))
    return Estimate(mean, quantile * float(samples.std(ddof=1)) / math.sqrt(count))


def _ratio(amounts: Floats, seconds: Floats, confidence: float) -> Estimate:
    """Amount per second, by the ratio estimator, since runs that end at a condition differ in
    length."""
    whole = float(seconds.sum())
    if whole <= 0:
        return Estimate(math.nan, math.inf)
    ratio = float(amounts.sum()) / whole
    spread = _estimate(amounts - ratio * seconds, confidence).half_width
    return Estimate(ratio, spread * len(seconds) / whole)


def _estimate_json(estimate: Estimate) -> Dict[str, Optional[float]]:
    return {
        key: value if math.isfinite(value) else None for key, value in estimate._asdict().items()
    }

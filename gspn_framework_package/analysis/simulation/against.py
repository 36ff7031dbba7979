"""Compares an old and a new plan as they run: do the real durations, outcomes and failures confirm
what a computed policy promises?

Both plans are simulated in pairs of runs with the same random numbers, and the differences within
the pairs are averaged. The interval of their mean is valid whether or not the two runs of a pair
are correlated; the stronger the correlation, the narrower it is.

>>> from gspn_framework_package.analysis.decisions.aims import Objective
>>> from gspn_framework_package.model.builder import NetBuilder
>>> from gspn_framework_package.model.plan import Plan, RobotSpec
>>> from gspn_framework_package.model.policy import Policy
>>> net = (NetBuilder().place("choose", 1).place("short").place("long")
...        .immediate("walk", inputs="choose", outputs="long")
...        .immediate("drive", inputs="choose", outputs="short")
...        .exponential("walked", rate=0.5, inputs="long", outputs="choose")
...        .exponential("driven", rate=2.0, inputs="short", outputs="choose").build())
>>> plan = Plan(net, actions={"choose": None}, robots=(RobotSpec("r", "choose"),),
...             policy=Policy.from_table((), [((), {"walk": 1})]))
>>> faster = plan.with_policy(Policy.from_table((), [((), {"drive": 1})]))
>>> aim = Objective.long_run({"walked": 1, "driven": 1})
>>> found = compare_plans(plan, faster, aim, replications=50, seconds=None)
>>> found.significant, abs(found.difference.mean - 1.5) < 0.2
(True, True)
"""

from __future__ import annotations

import dataclasses
import math
import time as clock
from typing import Dict, Iterator, List, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Floats
from gspn_framework_package.analysis.decisions.aims import Aim, Objective
from gspn_framework_package.analysis.executors import Executor, LocalExecutor, WorkItem, Workload
from gspn_framework_package.analysis.simulation import machine
from gspn_framework_package.analysis.simulation.against_result import Against, sentence
from gspn_framework_package.analysis.simulation.aimed_run import worth_compiling
from gspn_framework_package.analysis.simulation.paired_estimates import (
    POWER,
    Measured,
    correlation_of,
    paired_mean,
    paired_share,
    paired_shares,
    pairs_needed,
    truncation,
)
from gspn_framework_package.analysis.simulation.pairs import (
    Contest,
    PairPlayer,
    PlayedPair,
    play_pairs,
)
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import TIME_KEYS, Plan

BATCH_SECONDS = 10.0
"""Default computing time of a comparison (s)."""

LEAST_PAIRS = 20
"""Smallest number of pairs of runs, however long they take: with fewer, a t interval is unreliable
if the values are skewed."""

MOST_PAIRS = 1_000_000


_WINDOWS = 20
"""Number of parts of a first run in which the warm-up is searched for."""

_FIRST_RUNS = 8
"""First runs of each plan, used only to find the warm-up."""

_MOST_LONGER = 6
"""Largest number of times that a warm-up is lengthened."""

_ROUNDING = 1e-9

_LOOKS = (20, 60, 200, 600)
"""Numbers of pairs after which a warm-up that is too short is lengthened."""

_LONGEST = 20.0
"""Length of a run that may not reach its condition, as a multiple of a first estimate."""


def compare_plans(
    old: Plan,
    new: Plan,
    objective: Objective,
    *,
    seconds: Optional[float] = BATCH_SECONDS,
    replications: Optional[int] = None,
    precision: Optional[float] = None,
    time: Optional[float] = None,
    warmup: Optional[float] = None,
    expected: Optional[float] = None,
    losses: float = 0.0,
    seed: int = 0,
    confidence: float = 0.95,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    on: Optional[Executor] = None,
) -> Against:
    """Simulate two plans as they run, and compare their values for an aim.

    The runs end at the earliest of ``seconds``, ``replications`` and ``precision``, but after at
    least :data:`LEAST_PAIRS` pairs, unless ``replications`` is smaller.

    :param old: a validated plan; ``new`` is another with the same places and transitions as far as
        the aim names them.
    :param seconds: computing time (s); None: no limit.
    :param replications: number of pairs of runs.
    :param precision: the half width of the difference, relative to the value of the old plan, that
        is enough.
    :param time: length of a run (s), for the long run and for the probability to reach a condition.
        By default it is chosen.
    :param warmup: time (s) at the start of a run that the long run leaves out. By default, it is
        found in first runs of both plans, which are not used otherwise.
    :param expected: the difference that a model promises, for which the number of runs needed is
        reported; by default, the observed difference.
    :param losses: how often a robot is lost, per second and robot.
    :param seed: the same seed gives the same runs.
    :param confidence: level of the intervals.
    :param on: where to compute: by default in this process. The same pairs give the same result.
    :raises UsageError: a number is invalid, or a plan lacks a name of the aim.
    :raises ExpressionError: the condition cannot be parsed.
    :raises RefusedError: a plan cannot be played: a timeless cycle.
    :raises CancelledError: ``cancel`` returned true.
    """
    objective = _same_for_both(old, new, objective)
    _check(old, new, objective, seconds, replications, precision, time, warmup, confidence)
    contest = Contest(old, new, objective, losses, seed, seconds)
    most = MOST_PAIRS if replications is None else replications
    if seconds is None and replications is None and precision is None:
        most = 1000
    executor = on or LocalExecutor()
    work = _Comparison(contest, Watch(progress, cancel), executor)
    work.plan_runs(time, warmup)
    settles = warmup is None and time is None
    while work.pairs < most and not work.is_over(precision, confidence):
        work.compile_for(most, precision)
        for pair in work.played(most):
            work.add(pair)
            if settles and work.pairs in _LOOKS:
                work.settle()
            if work.is_over(precision, confidence):
                break
    return work.result(confidence, expected)


def _same_for_both(old: Plan, new: Plan, objective: Objective) -> Objective:
    found = objective.resolved(old.net)
    others = objective.resolved(new.net).rewards
    for name in set(found.rewards) ^ set(others):
        if name not in objective.rewards:
            raise UsageError("a pattern matches '%s', which one of the two plans lacks" % name)
    return found


def _check(
    old: Plan,
    new: Plan,
    objective: Objective,
    seconds: Optional[float],
    replications: Optional[int],
    precision: Optional[float],
    time: Optional[float],
    warmup: Optional[float],
    confidence: float,
) -> None:
    for plan in (old, new):
        for name in objective.rewards:
            if name not in plan.net.place_index and name not in plan.net.transition_index:
                raise UsageError("a reward names '%s', which the plan does not have" % name)
    if not 0 < confidence < 1:
        raise UsageError("a confidence of %g is not possible" % confidence)
    if replications is not None and replications < 2:
        raise UsageError("%d pairs of runs are too few for an interval" % replications)
    if seconds is not None and not seconds > 0:
        raise UsageError("a time of %g s is not possible" % seconds)
    if precision is not None and not 0 < precision < 1:
        raise UsageError("a precision of %g is not possible" % precision)
    if time is not None:
        if objective.aim not in (Aim.LONG_RUN, Aim.REACH):
            raise UsageError("runs for this aim end by themselves: leave out their length")
        if not 0 < time < math.inf:
            raise UsageError("a run of %g s is not possible" % time)
    if warmup is not None:
        if objective.aim is not Aim.LONG_RUN:
            raise UsageError("a warm-up is for the long run only")
        if not 0 <= warmup < (math.inf if time is None else time):
            raise UsageError("a warm-up of %g s is not possible" % warmup)


class _Comparison:
    """Pairs of runs of two plans."""

    def __init__(self, contest: Contest, watch: Watch, executor: Executor) -> None:
        self._player = PairPlayer(contest, watch)
        self.runs = self._player.runs
        self.objective = contest.objective
        self.pairs = 0
        self.time: Optional[float] = None
        self.warmup = 0.0
        self.notes: List[str] = []
        self._contest, self._watch, self._executor = contest, watch, executor
        self._firings = 0
        """Firings of the workers of the executor."""

        self._seed = contest.seed
        self._began = clock.monotonic()
        self._pairs_began = self._began
        self._seconds = seconds = contest.seconds
        self._may_compile = True
        if seconds is not None and worth_compiling(seconds):
            self._compile()
        self._chosen = False
        self._longer = 0
        self._values: Tuple[List[float], List[float]] = ([], [])
        self._drifts: Tuple[List[float], List[float]] = ([], [])
        self._missed = [0, 0]
        self._cut = [0, 0]
        self._late = [0, 0]
        self._gave_up = ""
        old, new = contest.old, contest.new
        if dataclasses.replace(new, policy=old.policy).hash() != old.hash() or any(
            getattr(old, key) != getattr(new, key) for key in (*TIME_KEYS, "own_times")
        ):
            self.notes.append("the plans differ in more than their policies")
        self.notes += list(dict.fromkeys(s for run in self.runs for s in run.assumptions))

    # -- how long ----------------------------------------------------------------------------------

    def plan_runs(self, time: Optional[float], warmup: Optional[float]) -> None:
        """Decide how long a run and its warm-up are."""
        aim = self.objective.aim
        if aim is Aim.LONG_RUN:
            self._plan_long_run(time, warmup)
        elif aim is Aim.REACH:
            self.time = time if time is not None else _LONGEST * max(map(self._span, (0, 1)))
        self._pairs_began = clock.monotonic()

    def _span(self, which: int) -> float:
        """A time (s) in which each robot finishes some dozens of actions."""
        run = self.runs[which]
        run.begin(self._seed, 0, 1)
        run.go(most=100 + 30 * len(run.tables.plan.robots))
        return run.now if run.now > 0 else 1.0

    def _plan_long_run(self, time: Optional[float], warmup: Optional[float]) -> None:
        if time is not None and warmup is not None:
            self.time, self.warmup = time, warmup
            return
        span = max(map(self._span, (0, 1)))
        if time is not None:
            span = min(span, time)
        settles = span
        for _ in range(6):
            ends = [self._settling(which, span) for which in (0, 1)]
            settles = max(ends)
            if settles <= span / 2 or (time is not None and 2 * span > time):
                break
            span *= 2
        found = max(settles, span / _WINDOWS)
        self.warmup = found if warmup is None else warmup
        if time is None:
            time = self.warmup + max(span, 4 * self.warmup)
        elif warmup is None and self.warmup > time / 2:
            self.warmup = time / 2
            self.notes.append(
                "a run of %g s is short: its start matters for about %g s" % (time, found)
            )
        self.time = time
        self._chosen = warmup is None

    def _settling(self, which: int, span: float) -> float:
        """The time (s) after which the mean of some runs of ``span`` settles, by the marginal
        standard error rule (MSER) of K. P. White, *An effective truncation heuristic for bias
        reduction in simulation output* (Simulation, 1997); ``span`` if it does not."""
        run = self.runs[which]
        means = np.zeros(_WINDOWS)
        for number in range(_FIRST_RUNS):
            run.begin(self._seed, number, 2)
            before = 0.0
            for k in range(_WINDOWS):
                at = span * (k + 1) / _WINDOWS
                run.go(at)
                earned = run.earned(at)
                means[k] += earned - before
                before = earned
        return span * truncation(means) / _WINDOWS

    # -- the runs ----------------------------------------------------------------------------------

    def settle(self) -> None:
        """If the runs still change after their warm-up, start again with a longer one, unless more
        than half of the time is used up."""
        if self.objective.aim is not Aim.LONG_RUN or not any(
            self._drifting(which) for which in (0, 1)
        ):
            return
        now = clock.monotonic()
        if self._seconds is not None and now > self._began + self._seconds / 2:
            return
        if self._longer >= _MOST_LONGER:
            return
        self._longer += 1
        self.warmup *= 4
        self.time = 5 * self.warmup
        self.pairs = 0
        self._pairs_began = now
        self._values, self._drifts = ([], []), ([], [])
        self._cut, self._late = [0, 0], [0, 0]

    def compile_for(self, most: int, precision: Optional[float]) -> None:
        """Use the compiled kernel if the remaining pairs take long enough."""
        if not self._may_compile or self._player.firings < machine.WORTH_COMPILING:
            return
        now = clock.monotonic()
        left = math.inf if self.pairs == 0 or precision is not None else 0.0
        if self.pairs:
            left = max(left, (most - self.pairs) * (now - self._pairs_began) / self.pairs)
        if self._seconds is not None:
            least = (LEAST_PAIRS - self.pairs) * (now - self._pairs_began) / max(self.pairs, 1)
            left = min(left, max(self._began + self._seconds - now, least))
        self._may_compile = False
        if worth_compiling(left):
            self._compile()

    def _compile(self) -> None:
        self._may_compile = False
        self._player.compile()

    def played(self, most: int) -> Iterator[PlayedPair]:
        """Play the next pairs: one in this process, or with workers, all up to the next check."""
        contest = self._contest._replace(time=self.time, warmup=self.warmup)
        if isinstance(self._executor, LocalExecutor):
            self._player.contest = contest
            yield self._player.play(self.pairs)
            return
        first = self.pairs
        end = min(most, next((n for n in _LOOKS if n > first), first + _LOOKS[-1]))
        if self._seconds is not None and first:
            now = clock.monotonic()
            left = max(self._began + self._seconds - now, 0.0)
            affordable = math.ceil(left * first / max(now - self._pairs_began, 1e-3))
            end = min(end, first + max(affordable, self._executor.workers))
        size = max((end - first) // (4 * self._executor.workers), 1)
        workload = Workload(PairPlayer, play_pairs, contest)
        items = [
            WorkItem(workload, (number, min(size, end - number)), min(size, end - number))
            for number in range(first, end, size)
        ]
        for found, firings in self._executor.ordered(items, "pairs of runs", self._watch):
            self._firings += firings
            yield from found

    def add(self, pair: PlayedPair) -> None:
        """Add a pair to the results."""
        if isinstance(pair, str):
            self._gave_up = pair
            return
        for which, outcome in enumerate(pair):
            self._values[which].append(outcome.value)
            if self.objective.aim is Aim.LONG_RUN:
                self._drifts[which].append(outcome.drift)
            self._cut[which] += outcome.cut
            self._late[which] += outcome.late
            self._missed[which] += outcome.missed
        self.pairs += 1

    def is_over(self, precision: Optional[float], confidence: float) -> bool:
        """Whether there are enough pairs."""
        if self._gave_up:
            return True
        if self.pairs < LEAST_PAIRS:
            return False
        if self._seconds is not None:
            now = clock.monotonic()
            each = (now - self._pairs_began) / self.pairs
            if now + each / 2 > self._began + self._seconds:
                return True
        if precision is not None and self.pairs >= 2 * LEAST_PAIRS and self.pairs % 10 == 0:
            old = self._values[0]
            middle = float(np.mean(old))
            difference = self._difference(confidence)
            if difference.low is not None and difference.high is not None and middle:
                half = (difference.high - difference.low) / 2
                return half <= precision * abs(middle)
        return False

    # -- the result --------------------------------------------------------------------------------

    def _difference(self, confidence: float) -> Measured:
        old, new = (np.array(values) for values in self._values)
        if self.objective.aim is Aim.REACH:
            return paired_shares(old > 0, new > 0, confidence)
        if any(self._missed):
            return Measured(None, why="not every run reaches the condition")
        return paired_mean(new - old, confidence)

    def result(self, confidence: float, expected: Optional[float]) -> Against:
        """The result of the pairs."""
        spent = clock.monotonic() - self._pairs_began
        measured = []
        for which, values in enumerate(self._values):
            measured.append(self._measured(which, np.array(values), confidence))
        if self.pairs < 2:
            difference = Measured(None, why=self._gave_up or "there are no runs")
        else:
            difference = self._difference(confidence)
        self._note_ends()
        self._note_warmup()
        low, high = difference.low, difference.high
        significant = low is not None and high is not None and (low > 0 or high < 0)
        better = None
        if significant:
            better = (difference.mean or 0.0) > 0 if self.objective.maximise else (high or 0.0) < 0
        correlation, needed = None, None
        if difference.mean is not None:
            correlation = correlation_of(*self._values)
            size = abs(difference.mean if expected is None else expected)
            if not significant and size > 0:
                needed = self._needed(size, confidence, spent)
        if self._gave_up:
            self.notes.append("%s and was abandoned" % self._gave_up)
        found = Against(
            self.objective,
            measured[0],
            measured[1],
            difference,
            significant,
            "",
            self.pairs,
            better,
            correlation,
            self.time,
            self.warmup,
            needed,
            confidence,
            self._seed,
            self._player.firings + self._firings,
            self.notes,
        )
        found.text = sentence(found)
        return found

    def _measured(self, which: int, values: Floats, confidence: float) -> Measured:
        if len(values) < 2:
            return Measured(None, why=self._gave_up or "there are no runs")
        if self.objective.aim is Aim.REACH:
            return paired_share(values > 0, confidence)
        missed = self._missed[which]
        if missed:
            come = values[np.isfinite(values)]
            text = "%d of %d runs never reach the condition" % (missed, len(values))
            if len(come):
                text += "; the others have %.6g on average" % come.mean()
            return Measured(None, why=text)
        return paired_mean(values, confidence)

    def _note_ends(self) -> None:
        for which, name in enumerate(("old", "new")):
            cut = self._cut[which]
            if cut and self.objective.aim is Aim.LONG_RUN:
                self.notes.append(
                    "%d of %d runs of the %s plan end; the marking then stays the same"
                    % (cut, self.pairs, name)
                )
            elif cut:
                self.notes.append(
                    "%d of %d runs of the %s plan are unfinished after %.6g s; they count as not "
                    "reaching the condition" % (cut, self.pairs, name, self.time or 0.0)
                )

    def _drifting(self, which: int) -> bool:
        """Whether runs still change after their warm-up: some end then, or their first and last
        third differ by more than chance and rounding."""
        if self._late[which]:
            return True
        if len(self._drifts[which]) < LEAST_PAIRS:
            return False
        drift = paired_mean(np.array(self._drifts[which]), 0.999)
        least = _ROUNDING * float(np.mean(np.abs(self._values[which])))
        return (drift.low or 0.0) > least or (drift.high or 0.0) < -least

    def _note_warmup(self) -> None:
        if self._chosen:
            again = ", and in later ones that still changed" if self._longer else ""
            self.notes.append(
                "the first %.4g s of each run of %.4g s are left out, from %d first runs "
                "(MSER)%s" % (self.warmup, self.time or 0.0, _FIRST_RUNS, again)
            )
        for which, name in enumerate(("old", "new")):
            if self._drifting(which):
                self.notes.append(
                    "the runs of the %s plan have not settled after %.4g s: take a longer warm-up"
                    % (name, self.warmup)
                )

    def _needed(self, size: float, confidence: float, spent: float) -> Dict[str, float]:
        differences = np.array(self._values[1]) - np.array(self._values[0])
        pairs = pairs_needed(float(differences.std(ddof=1)), size, confidence)
        pairs = max(pairs, LEAST_PAIRS)
        return {
            "size": size,
            "pairs": pairs,
            "seconds": pairs * spent / max(self.pairs, 1),
            "power": POWER,
        }

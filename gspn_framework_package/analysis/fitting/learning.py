"""Learns the parameters of a plan from attempts in runs: durations, outcomes, failures, event
rates."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import (
    Any,
    Dict,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)

import numpy as np

from gspn_framework_package.analysis.executors import Executor, LocalExecutor, WorkItem, Workload
from gspn_framework_package.analysis.fitting.arrivals import ArrivalsFit, fit_arrivals
from gspn_framework_package.analysis.fitting.durations import DurationFit, fit_duration
from gspn_framework_package.analysis.fitting.needs import ENOUGH_ATTEMPTS, Need, find_needs
from gspn_framework_package.analysis.fitting.sample import Sample
from gspn_framework_package.analysis.fitting.testing import (
    SAMPLES,
    SIGNIFICANT,
    EventFit,
    FitTest,
    OutcomeFit,
    event_fit,
    groups_differ,
    largest_clear,
    outcome_fit,
    outcomes_depend,
    shares_differ,
    test_of_fit,
    wilson,
)
from gspn_framework_package.analysis.watch import Progress, Watch
from gspn_framework_package.model.attempt import Attempt, EventCount
from gspn_framework_package.model.duration import FAMILIES, Duration, Evidence, Family, Kind
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import TIME_KEYS, OwnTimes, Plan

ENOUGH_FOR_QUANTILES = 200
"""With fewer observations than this, a family that fits badly is not replaced by quantiles."""

MATERIAL = 0.03
"""A family that fits badly is kept anyway if its Kolmogorov-Smirnov distance is smaller: with
enough data, even an irrelevant deviation is significant."""

NARROW = 0.05
"""The same if the coefficient of variation is smaller: the form of so narrow a distribution is
irrelevant too."""

_REFUTED = 0.01
"""A family is contradicted by the data if the p-value of the test of fit is below this."""

WITHIN = 0.05
"""Largest half-width of a 95 % interval for which no more log is asked for; see
:func:`.needs.find_needs`.
"""

_DIFFER = {key: "the robots' " + key for key in TIME_KEYS}
"""Key of the plan file -> the kind of test whether robots differ in it."""


class PlaceFit(NamedTuple):
    """The results for an action place.

    :ivar n: observed durations: of attempts that succeeded, or of those that failed if all did.
    :ivar censored: attempts that were cut off, for example by a timeout.
    :ivar fit: the distribution; None if there was too little data.
    :ivar test: the test of fit; None if there is none.
    :ivar outcomes: transition, or "" -> number of times the action named it; empty if there is no
        choice.
    :ivar failure: failed attempts; None if none failed and the plan expects none.
    :ivar sample: the durations.
    """

    n: int
    censored: int
    fit: Optional[DurationFit]
    test: Optional[FitTest]
    outcomes: Mapping[str, OutcomeFit]
    failure: Optional[OutcomeFit]
    sample: Sample

    def to_json(self) -> Dict[str, Any]:
        """The fit as a JSON object."""
        fit, test = self.fit, self.test
        data: Dict[str, Any] = {
            "n": self.n,
            "censored": self.censored,
            "mean": fit.duration.mean if fit else None,
            "interval": list(fit.interval) if fit else None,
            "distribution": fit.duration.kind.value if fit else None,
            "shape": fit.shape if fit else None,
            "test": {"statistic": test.statistic, "p": test.p} if test else None,
            "outcomes": {name: share.to_json() for name, share in self.outcomes.items()},
        }
        if self.failure is not None:
            data["failure"] = self.failure.to_json()
        return data


class FitReport(NamedTuple):
    """The results.

    :ivar places: by place.
    :ivar rates: by transition of the environment or of an event.
    :ivar notes: for people.
    :ivar unseen: places with an action, but without an attempt.
    :ivar rare: transition of the environment or of an event that fired too seldom -> how often.
    :ivar robot_seconds: how long robots were recorded, all together (s).
    :ivar own: robot -> key of the plan file -> place -> the results for that robot alone, where
        robots differ.
    :ivar arrivals: what is learned about arrivals over the day.
    """

    places: Mapping[str, PlaceFit]
    rates: Mapping[str, EventFit]
    notes: Tuple[str, ...]
    unseen: Tuple[str, ...] = ()
    rare: Mapping[str, int] = {}
    robot_seconds: float = 0.0
    own: Mapping[str, Mapping[str, Mapping[str, PlaceFit]]] = {}
    arrivals: ArrivalsFit = ArrivalsFit()

    def needs(self, within: float = WITHIN) -> List[Need]:
        """What was not learned, or not exactly enough, and how much more log that needs.

        :param within: the largest accepted half-width of a 95 % interval: as a share of a mean
            duration or a rate, or the difference of a probability.
        """
        learned = self.places, self.rates, self.unseen, self.rare, self.arrivals, self.robot_seconds
        return list(find_needs(*learned, within))

    def to_json(self, within: float = WITHIN) -> Dict[str, Any]:
        """The report as a JSON object; ``within`` as in :meth:`needs`."""
        data: Dict[str, Any] = {"places": {p: fit.to_json() for p, fit in self.places.items()}}
        if self.rates:
            data["rates"] = {t: event.to_json() for t, event in self.rates.items()}
        if self.arrivals.arrivals:
            data.update(self.arrivals.to_json())
        for robot, keys in self.own.items():
            own = data.setdefault("own", {})[robot] = {}
            for key, places in keys.items():
                own[key] = {place: fit.to_json() for place, fit in places.items()}
        data["needs"] = [need.to_json() for need in self.needs(within)]
        data["notes"] = list(self.notes)
        return data

    def apply(self, plan: Plan, logs: Sequence[str], per_robot: bool = False) -> Plan:
        """The plan with the learned values. Values with too little data are kept.

        :param logs: the names of the logs, for the evidence.
        :param per_robot: whether robots that differ get their own values.
        """
        names = tuple(logs)
        team = _learned(plan.times, dict.fromkeys(TIME_KEYS, self.places), names)
        known = {place for place, found in self.places.items() if found.fit is not None}
        own = {robot: times.without(known) for robot, times in plan.own_times.items()}
        for robot, its in self.own.items() if per_robot else ():
            own[robot] = _learned(own.get(robot, OwnTimes()), its, names)
        rates: Dict[str, float] = {}
        evidence = dict(team.evidence)
        for name, event in self.rates.items():
            rates[name] = event.rate
            evidence["rates", name] = Evidence(event.seen, names, event.interval)
        return replace(
            plan.with_rates(rates),
            durations=team.durations,
            outcomes=team.outcomes,
            failures=team.failures,
            own_times={robot: times for robot, times in own.items() if any(times)},
            evidence=evidence,
        ).validate()


def _learned(
    old: OwnTimes, found: Mapping[str, Mapping[str, PlaceFit]], logs: Tuple[str, ...]
) -> OwnTimes:
    """Values, of the team or of one robot, with the learned ones in the place of old ones.

    :param found: key of the plan file -> place -> what was learned there.
    """
    durations, outcomes = dict(old.durations), dict(old.outcomes)
    failures, evidence = dict(old.failures), dict(old.evidence)
    for place, its in found.get("durations", {}).items():
        if its.fit is not None:
            durations[place] = its.fit.duration
            evidence["durations", place] = Evidence(its.n, logs, its.fit.interval)
    for place, its in found.get("outcomes", {}).items():
        if its.outcomes:
            outcomes[place] = {t: o.probability for t, o in its.outcomes.items()}
            total = max(o.total for o in its.outcomes.values())
            evidence["outcomes", place] = Evidence(total, logs)
    for place, its in found.get("failures", {}).items():
        if its.failure is not None:
            failures[place] = its.failure.probability
            evidence["failures", place] = Evidence(its.failure.total, logs, its.failure.interval)
    return OwnTimes(durations, outcomes, failures, evidence)


def fit_plan(
    plan: Plan,
    attempts: Iterable[Attempt],
    events: Optional[Mapping[str, EventCount]] = None,
    choice: str = "auto",
    *,
    seed: int = 0,
    samples: int = SAMPLES,
    progress: Optional[Progress] = None,
    on: Optional[Executor] = None,
) -> FitReport:
    """Learn from attempts.

    :param plan: the plan that was run.
    :param attempts: the attempts of all runs, each once.
    :param events: transition of the environment or of an event -> how often it fired, and for how
        long it could have.
    :param choice: the family of durations, one of :func:`.durations.family_choices`.
    :param seed: of the simulated tests; the same data and seed give the same report.
    :param samples: simulated samples of each test of fit; 0: no such tests.
    :param progress: called at intervals with what is counted, the count, and the seconds.
    :param on: where to fit and test the places: by default in this process. The result is the same.
    """
    executor = on or LocalExecutor()
    # another process does not know what was added here
    learning = _Learning(plan, FAMILIES.get(choice, choice), seed, samples)
    return learning.learn(attempts, events or {}, executor, Watch(progress, interval=0.0))


class _OfPlace(NamedTuple):
    """The results for a place, and for each robot alone."""

    found: PlaceFit
    notes: List[str]
    doubts: Dict[str, List[Tuple[float, str]]]
    robots: Dict[str, PlaceFit]


def _learn_place(shared: Any, piece: Any, _: Watch) -> _OfPlace:
    return _Learning(*shared).learn_place(*piece)


class _Learning:
    """The work of :func:`fit_plan`."""

    def __init__(self, plan: Plan, choice: Union[str, Family], seed: int, samples: int) -> None:
        self.plan = plan
        self.choice = choice
        self.seed = seed
        self.samples = samples
        self.notes: List[str] = []
        self._doubts: Dict[str, List[Tuple[float, str]]] = {}
        """Kind of test -> the p-values, each with the note for a small one."""

    def learn(
        self,
        attempts: Iterable[Attempt],
        events: Mapping[str, EventCount],
        executor: Executor,
        watch: Watch,
    ) -> FitReport:
        by_place: Dict[str, List[Attempt]] = {}
        spans: Dict[Tuple[int, str], Tuple[float, float]] = {}
        for attempt in attempts:
            by_place.setdefault(attempt.place, []).append(attempt)
            key = attempt.log, attempt.robot
            begin, end = spans.get(key, (attempt.start, attempt.end))
            spans[key] = min(begin, attempt.start), max(end, attempt.end)
        seen = [place for place in self.plan.action_places if place in by_place]
        shared = (self.plan, self.choice, self.seed, self.samples)
        workload = Workload(tuple, _learn_place, shared)
        items = [WorkItem(workload, (place, by_place[place])) for place in seen]
        places = {}
        learned = dict(zip(seen, executor.ordered(items, "places fitted", watch)))
        for place, of_place in learned.items():
            places[place] = of_place.found
            self.notes += of_place.notes
            for kind, doubts in of_place.doubts.items():
                self._doubts.setdefault(kind, []).extend(doubts)
        unseen = [
            place
            for place in self.plan.action_places
            if place not in by_place and self.plan.actions.get(place) is not None
        ]
        if unseen:
            self.notes.append("no attempt was seen in %s" % ", ".join(unseen))
        rates = self._rates(events)
        own = self._own(learned, self._report_doubts())
        rare = {name: event.firings for name, event in events.items() if name not in rates}
        recorded = sum(end - begin for begin, end in spans.values())
        arrivals = fit_arrivals(self.plan.net, events)
        notes = (*self.notes, *arrivals.notes)
        return FitReport(places, rates, notes, tuple(unseen), rare, recorded, own, arrivals)

    def _own(
        self, learned: Mapping[str, _OfPlace], clear: float
    ) -> Dict[str, Dict[str, Dict[str, PlaceFit]]]:
        """What was learned about single robots, as in :class:`FitReport`, where they differ with a
        p-value of at most ``clear``."""
        own: Dict[str, Dict[str, Dict[str, PlaceFit]]] = {}
        team = {robot.name for robot in self.plan.robots}
        for key, kind in _DIFFER.items():
            for place, of_place in learned.items():
                ps = [p for p, _ in of_place.doubts.get(kind, ())]
                for robot, its in of_place.robots.items() if ps and ps[0] <= clear else ():
                    if robot in team:
                        own.setdefault(robot, {}).setdefault(key, {})[place] = its
        return own

    # -- a place -----------------------------------------------------------------------------------

    def learn_place(self, place: str, attempts: List[Attempt]) -> _OfPlace:
        """The fit of a place, with notes and doubts."""
        # each place has its own random numbers, independent of other places
        source = np.random.SeedSequence([self.seed % 2**64, len(place), *place.encode()])
        generator = np.random.Generator(np.random.PCG64(source))
        found = self._place(place, attempts, generator)
        robots: Dict[str, PlaceFit] = {}
        differ = [p for kind in _DIFFER.values() for p, _ in self._doubts.get(kind, ())]
        if min(differ, default=1.0) < SIGNIFICANT:
            for robot in sorted({a.robot for a in attempts}):
                alone = _Learning(self.plan, self.choice, self.seed, 0)
                robots[robot] = alone._place(place, _of(attempts, robot), generator)
        return _OfPlace(found, self.notes, self._doubts, robots)

    def _place(self, place: str, attempts: List[Attempt], generator: Any) -> PlaceFit:
        done = [a for a in attempts if a.completed and not a.failed]
        failed = [a for a in attempts if a.completed and a.failed and a.failed != Outcome.TIMEOUT]
        cut = [a for a in attempts if not a.completed or a.failed == Outcome.TIMEOUT]
        if not done:  # only failures are known, so they also give the time of an attempt
            failed += [a for a in cut if a.completed]
            cut = [a for a in cut if not a.completed]
        sample = _sample(done or failed, cut)
        fit, test = self._duration(place, sample, generator)
        if fit is not None:
            self._compare_groups(place, done, cut, fit.duration)
        if failed and done:
            self._compare_failed(place, done, failed)
        outcomes = self._outcomes(place, done)
        if outcomes:
            self._compare_shares("outcomes", place, [(a.robot, a.result) for a in done])
        self._compare_shares(
            "failures",
            place,
            [(a.robot, "a success") for a in done] + [(a.robot, "a failure") for a in failed],
        )
        failure = self._failure(place, len(failed), len(failed) + len(done))
        return PlaceFit(sample.size, len(cut), fit, test, outcomes, failure, sample)

    def _duration(
        self, place: str, sample: Sample, generator: Any
    ) -> Tuple[Optional[DurationFit], Optional[FitTest]]:
        if sample.size < ENOUGH_ATTEMPTS:
            self.notes.append(
                "%s: %d observed durations are too few; %s"
                % (
                    place,
                    sample.size,
                    "the duration in the plan is kept"
                    if place in self.plan.durations
                    else "the rates of the net apply",
                )
            )
            return None, None
        fit = fit_duration(sample, self.choice)
        test = test_of_fit(fit, sample, generator, self.samples) if self.samples else None
        if test is None or test.p >= _REFUTED:
            return fit, test
        which = "%s: the times do not follow the best %s distribution (distance %.3g, p = %.2g)" % (
            place,
            fit.duration.kind.value,
            test.statistic,
            test.p,
        )
        far = test.statistic >= MATERIAL and fit.duration.variation >= NARROW
        quantiles = self.choice == "auto" and far and sample.size >= ENOUGH_FOR_QUANTILES
        if quantiles and len(sample.censored) > 0.05 * sample.size:
            self.notes.append(which + "; too many are censored for quantiles")
        elif quantiles:
            self.notes.append(which + "; their quantiles take its place")
            return fit_duration(sample, fits=False), None
        elif far:
            self.notes.append(which)
        return fit, test

    def _compare_groups(
        self,
        place: str,
        done: Sequence[Attempt],
        cut: Sequence[Attempt],
        duration: Duration,
    ) -> None:
        """Test whether robots differ, and the halves of the run."""
        if duration.kind is Kind.DETERMINISTIC:
            return
        robots = sorted({a.robot for a in done})
        samples = {r: _sample(_of(done, r), _of(cut, r)) for r in robots}
        samples = {r: s for r, s in samples.items() if s.size >= ENOUGH_ATTEMPTS}
        if len(samples) > 1:
            if all(map(_can_compare, samples.values())):
                p = groups_differ(list(samples.values()), duration)
            else:  # a robot always takes the same time
                p = outcomes_depend([sample.observed for sample in samples.values()])
            means = {r: s.total / s.size for r, s in samples.items()}
            slow, fast = max(means, key=means.__getitem__), min(means, key=means.__getitem__)
            both = slow, means[slow], fast, means[fast]
            text = "%s: the robots differ: %s takes %.3g s on average, %s %.3g s"
            self._doubt(_DIFFER["durations"], p, text % (place, *both))
        middle = _middles([*done, *cut])
        halves = [
            _sample(
                [a for a in done if (a.start >= middle[a.log]) == late],
                [a for a in cut if (a.start >= middle[a.log]) == late],
            )
            for late in (False, True)
        ]
        if all(_can_compare(half) for half in halves):
            p = groups_differ(halves, duration)
            first, second = (half.total / half.size for half in halves)
            self._doubt(
                "halves",
                p,
                "%s: it changed during the run: %.3g s on average in the first half, "
                "%.3g s in the second" % (place, first, second),
            )

    def _compare_shares(self, key: str, place: str, ends: Sequence[Tuple[str, str]]) -> None:
        """Test whether the ends of attempts, pairs of a robot and an end, depend on the robot."""
        counts: Dict[str, Counter[str]] = {}
        for robot, end in ends:
            counts.setdefault(robot, Counter())[end] += 1
        counts = {r: c for r, c in counts.items() if sum(c.values()) >= ENOUGH_ATTEMPTS}
        names = sorted(set().union(*counts.values()))
        if len(counts) > 1 and len(names) > 1:
            p = shares_differ([[c[name] for name in names] for c in counts.values()])
            text = "%s: the robots differ in their %s (--per-robot learns those of each)"
            self._doubt(_DIFFER[key], p, text % (place, key))

    def _compare_failed(
        self, place: str, done: Sequence[Attempt], failed: Sequence[Attempt]
    ) -> None:
        times = [a.end - a.start for a in done], [a.end - a.start for a in failed]
        if min(map(len, times)) < ENOUGH_ATTEMPTS:
            return
        self._doubt(
            "failed attempts",
            outcomes_depend(times),
            "%s: attempts that fail take %.3g s on average, those that succeed %.3g s; the model "
            "gives both the same time"
            % (place, sum(times[1]) / len(times[1]), sum(times[0]) / len(times[0])),
        )

    def _outcomes(self, place: str, done: Sequence[Attempt]) -> Dict[str, OutcomeFit]:
        net = self.plan.net
        named = {attempt.result for attempt in done}
        leaving = [
            net.transitions[t]
            for t in net.consumers[net.place_number(place)]
            if net.transitions[t].name not in self.plan.events or net.transitions[t].name in named
        ]
        if len(leaving) < 2 or len(done) < ENOUGH_ATTEMPTS:
            return {}
        durations: Dict[str, List[float]] = {}
        for attempt in done:
            durations.setdefault(attempt.result, []).append(attempt.end - attempt.start)
        timed = [t.name for t in leaving if t.timed]
        if len(timed) < len(leaving):
            names = [t.name for t in leaving if t.name in durations] + [""] * ("" in durations)
        else:
            names = timed
        common = [times for times in durations.values() if len(times) >= ENOUGH_ATTEMPTS]
        if len(common) > 1:
            means = {name or "(none)": sum(times) / len(times) for name, times in durations.items()}
            slow, fast = max(means, key=means.__getitem__), min(means, key=means.__getitem__)
            self._doubt(
                "outcomes",
                outcomes_depend(common),
                "%s: duration and outcome depend on each other: %s takes %.3g s on average, %s "
                "%.3g s; the model takes them as independent"
                % (place, slow, means[slow], fast, means[fast]),
            )
        n = len(done)
        return {
            name: outcome_fit(count, n)
            for name, count in ((name, len(durations.get(name, ()))) for name in names)
        }

    def _failure(self, place: str, failed: int, ended: int) -> Optional[OutcomeFit]:
        if ended == failed and failed:
            # below 1, so that the plan can succeed; inside the interval
            share = (failed - 0.5) / ended
            self.notes.append(
                "%s: all %d attempts failed; the probability %.4g is half an attempt below 1, the "
                "duration is that of failures, and the outcomes of a success stay as in the plan"
                % (place, failed, share)
            )
            return OutcomeFit(failed, ended, share, wilson(failed, ended))
        if ended < ENOUGH_ATTEMPTS and failed:
            self.notes.append(
                "%s: %d of %d attempts failed, too few to learn a probability; the plan has "
                "%g" % (place, failed, ended, self.plan.failures.get(place, 0.0))
            )
        if ended < ENOUGH_ATTEMPTS or (not failed and not self.plan.failures.get(place)):
            return None
        return outcome_fit(failed, ended)

    # -- the environment ---------------------------------------------------------------------------

    def _rates(self, events: Mapping[str, EventCount]) -> Dict[str, EventFit]:
        found = {}
        for name, event in events.items():
            if event.firings >= ENOUGH_ATTEMPTS and event.exposure > 0:
                found[name] = event_fit(event.firings, event.exposure)
            else:
                self.notes.append(
                    "%s: %d firings are too few to learn its rate; it is kept"
                    % (name, event.firings)
                )
        return found

    # -- doubts ------------------------------------------------------------------------------------

    def _doubt(self, kind: str, p: float, text: str) -> None:
        self._doubts.setdefault(kind, []).append((p, text))

    def _report_doubts(self) -> float:
        """Note the significant doubts. Returns the largest p-value with which robots differ."""
        robots = [doubt for kind in _DIFFER.values() for doubt in self._doubts.pop(kind, ())]
        for doubts in (*self._doubts.values(), robots):
            clear = largest_clear([p for p, _ in doubts])
            for p, text in doubts:
                if p <= clear:
                    allowed = " (p = %.2g; %d such tests are allowed for)" % (p, len(doubts))
                    self.notes.append(text + allowed)
        return clear


def _sample(done: Iterable[Attempt], cut: Iterable[Attempt] = ()) -> Sample:
    return Sample([a.end - a.start for a in done], [a.end - a.start for a in cut])


def _of(attempts: Iterable[Attempt], robot: str) -> List[Attempt]:
    return [a for a in attempts if a.robot == robot]


def _can_compare(sample: Sample) -> bool:
    return sample.size >= ENOUGH_ATTEMPTS and bool(np.ptp(sample.observed) > 1e-6)


def _middles(attempts: Iterable[Attempt]) -> Dict[int, float]:
    """Log -> the middle of its time (s)."""
    ends: Dict[int, Tuple[float, float]] = {}
    for a in attempts:
        low, high = ends.get(a.log, (math.inf, -math.inf))
        ends[a.log] = min(low, a.start), max(high, a.end)
    return {log: (low + high) / 2 for log, (low, high) in ends.items()}

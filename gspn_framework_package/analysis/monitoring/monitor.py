"""Watches a run and detects when it begins to depart from its plan.

A :class:`Monitor` is called when an attempt at an action begins or ends, and when the policy has
chosen. It keeps *streams*: the pace of each place, of each robot and of the whole team; the
outcomes and the failures of each place; the policy's choices in each place. A stream consists of
one or several cumulative sums (``cusum``). The thresholds are chosen so that a run that follows the
plan raises one alarm in the given time over all streams together.

The cost of an event does not depend on the length of the run.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any, Deque, Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis import quantiles
from gspn_framework_package.analysis.monitoring.choices import ChoiceTest
from gspn_framework_package.analysis.monitoring.cusum import ChanceChart, RateChart
from gspn_framework_package.analysis.monitoring.hazard import Hazard
from gspn_framework_package.analysis.monitoring.streams import (
    CHOICE,
    FAILURE,
    ODDS,
    OUTCOME,
    PACES,
    PLACE,
    RATIOS,
    ROBOT,
    TEAM,
    Alarm,
    ChoiceStream,
    PaceStream,
    ShareStream,
    SidedSum,
    Stream,
)
from gspn_framework_package.model.duration import Duration, Evidence
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import POLICY, PlanTiming

DAY = 86_400.0

ALARM_EVERY = 30 * DAY
"""Default mean time between false alarms of all streams together, in seconds."""


IMPOSSIBLE = 1e-3
"""An outcome or failure that the plan rules out is taken to have this probability, so that a single
one does not raise an alarm."""

SHORTEST_EXPECTED = 1e-3
"""Durations with a shorter mean (s) are not watched: a log mostly shows the computation time of the
machine."""

RAN_TO_THE_END = (Outcome.ABORTED, Outcome.BAD_RESULT)
"""Failures that the action itself reported, after its duration. Other failures interrupt it."""

RECENT = 4096
"""Number of finished attempts kept, to report by how much and where a run departs."""

LEAST_SEEN = 10
"""Number of attempts from which the interval of a change is computed."""


class _Running:
    """A running attempt: the place's hazards, and how much of them has been counted."""

    __slots__ = ("robot", "place", "start", "slow", "fast")

    def __init__(self, robot: str, place: str, start: float) -> None:
        self.robot, self.place, self.start = robot, place, start
        self.slow = self.fast = 0.0


class _Finished(NamedTuple):
    at: float
    place: str
    robot: str
    seconds: float
    expected: float

    @property
    def begun(self) -> float:
        return self.at - self.seconds


class Cause(NamedTuple):
    """An active alarm that no other one explains.

    :ivar follows: the active alarms that it explains.
    :ivar interval: of a pace, the 95 % interval of its change (0.5: half as long again), from the
        attempts that began after the alarm; None before :data:`LEAST_SEEN` of them have ended.
    """

    alarm: Alarm
    follows: Tuple[Alarm, ...]
    interval: Optional[Tuple[float, float]]

    def others(self) -> List[str]:
        """The texts of the alarms that it explains, without those that repeat this one or another
        one: alarms of a place and of the team may name the same robot, by slightly other times."""

        def about(alarm: Alarm) -> Tuple[str, ...]:
            return alarm.place, alarm.robot, alarm.transition, alarm.direction

        said = {about(alarm): alarm.describe() for alarm in self.follows}
        said.pop(about(self.alarm), None)
        return list(said.values())

    def size(self) -> str:
        """The interval, for people; "" if there is none."""
        if self.interval is None:
            return ""
        low, high = (100 * change for change in self.interval)
        return "%+.0f to %+.0f %% (95 %%)" % (low, high)


class Monitor:
    """Watches one run; see the module. Times are seconds on any clock, and must not decrease.

    :param plan: the expected plan. Only places with an action that takes time are watched for their
        pace.
    :param robots: the robots of the team at the start; others are only watched as part of their
        places.
    :param paces: place -> expected number of attempts per second, for the thresholds.
    :param alarm_every: mean time between two false alarms of all streams together (s).

    :ivar alarms: all alarms, in order.
    """

    def __init__(
        self,
        plan: Plan,
        robots: Iterable[str],
        paces: Mapping[str, float],
        alarm_every: float = ALARM_EVERY,
    ) -> None:
        self.alarm_every = alarm_every
        self.alarms: List[Alarm] = []
        self._plan = plan
        self._recent: Deque[_Finished] = deque(maxlen=RECENT)
        self._running: Dict[str, _Running] = {}
        timing = PlanTiming(plan)
        self._means: Dict[str, float] = {}
        self._hazards: Dict[str, Tuple[Hazard, Hazard]] = {}
        for p, place in timing.places.items():
            if place.duration.mean >= SHORTEST_EXPECTED and plan.net.consumers[p]:
                name = plan.net.places[p].name
                self._means[name] = place.duration.mean
                self._hazards[name] = _of_interval(plan.evidence, name, place.duration)
        self._own = {
            (robot, name): (duration.mean, _of_interval(own.evidence, name, duration))
            for robot, own in plan.own_times.items()
            for name, duration in own.durations.items()
            if name in self._hazards
        }
        names = list(dict.fromkeys(robots))
        least = 1.0 / alarm_every
        pace = {name: max(paces.get(name, 0.0), least) for name in self._hazards}
        whole = sum(pace.values())
        shares = [
            (kind, name, transition, chance)
            for p, place in timing.places.items()
            for name in [plan.net.places[p].name]
            if name in pace
            for kind, transition, chance in _shares(plan, place.outcomes, place.failure)
        ]
        deciding = [name for name in plan.action_places if _decides(plan, name)]
        each_robot = len(names) > 1
        team = len(self._hazards) > 1 and each_robot
        count = (
            len(RATIOS) * (len(pace) + (len(names) if each_robot and pace else 0) + int(team))
            + sum(2 if kind == OUTCOME else 1 for kind, _, _, _ in shares)
            + len(deciding)
        )

        def events(rate: float) -> float:
            """Events between two false alarms of one sum of a stream with ``rate`` events/s."""
            return rate * alarm_every * count

        def thresholds(rate: float) -> List[float]:
            return [RateChart(ratio).threshold(events(rate)) for ratio in RATIOS]

        self._places = {name: PaceStream(PLACE, name, "", thresholds(pace[name])) for name in pace}
        self._robots: Dict[str, PaceStream] = {}
        self._team: Optional[PaceStream] = None
        if each_robot and pace:
            common = thresholds(whole / len(names))
            self._robots = {name: PaceStream(ROBOT, "", name, common) for name in names}
        if team:
            self._team = PaceStream(TEAM, "", "", thresholds(whole))
        self._shares: Dict[Tuple[str, str], List[ShareStream]] = {}
        for kind, name, transition, chance in shares:
            odds = ODDS if kind == OUTCOME else ODDS[:1]
            charts = [ChanceChart(_possible(chance), ratio) for ratio in odds]
            stream = ShareStream(kind, name, transition, charts, events(pace[name]))
            self._shares.setdefault((kind, name), []).append(stream)
        self._choices: Dict[str, ChoiceTest] = {
            name: ChoiceTest(1.0 / (alarm_every * count)) for name in deciding
        }
        self._choice_streams = {
            name: ChoiceStream(name, test) for name, test in self._choices.items()
        }
        self.streams: List[Stream] = [
            *self._places.values(),
            *self._robots.values(),
            *([self._team] if self._team is not None else []),
            *(stream for group in self._shares.values() for stream in group),
            *self._choice_streams.values(),
        ]

    def _mean(self, robot: str, place: str) -> float:
        own = self._own.get((robot, place))
        return own[0] if own is not None else self._means[place]

    @property
    def on(self) -> List[Alarm]:
        """The active alarms: the newest of each stream with one, with the size of the deviation
        known so far. A slow robot or place that several streams notice is reported once."""
        return [cause.alarm for cause in self.causes()]

    def causes(self) -> List[Cause]:
        """The active alarms as in :attr:`on`, each with those that follow from it."""
        lasting = [
            stream.alarms[-1] if stream.kind not in PACES else self._estimated(stream.alarms[-1])
            for stream in self.streams
            if stream.on and stream.alarms
        ]
        found: List[Cause] = []
        left = [a for a in lasting if any(_explains(other, a) for other in lasting)]
        for alarm in lasting:
            if alarm in left:
                continue
            follows = tuple(a for a in left if _explains(alarm, a))
            found.append(Cause(alarm, follows, self._interval(alarm)))
        return found

    def _interval(self, alarm: Alarm) -> Optional[Tuple[float, float]]:
        """The interval of the change of a pace; see :class:`Cause`. What raised the alarm does not
        count: it departs more than usual, or it would have raised none."""
        if alarm.kind not in PACES:
            return None
        seen = [f for f in self._seen(alarm.at, alarm.place, alarm.robot) if f.begun >= alarm.at]
        if len(seen) < LEAST_SEEN:
            return None
        seconds, expected = np.array([(f.seconds, f.expected) for f in seen]).T
        ratio = seconds.sum() / expected.sum()
        rest = seconds - ratio * expected
        error = math.sqrt(len(seen) / (len(seen) - 1) * float((rest**2).sum())) / seconds.sum()
        half = quantiles.student(0.975, len(seen) - 1) * error
        return float(ratio * math.exp(-half) - 1), float(ratio * math.exp(half) - 1)

    def is_explained(self, alarm: Alarm) -> bool:
        """Whether another active alarm reports the same as this one."""
        return any(_explains(other, alarm) for other in self.on)

    def _estimated(self, alarm: Alarm) -> Alarm:
        """An active alarm, updated with the observations so far. When it is raised, little is
        known, mostly about what departs most."""
        seen = self._seen(alarm.since, alarm.place, alarm.robot)
        if not seen or seen[-1].at <= alarm.at:
            return alarm
        return alarm._replace(
            observed=sum(f.seconds for f in seen) / len(seen),
            expected=sum(f.expected for f in seen) / len(seen),
        )

    def _seen(self, since: float, place: str, robot: str) -> List[_Finished]:
        """The attempts that finished since then; "" stands for all places or robots."""
        return [
            f
            for f in self._recent
            if f.at >= since and place in ("", f.place) and robot in ("", f.robot)
        ]

    # -- events of the run -------------------------------------------------------------------------

    def begin(self, robot: str, place: str, start: float) -> None:
        """An attempt of ``robot`` at the action of ``place`` began at ``start`` (s)."""
        if place in self._hazards:
            self._running[robot] = _Running(robot, place, start)

    def end(
        self,
        robot: str,
        now: float,
        *,
        completed: bool = True,
        result: Optional[str] = "",
        failed: str = "",
    ) -> List[Alarm]:
        """The attempt of ``robot`` ended at ``now`` (s); returns the alarms that this raises.

        :param completed: whether its action ended by itself; if not, its duration is unknown.
        :param result: the transition that it named, "" if none; None if unknown so far, in which
            case :meth:`result` will report it.
        :param failed: the reason of its failure ("" if it succeeded).
        """
        raised = self.advance(now)
        attempt = self._running.pop(robot, None)
        if attempt is None or not completed or (failed and failed not in RAN_TO_THE_END):
            return raised
        place = attempt.place
        self._recent.append(
            _Finished(now, place, robot, now - attempt.start, self._mean(robot, place))
        )
        for stream in self._streams_of(attempt):
            for s, direction in stream.count(now):
                raised.append(self._alarm(stream, s, direction, now))
        found = []
        for share in self._shares.get((FAILURE, place), ()):
            found += share.count(bool(failed), now)
        self.alarms += found
        if not failed and result is not None:
            found = found + self.result(place, result, now)
        return raised + found

    def result(self, place: str, result: str, now: float) -> List[Alarm]:
        """Report that an action of ``place`` had named the transition ``result`` ("" if none);
        returns the alarms that this raises."""
        found: List[Alarm] = []
        for share in self._shares.get((OUTCOME, place), ()):
            found += share.count(result == share.transition, now)
        self.alarms += found
        return found

    def choose(
        self, place: str, row: Sequence[Tuple[str, float]], chosen: str, now: float
    ) -> List[Alarm]:
        """The policy chose the transition ``chosen`` in ``place``, by the probabilities ``row``;
        returns the alarms that this raises."""
        test = self._choices.get(place)
        if test is None or not test.count(row, chosen, now):
            return []
        transition, observed, expected = test.largest
        direction = "more often" if observed > expected else "less often"
        about = CHOICE, place, "", transition
        alarm = Alarm(*about, now, test.since, direction, observed, expected)
        self._choice_streams[place].alarms.append(alarm)
        self.alarms.append(alarm)
        return [alarm]

    def advance(self, now: float) -> List[Alarm]:
        """Advance the time to ``now`` (s); returns the alarms that this raises."""
        by_place: Dict[str, List[float]] = {}
        by_robot: Dict[str, List[float]] = {}
        slow_sum = fast_sum = 0.0
        for attempt in self._running.values():
            own = self._own.get((attempt.robot, attempt.place))
            slow_hazard, fast_hazard = own[1] if own is not None else self._hazards[attempt.place]
            slow = slow_hazard(now - attempt.start)
            fast = slow if fast_hazard is slow_hazard else fast_hazard(now - attempt.start)
            more, less = slow - attempt.slow, fast - attempt.fast
            if more <= 0.0 and less <= 0.0:
                continue
            attempt.slow, attempt.fast = slow, fast
            slow_sum += more
            fast_sum += less
            for group, key in ((by_place, attempt.place), (by_robot, attempt.robot)):
                pair = group.get(key)
                if pair is None:
                    group[key] = [more, less]
                else:
                    pair[0] += more
                    pair[1] += less
        raised: List[Alarm] = []
        for place, (more, less) in by_place.items():
            self._elapse(self._places[place], more, less, now, raised)
        for robot, (more, less) in by_robot.items():
            stream = self._robots.get(robot)
            if stream is not None:
                self._elapse(stream, more, less, now, raised)
        if self._team is not None:
            self._elapse(self._team, slow_sum, fast_sum, now, raised)
        return raised

    def _elapse(
        self, stream: PaceStream, slow: float, fast: float, now: float, raised: List[Alarm]
    ) -> None:
        for s, direction in stream.elapse(slow, fast, now):
            raised.append(self._alarm(stream, s, direction, now))

    def _streams_of(self, attempt: _Running) -> List[PaceStream]:
        found = [self._places[attempt.place]]
        robot = self._robots.get(attempt.robot)
        if robot is not None:
            found.append(robot)
        if self._team is not None:
            found.append(self._team)
        return found

    def _alarm(self, stream: PaceStream, s: SidedSum, direction: str, now: float) -> Alarm:
        """Raise the alarm of a pace, with the size of the deviation and where it is largest."""
        seen = self._seen(s.since, stream.place, stream.robot)
        place, robot = stream.place, stream.robot
        late = [
            r
            for r in self._running.values()
            if stream.place in ("", r.place)
            and stream.robot in ("", r.robot)
            and now - r.start > self._mean(r.robot, r.place)
        ]
        if direction == "slower" and late:
            # an action running for longer than planned counts too, with its time so far
            seen = seen + [
                _Finished(now, r.place, r.robot, now - r.start, self._mean(r.robot, r.place))
                for r in late
            ]
        if not place:
            place = _outstanding(seen, direction, lambda f: f.place)
        if not robot and len(self._robots) > 1:
            robot = _outstanding(seen, direction, lambda f: f.robot)
        chosen = [f for f in seen if place in ("", f.place) and robot in ("", f.robot)] or seen
        observed = expected = None
        if chosen:
            observed = sum(f.seconds for f in chosen) / len(chosen)
            expected = sum(f.expected for f in chosen) / len(chosen)
        about = stream.kind, place, robot, ""
        alarm = Alarm(*about, now, s.since, direction, observed, expected)
        stream.alarms.append(alarm)
        self.alarms.append(alarm)
        return alarm


def _explains(one: Alarm, other: Alarm) -> bool:
    """Whether an alarm is a consequence of another one. The pace of one robot affects that of its
    places and of the team; the pace of a place for all robots affects that of each robot and of the
    team."""
    if one.kind not in PACES or other.kind not in PACES or one.direction != other.direction:
        return False
    if one.kind == ROBOT:
        return other.kind != ROBOT and other.robot == one.robot
    return one.kind == PLACE and not one.robot and other.kind != PLACE and other.place == one.place


def _outstanding(seen: Sequence[_Finished], direction: str, key: Any) -> str:
    """The place or robot that explains most of the deviation; "" if none explains half of it."""
    sign = 1 if direction == "slower" else -1
    excess: Dict[str, float] = {}
    for f in seen:
        excess[key(f)] = excess.get(key(f), 0.0) + sign * (f.seconds / f.expected - 1)
    whole = sum(value for value in excess.values() if value > 0)
    if not whole:
        return ""
    first = max(excess, key=lambda name: excess[name])
    return first if excess[first] > whole / 2 else ""


def _shares(
    plan: Plan, outcomes: Sequence[Tuple[int, float]], failure: float
) -> List[Tuple[str, str, float]]:
    """The possible events at the end of an attempt: (kind, transition, probability)."""
    names = [
        (plan.net.transitions[t].name if t != POLICY else "", chance) for t, chance in outcomes
    ]
    if len(names) == 2:
        names = names[:1]  # the other stream would report the same
    found = [(OUTCOME, name, chance) for name, chance in names if chance < 1]
    return [*found, (FAILURE, "", failure)]


def _possible(chance: float) -> float:
    return min(max(chance, IMPOSSIBLE), 1 - IMPOSSIBLE)


def _decides(plan: Plan, place: str) -> bool:
    """Whether the policy has a real choice in a place."""
    p = plan.net.place_number(place)
    return len(plan.net.immediate_from[p]) > 1


def _of_interval(
    learned: Mapping[Tuple[str, str], Evidence], name: str, duration: Duration
) -> Tuple[Hazard, Hazard]:
    """The hazards at the upper and at the lower end of the mean's interval, so that a run
    whose mean is anywhere in it raises no more false alarms than stated."""
    evidence = learned.get(("durations", name))
    interval = evidence.interval if evidence is not None else None
    if interval is None or not 0 < interval[0] <= duration.mean <= interval[1] < math.inf:
        plain = Hazard(duration)
        return plain, plain
    low, high = interval
    return (
        Hazard(duration.scaled(high / duration.mean)),
        Hazard(duration.scaled(low / duration.mean)),
    )

"""Watches a run for the moment from which it departs from its plan.

A :class:`Monitor` is called when an attempt at an action begins or ends, and when the policy chose.
It keeps *streams*: the pace of each place, of each robot and of the whole team; the outcomes and
the failures of each place; the policy's choices in each place. A stream consists of one or several
cumulative sums (``cusum``). All thresholds together are chosen so that a run that follows the plan
raises one alarm in the stated time, all streams taken together.

The cost of an event does not depend on the length of the run.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any, Deque, Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.analysis.monitoring.choices import ChoiceTest
from gspn_framework_package.analysis.monitoring.cusum import ChanceChart, RateChart
from gspn_framework_package.analysis.monitoring.hazard import Hazard
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import POLICY, PlanTiming

DAY = 86_400.0

ALARM_EVERY = 30 * DAY
"""Default mean time between false alarms of all streams together, in seconds."""

RATIOS = (0.8, 0.67, 1.25, 1.5)
"""Factors of the pace that a stream looks for. Small changes need long, and large ones are found
sooner by a sum of their own."""

ODDS = (2.0, 0.5)
"""Factors of the odds of an outcome that a stream looks for."""

IMPOSSIBLE = 1e-3
"""An outcome or failure that the plan rules out is taken to have this probability, so that a single
one is no alarm yet."""

SHORTEST_EXPECTED = 1e-3
"""Durations with a shorter mean (s) are not watched: what a log shows of them is mostly the time of
the machine itself."""

RAN_TO_THE_END = (Outcome.ABORTED, Outcome.BAD_RESULT)
"""Failures that the action itself reported, after its duration. Other failures cut it off."""

RECENT = 4096
"""How many finished attempts are kept, to say by how much and where a run departs."""

_PLACE, ROBOT, TEAM, OUTCOME, _FAILURE, CHOICE = (
    "place",
    "robot",
    "team",
    "outcome",
    "failure",
    "choice",
)

PACES = (_PLACE, ROBOT, TEAM)
"""The kinds of streams that watch how fast something goes."""


class Alarm(NamedTuple):
    """An alarm.

    :ivar kind: what the stream watches: ``place``, ``robot`` or ``team`` (their pace), ``outcome``,
        ``failure`` or ``choice``.
    :ivar place: the place that departs most; "" if it is all of them.
    :ivar robot: the robot that departs; "" if it is all of them.
    :ivar transition: the outcome or choice; "" for others.
    :ivar at: when it was raised (s).
    :ivar since: when the sum last left 0 (s): about when the change began.
    :ivar direction: ``slower``, ``faster``, ``more often`` or ``less often``.
    :ivar observed: the mean duration (s) or the share since then; None if there is none yet.
    :ivar expected: the same by the plan.
    """

    kind: str
    place: str
    robot: str
    transition: str
    at: float
    since: float
    direction: str
    observed: Optional[float]
    expected: Optional[float]

    @property
    def change(self) -> Optional[float]:
        """By how much the observed value exceeds the expected one, as a share of it (-0.3: 30 %
        less); None if that is not known."""
        if self.observed is None or not self.expected:
            return None
        return self.observed / self.expected - 1

    def describe(self) -> str:
        """The alarm in a sentence, for people."""
        whose = self.robot or ("all robots together" if not self.place else "")
        where = ", ".join(part for part in (self.place, whose) if part)
        if self.kind in PACES:
            text = "%s: %s than planned" % (where, self.direction)
            if self.observed is None:
                return text + ": an action that should have ended goes on"
            assert self.expected is not None
            text += ": %.3g s instead of %.3g s" % (self.observed, self.expected)
            if self.change is not None:
                text += " (%+.0f %%)" % (100 * self.change)
            return text
        what = {OUTCOME: "the outcome %s", CHOICE: "the choice of %s", _FAILURE: "failure%s"}
        text = "%s: %s %s than planned" % (
            where,
            what[self.kind] % self.transition,
            self.direction,
        )
        if self.observed is not None and self.expected is not None:
            text += ": %.3g %% instead of %.3g %%" % (100 * self.observed, 100 * self.expected)
        return text

    def to_json(self) -> Dict[str, Any]:
        """The alarm as a JSON object."""
        return {**self._asdict(), "change": self.change, "text": self.describe()}


class _Sum:
    """One cumulative sum of a stream: its value, and the stream's totals when it was last 0."""

    __slots__ = ("value", "threshold", "on", "since", "totals")

    def __init__(self, threshold: float) -> None:
        self.value = 0.0
        self.threshold = threshold
        self.on = False
        self.since = 0.0
        self.totals: Tuple[float, ...] = (0.0, 0.0)


class Stream:
    """What is watched, and its sums.

    :ivar kind: see :class:`Alarm`, also for ``place``, ``robot`` and ``transition``.
    :ivar alarms: the alarms that it has raised. An alarm lasts until its sum has fallen to half of
        its threshold.
    """

    def __init__(self, kind: str, place: str, robot: str = "", transition: str = "") -> None:
        self.kind, self.place, self.robot, self.transition = kind, place, robot, transition
        self.alarms: List[Alarm] = []
        self.sums: List[_Sum] = []

    @property
    def on(self) -> bool:
        """Whether an alarm lasts."""
        return any(s.on for s in self.sums)

    def nearest(self) -> _Sum:
        """The sum that is nearest to its threshold."""
        return max(self.sums, key=lambda s: s.value / s.threshold)

    def to_json(self) -> Dict[str, Any]:
        """The stream as a JSON object."""
        nearest = self.nearest()
        return {
            "kind": self.kind,
            "place": self.place,
            "robot": self.robot,
            "transition": self.transition,
            "cusum": round(nearest.value, 4),
            "threshold": round(nearest.threshold, 4),
            "alarm_at": round(self.alarms[0].at, 3) if self.alarms else None,
            "alarms": len(self.alarms),
            "direction": self.alarms[0].direction if self.alarms else "",
            "change": self.alarms[0].change if self.alarms else None,
            "on": self.on,
        }


class _Pace(Stream):
    """The pace of a place, of a robot or of the team."""

    def __init__(self, kind: str, place: str, robot: str, thresholds: Sequence[float]) -> None:
        super().__init__(kind, place, robot)
        self.sums = [_Sum(h) for h in thresholds]
        self._slow = [
            (s, 1 - ratio, -math.log(ratio)) for s, ratio in zip(self.sums, RATIOS) if ratio < 1
        ]
        self._fast = [
            (s, ratio - 1, math.log(ratio)) for s, ratio in zip(self.sums, RATIOS) if ratio > 1
        ]

    def elapse(self, slow: float, fast: float, now: float) -> List[Tuple[_Sum, str]]:
        """Let time pass: ``slow`` and ``fast`` ends of actions were expected in it, if the plan's
        durations are at the upper and lower ends of their intervals. Returns the sums that raise
        the alarm."""
        raised = []
        for s, slope, _ in self._slow:
            if s.value == 0.0:
                s.since = now
            s.value += slope * slow
            if s.value >= s.threshold:
                s.value = s.threshold
                if not s.on:
                    if not any(other.on for other, _, _ in self._slow):
                        raised.append((s, "slower"))
                    s.on = True
        for s, slope, _ in self._fast:
            if s.value > 0.0:
                s.value = max(s.value - slope * fast, 0.0)
                s.on = s.on and s.value > s.threshold / 2
        return raised

    def count(self, now: float) -> List[Tuple[_Sum, str]]:
        """Count the end of an action; returns the sums that raise the alarm."""
        raised = []
        for s, _, step in self._slow:
            s.value = max(s.value - step, 0.0)
            s.on = s.on and s.value > s.threshold / 2
        for s, _, step in self._fast:
            if s.value == 0.0:
                s.since = now
            s.value += step
            if s.value >= s.threshold:
                s.value = s.threshold
                if not s.on:
                    if not any(other.on for other, _, _ in self._fast):
                        raised.append((s, "faster"))
                    s.on = True
        return raised


class _Share(Stream):
    """How often something happens: an outcome, or a failure."""

    def __init__(
        self, kind: str, place: str, transition: str, charts: Sequence[ChanceChart], events: float
    ) -> None:
        super().__init__(kind, place, "", transition)
        self.chance = charts[0].chance
        self._charts = charts
        self.sums = [_Sum(chart.threshold(events)) for chart in charts]
        self._hits = self._trials = 0

    def count(self, hit: bool, now: float) -> List[Alarm]:
        """Count a trial; returns the alarms that it raises."""
        self._trials += 1
        self._hits += hit
        raised = []
        for s, chart in zip(self.sums, self._charts):
            if s.value == 0.0:
                s.since = now
                s.totals = (self._hits - hit, self._trials - 1)
            s.value = max(s.value + (chart.hit if hit else chart.miss), 0.0)
            s.on = s.on and s.value > s.threshold / 2
            if s.value >= s.threshold:
                s.value = s.threshold
                if not s.on:
                    s.on = True
                    hits, trials = s.totals
                    alarm = Alarm(
                        self.kind,
                        self.place,
                        "",
                        self.transition,
                        now,
                        s.since,
                        "more often" if chart.odds > 1 else "less often",
                        (self._hits - hits) / (self._trials - trials),
                        self.chance,
                    )
                    self.alarms.append(alarm)
                    raised.append(alarm)
        return raised


class _Running:
    """An attempt that goes on: the place's hazards, and how much of them has been counted."""

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


class Monitor:
    """Watches one run; see the module. Times are seconds on any clock, and must not decrease.

    :param plan: what the run is expected to follow. Only places with an action that takes time are
        watched for their pace.
    :param robots: the robots of the team at the start; others are watched with their places.
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
                self._hazards[name] = self._of_interval(name, place.duration)
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

        self._places = {name: _Pace(_PLACE, name, "", thresholds(pace[name])) for name in pace}
        self._robots: Dict[str, _Pace] = {}
        self._team: Optional[_Pace] = None
        if each_robot and pace:
            common = thresholds(whole / len(names))
            self._robots = {name: _Pace(ROBOT, "", name, common) for name in names}
        if team:
            self._team = _Pace(TEAM, "", "", thresholds(whole))
        self._shares: Dict[Tuple[str, str], List[_Share]] = {}
        for kind, name, transition, chance in shares:
            odds = ODDS if kind == OUTCOME else ODDS[:1]
            charts = [ChanceChart(_possible(chance), ratio) for ratio in odds]
            stream = _Share(kind, name, transition, charts, events(pace[name]))
            self._shares.setdefault((kind, name), []).append(stream)
        self._choices: Dict[str, ChoiceTest] = {
            name: ChoiceTest(1.0 / (alarm_every * count)) for name in deciding
        }
        self._choice_streams = {name: _Choice(name, test) for name, test in self._choices.items()}
        self.streams: List[Stream] = [
            *self._places.values(),
            *self._robots.values(),
            *([self._team] if self._team is not None else []),
            *(stream for group in self._shares.values() for stream in group),
            *self._choice_streams.values(),
        ]

    def _of_interval(self, name: str, duration: Any) -> Tuple[Hazard, Hazard]:
        """The hazards at the upper and at the lower end of the mean's interval, so that a run
        whose mean is anywhere in it raises no more false alarms than stated."""
        evidence = self._plan.evidence.get(("durations", name))
        interval = evidence.interval if evidence is not None else None
        if interval is None or not 0 < interval[0] <= duration.mean <= interval[1] < math.inf:
            plain = Hazard(duration)
            return plain, plain
        low, high = interval
        return (
            Hazard(duration.scaled(high / duration.mean)),
            Hazard(duration.scaled(low / duration.mean)),
        )

    @property
    def on(self) -> List[Alarm]:
        """The alarms that last: the newest of each stream that is on, by how much as far as is
        known now. Several streams see one slow robot, or one slow place: it is told once."""
        lasting = [
            stream.alarms[-1] if stream.kind not in PACES else self._estimated(stream.alarms[-1])
            for stream in self.streams
            if stream.on and stream.alarms
        ]
        return [a for a in lasting if not any(_explains(other, a) for other in lasting)]

    def is_explained(self, alarm: Alarm) -> bool:
        """Whether another alarm, which lasts, says what this one says."""
        return any(_explains(other, alarm) for other in self.on)

    def _estimated(self, alarm: Alarm) -> Alarm:
        """An alarm that lasts with what was observed up to now. When it is raised, little is
        known, and mostly what departs most."""
        seen = [
            f
            for f in self._recent
            if f.at >= alarm.since and alarm.place in ("", f.place) and alarm.robot in ("", f.robot)
        ]
        if not seen or seen[-1].at <= alarm.at:
            return alarm
        return alarm._replace(
            observed=sum(f.seconds for f in seen) / len(seen),
            expected=sum(f.expected for f in seen) / len(seen),
        )

    # -- what happens ------------------------------------------------------------------------------

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
        :param result: the transition that it named, "" if none; None if that is not known yet, and
            :meth:`result` will say.
        :param failed: why it failed ("" if it succeeded).
        """
        raised = self.advance(now)
        attempt = self._running.pop(robot, None)
        if attempt is None or not completed or (failed and failed not in RAN_TO_THE_END):
            return raised
        place = attempt.place
        self._recent.append(_Finished(now, place, robot, now - attempt.start, self._means[place]))
        for stream in self._streams_of(attempt):
            for s, direction in stream.count(now):
                raised.append(self._alarm(stream, s, direction, now))
        found = []
        for share in self._shares.get((_FAILURE, place), ()):
            found += share.count(bool(failed), now)
        self.alarms += found
        if not failed and result is not None:
            found = found + self.result(place, result, now)
        return raised + found

    def result(self, place: str, result: str, now: float) -> List[Alarm]:
        """An action of ``place`` had named the transition ``result`` ("" if none); returns the
        alarms that this raises."""
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
        alarm = Alarm(
            CHOICE,
            place,
            "",
            transition,
            now,
            test.since,
            "more often" if observed > expected else "less often",
            observed,
            expected,
        )
        self._choice_streams[place].alarms.append(alarm)
        self.alarms.append(alarm)
        return [alarm]

    def advance(self, now: float) -> List[Alarm]:
        """Let the time pass until ``now`` (s); returns the alarms that this raises."""
        by_place: Dict[str, List[float]] = {}
        by_robot: Dict[str, List[float]] = {}
        slow_sum = fast_sum = 0.0
        for attempt in self._running.values():
            slow_hazard, fast_hazard = self._hazards[attempt.place]
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
        self, stream: _Pace, slow: float, fast: float, now: float, raised: List[Alarm]
    ) -> None:
        for s, direction in stream.elapse(slow, fast, now):
            raised.append(self._alarm(stream, s, direction, now))

    def _streams_of(self, attempt: _Running) -> List[_Pace]:
        found = [self._places[attempt.place]]
        robot = self._robots.get(attempt.robot)
        if robot is not None:
            found.append(robot)
        if self._team is not None:
            found.append(self._team)
        return found

    def _alarm(self, stream: _Pace, s: _Sum, direction: str, now: float) -> Alarm:
        """Raise the alarm of a pace: by how much, and where most."""
        seen = [
            f
            for f in self._recent
            if f.at >= s.since and stream.place in ("", f.place) and stream.robot in ("", f.robot)
        ]
        place, robot = stream.place, stream.robot
        late = [
            r
            for r in self._running.values()
            if stream.place in ("", r.place)
            and stream.robot in ("", r.robot)
            and now - r.start > self._means[r.place]
        ]
        if direction == "slower" and late:
            # an action that goes on for longer than planned counts as well, as far as it is known
            seen = seen + [
                _Finished(now, r.place, r.robot, now - r.start, self._means[r.place]) for r in late
            ]
        if not place:
            place = _outstanding(seen, direction, lambda f: f.place)
        if not robot and len(self._robots) > 1:
            robot = _outstanding(seen, direction, lambda f: f.robot)
        chosen = [f for f in seen if place in ("", f.place) and robot in ("", f.robot)] or seen
        alarm = Alarm(
            stream.kind,
            place,
            robot,
            "",
            now,
            s.since,
            direction,
            sum(f.seconds for f in chosen) / len(chosen) if chosen else None,
            sum(f.expected for f in chosen) / len(chosen) if chosen else None,
        )
        stream.alarms.append(alarm)
        self.alarms.append(alarm)
        return alarm


class _Choice(Stream):
    """The policy's choices in a place; its test is the only sum."""

    def __init__(self, place: str, test: ChoiceTest) -> None:
        super().__init__(CHOICE, place)
        self._test = test

    @property
    def on(self) -> bool:
        """Whether the last full block of choices departed."""
        return self._test.on

    def nearest(self) -> _Sum:
        """The statistic of the block so far, against its critical value."""
        now = _Sum(self._test.critical)
        now.value = self._test.statistic
        return now


def _explains(one: Alarm, other: Alarm) -> bool:
    """Whether an alarm is a consequence of another one: the pace of a place or of the team of that
    of one robot, and the pace of a robot or of the team of that of a place for all robots."""
    if one.kind not in PACES or other.kind not in PACES or one.direction != other.direction:
        return False
    if one.kind == ROBOT:
        return other.kind != ROBOT and other.robot == one.robot
    return (
        one.kind == _PLACE and not one.robot and other.kind != _PLACE and other.place == one.place
    )


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
    """What can happen at the end of an attempt: (kind, transition, probability)."""
    names = [
        (plan.net.transitions[t].name if t != POLICY else "", chance) for t, chance in outcomes
    ]
    if len(names) == 2:
        names = names[:1]  # the other one says the same
    found = [(OUTCOME, name, chance) for name, chance in names if chance < 1]
    return [*found, (_FAILURE, "", failure)]


def _possible(chance: float) -> float:
    return min(max(chance, IMPOSSIBLE), 1 - IMPOSSIBLE)


def _decides(plan: Plan, place: str) -> bool:
    """Whether the policy has a real choice in a place."""
    p = plan.net.place_number(place)
    leaving = [t for t in plan.net.consumers[p] if not plan.net.transitions[t].timed]
    return len(leaving) > 1

"""The streams of a monitor: what they count, and the sums that raise their alarms."""

from __future__ import annotations

import math
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.analysis.monitoring.choices import ChoiceTest
from gspn_framework_package.analysis.monitoring.cusum import ChanceChart

RATIOS = (0.8, 0.67, 1.25, 1.5)
"""Factors of the pace that a stream looks for. Small changes take long to detect; a separate sum
finds large ones sooner."""

ODDS = (2.0, 0.5)
"""Factors of the odds of an outcome that a stream looks for."""

PLACE, ROBOT, TEAM = "place", "robot", "team"
OUTCOME, FAILURE, CHOICE = "outcome", "failure", "choice"

PACES = (PLACE, ROBOT, TEAM)
"""The kinds of streams that watch a pace."""


class Alarm(NamedTuple):
    """An alarm.

    :ivar kind: what the stream watches: ``place``, ``robot`` or ``team`` (their pace), ``outcome``,
        ``failure`` or ``choice``.
    :ivar place: the place that departs most; "" for all places.
    :ivar robot: the robot that departs; "" for all robots.
    :ivar transition: the outcome or choice; "" for others.
    :ivar at: when it was raised (s).
    :ivar since: when the sum last left 0 (s): about when the change began.
    :ivar direction: ``slower``, ``faster``, ``more often`` or ``less often``.
    :ivar observed: the mean duration (s) or the share since then; None if there is none so far.
    :ivar expected: the same according to the plan.
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
                return text + ": an action that should have ended is still running"
            assert self.expected is not None
            text += ": %.3g s instead of %.3g s" % (self.observed, self.expected)
            if self.change is not None:
                text += " (%+.0f %%)" % (100 * self.change)
            return text
        what = {OUTCOME: "the outcome %s", CHOICE: "the choice of %s", FAILURE: "failure%s"}
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


class SidedSum:
    """One cumulative sum of a stream: its value, and the stream's totals when it was last 0."""

    __slots__ = ("value", "threshold", "on", "since", "totals")

    def __init__(self, threshold: float) -> None:
        self.value = 0.0
        self.threshold = threshold
        self.on = False
        self.since = 0.0
        self.totals: Tuple[float, ...] = (0.0, 0.0)

    def rise(self, step: float, now: float) -> bool:
        """Add a positive step; returns whether that turns the sum on."""
        if self.value == 0.0:
            self.since = now
        self.value = min(self.value + step, self.threshold)
        turned = not self.on and self.value >= self.threshold
        self.on = self.on or turned
        return turned

    def fall(self, step: float) -> None:
        """Subtract a positive step."""
        self.value = max(self.value - step, 0.0)
        self.on = self.on and self.value > self.threshold / 2


class Stream:
    """A watched quantity and its sums.

    :ivar kind: see :class:`Alarm`, also for ``place``, ``robot`` and ``transition``.
    :ivar alarms: the alarms that it has raised. An alarm is active until its sum has fallen to half
        of its threshold.
    """

    def __init__(self, kind: str, place: str, robot: str = "", transition: str = "") -> None:
        self.kind, self.place, self.robot, self.transition = kind, place, robot, transition
        self.alarms: List[Alarm] = []
        self.sums: List[SidedSum] = []

    @property
    def on(self) -> bool:
        """Whether an alarm is active."""
        return any(s.on for s in self.sums)

    def nearest(self) -> SidedSum:
        """The sum nearest to its threshold."""
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


class PaceStream(Stream):
    """The pace of a place, of a robot or of the team."""

    def __init__(self, kind: str, place: str, robot: str, thresholds: Sequence[float]) -> None:
        super().__init__(kind, place, robot)
        self.sums = [SidedSum(h) for h in thresholds]
        self._slow = [
            (s, 1 - ratio, -math.log(ratio)) for s, ratio in zip(self.sums, RATIOS) if ratio < 1
        ]
        self._fast = [
            (s, ratio - 1, math.log(ratio)) for s, ratio in zip(self.sums, RATIOS) if ratio > 1
        ]

    def elapse(self, slow: float, fast: float, now: float) -> List[Tuple[SidedSum, str]]:
        """Advance the time, in which ``slow`` and ``fast`` action ends were expected with the
        plan's durations at the upper and lower ends of their intervals. Returns the sums that raise
        the alarm."""
        raised = []
        for s, slope, _ in self._slow:
            if s.rise(slope * slow, now) and sum(other.on for other, _, _ in self._slow) == 1:
                raised.append((s, "slower"))
        for s, slope, _ in self._fast:
            if s.value > 0.0:
                s.fall(slope * fast)
        return raised

    def count(self, now: float) -> List[Tuple[SidedSum, str]]:
        """Count the end of an action; returns the sums that raise the alarm."""
        raised = []
        for s, _, step in self._slow:
            s.fall(step)
        for s, _, step in self._fast:
            if s.rise(step, now) and sum(other.on for other, _, _ in self._fast) == 1:
                raised.append((s, "faster"))
        return raised


class ShareStream(Stream):
    """The frequency of an outcome or a failure."""

    def __init__(
        self, kind: str, place: str, transition: str, charts: Sequence[ChanceChart], events: float
    ) -> None:
        super().__init__(kind, place, "", transition)
        self.chance = charts[0].chance
        self._charts = charts
        self.sums = [SidedSum(chart.threshold(events)) for chart in charts]
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
                    about = self.kind, self.place, "", self.transition
                    direction = "more often" if chart.odds > 1 else "less often"
                    share = (self._hits - hits) / (self._trials - trials)
                    alarm = Alarm(*about, now, s.since, direction, share, self.chance)
                    self.alarms.append(alarm)
                    raised.append(alarm)
        return raised


class ChoiceStream(Stream):
    """The policy's choices in a place; the chi-squared test replaces the sums."""

    def __init__(self, place: str, test: ChoiceTest) -> None:
        super().__init__(CHOICE, place)
        self._test = test

    @property
    def on(self) -> bool:
        """Whether the last full block of choices departed."""
        return self._test.on

    def nearest(self) -> SidedSum:
        """The statistic of the block so far, relative to its critical value."""
        now = SidedSum(self._test.critical)
        now.value = self._test.statistic
        return now

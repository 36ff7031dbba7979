"""The number of states that the phases of durations create."""

from __future__ import annotations

import math
from functools import lru_cache
from types import MappingProxyType
from typing import Dict, List, Mapping, Sequence, Tuple

import numpy as np

from gspn_framework_package.run_net.columns import TimedAttempt
from gspn_framework_package.run_net.phases import (
    MOST_PHASES,
    Phases,
    number_of_phases,
    phases_of,
)
from gspn_framework_package.run_net.run_net import RunNet, State

_MATTERS, _NEGLIGIBLE = 1e-2, 1e-4
"""An error below the first needs no more phases while others are larger; one below the second never
does. The error is the number of robots, or the share of the longest mean time, times the difference
of the coefficients of variation."""

_ENOUGH = 28
"""Maximum number of phases if the package chooses it: more change little, and take long to
solve."""


class PhasesOfDurations:
    """The durations that need several phases.

    :param run_net: a run net that was compiled with one phase for each duration.
    """

    def __init__(self, run_net: RunNet) -> None:
        self._run_net = run_net
        self._many: List[Tuple[int, TimedAttempt, float]] = []  # place, attempt, number of phases
        for p, columns in run_net.columns.items():
            for attempt in columns.attempts:
                count = number_of_phases(attempt.duration)
                if count > 1:
                    self._many.append((p, attempt, count))
        self._names = [run_net.net.places[p].name for p, _, _ in self._many]

    @property
    def most(self) -> float:
        """The largest number of phases of a duration."""
        return max((k for _, _, k in self._many), default=1)

    def matches(self, most: Mapping[str, float] = MappingProxyType({})) -> List[str]:
        """Sentences for people on the phases that replace durations.

        :param most: place -> the most phases of each duration there.
        """
        found = []
        distance = lru_cache(maxsize=None)(Phases.distance)
        for name, (_, attempt, count) in zip(self._names, self._many):
            phases = phases_of(attempt.duration, most.get(name, MOST_PHASES))
            if attempt.duration.branches is None or len(phases.rates) < count:
                before, now = attempt.duration.variation, phases.duration.variation
                alike = abs(now - before) <= 1e-6 * before
                found.append(
                    "the duration of %s (%s) was replaced by phases of the same mean%s: %s; their "
                    "distributions differ by up to %.2g"
                    % (
                        name,
                        attempt.what,
                        " and variance" if alike else "",
                        phases.matched
                        + ("" if alike else ", variation %.3g instead of %.3g" % (now, before)),
                        distance(phases, attempt.duration),
                    )
                )
        return list(dict.fromkeys(found))

    def states(
        self, states: Sequence[State], most: Mapping[str, float] = MappingProxyType({})
    ) -> float:
        """How many states there would be if durations had these phases: each of ``states``, which
        were found with one phase for each duration, counts as often as its robots can be spread
        over the phases.

        :param most: place -> the most phases of each duration there.
        """
        return self._spread(_distinct(self._doing(states)), most)

    def _spread(self, distinct: Tuple[np.ndarray, np.ndarray], most: Mapping[str, float]) -> float:
        """The same from the distinct rows of :meth:`_doing` and how often each occurs."""
        doing, times = distinct
        total = times.astype(np.float64)
        for robots, name, (_, (*_, duration, _), _) in zip(doing.T, self._names, self._many):
            k = number_of_phases(duration, most.get(name, MOST_PHASES))
            total *= np.array([_spreadings(n, k) for n in range(robots.max() + 1)])[robots]
        return float(total.sum())

    def _doing(self, states: Sequence[State]) -> np.ndarray:
        """The number of robots in each of the durations, a row for each state."""
        columns = [attempt.columns[0] for _, attempt, _ in self._many]
        rows = [[state[c] for c in columns] if state else [0] * len(columns) for state in states]
        return np.array(rows, dtype=np.int64)

    @property
    def everything(self) -> Dict[str, float]:
        """As many phases as each duration needs."""
        return dict.fromkeys(self._names, math.inf)

    @property
    def enough(self) -> Dict[str, float]:
        """Fewer phases for the durations that need more than are represented."""
        named = zip(self._names, self._many)
        return {name: _ENOUGH for name, (_, _, k) in named if k > MOST_PHASES}

    def chosen(self, states: Sequence[State], shares: np.ndarray, limit: float) -> Dict[str, int]:
        """Choose the phases for the durations of each place so that there are about ``limit``
        states. All durations that so many phases do not match get equally many, then those in which
        robots spend more time get more.

        :param states: those with one phase for each duration.
        :param shares: the share of time in each of them; all 0 if it is not known.
        :return: place -> the most phases of each duration there.
        """
        doing = self._doing(states)
        spent, distinct = shares @ doing, _distinct(doing)
        names = self._names
        longest = max(visit.duration.mean for visit in self._run_net.timing.values())
        most = dict.fromkeys(names, 1)

        def wrong(place: str) -> Tuple[float, float]:
            """The error of the phases in a place: by the robots there, and by mean time."""
            by_robots = by_mean = 0.0
            for name, robots, (_, (*_, duration, _), _) in zip(names, spent, self._many):
                if name == place:
                    used = phases_of(duration, most[place]).duration
                    gap = abs(used.variation - duration.variation)
                    by_robots += robots * gap
                    by_mean += duration.mean / longest * gap
            return by_robots, by_mean

        def urgency(place: str) -> Tuple[bool, int, Tuple[float, float]]:
            error = wrong(place)
            return max(error) > _MATTERS, -most[place], error

        left = set(most)
        while left:
            place = max(sorted(left), key=urgency)
            more = {**most, place: most[place] + max(most[place] // 2, 1)}
            needs = max(k for name, (_, _, k) in zip(names, self._many) if name == place)
            if (
                most[place] < needs
                and more[place] <= _ENOUGH
                and max(wrong(place)) > _NEGLIGIBLE
                and self._spread(distinct, more) <= limit
            ):
                most = more
            else:
                left.remove(place)
        return most

    def fewer(self, most: Mapping[str, float]) -> Dict[str, float]:
        """``most`` with half as many phases, so that the squared variation is doubled, for the
        durations that it does not represent exactly; empty if there are none. A duration with one
        phase gets a squared variation of 4, or twice its own if that is more."""
        found: Dict[str, float] = {}
        for name, (_, (*_, duration, _), count) in zip(self._names, self._many):
            allowed = most.get(name, MOST_PHASES)
            if duration.branches is not None and allowed >= count:
                continue
            c = duration.variation**2
            if allowed <= 1:
                half = 1 / max(2.0 * c, 4.0)
            else:
                half = 1.0 if c > 1 else 0.5 / phases_of(duration, allowed).duration.variation ** 2
            found[name] = min(found.get(name, math.inf), half)
        return {**most, **found} if found else {}

    def where_most(self, most: Sequence[int]) -> str:
        """Where the largest number of states comes from, for people; empty if from no place.

        :param most: the largest number of robots in each place so far.
        """
        conditions = {p: float(last - first) for p, (first, last) in enumerate(self._run_net.parts)}
        for p, _, count in self._many:
            conditions[p] += count - 1 if math.isfinite(count) else 0
        ways = {p: _spreadings(most[p], conditions[p]) for p in self._run_net.columns}
        if not ways:
            return ""
        p = max(ways, key=ways.__getitem__)
        return "%s holds up to %d robot%s, each in one of %d phases or other conditions" % (
            self._run_net.net.places[p].name,
            most[p],
            "" if most[p] == 1 else "s",
            conditions[p],
        )

    def why_so_many(self, states: float, limit: int) -> str:
        """Why the phases of the durations are too many, for people."""
        p, attempt, _ = max(self._many, key=lambda entry: entry[2])
        return (
            "the durations take about %s states, more than the limit of %s (--limit); with fewer "
            "phases (--phases) they take fewer, above all the duration of %s (%s)"
        ) % (
            format(int(states), ",") if states < 1e15 else "%.1e" % states,
            format(limit, ","),
            self._run_net.net.places[p].name,
            attempt.what,
        )


def _distinct(rows: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """The distinct rows, and how often each occurs."""
    found, times = np.unique(rows, axis=0, return_counts=True)
    return found, times


def _spreadings(robots: int, phases: float) -> float:
    """The number of ways in which interchangeable robots can be in phases."""
    if not robots:
        return 1.0
    if math.isinf(phases):
        return math.inf
    return float(math.comb(robots + int(phases) - 1, robots))

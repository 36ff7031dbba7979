"""How many states the phases of durations make."""

from __future__ import annotations

import math
from typing import Dict, List, Sequence, Tuple

from gspn_framework_package.run_net.columns import TimedAttempt
from gspn_framework_package.run_net.phases import MOST_PHASES, number_of_phases, phases_of
from gspn_framework_package.run_net.run_net import RunNet, State


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

    @property
    def most(self) -> float:
        """The largest number of phases of a duration."""
        return max((k for _, _, k in self._many), default=1)

    def matches(self) -> List[str]:
        """With what durations that are not made of phases are replaced: sentences for people."""
        found = []
        for p, attempt, _ in self._many:
            phases = phases_of(attempt.duration)
            if attempt.duration.branches is None and phases is not None:
                found.append(
                    "the duration of %s (%s) was replaced by phases of the same mean and variance: "
                    "%s" % (self._run_net.net.places[p].name, attempt.what, phases.matched)
                )
        return list(dict.fromkeys(found))

    def states(self, states: Sequence[State]) -> float:
        """How many states there would be if durations had their phases: each of ``states``, found
        with one phase for each, as often as its robots can be spread over the phases."""
        many = [(attempt.columns[0], k) for _, attempt, k in self._many]
        total = 0.0
        known: Dict[Tuple[int, ...], float] = {}
        for state in states:
            doing = tuple([state[column] for column, _ in many]) if state else ()
            if doing not in known:
                known[doing] = math.prod([_spreadings(n, k) for n, (_, k) in zip(doing, many)])
            total += known[doing]
        return total

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
        p, attempt, k = max(self._many, key=lambda entry: entry[2])
        longest = "that of %s (%s)" % (self._run_net.net.places[p].name, attempt.what)
        if math.isinf(k):
            return "durations that never vary have no exponential phases: %s" % longest
        takes = "%s alone takes %s phases" % (longest, format(int(k), ","))
        if states <= limit:
            return "a duration may take up to %d phases, and %s" % (MOST_PHASES, takes)
        return "the durations take about %s states, more than the limit of %s; %s" % (
            format(int(states), ",") if states < 1e15 else "%.1e" % states,
            format(limit, ","),
            takes,
        )


def _spreadings(robots: int, phases: float) -> float:
    """The number of ways in which robots that are alike can be in phases."""
    if not robots:
        return 1.0
    if math.isinf(phases):
        return math.inf
    return float(math.comb(robots + int(phases) - 1, robots))

"""Lists what was not learned from logs, or not exactly enough, and how much more log it needs.

The width of an interval shrinks with the square root of the number of observations, and these grow
with the log, as long as robots continue like this.
"""

from __future__ import annotations

import math
from typing import Any, Dict, Iterator, Mapping, NamedTuple, Optional, Tuple

ENOUGH_ATTEMPTS = 5
"""With fewer observations than this, nothing is learned."""


class Need(NamedTuple):
    """Something that the logs do not say, or not exactly enough.

    :ivar what: ``duration``, ``outcomes``, ``failure``, ``rate``, ``change over the day``, or
        ``shares`` (of the values of a field).
    :ivar of: the place or transition.
    :ivar seen: observations in the logs.
    :ivar needed: about how many there should be.
    :ivar half_width: half of the 95 % interval: a share of the value; for failures, and for the
        outcome that is known least, the difference of the probability; None if nothing was
        learned.
    :ivar robot_seconds: about how much longer robots would have to be recorded (s, all robots
        together); None if the logs do not tell.
    """

    what: str
    of: str
    seen: int
    needed: int
    half_width: Optional[float]
    robot_seconds: Optional[float]

    def to_json(self) -> Dict[str, Any]:
        """The need as a JSON object."""
        hours = None if self.robot_seconds is None else self.robot_seconds / 3600
        return {
            "what": self.what,
            "of": self.of,
            "n": self.seen,
            "needed": self.needed,
            "half_width": self.half_width,
            "more_robot_hours": hours,
        }

    def text(self) -> str:
        """The need in a sentence."""
        name = "%s of %s" % (self.what, self.of)
        if self.half_width is None:
            known = "not learned, %d seen, at least %d are needed" % (self.seen, self.needed)
        else:
            points = " points" if self.what in ("outcomes", "failure", "shares") else " %"
            known = "known to %.3g%s from %d; about %d are needed" % (
                100 * self.half_width,
                points,
                self.seen,
                self.needed,
            )
        if self.robot_seconds is None:
            return "%s: %s; the logs do not show how long that takes" % (name, known)
        return "%s: %s: %s more" % (name, known, _robot_time(self.robot_seconds))


def _robot_time(seconds: float) -> str:
    if seconds < 3600:
        return "%.3g robot-minutes" % (seconds / 60)
    return "%.3g robot-hours" % (seconds / 3600)


def find_needs(
    places: Mapping[str, Any],
    rates: Mapping[str, Any],
    unseen: Tuple[str, ...],
    rare: Mapping[str, int],
    arrivals: Any,
    robot_seconds: float,
    within: float,
) -> Iterator[Need]:
    """Everything for which the logs are too short.

    :param places: place -> its :class:`~.learning.PlaceFit`.
    :param rates: transition -> its :class:`~.learning.EventFit`.
    :param unseen: action places without an attempt.
    :param rare: transition -> its firings, which are too few.
    :param arrivals: the :class:`~.arrivals.ArrivalsFit`.
    :param robot_seconds: how long robots were recorded, all together (s).
    :param within: what half of a 95 % interval may be: as a share of a mean duration or a rate, or
        the difference of a probability.
    """

    def need(
        what: str, of: str, seen: int, half: Optional[float], needed: int = ENOUGH_ATTEMPTS
    ) -> Iterator[Need]:
        if half is not None:
            if half <= within:
                return
            needed = math.ceil(seen * (half / within) ** 2)
        more = robot_seconds * (needed / seen - 1) if seen and robot_seconds > 0 else None
        yield Need(what, of, seen, needed, half, more)

    for place, found in places.items():
        if found.fit is None:
            yield from need("duration", place, found.n, None)
            continue
        mean = found.fit.duration.mean
        if mean > 0:
            yield from need("duration", place, found.n, _half(found.fit) / mean)
        if len(found.outcomes) > 1:
            least = max(found.outcomes.values(), key=_half)  # the others are known better
            yield from need("outcomes", place, least.total, _half(least))
        if found.failure is not None:
            yield from need("failure", place, found.failure.total, _half(found.failure))
    for place in unseen:
        yield from need("duration", place, 0, None)
    for name, event in rates.items():
        yield from need("rate", name, event.seen, _half(event) / event.rate)
    for name, seen in rare.items():
        yield from need("rate", name, seen, None)
    for name, arrival in arrivals.arrivals.items():
        if arrival.p is None:  # two parts of the day, and as many arrivals in each
            yield from need("change over the day", name, arrival.seen, None, 2 * ENOUGH_ATTEMPTS)
        for field, shares in arrival.data.items():
            least = max(shares.values(), key=_half)
            yield from need("shares", "%s of %s" % (field, name), least.total, _half(least))
    for period in arrivals.day:
        for name, event in period.rates.items():
            half = _half(event) / event.rate if event.seen else None
            yield from need("rate", "%s from %d to %d h" % (name, *period.span), event.seen, half)


def _half(found: Any) -> float:
    """Half of its interval."""
    low, high = found.interval
    return float(high - low) / 2

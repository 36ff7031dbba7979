"""The columns of a run net: what the robots of an action place are up to.

A place whose robots must be distinguished has a column for each thing that one of them can be
doing; a state of a run net counts the robots in each:

* *doing*: for each attempt at the action one column for each phase of the duration (one phase if it
  is exponential);
* *arriving*: the attempt takes no time, and has yet to end;
* *named t*: done, and the action has named transition t;
* *asking*, *holding t* and *idle*: done, and the policy decides. It has yet to draw; it has drawn
  t, which can fire as soon as a partner is done; it has drawn what this marking does not enable, or
  there is nothing to draw;
* *stuck*: its action has failed for good, or said nothing that is possible;
* *inactive*: done in a place that no transition leaves.

Every other place has one column.
"""

from __future__ import annotations

import math
from typing import Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.net import Net

Shares = Tuple[Tuple[int, float], ...]
"""PlaceColumns, or transitions, each with a probability or a rate (1/s)."""


class End(NamedTuple):
    """One way in which an attempt at an action ends: the robot goes to ``column`` with this
    ``probability``.

    :ivar request: the transition that it asks for, or ``POLICY``; None: nothing, because the
        attempt failed or nothing comes next.
    :ivar stops: whether this stops the team.
    :ivar failed: whether the attempt failed.
    """

    request: Optional[int]
    column: int
    probability: float
    stops: bool = False
    failed: bool = False


class TimedAttempt(NamedTuple):
    """An attempt at an action that takes time.

    :ivar columns: those of its phases, in which robots are doing.
    :ivar rates: the rates of the phases (1/s).
    :ivar following: for each phase the column after it; -1: the attempt ends.
    :ivar duration: how long it takes; messages call this ``what``.
    """

    columns: Tuple[int, ...]
    rates: Tuple[float, ...]
    following: Tuple[int, ...]
    duration: Duration
    what: str


class PlaceColumns(NamedTuple):
    """The columns of an action place whose robots are distinguished.

    :ivar entry: where a robot that enters begins: columns with probabilities.
    :ivar ends: for the columns in which an attempt ends, how it may end.
    :ivar outcomes: requests of a robot whose action succeeded (a transition, or ``POLICY``), with
        their probabilities.
    :ivar attempts: the attempts that take time.
    :ivar arriving: one column for each attempt that takes none.
    :ivar named: transition -> column of the robots that named it.
    :ivar asking, idle: -1 where no robot asks the policy.
    :ivar holding: transition -> column of the robots that have drawn it.
    :ivar stuck: -1 if the action always says what to do next.
    :ivar inactive: -1 if a transition leaves the place.
    """

    entry: Shares
    ends: Mapping[int, Tuple[End, ...]] = {}
    outcomes: Shares = ()
    attempts: Tuple[TimedAttempt, ...] = ()
    arriving: Tuple[int, ...] = ()
    named: Mapping[int, int] = {}
    asking: int = -1
    idle: int = -1
    holding: Mapping[int, int] = {}
    stuck: int = -1
    inactive: int = -1

    @property
    def at_policy(self) -> Tuple[int, ...]:
        """The columns of the robots that ask the policy."""
        if self.asking < 0:
            return ()
        return (self.asking, self.idle, *self.holding.values())

    def named_for_people(self, net: Net, p: int) -> Iterator[Tuple[int, str]]:
        """The columns in which time passes, each with what its robots are up to in place ``p``, in
        words. Nothing if all robots are done and interchangeable."""
        if self.attempts or self.named or self.holding:
            yield from ((c, words) for c, words in self.words(net, p) if c not in self.arriving)

    def words(self, net: Net, p: int) -> Iterator[Tuple[int, str]]:
        """All columns, each with what its robots are up to in place ``p``, in words."""
        place = net.places[p].name
        for number, attempt in enumerate(self.attempts, 1):
            count = len(attempt.columns)
            again = "" if number == 1 else ", attempt %d" % number
            for phase, column in enumerate(attempt.columns, 1):
                what = "doing, phase %d of %d" % (phase, count) if count > 1 else "doing its action"
                yield column, "%s (%s%s)" % (place, what, again)
        for does, table in (("wants", self.named), ("has drawn", self.holding)):
            for t, column in table.items():
                yield column, "%s (done, %s %s)" % (place, does, net.transitions[t].name)
        for column, what in (
            *((column, "arrives") for column in self.arriving),
            (self.asking, "done, asks the policy"),
            (self.idle, "done, waits"),
            (self.stuck, "stuck"),
            (self.inactive, "done for good"),
        ):
            if column >= 0:
                yield column, "%s (%s)" % (place, what)


class Taking(NamedTuple):
    """The robots that a requested transition takes from one place: ``weight`` of those that named
    it and of those that ask the policy.

    :ivar named: their column; -1: there is none.
    :ivar at_policy: the columns of the robots at the policy; empty if the transition is
        exponential.
    """

    place: int
    weight: int
    named: int
    at_policy: Tuple[int, ...]


class Racing(NamedTuple):
    """A place that is not split although its action takes time: each robot in ``column`` fires each
    of ``rates``."""

    column: int
    rates: Shares


class EventClock(NamedTuple):
    """An event: each robot in one of ``columns`` fires ``transition`` at this ``rate`` (1/s)."""

    transition: int
    rate: float
    columns: Tuple[int, ...]


class Race(NamedTuple):
    """An exponential transition that fires at the rate that the marking gives it.

    :ivar whole: the robots that it takes from places that are not split: pairs (column, count).
    :ivar split: those that it takes from any columns of places that are: pairs (columns, count).
    """

    transition: int
    whole: Tuple[Tuple[int, int], ...]
    split: Tuple[Tuple[Tuple[int, ...], int], ...]


def spread(
    found: List[Tuple[List[int], float]], entry: Sequence[Tuple[int, float]], robots: int
) -> List[Tuple[List[int], float]]:
    """Add ``robots`` robots to the columns of ``entry``, each at random; return the possible counts
    with their probabilities. It may change the lists in ``found``."""
    if not robots:
        return found
    if len(entry) == 1:
        for counts, _ in found:
            counts[entry[0][0]] += robots
        return found
    result = []
    for numbers in _compositions(robots, len(entry)):
        chance = float(math.factorial(robots))
        for n, (_, v) in zip(numbers, entry):
            chance *= v**n / math.factorial(n)
        for counts, u in found:
            more = list(counts)
            for n, (column, _) in zip(numbers, entry):
                more[column] += n
            result.append((more, u * chance))
    return result


def _compositions(total: int, parts: int) -> Iterator[Tuple[int, ...]]:
    """All ways to write ``total`` as a sum of this many non-negative integers."""
    if parts == 1:
        yield (total,)
        return
    for first in range(total, -1, -1):
        for rest in _compositions(total - first, parts - 1):
            yield (first, *rest)

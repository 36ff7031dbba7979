"""Arrivals: whether their rates change over the day, in which hours, and what comes.

An *arrival* is a transition of the environment that takes nothing: a new order, a part, a person.
Its rate is tested hour by hour. Where arrivals change, the day falls into periods with one rate
each, which a plan follows by a clock of its own (:func:`with_day`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.analysis.fitting.needs import ENOUGH_ATTEMPTS
from gspn_framework_package.analysis.fitting.testing import (
    SIGNIFICANT,
    EventFit,
    OutcomeFit,
    event_fit,
    largest_clear,
    outcome_fit,
)
from gspn_framework_package.model.attempt import EventCount
from gspn_framework_package.model.duration import Evidence
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.net import Arc, Net, Place, Transition
from gspn_framework_package.model.plan import Plan

_HOURS = 24

_POWER = 0.8
"""The probability that a test detects the variation that is stated with it."""

_MOST_VALUES = 20
"""Of a field with more values than this, no shares are learned."""


class ArrivalFit(NamedTuple):
    """What was learned about an arrival.

    :ivar seen: how many came.
    :ivar parts: the parts of the day that were compared; below 2: too little log for a test.
    :ivar p: the p-value of the test that the rate is the same in all of them, or None.
    :ivar shows: the variation (standard deviation over the day, as a share of the mean rate) that
        such a test shows in four of five cases, or None.
    :ivar changes: whether the rate changes.
    :ivar share: its share of all arrivals.
    :ivar data: field of the tasks' data -> value -> its share.
    """

    seen: int
    parts: int
    p: Optional[float]
    shows: Optional[float]
    changes: bool
    share: OutcomeFit
    data: Mapping[str, Mapping[Any, OutcomeFit]]

    def to_json(self) -> Dict[str, Any]:
        """The arrival as a JSON object."""
        return {
            "n": self.seen,
            "parts": self.parts,
            "p": self.p,
            "shows": self.shows,
            "changes": self.changes,
            "share": self.share.to_json(),
            "data": {
                name: {str(value): share.to_json() for value, share in shares.items()}
                for name, shares in self.data.items()
            },
        }


class Period(NamedTuple):
    """A part of the day: the hour (UTC) in which it ``begins``, its ``hours``, and the rates in it
    of the arrivals that change."""

    begins: int
    hours: int
    rates: Mapping[str, EventFit]

    @property
    def span(self) -> Tuple[int, int]:
        """The hours in which it begins and ends."""
        return self.begins, (self.begins + self.hours) % _HOURS or _HOURS

    def to_json(self) -> Dict[str, Any]:
        """The period as a JSON object."""
        rates = {name: fit.to_json() for name, fit in self.rates.items()}
        return {"from_hour": self.begins, "hours": self.hours, "rates": rates}


class ArrivalsFit(NamedTuple):
    """What was learned about all arrivals; ``day`` has the periods of a day, and none if no arrival
    changes. ``notes`` are for people."""

    arrivals: Mapping[str, ArrivalFit] = {}
    day: Tuple[Period, ...] = ()
    notes: Tuple[str, ...] = ()

    def to_json(self) -> Dict[str, Any]:
        """The results as a JSON object."""
        return {
            "arrivals": {name: fit.to_json() for name, fit in self.arrivals.items()},
            "day": [period.to_json() for period in self.day],
        }


def fit_arrivals(net: Net, events: Mapping[str, EventCount]) -> ArrivalsFit:
    """Learn from what logs counted of the transitions of a net."""
    seen = {
        name: event
        for name, event in events.items()
        if not net.inputs[net.transition_number(name)]
        and any(time > 0 for _, time in event.hours.values())
    }
    total = sum(event.firings for event in seen.values())
    tests = {name: _test(event) for name, event in seen.items()}
    clear = largest_clear([p for _, p, _ in tests.values() if p is not None])
    changing = {n: e for n, e in seen.items() if (tests[n][1] or 0.0) <= clear and tests[n][0] > 1}
    notes: List[str] = []
    arrivals = {}
    for name, event in seen.items():
        data = dict(_shares(name, event, notes))
        share = outcome_fit(event.firings, total)
        arrivals[name] = ArrivalFit(event.firings, *tests[name], name in changing, share, data)
    hours = sorted({h for e in seen.values() for h, (_, time) in e.hours.items() if time > 0})
    if changing and len(hours) < _HOURS:
        notes.append(
            "the logs have nothing from %d of 24 hours of the day (UTC): %s; nothing is known of "
            "arrivals then, and the learned day leaves them out"
            % (_HOURS - len(hours), _spans(set(range(_HOURS)).difference(hours)))
        )
    return ArrivalsFit(arrivals, tuple(_day(changing, hours)), tuple(notes))


def _test(event: EventCount) -> Tuple[int, Optional[float], Optional[float]]:
    """``parts``, ``p`` and ``shows`` of :class:`ArrivalFit`, by Pearson's test of counts: in each
    part at least five are to be expected if nothing changes (Cochran 1954)."""
    from scipy import special, stats  # slow to import

    total, whole = _within(event, sorted(event.hours))
    counts, expected, count, time = [0], [0.0], 0, 0.0
    for _, (more, seconds) in sorted(event.hours.items()):
        count, time = count + more, time + seconds
        if total * time >= ENOUGH_ATTEMPTS * whole:
            counts.append(count)
            expected.append(total * time / whole)
            count, time = 0, 0.0
    counts[-1] += count  # what is left belongs to the last part
    expected[-1] += total * time / whole
    freedom = len(counts) - 2
    if freedom < 1:
        return freedom + 1, None, None
    found = stats.chisquare(counts[1:], expected[1:])
    noise = special.chndtrinc(special.chdtri(freedom, SIGNIFICANT), freedom, 1 - _POWER)
    return freedom + 1, float(found.pvalue), math.sqrt(noise / total)


def _shares(
    name: str, event: EventCount, notes: List[str]
) -> Iterator[Tuple[str, Dict[Any, OutcomeFit]]]:
    """The shares of the values of each field; a note for a field that has too many."""
    for key, values in sorted(event.data.items()):
        total = sum(values.values())
        if len(values) <= _MOST_VALUES and total >= ENOUGH_ATTEMPTS * len(values):
            order = sorted(values, key=lambda value: (-values[value], str(value)))
            yield key, {value: outcome_fit(values[value], total) for value in order}
        elif len(values) <= _MOST_VALUES:
            notes.append(
                "%s: %d tasks are too few for the shares of the %d values of %s; about %d are "
                "needed" % (name, total, len(values), key, ENOUGH_ATTEMPTS * len(values))
            )
        elif len(values) < total:
            notes.append(
                "%s: %s has %d values in %d tasks, too many for shares"
                % (name, key, len(values), total)
            )


def _spans(hours: Any) -> str:
    """Hours as text: ``0 to 6, 22 to 24``."""
    starts = [h for h in sorted(hours) if h - 1 not in hours]
    ends = [h + 1 for h in sorted(hours) if h + 1 not in hours]
    return ", ".join("%d to %d" % span for span in zip(starts, ends))


# -- the day ---------------------------------------------------------------------------------------


def _day(changing: Mapping[str, EventCount], hours: Sequence[int]) -> Iterator[Period]:
    """The periods, of those hours that are known: as many as are worth their parameters (Schwarz
    1978), but at least two."""
    if not changing or len(hours) < 2:
        return
    if len(hours) == _HOURS:  # the day may begin anywhere
        turns = [[*hours[k:], *hours[:k]] for k in range(_HOURS)]
    else:  # after the longest gap
        gaps = [(hours[k] - hours[k - 1]) % _HOURS for k in range(len(hours))]
        first = gaps.index(max(gaps))
        turns = [[*hours[first:], *hours[:first]]]
    _, order, cuts = min((_divided(changing, turn) for turn in turns), key=lambda found: found[0])
    found = []
    for begin, end in zip(cuts, cuts[1:]):
        rates = {}
        for name, event in changing.items():
            count, time = _within(event, order[begin:end])
            rates[name] = event_fit(count, time or event.exposure)
        found.append(Period(order[begin], end - begin, rates))
    yield from sorted(found)  # no two begin in the same hour


def _within(event: EventCount, hours: Sequence[int]) -> Tuple[int, float]:
    counts = [event.hours.get(hour, (0, 0.0)) for hour in hours]
    return sum(n for n, _ in counts), sum(seconds for _, seconds in counts)


def _divided(
    changing: Mapping[str, EventCount], order: Sequence[int]
) -> Tuple[float, Sequence[int], List[int]]:
    """The best division of hours in this order: its score, the hours, and where each part begins,
    with the end of the last (dynamic programming)."""
    size = len(order)
    total = sum(event.firings for event in changing.values())
    price = (len(changing) + 1) / 2 * math.log(total)  # its rates, and where it begins

    def score(begin: int, end: int) -> float:
        gain = 0.0
        for event in changing.values():
            count, time = _within(event, order[begin:end])
            gain += count * math.log(count / time) if count and time > 0 else 0.0
        return math.inf if end - begin == size else price - gain

    best, back = [0.0], [0]
    for end in range(1, size + 1):
        found = min((best[begin] + score(begin, end), begin) for begin in range(end))
        best.append(found[0])
        back.append(found[1])
    cuts = [size]
    while cuts[0]:
        cuts.insert(0, back[cuts[0]])
    return best[-1], order, cuts


def with_day(plan: Plan, fit: ArrivalsFit, logs: Sequence[str]) -> Plan:
    """The plan with a clock: a place for each period, of which one has a token, and transitions
    between them that fire by the hours of the day; in the model, a period takes an exponential
    time, as long on average as its hours.

    An arrival keeps its transition, with its lowest rate of the day, so that in a run everything
    comes in as before; what comes besides in a period has its own transition.

    :param logs: the names of the logs, for the evidence.
    :raises NetError: the net has such a place or transition already.
    """
    net, day = plan.net, fit.day
    if not day:
        return plan
    places, transitions, arcs = list(net.places), list(net.transitions), list(net.arcs)
    lowest = {name: min((p.rates[name] for p in day), key=_positive) for name in day[0].rates}
    learned: Dict[str, Tuple[EventFit, float]] = {n: (fit, 0.0) for n, fit in lowest.items()}
    events = dict(plan.events)
    clock = ["hours_%d_%d" % period.span for period in day]
    for k, (period, now) in enumerate(zip(day, clock)):
        following = (k + 1) % len(day)
        places.append(Place(now, tokens=int(k == 0)))
        after = "after_" + now
        transitions.append(Transition(after, timed=True, rate=1 / (3600.0 * period.hours)))
        arcs += [Arc(now, after), Arc(after, clock[following])]
        ends = float(day[following].begins)
        events[after] = EventSource(from_hour=ends, to_hour=float(period.begins))
        for name, rate in period.rates.items():
            least = _positive(lowest[name])
            if rate.rate > least:
                new = "%s_%d_%d" % (name, *period.span)
                learned[new] = rate, least
                if name in events:
                    events[new] = EventSource()  # tasks that nobody sends in a run
                transitions.append(net.transition(name)._replace(name=new, rate=rate.rate - least))
                arcs += [Arc(now, new), Arc(new, now)]
                arcs += [
                    a._replace(source=new) if a.source == name else a._replace(target=new)
                    for a in net.arcs
                    if name in (a.source, a.target)
                ]
    evidence = dict(plan.evidence)
    for name, (rate, less) in learned.items():
        low, high = rate.interval
        interval = max(low - less, 0.0), high - less
        evidence["rates", name] = Evidence(rate.seen, tuple(logs), interval)
    new_plan = replace(
        plan,
        net=Net(places, transitions, arcs, net.name),
        resource_places=plan.resource_places.union(clock),
        events=events,
        evidence=evidence,
    )
    rates = {name: _positive(fit) - less for name, (fit, less) in learned.items()}
    return new_plan.with_rates(rates).validate()


def _positive(fit: EventFit) -> float:
    """The rate; where nothing was seen, a tenth of the highest rate that is compatible with
    that."""
    return fit.rate or fit.interval[1] / 10

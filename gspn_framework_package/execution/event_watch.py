"""Decides which events interrupt a robot and when, turning reports of event sources into log
entries.

The host of a robot (its node, or the standalone executor) watches the sources of a plan's events,
and passes on changes: that the condition of an event holds or no longer does, or that an
instantaneous event occurred. :class:`EventWatch` relates this to the robot's present visit. It
reads no clock and no source; the token game decides whether an event has an effect.
"""

from __future__ import annotations

from typing import Any, Collection, Dict, List, Mapping, NamedTuple, Optional

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.log_entries import NOTHING
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.plan import Plan


class Visit(NamedTuple):
    """A visit of a robot to a place."""

    place: str
    incarnation: int
    number: int


def asked_anew(plan: Plan, topics: bool) -> List[str]:
    """The events whose functions a host calls again when a visit begins (with
    ``EventFunctions.ask_again``): those that count by level.

    :param topics: whether the host subscribes to topics.
    """
    return [t for t, e in plan.events.items() if e.asks_function(topics) and not e.edge]


class EventWatch:
    """The events of one robot.

    :param asked_anew: events whose source the host queries again when a visit begins; earlier
        reports do not count in that visit.
    """

    def __init__(self, plan: Plan, robot: str, asked_anew: Collection[str] = ()) -> None:
        self._robot = robot
        self._asked_anew = tuple(asked_anew)
        self._events = plan.events
        self._interrupts = {place: plan.interrupts(place) for place in plan.action_places}
        self._holds: Dict[str, Mapping[str, Any]] = {}
        """Event that holds -> its cause."""
        self._came: Dict[str, Mapping[str, Any]] = {}
        """Event that occurred during this visit, as a rising edge or instantaneously -> its
        cause."""
        self._visit: Optional[Visit] = None
        self._since = 0.0
        self._reported: Dict[str, None] = {}
        """Events of this visit for which an entry was made and that still hold."""

    def go_on_from(self, before: EventWatch, mapping: Mapping[str, str]) -> None:
        """Copy the state of all events that an earlier plan shares with this one.

        :param mapping: names of the earlier plan -> names of this one, if they differ.
        """
        same = {}
        for name, event in before._events.items():
            new = mapping.get(name, name)
            if self._events.get(new) == event:
                same[name] = new
        self._holds = {same[t]: cause for t, cause in before._holds.items() if t in same}
        self._came = {same[t]: cause for t, cause in before._came.items() if t in same}
        self._reported = {same[t]: None for t in before._reported if t in same}
        self._since = before._since
        if before._visit is not None:
            place = before._visit.place
            self._visit = before._visit._replace(place=mapping.get(place, place))

    def watches(self, transition: str) -> bool:
        """Whether an event could interrupt the robot in its present visit."""
        return self._visit is not None and transition in self._interrupts.get(self._visit.place, ())

    def observe(
        self, transition: str, holds: Optional[bool], cause: Mapping[str, Any] = NOTHING
    ) -> None:
        """Take a report of a source.

        :param transition: the event.
        :param holds: whether its condition holds; None for an instantaneous event.
        :param cause: the data read from the event.
        """
        if holds is None:
            if self.watches(transition):
                self._came[transition] = cause
        elif holds:
            if transition not in self._holds and self.watches(transition):
                self._came[transition] = cause
            self._holds.setdefault(transition, cause)
        else:
            self._holds.pop(transition, None)
            self._reported.pop(transition, None)

    def due(self, visit: Optional[Visit], now: float) -> List[log_entries.Interrupt]:
        """The events that should now interrupt the robot, each once.

        :param visit: the robot's present visit; None if it is in no place.
        :param now: a monotonic clock, s.
        """
        if visit != self._visit:
            self._visit, self._since = visit, now
            self._came, self._reported = {}, {}
            for transition in self._asked_anew:
                self._holds.pop(transition, None)
        if visit is None:
            return []
        found = []
        for transition in self._interrupts.get(visit.place, ()):
            cause = self._cause(transition, self._events[transition], now)
            if cause is not None:
                self._reported[transition] = None
                found.append(
                    log_entries.Interrupt(
                        self._robot, visit.incarnation, visit.number, transition, cause
                    )
                )
        self._came = {}
        return found

    def wake_time(self, visit: Optional[Visit]) -> Optional[float]:
        """When the next timed event is due in a visit passed to :meth:`due` (s)."""
        if visit is None or visit != self._visit:
            return None
        times = [
            self._since + after
            for t in self._interrupts.get(visit.place, ())
            for after in (self._events[t].after,)
            if after is not None and t not in self._reported
        ]
        return min(times, default=None)

    def _cause(
        self, transition: str, source: EventSource, now: float
    ) -> Optional[Mapping[str, Any]]:
        """The cause of an event that is due; None if it is not."""
        if transition in self._came:
            return self._came[transition]
        if transition in self._reported:
            return None
        if source.after is not None:
            return {"after": source.after} if now >= self._since + source.after else None
        return None if source.edge else self._holds.get(transition)

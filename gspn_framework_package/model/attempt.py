"""The actions and events of a plan in the logs of its runs."""

from __future__ import annotations

from collections import Counter
from typing import Dict, Iterable, Mapping, NamedTuple, Tuple, Union


class Attempt(NamedTuple):
    """An attempt at the action of a place, by ``robot`` in its ``visit``.

    ``start`` and ``end`` are seconds on the clock of the log; for a censored attempt ``end`` is
    when it was last known to be running. ``completed``: whether the end is known. ``result`` is the
    transition that the action named ("" for none), which is meaningful only if the attempt is
    completed and did not fail. ``failed`` is the reason of a failure, otherwise "". ``log`` is the
    index of the attempt's log among those given.
    """

    robot: str
    place: str
    visit: int
    attempt: int
    start: float
    end: float
    completed: bool
    result: str = ""
    failed: str = ""
    log: int = 0

    @property
    def duration(self) -> float:
        """Seconds from the start to the end."""
        return self.end - self.start


class EventCount(NamedTuple):
    """How often something occurred, and its *exposure*: the time (s) in which it could have. The
    rate is the quotient.

    A transition of the environment occurs when it fires; its time counts once for each busy server.
    A task from outside arrives whether or not its transition is enabled. An event that interrupts
    occurs once per visit, for each robot in its place (also while the robot is done or waits); if
    it is not held, only while its transition is enabled.

    :ivar hours: hour of the day (UTC) -> both, in that hour.
    :ivar data: field of the data of tasks -> text or whole number in it -> number of tasks.
    """

    firings: int
    exposure: float
    hours: Mapping[int, Tuple[int, float]] = {}
    data: Mapping[str, Mapping[Union[str, int], int]] = {}

    @classmethod
    def summed(cls, counts: Iterable[Mapping[str, EventCount]]) -> Dict[str, EventCount]:
        """The sums over runs of the counts of each transition."""
        found: Dict[str, EventCount] = {}
        for run in counts:
            for name, event in run.items():
                known = found.get(name, cls(0, 0.0))
                hours, data = dict(known.hours), dict(known.data)
                for hour, (firings, exposure) in event.hours.items():
                    before = hours.get(hour, (0, 0.0))
                    hours[hour] = before[0] + firings, before[1] + exposure
                for key, values in event.data.items():
                    data[key] = Counter(data.get(key, {})) + Counter(values)
                both = known.firings + event.firings, known.exposure + event.exposure
                found[name] = cls(*both, hours, data)
        return found

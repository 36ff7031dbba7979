"""Plays a recorded run to a monitor, in chronological order."""

from __future__ import annotations

from typing import Any, Iterable, List, Optional, Tuple

from gspn_framework_package.analysis.monitoring.monitor import Monitor
from gspn_framework_package.analysis.watch import Progress, Watch
from gspn_framework_package.model.attempt import Attempt

_ENDS, _CHOOSES, _BEGINS = range(3)
"""The order of events of one moment."""


def play_to_monitor(
    monitor: Monitor,
    attempts: Iterable[Attempt],
    choices: Iterable[Any] = (),
    *,
    began: float = 0.0,
    progress: Optional[Progress] = None,
) -> None:
    """Pass all attempts and choices of one run to a monitor.

    :param attempts: in any order.
    :param choices: of class ``execution.observation.PolicyChoice``, in any order.
    :param began: when the run began, in seconds on the clock of the attempts; the monitor's time
        begins there.
    """
    events: List[Tuple[float, int, int, Any]] = []
    for number, attempt in enumerate(attempts):
        events.append((attempt.start - began, _BEGINS, number, attempt))
        events.append((attempt.end - began, _ENDS, number, attempt))
    for number, choice in enumerate(choices):
        events.append((choice.at - began, _CHOOSES, number, choice))
    events.sort(key=lambda event: event[:3])
    watch = Watch(progress)
    for count, (at, kind, _, seen) in enumerate(events):
        monitor.advance(at)
        if kind == _BEGINS:
            monitor.begin(seen.robot, seen.place, at)
        elif kind == _CHOOSES:
            monitor.choose(seen.place, seen.row, seen.chosen, at)
        else:
            how = {"completed": seen.completed, "result": seen.result, "failed": seen.failed}
            monitor.end(seen.robot, at, **how)
        if count % 1024 == 0:
            watch.step("events watched", count)

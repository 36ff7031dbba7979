"""Plays a recorded run to a monitor, in chronological order."""

from __future__ import annotations

from typing import Any, Callable, Iterable, List, Optional, Tuple

from gspn_framework_package.analysis.monitoring.monitor import Monitor
from gspn_framework_package.analysis.watch import Progress, Watch
from gspn_framework_package.model.attempt import Attempt


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
    events: List[Tuple[float, int, int, Callable[[float], object]]] = []
    for number, attempt in enumerate(attempts):
        events.append((attempt.start - began, 2, number, _begin(monitor, attempt)))
        events.append((attempt.end - began, 0, number, _end(monitor, attempt)))
    for number, choice in enumerate(choices):
        events.append((choice.at - began, 1, number, _choose(monitor, choice)))
    events.sort(key=lambda event: event[:3])  # at one moment: ends, then choices, then starts
    watch = Watch(progress)
    for count, (at, _, _, tell) in enumerate(events):
        monitor.advance(at)
        tell(at)
        if count % 1024 == 0:
            watch.step("events watched", count)


def _begin(monitor: Monitor, attempt: Attempt) -> Callable[[float], object]:
    return lambda at: monitor.begin(attempt.robot, attempt.place, at)


def _end(monitor: Monitor, attempt: Attempt) -> Callable[[float], object]:
    return lambda at: monitor.end(
        attempt.robot,
        at,
        completed=attempt.completed,
        result=attempt.result,
        failed=attempt.failed,
    )


def _choose(monitor: Monitor, choice: Any) -> Callable[[float], object]:
    return lambda at: monitor.choose(choice.place, choice.row, choice.chosen, at)

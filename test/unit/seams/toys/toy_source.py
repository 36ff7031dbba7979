"""A source of events: a kitchen timer, which rings once, so long after the robot has arrived."""

from __future__ import annotations

import time
from typing import Optional

from gspn_framework_package.model.event import SourceKind


class Timer:
    def __init__(self, minutes: float) -> None:
        self.seconds = 60 * minutes
        self.began: Optional[float] = None

    def __call__(self) -> bool:
        if self.began is None:
            self.began = time.monotonic()
        return time.monotonic() >= self.began + self.seconds


def after(minutes: float) -> float:
    return 60 * minutes


TIMER = SourceKind(
    "timer",
    {
        "type": "object",
        "required": ["minutes"],
        "additionalProperties": False,
        "properties": {"minutes": {"type": "number", "exclusiveMinimum": 0}},
    },
    Timer,
    after,
)

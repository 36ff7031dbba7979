"""A family of durations: a least time, and an exponential one after it."""

from __future__ import annotations

from typing import Any, Dict, List

from gspn_framework_package.model.duration import Duration, DurationPart, Family


def parts(least: float, rest: float) -> List[DurationPart]:
    return [DurationPart(1.0, least, Duration.exponential(rest))]


def estimate(sample: Any) -> Dict[str, float]:
    least = float(sample.observed.min())
    return {"least": least, "rest": float(sample.observed.mean()) - least}


AT_LEAST = Family(
    "at-least",
    {
        "least": {"description": "Seconds.", "type": "number", "minimum": 0, "default": 1},
        "rest": {"description": "Its mean (s).", "type": "number", "exclusiveMinimum": 0},
    },
    ("least", "rest"),
    parts,
    estimate,
)

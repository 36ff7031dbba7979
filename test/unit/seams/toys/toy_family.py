"""Two families of durations: a least time with an exponential one after it, which is made of others,
and that of Rayleigh, which is not."""

from __future__ import annotations

from typing import Any, Dict, List

import numpy as np

from gspn_framework_package.model.duration import Duration, DurationPart, Family
from gspn_framework_package.model.families import parts_of_quantiles


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


def parts_of_rayleigh(scale: float) -> List[DurationPart]:
    return parts_of_quantiles(lambda p: scale * np.sqrt(-2 * np.log1p(-p)))


def estimate_of_rayleigh(sample: Any) -> Dict[str, float]:
    squares = (sample.observed**2).sum() + (sample.censored**2).sum()
    return {"scale": float(np.sqrt(squares / 2 / sample.size))}


RAYLEIGH = Family(
    "rayleigh",
    {"scale": {"description": "Seconds.", "type": "number", "exclusiveMinimum": 0, "default": 1}},
    ("scale",),
    parts_of_rayleigh,
    estimate_of_rayleigh,
)

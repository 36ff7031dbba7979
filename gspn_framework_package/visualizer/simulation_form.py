"""The forms of the page's *Simulated runs* and *Sweep*: turns their fields into simulation
settings, and reports the points of a sweep as they come."""

from __future__ import annotations

import math
import time as clock
from typing import TYPE_CHECKING, Any, Callable, Dict, List, Optional, Union

from gspn_framework_package.analysis.watch import Progress, Watch
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

if TYPE_CHECKING:
    from gspn_framework_package.analysis.simulation import Asked

MOST_FORM_REPLICATIONS = 100_000
"""Largest number of simulated runs that the page may ask for."""

MOST_SWEEP_POINTS = 400
"""Largest number of points of a sweep on the page."""

_TEXTS = 20
_EVERY = 0.3
"""Minimum seconds between two reports."""


def asked_in_form(form: object, name: str) -> Asked:
    """The simulation settings in the fields.

    :param name: name of the form, for the message.
    :raises UsageError: the fields are invalid.
    """
    from gspn_framework_package.analysis.simulation import Asked

    if not isinstance(form, dict):
        raise UsageError("'%s' must be an object" % name)
    replications = form_number(form, "replications", 1000.0)
    if replications is None or not 1 <= replications <= MOST_FORM_REPLICATIONS:
        raise UsageError("the number of runs must be from 1 to %d" % MOST_FORM_REPLICATIONS)
    time = form_number(form, "time")
    until = form.get("until") or None
    if until is not None and not isinstance(until, str):
        raise UsageError("'until' must be a condition")
    return Asked(
        time=math.inf if time is None else time,
        replications=int(replications),
        seed=int(form_number(form, "seed", 0.0) or 0),
        warmup=form_number(form, "warmup", 0.0) or 0.0,
        until=until,
        confidence=form_number(form, "confidence", 0.95) or 0.0,
    )


def form_number(form: Dict[str, Any], key: str, default: Optional[float] = None) -> Optional[float]:
    """A number of a form, at least 0. :raises UsageError: it is not."""
    value = form.get(key, default)
    if value is not None and (
        isinstance(value, bool) or not isinstance(value, (int, float)) or value < 0
    ):
        raise UsageError("'%s' must be a number of at least 0" % key)
    return value


def sweep_in_parts(
    subject: Union[Net, Plan],
    form: Any,
    progress: Progress,
    tell: Callable[[Dict[str, Any]], object],
) -> None:
    """Measure the points of a sweep.

    :param form: ``vary`` and ``measure``, lists as ``gspn sweep`` takes them, and the fields of a
        simulation.
    :param tell: called with all points so far, at intervals and at the end.
    :raises GspnError: the form is invalid, or a point cannot be measured.
    """
    from gspn_framework_package.analysis.sweeps.sweep import (
        Sweep,
        SweepPoint,
        chosen,
        read_variation,
    )

    asked = asked_in_form(form, "sweep")
    variations = [read_variation(text) for text in _few_texts(form, "vary")]
    if not variations:
        raise UsageError("no parameter to vary", hint="write robots=1..5, for example")
    if any(variation.kind == "policy" for variation in variations):
        raise UsageError("the page cannot read policies from files", hint="use gspn sweep")
    if math.prod(len(variation.values) for variation in variations) > MOST_SWEEP_POINTS:
        raise UsageError(
            "the page shows at most %d points" % MOST_SWEEP_POINTS, hint="gspn sweep has no limit"
        )
    ends = asked.until is not None or isinstance(subject, Plan) and subject.until is not None
    wanted = chosen(subject, _few_texts(form, "measure"), ends)
    sweep = Sweep(subject, variations, asked)
    points: List[SweepPoint] = []
    reported = clock.monotonic()
    for point in sweep.run(watch=Watch(progress)):
        points.append(point)
        if clock.monotonic() - reported > _EVERY or len(points) == 1:
            reported = clock.monotonic()
            tell({**sweep.to_json(points, wanted), "of": len(sweep.points)})
    tell({**sweep.to_json(points, wanted), "of": len(sweep.points)})


def form_texts(form: Dict[str, Any], key: str, what: str = "texts") -> List[str]:
    """A list of texts of a form. :raises UsageError: it is not."""
    values = form.get(key, [])
    if not isinstance(values, list) or not all(isinstance(v, str) for v in values):
        raise UsageError("'%s' must be a list of %s" % (key, what))
    return values


def _few_texts(form: Dict[str, Any], key: str) -> List[str]:
    values = form_texts(form, key)
    if len(values) > _TEXTS:
        raise UsageError("'%s' has more than %d entries" % (key, _TEXTS))
    return values

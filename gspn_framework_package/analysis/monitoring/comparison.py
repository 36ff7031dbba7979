"""Predicted against observed: the measures of a run with their prediction intervals."""

from __future__ import annotations

import math
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis import quantiles
from gspn_framework_package.analysis.arrays import Floats
from gspn_framework_package.analysis.monitoring.prediction import RunSample
from gspn_framework_package.analysis.plan.subnets import subnet_counts
from gspn_framework_package.model.plan import Plan

LEVEL = 0.95
"""Probability that a prediction interval contains the value of a run that follows the plan."""

DEPARTS = 0.01
"""The share of runs following the plan whose measures, taken together, are reported as
departing."""

ENOUGH_RUNS = 400
"""From this many replications on, the ends of an interval are quantiles of the sample; with fewer,
they follow from its mean and standard deviation and Student's distribution."""

CLOCK_RESOLUTION = 2e-6
"""Seconds by which the clocks of a log, which count microseconds, may shift each firing."""

SIMULTANEOUS = 0.01
"""The share of the prediction by which its interval is widened on both sides beyond that of the
simulated runs: in the model, durations are independent, but whatever slows down a real machine or
robot (load, heat, battery) slows down all its actions. A smaller difference is not a departure."""

THROUGHPUT, TOKENS, VISITS, TIME = "throughput", "mean tokens", "visits", "time to condition"
SUBNET_ROBOTS, SUBNET_STAY = "robots in subnet", "time in subnet"
SUBNET_ENTRIES, SUBNET_EXITS = "entries of subnet", "exits of subnet"


class Observed(NamedTuple):
    """The totals observed in some runs.

    :ivar seconds: the time for which they were observed.
    :ivar firings: transition -> number of firings.
    :ivar tokens: place -> token-seconds.
    :ivar came: whether all of them reached the condition of the plan.
    """

    seconds: float
    firings: Mapping[str, int]
    tokens: Mapping[str, float]
    came: bool = False


class PredictedMeasure(NamedTuple):
    """A measure: predicted mean, prediction interval, and observed value (None: not reached) with
    its uncertainty ``slack``."""

    kind: str
    of: str
    unit: str
    predicted: float
    low: float
    high: float
    observed: Optional[float]
    slack: float = 0.0

    @property
    def name(self) -> str:
        """The name of the measure, for people."""
        return ("%s %s" % (self.kind, self.of)).strip()

    @property
    def inside(self) -> bool:
        """Whether the observed value may be in the interval, given its uncertainty."""
        if self.observed is None:
            return math.isinf(self.high)
        slack = self.slack + 1e-9 * max(abs(self.low), abs(self.high), abs(self.observed))
        return self.low - slack <= self.observed <= self.high + slack

    @property
    def change(self) -> Optional[float]:
        """The excess of the observed value over the prediction, as a share of the prediction."""
        if self.observed is None or not self.predicted:
            return None
        return self.observed / self.predicted - 1

    @property
    def direction(self) -> str:
        """``more`` or ``less`` than predicted; empty if the value is inside or was not reached."""
        if self.inside or self.observed is None:
            return ""
        return "more" if self.observed > self.high else "less"

    def to_json(self) -> Dict[str, Any]:
        """The measure as a JSON object."""
        return {
            "name": self.name,
            "kind": self.kind,
            "of": self.of,
            "unit": self.unit,
            "predicted": _finite(self.predicted),
            "interval": [_finite(self.low), _finite(self.high)],
            "observed": None if self.observed is None else _finite(self.observed),
            "inside": self.inside,
            "direction": self.direction,
            "change": self.change,
        }


class RunComparison(NamedTuple):
    """All measures, and how unusual they are in combination.

    :ivar unusual: the share of runs following the plan in which some measure lies at least as far
        out as the farthest one here, in standard deviations.
    :ivar farthest: the name of that measure.
    """

    measures: List[PredictedMeasure]
    unusual: float
    farthest: str

    @property
    def departs(self) -> bool:
        """Whether the run departs from the prediction."""
        return self.unusual < DEPARTS


def compare(plan: Plan, sample: RunSample, observed: Observed) -> RunComparison:
    """Compare the observed measures with a sample of predicted runs."""
    measures: List[PredictedMeasure] = []
    deviations: List[Floats] = []
    actual: List[float] = []
    blur = CLOCK_RESOLUTION * sum(observed.firings.values()) / observed.seconds
    for kind, of, unit, values, value in _values(plan, sample, observed):
        slack = blur if kind in (TOKENS, SUBNET_ROBOTS) else 0.0
        measure = _measure(kind, of, unit, values, value)
        margin = SIMULTANEOUS * abs(measure.predicted) if math.isfinite(measure.predicted) else 0.0
        measures.append(
            measure._replace(
                low=max(measure.low - margin, 0.0), high=measure.high + margin, slack=slack
            )
        )
        known = values[np.isfinite(values)]
        if value is None or len(known) < len(values):
            continue
        spread = float(values.std())
        middle = float(values.mean())
        distance = max(abs(value - middle) - slack - margin, 0.0)
        if spread <= 1e-12 * max(abs(middle), 1e-300):
            off = distance > 1e-6 * max(abs(middle), abs(value), 1e-300)
            actual.append(math.inf if off else 0.0)
            deviations.append(np.zeros(len(values)))
        else:
            actual.append(distance / spread)
            deviations.append(np.abs(values - middle) / spread)
    if not actual:
        return RunComparison(measures, 1.0, "")
    names = [m.name for m in measures if m.observed is not None and math.isfinite(m.predicted)]
    largest = np.max(np.array(deviations), axis=0)
    worst = int(np.argmax(actual))
    above = float((largest >= actual[worst] * (1 - 1e-12)).sum())
    return RunComparison(
        measures,
        (1 + above) / (1 + sample.size) if actual[worst] > 0 else 1.0,
        names[worst] if worst < len(names) else "",
    )


def _values(
    plan: Plan, sample: RunSample, observed: Observed
) -> Iterator[Tuple[str, str, str, Floats, Optional[float]]]:
    """(kind, name, unit, values of the replications, observed value) of each measure."""
    net = plan.net
    seconds = np.maximum(sample.seconds, 1e-300)
    for t, transition in enumerate(net.transitions):
        fired = observed.firings.get(transition.name, 0) / observed.seconds
        yield THROUGHPUT, transition.name, "1/s", sample.firings[:, t] / seconds, fired
    for p, place in enumerate(net.places):
        held = observed.tokens.get(place.name, 0.0) / observed.seconds
        yield TOKENS, place.name, "", sample.tokens[:, p] / seconds, held
    arrivals = np.zeros((len(net.transitions), len(net.places)))
    for t, outputs in enumerate(net.outputs):
        for p, weight in outputs:
            arrivals[t, p] += weight
    counts = np.array([observed.firings.get(t.name, 0) for t in net.transitions], dtype=np.float64)
    for name in plan.action_places:
        p = net.place_index[name]
        into = arrivals[:, p]
        if into.any():
            yield VISITS, name, "", sample.firings @ into, float(counts @ into)
    yield from _subnet_values(plan, sample, observed)
    if plan.until is not None:
        times = np.where(sample.came, sample.seconds, math.inf)
        yield TIME, plan.until, "s", times, observed.seconds if observed.came else None


def _subnet_values(
    plan: Plan, sample: RunSample, observed: Observed
) -> Iterator[Tuple[str, str, str, Floats, Optional[float]]]:
    net = plan.net
    predicted = subnet_counts(plan, net, sample.firings, sample.tokens)
    actual = subnet_counts(
        plan,
        net,
        np.array([[observed.firings.get(t.name, 0) for t in net.transitions]], dtype=np.float64),
        np.array([[observed.tokens.get(p.name, 0.0) for p in net.places]]),
    )
    seconds = np.maximum(sample.seconds, 1e-300)
    for name, counts in predicted.items():
        inside, entries, exits = (float(values[0]) for values in actual[name])
        yield SUBNET_ROBOTS, name, "", counts.inside / seconds, inside / observed.seconds
        yield SUBNET_ENTRIES, name, "1/s", counts.entries / seconds, entries / observed.seconds
        yield SUBNET_EXITS, name, "1/s", counts.exits / seconds, exits / observed.seconds
        if entries and counts.entries.all():  # otherwise, some visit has no length to compare
            yield SUBNET_STAY, name, "s", counts.inside / counts.entries, inside / entries


def _measure(
    kind: str, of: str, unit: str, values: Floats, observed: Optional[float]
) -> PredictedMeasure:
    known = values[np.isfinite(values)]
    if len(known) < len(values):  # some never reached the condition
        ordered = np.sort(values)
        low, high = (
            float(ordered[min(int(q * len(ordered)), len(ordered) - 1)])
            for q in ((1 - LEVEL) / 2, (1 + LEVEL) / 2)
        )
        mean = float(known.mean()) if len(known) else math.inf
        return PredictedMeasure(kind, of, unit, mean, low, high, observed)
    low, high = interval(values)
    return PredictedMeasure(kind, of, unit, float(values.mean()), low, high, observed)


def interval(values: Floats, level: float = LEVEL) -> Tuple[float, float]:
    """The prediction interval for one more value like these."""
    if len(values) >= ENOUGH_RUNS:
        low, high = np.percentile(values, [50 * (1 - level), 50 * (1 + level)])
        return float(low), float(high)
    if len(values) < 2:
        return 0.0, math.inf
    mean, spread = float(values.mean()), float(values.std(ddof=1))
    half = quantiles.student(0.5 + level / 2, len(values) - 1) * spread
    half *= math.sqrt(1 + 1 / len(values))
    return max(mean - half, 0.0), mean + half


def _finite(value: float) -> Optional[float]:
    return value if math.isfinite(value) else None

"""What a simulation estimates, with confidence intervals."""

from __future__ import annotations

import math
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence

import numpy as np

from gspn_framework_package.analysis import quantiles
from gspn_framework_package.analysis.arrays import Booleans, Floats
from gspn_framework_package.analysis.plan.subnets import subnet_counts
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan


class Estimate(NamedTuple):
    """A mean over the replications, with the half width of its confidence interval (infinite for
    one replication).

    If no replication showed it, the mean is 0 and the half width is the upper confidence bound
    ("rule of three"), or infinite if there is none.
    """

    mean: float
    half_width: float

    @property
    def seen(self) -> bool:
        """Whether it occurred at all; if not, ``half_width`` is an upper bound."""
        return self.mean != 0 or self.half_width == 0

    def __str__(self) -> str:
        if math.isnan(self.mean):
            return "not known"
        if not self.seen:
            bound = ", below %.2g" % self.half_width if math.isfinite(self.half_width) else ""
            return "not seen" + bound
        if self.half_width == 0:
            return "%.6g in every run" % self.mean
        return "%.6g ± %.2g" % (self.mean, self.half_width)


class Samples(NamedTuple):
    """The values of each replication (or batch), as arrays with a row for each.

    :ivar clock: when it ended (s).
    :ivar seconds: how long it was observed, without the warm-up (s).
    :ivar firings: number of firings after the warm-up, by transition in net order.
    :ivar tokens: tokens times seconds after the warm-up, by place in net order.
    :ivar over: whether it reached the condition.
    """

    clock: Floats
    seconds: Floats
    firings: Floats
    tokens: Floats
    over: Booleans


class Simulation(NamedTuple):
    """The results of the replications.

    :ivar mean_tokens: place -> time-averaged number of tokens.
    :ivar throughput: transition -> firings per second.
    :ivar token_distribution: place -> number of tokens -> share of time; empty for a place with
      thousands of tokens.
    :ivar end_time: when a replication ended (s): at the condition, at its end, or at ``time``.
    :ivar reached: share of the replications that reached the condition; None without one.
    :ivar time_to_condition: when (s) those replications reached it; None without a condition, or if
      none did.
    :ivar events: total number of firings.
    :ivar timing: the interpretation of time: ``run`` or ``net``.
    :ivar subnets: of a plan with subnets: measure (a key of ``analysis.plan.subnets.TITLES``)
      -> subnet -> estimate; the time per visit of a subnet that no robot entered is NaN.
    :ivar batches: number of batches of one long run; None for replications.
    :ivar precision: the requested relative precision, and the one reached; None if none was
        requested.
    :ivar notes: remarks on the results.
    :ivar samples: the values of each replication, if requested; not in the JSON.
    """

    time: float
    warmup: float
    replications: int
    seed: int
    confidence: float
    mean_tokens: Dict[str, Estimate]
    throughput: Dict[str, Estimate]
    token_distribution: Dict[str, Dict[int, float]]
    end_time: Estimate
    reached: Optional[Estimate]
    time_to_condition: Optional[Estimate]
    events: int
    timing: str = "net"
    subnets: Mapping[str, Dict[str, Estimate]] = {}
    batches: Optional[int] = None
    precision: Optional[Dict[str, Any]] = None
    notes: Sequence[str] = ()
    samples: Optional[Samples] = None

    def to_json(self) -> Dict[str, Any]:
        """Everything but the samples, as plain JSON values."""
        data = dict(self._asdict())
        del data["samples"], data["subnets"]
        for key in ("end_time", "reached", "time_to_condition"):
            data[key] = None if data[key] is None else _estimate_json(data[key])
        for key in ("mean_tokens", "throughput"):
            data[key] = {name: _estimate_json(value) for name, value in data[key].items()}
        for key, values in self.subnets.items():
            data[key] = {name: _estimate_json(value) for name, value in values.items()}
        data["token_distribution"] = {
            place: {str(n): share for n, share in counts.items()}
            for place, counts in self.token_distribution.items()
        }
        data["time"] = self.time if math.isfinite(self.time) else None
        data["notes"] = list(self.notes)
        return data


def mean(samples: Floats, confidence: float) -> Estimate:
    """The mean of independent samples."""
    count = len(samples)
    value = float(samples.mean())
    if count < 2:
        return Estimate(value, math.inf)
    quantile = quantiles.student(0.5 + confidence / 2, count - 1)
    return Estimate(value, quantile * float(samples.std(ddof=1)) / math.sqrt(count))


def share(samples: Booleans, confidence: float) -> Estimate:
    """The proportion of independent samples that are true. If none or all are, the half width is
    the bound on the proportion of the others."""
    count, true = len(samples), int(samples.sum())
    if true in (0, count):
        return Estimate(true / count, 1.0 - (1.0 - confidence) ** (1.0 / count))
    return mean(samples.astype(np.float64), confidence)


def ratio(amounts: Floats, seconds: Floats, confidence: float) -> Estimate:
    """Amount per second, by the ratio estimator, since runs that end at a condition differ in
    length."""
    whole = float(seconds.sum())
    if whole <= 0:
        return Estimate(math.nan, math.inf)
    value = float(amounts.sum()) / whole
    spread = mean(amounts - value * seconds, confidence).half_width
    return Estimate(value, spread * len(seconds) / whole)


def throughput(firings: Floats, seconds: Floats, confidence: float) -> Estimate:
    """Firings per second; if there were none, with an upper bound."""
    whole = float(seconds.sum())
    if whole > 0 and not firings.any():
        return Estimate(0.0, -math.log(1.0 - confidence) / whole if confidence < 1 else math.inf)
    return ratio(firings, seconds, confidence)


def mean_tokens(net: Net, samples: Samples, confidence: float) -> Dict[str, Estimate]:
    """Place -> time-averaged number of tokens. A place that no token entered counts as not seen;
    one that tokens only passed through has 0."""
    fired = samples.firings.sum(axis=0)
    found = {}
    for p, place in enumerate(net.places):
        estimate = ratio(samples.tokens[:, p], samples.seconds, confidence)
        if estimate.mean == 0 and not any(fired[t] for t in net.producers[p]):
            estimate = Estimate(0.0, math.inf)
        found[place.name] = estimate
    return found


def of_subnets(
    plan: Plan, net: Net, samples: Samples, confidence: float
) -> Dict[str, Dict[str, Estimate]]:
    """Measure -> subnet -> estimate; empty for a plan without subnets."""
    counts = subnet_counts(plan, net, samples.firings, samples.tokens)
    if not counts:
        return {}
    seconds = samples.seconds
    return {
        "subnet_robots": {n: ratio(c.inside, seconds, confidence) for n, c in counts.items()},
        "subnet_entries": {
            n: throughput(c.entries, seconds, confidence) for n, c in counts.items()
        },
        "subnet_exits": {n: throughput(c.exits, seconds, confidence) for n, c in counts.items()},
        "subnet_time": {n: ratio(c.inside, c.entries, confidence) for n, c in counts.items()},
    }


def summary(
    net: Net,
    samples: Samples,
    shares: Sequence[Dict[int, float]],
    conditional: bool,
    *,
    plan: Optional[Plan] = None,
    events: int,
    **settings: Any,
) -> Simulation:
    """The estimates of these samples.

    :param shares: for each place, number of tokens -> seconds.
    :param conditional: whether there is a condition to reach.
    :param plan: the plan that was simulated, if any.
    :param settings: the other fields of the result.
    """
    confidence = settings["confidence"]
    whole = float(samples.seconds.sum())
    came = samples.clock[samples.over]
    return Simulation(
        mean_tokens=mean_tokens(net, samples, confidence),
        throughput={
            t.name: throughput(samples.firings[:, i], samples.seconds, confidence)
            for i, t in enumerate(net.transitions)
        },
        token_distribution={
            p.name: {n: s / whole for n, s in sorted(shares[i].items())} if whole > 0 else {}
            for i, p in enumerate(net.places)
        },
        end_time=mean(samples.clock, confidence),
        reached=share(samples.over, confidence) if conditional else None,
        time_to_condition=mean(came, confidence) if conditional and len(came) else None,
        events=events,
        subnets=of_subnets(plan, net, samples, confidence) if plan is not None else {},
        **settings,
    )


def relative(estimates: List[Estimate]) -> float:
    """The largest half width relative to its mean."""
    return max(
        (e.half_width / abs(e.mean) if e.mean else math.inf for e in estimates), default=math.inf
    )


def _estimate_json(estimate: Estimate) -> Dict[str, Any]:
    data: Dict[str, Any] = {
        key: value if math.isfinite(value) else None for key, value in estimate._asdict().items()
    }
    if not estimate.seen:
        data["seen"] = False
    return data

"""The comparison of two plans, in numbers and in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, List, Optional

from gspn_framework_package.analysis.decisions.aims import Objective
from gspn_framework_package.analysis.simulation.paired_estimates import Measured


@dataclass
class Against:
    """Two plans, simulated as they run.

    :ivar objective: the aim of the comparison.
    :ivar old: the value of the old plan; ``new``: that of the new one.
    :ivar difference: new minus old.
    :ivar significant: whether the interval of the difference excludes 0.
    :ivar better: whether the new plan is better; None unless the difference is significant.
    :ivar text: the result in words.
    :ivar pairs: number of pairs of runs.
    :ivar correlation: the correlation of the runs of a pair; None if nothing varies.
    :ivar seconds: length of a run (s); None if it ends by itself.
    :ivar warmup: time (s) at the start of a run that is excluded.
    :ivar needed: pairs of runs, and seconds of computing, to detect a difference of the given
        ``size`` with the probability :data:`POWER`; None if it is significant.
    :ivar confidence: level of the intervals.
    :ivar seed: seed of the random numbers.
    :ivar firings: number of firings in all runs.
    :ivar notes: remarks on the results.
    """

    objective: Objective
    old: Measured
    new: Measured
    difference: Measured
    significant: bool
    text: str
    pairs: int
    better: Optional[bool] = None
    correlation: Optional[float] = None
    seconds: Optional[float] = None
    warmup: float = 0.0
    needed: Optional[Dict[str, float]] = None
    confidence: float = 0.95
    seed: int = 0
    firings: int = 0
    notes: List[str] = field(default_factory=list)

    def to_json(self) -> Dict[str, Any]:
        """As plain JSON values."""
        return {
            "old": self.old.to_json(),
            "new": self.new.to_json(),
            "difference": self.difference.to_json(),
            "significant": self.significant,
            "better": self.better,
            "text": self.text,
            "pairs": self.pairs,
            "correlation": self.correlation,
            "time": self.seconds,
            "warmup": self.warmup,
            "needed": self.needed,
            "confidence": self.confidence,
            "seed": self.seed,
            "firings": self.firings,
            "notes": list(self.notes),
        }


def sentence(found: Against) -> str:
    """The result of a comparison in words."""
    unit = " " + found.objective.unit if found.objective.unit else ""
    difference = found.difference
    runs = "%s pairs of runs" % format(found.pairs, ",")
    if difference.mean is None and found.old.why == found.new.why:
        return "not decided (%s): %s" % (runs, difference.why)
    if difference.mean is None:
        sides = [
            "the %s plan: %s" % (name, side)
            for name, side in (("old", found.old), ("new", found.new))
        ]
        return "not decided (%s): %s" % (runs, "; ".join(sides))
    level = "%g %%" % (100 * found.confidence)
    interval = "%+.4g%s (%s interval: %+.4g to %+.4g)" % (
        difference.mean,
        unit,
        level,
        difference.low or 0.0,
        difference.high or 0.0,
    )
    change = ""
    if found.old.mean:
        change = ", %+.3g %%" % (100 * difference.mean / abs(found.old.mean))
    values = "%.5g%s instead of %.5g%s" % (
        found.new.mean or 0.0,
        unit,
        found.old.mean or 0.0,
        unit,
    )
    if found.significant:
        word = "better" if found.better else "worse"
        return "the new plan is %s than the old one: %s, a difference of %s%s, in %s" % (
            word,
            values,
            interval,
            change,
            runs,
        )
    if difference.low == difference.high == 0:
        return "no difference at all: the two plans did the same (%.5g%s) in each of %s" % (
            found.new.mean or 0.0,
            unit,
            runs,
        )
    text = "the difference is not significant: %s, a difference of %s%s, in %s" % (
        values,
        interval,
        change,
        runs,
    )
    if found.needed is not None:
        text += "; detecting a difference of %.4g%s takes about %s pairs (%s)" % (
            found.needed["size"],
            unit,
            format(int(found.needed["pairs"]), ","),
            _duration(found.needed["seconds"]),
        )
    return text


def _duration(seconds: float) -> str:
    for size, name in ((86_400.0, "days"), (3_600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return "%.2g %s on this machine" % (seconds / size, name)
    return "%.2g s on this machine" % seconds

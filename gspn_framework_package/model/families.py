"""Durations in plan files, and the families that other packages add to those of ``duration``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

from gspn_framework_package.model.duration import (
    FAMILIES,
    KEYS,
    Duration,
    DurationPart,
    ErlangBranch,
    Family,
    Kind,
)
from gspn_framework_package.model.errors import PlanError

FOLLOWS = (Kind.UNIFORM, Kind.EMPIRICAL, Kind.HYPER_ERLANG)
"""Families whose mean follows from the other parameters, so that a plan file may omit it."""


_STEPS = 250
"""Steps of probability between the quantiles of a part that is given by them."""

_DECADES = 9
"""A distribution given by its quantiles has no values above its quantile of 1 - 1e-9."""


def parts_of_quantiles(quantile: Callable[[Any], Any]) -> List[DurationPart]:
    """The parts of a distribution that is not a mixture: nine tenths of all times, nine tenths of
    the longer ones, and so on, each by 251 of its quantiles. So a probability is off by at most 0.4
    % of that of its part, and for a smooth density by far less.

    :param quantile: the time (s) that is not exceeded with each of an array of probabilities from 0
        to 1 - 1e-9.
    :raises PlanError: the quantiles are no times, or do not increase.
    """
    import numpy as np

    longer = 0.1 ** np.arange(_DECADES + 1)
    chances = longer[:-1] - longer[1:]
    return [
        DurationPart(
            chance / (1.0 - longer[-1]),
            0.0,
            Duration.empirical(quantile(1.0 - np.linspace(more, less, _STEPS + 1))),
        )
        for chance, more, less in zip(chances.tolist(), longer, longer[1:])
    ]


def duration_from_json(data: Mapping[str, Any]) -> Duration:
    """The distribution in an object of a plan file that fits the schema.

    :raises PlanError: a parameter is missing, does not belong to the family, or is out of range;
        the mean contradicts the other parameters.
    """
    name = data.get("distribution", Kind.EXPONENTIAL.value)
    family, kind = FAMILIES.get(name), None
    if family is not None:
        keys: Tuple[str, ...] = tuple(family.form)
    else:
        kind = Kind(name)
        keys = KEYS[kind] + (() if kind in FOLLOWS else ("mean",))
    missing = [key for key in keys if key not in data]
    known = {"mean", "distribution", "of", *keys}
    foreign = sorted(set(data) - known)
    if missing or foreign:
        raise PlanError(
            "'%s' is missing" % missing[0]
            if missing
            else "'%s' does not belong to this distribution" % foreign[0],
            hint="%s takes: %s" % (name, ", ".join(sorted(set(keys) | {"mean"}))),
        )
    if family is not None:
        found = compose(family, {key: data[key] for key in keys})
    elif kind is Kind.HYPER_ERLANG:
        branches = [(b["probability"], b["phases"], b["mean"]) for b in data["branches"]]
        found = Duration.hyper_erlang(branches)
    else:  # the other constructors take the keys in this order
        found = getattr(Duration, name)(*(data[key] for key in keys))
    mean = data.get("mean", found.mean)
    if abs(mean - found.mean) > 0.01 * found.mean:
        raise PlanError(
            "the mean is given as %g s, but the parameters imply %g s" % (mean, found.mean),
            hint="leave the mean out",
        )
    return found


def compose(family: Family, parameters: Mapping[str, float]) -> Duration:
    """A distribution of a family of mixtures.

    :param parameters: the value of each of its parameters.
    :raises PlanError: they are out of range, or the parts are not a distribution.
    """
    parts = tuple(family.parts(**parameters))
    if (
        abs(math.fsum(part.probability for part in parts) - 1.0) > 1e-6
        or any(part.probability <= 0 or not 0 <= part.shift < math.inf for part in parts)
        or any(isinstance(part.duration, _Composed) for part in parts)
    ):
        raise PlanError("the parts of the family '%s' are not a distribution" % family.value)
    mean = math.fsum(p * (shift + duration.mean) for p, shift, duration in parts)
    values = tuple(float(parameters[key]) for key in family.form)
    return _Composed(family, mean, values, parts)


@dataclass(frozen=True)
class _Composed(Duration):
    """A distribution of a :class:`Family`."""

    kind: Family
    parts: Tuple[DurationPart, ...] = ()

    @property
    def _named(self) -> Dict[str, float]:
        return dict(zip(self.kind.form, self.parameters))

    @property
    def variance(self) -> float:
        square = math.fsum(
            p * (duration.variance + (shift + duration.mean) ** 2)
            for p, shift, duration in self.parts
        )
        return max(square - self.mean**2, 0.0)

    @property
    def branches(self) -> Optional[Tuple[ErlangBranch, ...]]:
        found: List[ErlangBranch] = []
        for probability, shift, duration in self.parts:
            if shift or duration.branches is None:
                return None
            found += [
                b._replace(probability=probability * b.probability) for b in duration.branches
            ]
        return tuple(found)

    @property
    def _corners(self) -> Tuple[float, ...]:
        return tuple(
            shift + corner
            for _, shift, duration in self.parts
            for corner in (0.0, *duration._corners)
        )

    def scaled(self, factor: float) -> Duration:
        times = self.kind.times
        found = compose(
            self.kind, {key: v * factor if key in times else v for key, v in self._named.items()}
        )
        if abs(found.mean - factor * self.mean) > 1e-6 * found.mean:
            raise PlanError(
                "the family '%s' cannot be scaled" % self.kind.value,
                hint="its parts must not have times other than its parameters in seconds",
            )
        return found

    def sample(self, generator: Any, size: Optional[int] = None) -> Any:
        import numpy as np

        chances = np.array([part.probability for part in self.parts])
        count = 1 if size is None else size
        chosen = generator.choice(len(chances), count, p=chances / chances.sum())
        drawn = np.empty(count)
        for number, (_, shift, duration) in enumerate(self.parts):
            here = chosen == number
            drawn[here] = shift + duration.sample(generator, int(here.sum()))
        return float(drawn[0]) if size is None else drawn

    def _of_parts(self, x: Any, function: Callable[[Duration, Any], Any], before: float) -> Any:
        """A function of the time since each part's shift, and its value before that; a row for
        each part."""
        import numpy as np

        return np.array(
            [
                np.where(x < shift, before, function(duration, np.maximum(x - shift, 0.0)))
                for _, shift, duration in self.parts
            ]
        )

    def _log_sum(self, logarithms: Any) -> Any:
        """The logarithm of a sum over the parts."""
        import numpy as np
        from scipy import special

        chances = np.array([part.probability for part in self.parts])
        return special.logsumexp(logarithms.T, axis=1, b=chances)

    def _cdf(self, x: Any) -> Any:
        import numpy as np

        return -np.expm1(-self._hazard_integral(x))

    def _survival(self, x: Any) -> Any:
        import numpy as np

        return np.exp(-self._hazard_integral(x))

    def _hazard_integral(self, x: Any) -> Any:
        return -self._log_sum(-self._of_parts(x, Duration.hazard_integral, 0.0))

    def _log_density(self, x: Any) -> Any:
        import numpy as np

        return self._log_sum(self._of_parts(x, Duration.log_density, -np.inf))

    def _quantile(self, p: Any) -> Any:
        return self._quantile_by_bisection(
            p, max(shift + duration.mean for _, shift, duration in self.parts)
        )

    def to_json(self) -> Dict[str, Any]:
        return {"mean": self.mean, "distribution": self.kind.value, **self._named}

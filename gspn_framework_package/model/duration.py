"""The distributions of action durations that a plan can assign to places.

A :class:`Duration` is immutable. Its times are in seconds and never negative. The functions of a
time accept a number or a numpy array, and return the same.

>>> wait = Duration.erlang(4, mean=2.0)
>>> round(wait.variance, 6), round(wait.cdf(2.0), 3), wait.describe()
(1.0, 0.567, 'Erlang, mean 2 s, 4 phases')
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

from gspn_framework_package.model.errors import PlanError

MAX_PHASES = 1_000_000
"""Maximum number of phases of an Erlang distribution, and of entries of a list."""

Times = Any
"""A time in seconds (>= 0), or a numpy array of such times."""


class Kind(enum.Enum):
    """The family of a distribution; the value is its name in a plan file."""

    EXPONENTIAL = "exponential"
    ERLANG = "erlang"
    GAMMA = "gamma"
    LOGNORMAL = "lognormal"
    DETERMINISTIC = "deterministic"
    UNIFORM = "uniform"
    EMPIRICAL = "empirical"
    HYPER_ERLANG = "hyper-erlang"


class ErlangBranch(NamedTuple):
    """A branch of a hyper-Erlang distribution: with ``probability``, ``phases`` exponential phases
    follow each other, each at ``rate`` (1/s)."""

    probability: float
    phases: int
    rate: float


class DurationPart(NamedTuple):
    """A part of a distribution: with ``probability``, the time is ``shift`` (s, >= 0) and then
    ``duration``, which has no parts itself."""

    probability: float
    shift: float
    duration: Duration


@dataclass(frozen=True, eq=False)
class Family:
    """A family of mixtures of other distributions: a part is drawn, then a time from it. The
    package computes everything else from the parts. A family that is not a mixture gives its
    quantiles to :func:`~gspn_framework_package.model.families.parts_of_quantiles`.

    :ivar value: its name in a plan file.
    :ivar form: its parameters in a plan file: name -> JSON Schema of the number, with its
        ``default`` on the page. Each is in seconds or has no unit.
    :ivar times: those in seconds.
    :ivar parts: makes the parts from the parameters, by name. It may raise a :class:`PlanError`.
        A function of a module, so that other processes can be given it.
    :ivar estimate: for ``gspn fit``, makes the parameters from a
        :class:`~gspn_framework_package.analysis.fitting.sample.Sample` with two or more observed
        times.
    """

    value: str
    form: Mapping[str, Mapping[str, Any]]
    times: Tuple[str, ...]
    parts: Callable[..., Sequence[DurationPart]]
    estimate: Optional[Callable[[Any], Mapping[str, float]]] = None


FAMILIES: Dict[str, Family] = {}
"""The families that other packages have added, by name."""


class Evidence(NamedTuple):
    """The origin of a learned value of a plan: the number of ``observations``, the names of the
    ``logs``, and the 95 % confidence ``interval`` of the value (for a duration: of its mean, in
    seconds); None if there is none."""

    observations: int
    logs: Tuple[str, ...] = ()
    interval: Optional[Tuple[float, float]] = None

    def scaled(self, factor: float) -> Evidence:
        """That of the value times ``factor`` (> 0)."""
        if self.interval is None:
            return self
        return self._replace(interval=(self.interval[0] * factor, self.interval[1] * factor))


@dataclass(frozen=True)
class Duration:
    """The distribution of a time. Create one with the class methods, which check the parameters.

    :ivar kind: the family.
    :ivar mean: the mean (s).
    :ivar parameters: the parameters of the family other than the mean: Erlang ``(phases,)``, gamma
        ``(shape,)``, lognormal ``(sigma,)`` (the standard deviation of the logarithm), uniform
        ``(low, high)`` (s), empirical: quantiles (s) at equal steps of probability from 0 to 1,
        between which it is uniform; hyper-Erlang: probability, phases and mean (s) of each branch
        in turn.
    """

    kind: Union[Kind, Family]
    mean: float
    parameters: Tuple[float, ...] = ()

    # -- creating ----------------------------------------------------------------------------------

    @classmethod
    def none(cls) -> Duration:
        """No time."""
        return cls(Kind.DETERMINISTIC, 0.0)

    @classmethod
    def exponential(cls, mean: float) -> Duration:
        """An exponential distribution. :raises PlanError: the mean is not a positive number."""
        return cls(Kind.EXPONENTIAL, _positive(mean, "mean"))

    @classmethod
    def erlang(cls, phases: int, mean: float) -> Duration:
        """The sum of ``phases`` exponential times. :raises PlanError: a number is out of range."""
        return cls(Kind.ERLANG, _positive(mean, "mean"), (_phases(phases),))

    @classmethod
    def gamma(cls, shape: float, mean: float) -> Duration:
        """A gamma distribution. :raises PlanError: a number is not positive."""
        return cls(Kind.GAMMA, _positive(mean, "mean"), (_positive(shape, "shape"),))

    @classmethod
    def lognormal(cls, sigma: float, mean: float) -> Duration:
        """A lognormal distribution. :raises PlanError: a number is not positive, or ``sigma``
        exceeds 10."""
        if sigma > 10.0:
            raise PlanError("a sigma of %g is too large" % sigma, hint="at most 10")
        return cls(Kind.LOGNORMAL, _positive(mean, "mean"), (_positive(sigma, "sigma"),))

    @classmethod
    def deterministic(cls, mean: float) -> Duration:
        """Always the same time. :raises PlanError: it is not a number of at least 0."""
        return cls(Kind.DETERMINISTIC, _at_least_0(mean, "mean"))

    @classmethod
    def uniform(cls, low: float, high: float) -> Duration:
        """A uniform distribution. :raises PlanError: not 0 <= low < high."""
        if not _at_least_0(low, "low") < _positive(high, "high"):
            raise PlanError("low (%g) is not below high (%g)" % (low, high))
        return cls(Kind.UNIFORM, low + (high - low) / 2, (float(low), float(high)))

    @classmethod
    def empirical(cls, quantiles: Sequence[float]) -> Duration:
        """A distribution given by its quantiles at equal steps of probability from 0 to 1.

        :raises PlanError: there are fewer than two, they decrease, or all are equal.
        """
        if not 2 <= len(quantiles) <= MAX_PHASES:
            raise PlanError("%d quantiles are not enough for a distribution" % len(quantiles))
        values = tuple(float(_at_least_0(q, "quantile")) for q in quantiles)
        if any(a > b for a, b in zip(values, values[1:])) or values[0] == values[-1]:
            raise PlanError(
                "the quantiles do not increase",
                hint="list them from the shortest time to the longest",
            )
        mean = math.fsum((a + b) / 2 for a, b in zip(values, values[1:])) / (len(values) - 1)
        return cls(Kind.EMPIRICAL, mean, values)

    @classmethod
    def hyper_erlang(cls, branches: Sequence[Tuple[float, int, float]]) -> Duration:
        """A mixture of Erlang distributions.

        :param branches: (probability, phases, mean in seconds) of each.
        :raises PlanError: there is none, a number is out of range, or the probabilities do not sum
            to 1.
        """
        if not 1 <= len(branches) <= MAX_PHASES:
            raise PlanError("%d branches are not a distribution" % len(branches))
        total = math.fsum(_positive(p, "probability") for p, _, _ in branches)
        if abs(total - 1.0) > 1e-6:
            raise PlanError("the probabilities of the branches sum to %g, not to 1" % total)
        flat: List[float] = []
        for probability, phases, mean in branches:
            flat += [probability / total, _phases(phases), _positive(mean, "mean")]
        mean = math.fsum(flat[i] * flat[i + 2] for i in range(0, len(flat), 3))
        return cls(Kind.HYPER_ERLANG, mean, tuple(flat))

    @classmethod
    def with_moments(cls, mean: float, variance: float) -> Duration:
        """A gamma distribution of this mean (s) and variance (s^2); deterministic without
        variance."""
        if variance <= 1e-12 * mean**2:
            return cls.deterministic(mean)
        return cls.gamma(mean**2 / variance, mean)

    # -- moments -----------------------------------------------------------------------------------

    @property
    def variance(self) -> float:
        """The variance (s^2)."""
        if self.kind is Kind.EXPONENTIAL:
            return self.mean**2
        if self.kind in (Kind.ERLANG, Kind.GAMMA):
            return self.mean**2 / self.parameters[0]
        if self.kind is Kind.LOGNORMAL:
            return self.mean**2 * math.expm1(self.parameters[0] ** 2)
        if self.kind is Kind.UNIFORM:
            low, high = self.parameters
            return (high - low) ** 2 / 12
        if self.kind is Kind.EMPIRICAL:
            steps = list(zip(self.parameters, self.parameters[1:]))
            square = math.fsum((a * a + a * b + b * b) / 3 for a, b in steps) / len(steps)
            return max(square - self.mean**2, 0.0)
        if self.kind is Kind.HYPER_ERLANG:
            square = math.fsum(p * m * m * (1 + 1 / k) for p, k, m in self._mixture())
            return max(square - self.mean**2, 0.0)
        return 0.0

    @property
    def variation(self) -> float:
        """The coefficient of variation: the standard deviation divided by the mean."""
        return math.sqrt(self.variance) / self.mean if self.mean > 0 else 0.0

    @property
    def branches(self) -> Optional[Tuple[ErlangBranch, ...]]:
        """The exponential phases that it consists of; None if it does not consist of phases."""
        if self.kind is Kind.EXPONENTIAL:
            return (ErlangBranch(1.0, 1, 1 / self.mean),)
        if self.kind is Kind.ERLANG:
            phases = int(self.parameters[0])
            return (ErlangBranch(1.0, phases, phases / self.mean),)
        if self.kind is Kind.HYPER_ERLANG:
            return tuple(ErlangBranch(p, int(k), k / m) for p, k, m in self._mixture())
        return None

    @property
    def parts(self) -> Tuple[DurationPart, ...]:
        """The durations of which it is a mixture; itself, if it is not one."""
        if self.kind is Kind.HYPER_ERLANG:
            return tuple(
                DurationPart(p, 0.0, Duration.erlang(int(k), m)) for p, k, m in self._mixture()
            )
        return (DurationPart(1.0, 0.0, self),)

    @property
    def _corners(self) -> Tuple[float, ...]:
        """Where the survival is not smooth (s)."""
        rough = self.kind in (Kind.EMPIRICAL, Kind.UNIFORM, Kind.DETERMINISTIC)
        return (*self.parameters, self.mean) if rough else ()

    def _mixture(self) -> List[Tuple[float, float, float]]:
        p = self.parameters
        return [(p[i], p[i + 1], p[i + 2]) for i in range(0, len(p), 3)]

    def cut_off(self, limit: float) -> Duration:
        """A distribution with the mean and the variance of the time, or ``limit`` (s, > 0) where
        that is less."""
        import numpy as np

        # E min(T, l)^n is the integral of n x^(n-1) S(x) from 0 to l
        ends = np.linspace(0.0, limit, 65)
        ends = np.union1d(ends, [x for x in self._corners if 0 < x < limit])
        nodes, weights = np.polynomial.legendre.leggauss(16)  # type: ignore[no-untyped-call]
        half = np.diff(ends)[:, None] / 2
        x = ends[:-1, None] + half * (nodes + 1)
        survival = self.survival(x.ravel()).reshape(x.shape) * half * weights
        mean = float(survival.sum())
        return Duration.with_moments(mean, float((2 * x * survival).sum()) - mean**2)

    def delayed(self, delay: float) -> Duration:
        """A distribution with the mean and the variance of the time and ``delay`` (s, > 0) after
        each other."""
        return Duration.with_moments(self.mean + delay, self.variance)

    def scaled(self, factor: float) -> Duration:
        """The distribution of the time multiplied by ``factor`` (> 0)."""
        parameters = self.parameters
        if self.kind in (Kind.UNIFORM, Kind.EMPIRICAL):
            parameters = tuple(value * factor for value in parameters)
        elif self.kind is Kind.HYPER_ERLANG:
            parameters = tuple(
                value * factor if i % 3 == 2 else value for i, value in enumerate(parameters)
            )
        return Duration(self.kind, self.mean * factor, parameters)

    # -- functions of a time -----------------------------------------------------------------------

    def cdf(self, x: Times) -> Any:
        """The probability of a time of at most ``x``."""
        return self._of(x, self._cdf)

    def survival(self, x: Times) -> Any:
        """The probability of a time above ``x``."""
        return self._of(x, self._survival)

    def log_density(self, x: Times) -> Any:
        """The logarithm of the density (1/s) at ``x``; -inf outside its support. A deterministic
        time has no density: infinity at its value."""
        return self._of(x, self._log_density)

    def hazard_integral(self, x: Times) -> Any:
        """The integral of the hazard from 0 to ``x``, which is -log of the survival; infinite where
        the survival is 0."""
        return self._of(x, lambda y: abs(self._hazard_integral(y)))  # abs: no -0.0

    def quantile(self, p: Times) -> Any:
        """The time that is not exceeded with probability ``p`` in [0, 1]."""
        return self._of(p, self._quantile)

    def sample(self, generator: Any, size: Optional[int] = None) -> Any:
        """Draw a time, or an array of ``size`` times.

        :param generator: a ``numpy.random.Generator``.
        """
        import numpy as np

        count = 1 if size is None else size
        if self.kind is Kind.EXPONENTIAL:
            drawn = generator.exponential(self.mean, count)
        elif self.kind in (Kind.ERLANG, Kind.GAMMA):
            shape = self.parameters[0]
            drawn = generator.gamma(shape, self.mean / shape, count)
        elif self.kind is Kind.LOGNORMAL:
            drawn = generator.lognormal(self._mu, self.parameters[0], count)
        elif self.kind is Kind.UNIFORM:
            drawn = generator.uniform(*self.parameters, count)
        elif self.kind is Kind.EMPIRICAL:
            drawn = self._quantile(generator.random(count))
        elif self.kind is Kind.HYPER_ERLANG:
            mixture = np.array(self._mixture())
            chosen = mixture[generator.choice(len(mixture), count, p=mixture[:, 0])]
            drawn = generator.gamma(chosen[:, 1], chosen[:, 2] / chosen[:, 1])
        else:
            drawn = np.full(count, self.mean)
        return float(drawn[0]) if size is None else drawn

    @property
    def _mu(self) -> float:
        return math.log(self.mean) - self.parameters[0] ** 2 / 2

    def _of(self, x: Times, function: Any) -> Any:
        import numpy as np

        with np.errstate(divide="ignore", invalid="ignore"):
            values = function(np.atleast_1d(np.asarray(x, dtype=np.float64)))
        return float(values[0]) if np.ndim(x) == 0 else values

    def _cdf(self, x: Any) -> Any:
        import numpy as np
        from scipy import special

        if self.kind is Kind.EXPONENTIAL:
            return -np.expm1(-x / self.mean)
        if self.kind in (Kind.ERLANG, Kind.GAMMA):
            shape = self.parameters[0]
            return special.gammainc(shape, x * shape / self.mean)
        if self.kind is Kind.LOGNORMAL:
            return special.ndtr((np.log(x) - self._mu) / self.parameters[0])
        if self.kind is Kind.UNIFORM:
            low, high = self.parameters
            return np.clip((x - low) / (high - low), 0.0, 1.0)
        if self.kind is Kind.EMPIRICAL:
            # where quantiles are equal, interp takes the last one: right-continuous, as it must be
            levels = np.linspace(0.0, 1.0, len(self.parameters))
            return np.interp(x, np.array(self.parameters), levels, left=0.0, right=1.0)
        if self.kind is Kind.HYPER_ERLANG:
            return sum(p * special.gammainc(k, x * k / m) for p, k, m in self._mixture())
        return (x >= self.mean).astype(np.float64)

    def _survival(self, x: Any) -> Any:
        import numpy as np
        from scipy import special

        if self.kind is Kind.EXPONENTIAL:
            return np.exp(-x / self.mean)
        if self.kind in (Kind.ERLANG, Kind.GAMMA):
            shape = self.parameters[0]
            return special.gammaincc(shape, x * shape / self.mean)
        if self.kind is Kind.LOGNORMAL:
            return special.ndtr(-(np.log(x) - self._mu) / self.parameters[0])
        if self.kind is Kind.HYPER_ERLANG:
            return sum(p * special.gammaincc(k, x * k / m) for p, k, m in self._mixture())
        return 1.0 - self._cdf(x)

    def _hazard_integral(self, x: Any) -> Any:
        import numpy as np
        from scipy import special

        if self.kind is Kind.EXPONENTIAL:
            return x / self.mean
        if self.kind is Kind.LOGNORMAL:
            return -special.log_ndtr(-(np.log(x) - self._mu) / self.parameters[0])
        if self.kind in (Kind.ERLANG, Kind.GAMMA):
            shape = self.parameters[0]
            return -_log_gamma_survival(shape, x * shape / self.mean)
        if self.kind is Kind.HYPER_ERLANG:
            parts = [math.log(p) + _log_gamma_survival(k, x * k / m) for p, k, m in self._mixture()]
            return -special.logsumexp(np.array(parts), axis=0)
        return -np.log(self._survival(x))

    def _log_density(self, x: Any) -> Any:
        import numpy as np
        from scipy import special

        if self.kind is Kind.EXPONENTIAL:
            return -x / self.mean - math.log(self.mean)
        if self.kind in (Kind.ERLANG, Kind.GAMMA):
            return _log_gamma_density(self.parameters[0], self.mean, x)
        if self.kind is Kind.LOGNORMAL:
            sigma = self.parameters[0]
            z = (np.log(x) - self._mu) / sigma
            found = -(z**2) / 2 - np.log(x) - math.log(sigma * math.sqrt(2 * math.pi))
            return np.where(x > 0, found, -np.inf)
        if self.kind is Kind.UNIFORM:
            low, high = self.parameters
            return np.where((x >= low) & (x <= high), -math.log(high - low), -np.inf)
        if self.kind is Kind.EMPIRICAL:
            values = np.array(self.parameters)
            i = np.clip(np.searchsorted(values, x, side="right") - 1, 0, len(values) - 2)
            inside = (x >= values[0]) & (x <= values[-1])
            width = values[i + 1] - values[i]
            return np.where(inside, -np.log(width * (len(values) - 1)), -np.inf)
        if self.kind is Kind.HYPER_ERLANG:
            parts = [math.log(p) + _log_gamma_density(k, m, x) for p, k, m in self._mixture()]
            return special.logsumexp(np.array(parts), axis=0)
        return np.where(x == self.mean, np.inf, -np.inf)

    def _quantile(self, p: Any) -> Any:
        import numpy as np
        from scipy import special

        if self.kind is Kind.EXPONENTIAL:
            return -self.mean * np.log1p(-p)
        if self.kind in (Kind.ERLANG, Kind.GAMMA):
            shape = self.parameters[0]
            return special.gammaincinv(shape, p) * self.mean / shape
        if self.kind is Kind.LOGNORMAL:
            return np.exp(self._mu + self.parameters[0] * special.ndtri(p))
        if self.kind is Kind.UNIFORM:
            low, high = self.parameters
            return low + p * (high - low)
        if self.kind is Kind.EMPIRICAL:
            steps = len(self.parameters) - 1
            return np.interp(p * steps, np.arange(steps + 1), np.array(self.parameters))
        if self.kind is Kind.HYPER_ERLANG:
            return self._quantile_by_bisection(p, max(m for _, _, m in self._mixture()))
        return np.full_like(p, self.mean)

    def _quantile_by_bisection(self, p: Any, start: float) -> Any:
        import numpy as np

        low = np.zeros_like(p)
        high = np.full_like(p, start)
        while (self._cdf(high) < np.minimum(p, 1 - 1e-15)).any():
            high = np.where(self._cdf(high) < p, high * 2, high)
        for _ in range(60):
            middle = (low + high) / 2
            below = self._cdf(middle) < p
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return np.where(p >= 1, np.inf, np.where(p <= 0, 0.0, high))

    # -- formatting ----------------------------------------------------------------------

    def describe(self) -> str:
        """The distribution in a few words, for people."""
        mean = "mean %.4g s" % self.mean
        if self.kind is Kind.ERLANG:
            return "Erlang, %s, %d phases" % (mean, self.parameters[0])
        if self.kind is Kind.GAMMA:
            return "gamma, %s, shape %.4g" % (mean, self.parameters[0])
        if self.kind is Kind.LOGNORMAL:
            return "lognormal, %s, sigma %.4g" % (mean, self.parameters[0])
        if self.kind is Kind.UNIFORM:
            return "uniform, from %.4g s to %.4g s" % self.parameters
        if self.kind is Kind.EMPIRICAL:
            return "empirical, %s, %d quantiles" % (mean, len(self.parameters))
        if self.kind is Kind.HYPER_ERLANG:
            return "hyper-Erlang, %s, %d branches" % (mean, len(self._mixture()))
        if self.kind is Kind.DETERMINISTIC and self.mean == 0:
            return "no time"
        return "%s, %s" % (self.kind.value, mean)

    def to_json(self) -> Dict[str, Any]:
        """Convert to the form of a plan file."""
        data: Dict[str, Any] = {"mean": self.mean, "distribution": self.kind.value}
        if self.kind is Kind.HYPER_ERLANG:
            data["branches"] = [
                {"probability": p, "phases": int(k), "mean": m} for p, k, m in self._mixture()
            ]
        elif self.kind is Kind.EMPIRICAL:
            data["quantiles"] = list(self.parameters)
        else:
            for key, value in zip(KEYS[self.kind], self.parameters):
                data[key] = int(value) if key == "phases" else value
        return data


KEYS: Mapping[Any, Tuple[str, ...]] = {
    Kind.EXPONENTIAL: (),
    Kind.ERLANG: ("phases",),
    Kind.GAMMA: ("shape",),
    Kind.LOGNORMAL: ("sigma",),
    Kind.DETERMINISTIC: (),
    Kind.UNIFORM: ("low", "high"),
    Kind.EMPIRICAL: ("quantiles",),
    Kind.HYPER_ERLANG: ("branches",),
}
"""The parameters of each family in a plan file other than the mean."""


def _log_gamma_survival(shape: float, x: Any) -> Any:
    """The logarithm of the regularised upper incomplete gamma function, also where the function
    itself is too small for a float (first term of its asymptotic series, DLMF 8.11.2)."""
    import numpy as np
    from scipy import special

    plain = special.gammaincc(shape, x)
    far = (shape - 1) * np.log(x) - x - special.gammaln(shape) - np.log1p((1 - shape) / x)
    return np.where(plain > 1e-290, np.log(plain), far)


def _log_gamma_density(shape: float, mean: float, x: Any) -> Any:
    from scipy import special

    rate = shape / mean
    return (
        special.xlogy(shape, rate) + special.xlogy(shape - 1, x) - rate * x - special.gammaln(shape)
    )


def _positive(value: float, what: str) -> float:
    if not (math.isfinite(value) and value > 0):
        raise PlanError("%g is not a possible %s" % (value, what), hint="give a positive number")
    return float(value)


def _at_least_0(value: float, what: str) -> float:
    if not (math.isfinite(value) and value >= 0):
        raise PlanError("%g is not a possible %s" % (value, what), hint="give a number >= 0")
    return float(value)


def _phases(value: float) -> float:
    if value != int(value) or not 1 <= value <= MAX_PHASES:
        raise PlanError("%g phases are not possible" % value, hint="from 1 to %d" % MAX_PHASES)
    return float(int(value))

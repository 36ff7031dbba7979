"""Distributions of durations, estimated from partly censored times.

All estimators maximise the likelihood: an observed time contributes the density, a censored one the
survival (the probability of lasting longer). Leaving out the censored times would make every mean
too short, because long times are cut off more often than short ones.

- Exponential: the mean is the total time divided by the number of observed ends, with the interval
  of the chi-squared distribution.
- Gamma and lognormal: two parameters, and a profile interval of the mean: all means that are not
  much less likely than the best one, with the other parameter optimised for each of them.
- Erlang: the whole number of phases nearest to a gamma's shape, if the data do not contradict it.
- Hyper-Erlang, for a coefficient of variation above 1: expectation maximisation (Asmussen, Nerman
  and Olsson 1996; Olsson 1996 for censored times), for the special case of mixed Erlang branches.
- Deterministic, when the times hardly vary; empirical quantiles, when nothing else fits.
"""

from __future__ import annotations

import math
from typing import Any, Callable, List, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np
from scipy import optimize, special

from gspn_framework_package.analysis import quantiles
from gspn_framework_package.analysis.fitting.sample import SHORTEST_FITTED, Sample
from gspn_framework_package.model.duration import FAMILIES, Duration, Family, Kind
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.families import compose

CONFIDENCE = 0.95

NEGLIGIBLE = 1e-3
"""Times whose coefficient of variation is at most this count as deterministic."""

MOST_FITTED_PHASES = 12
"""Largest number of phases of an Erlang distribution. Beyond it, a gamma distribution is used,
because the exact analysis would need too many states."""

_FEWEST = 50
"""Smallest number of observations for a hyper-Erlang distribution."""

_QUANTILES = 101
"""Quantiles of an empirical distribution."""

_STEPS = 300
"""Largest number of steps of the expectation maximisation."""

_WIDEST = 20.0
"""Approximate logarithm of the largest factor from a mean to the end of its interval."""

_PREFERENCE = 2.0
"""A lognormal distribution is preferred to a gamma distribution if Schwarz's criterion is better by
this much: with few data both fit equally well, but only the former allows for times far longer than
any observed."""


class DurationFit(NamedTuple):
    """A fitted duration.

    :ivar interval: the 95 % confidence interval of the mean (s).
    :ivar likelihood: the logarithm of the likelihood; None for a deterministic or empirical one.
    """

    duration: Duration
    interval: Tuple[float, float]
    likelihood: Optional[float]
    parameters: int

    @property
    def shape(self) -> Optional[float]:
        """The shape of a gamma distribution, the phases of an Erlang one, 1 for an exponential one,
        the sigma of a lognormal one; None for others."""
        if self.duration.kind is Kind.EXPONENTIAL:
            return 1.0
        if self.duration.kind in (Kind.GAMMA, Kind.ERLANG, Kind.LOGNORMAL):
            return self.duration.parameters[0]
        return None


def likelihood(duration: Duration, sample: Sample) -> float:
    """The logarithm of the likelihood of a sample."""
    found = float(np.sum(duration.log_density(sample.observed)))
    if len(sample.censored):
        found -= float(np.sum(duration.hazard_integral(sample.censored)))
    return found


# -- families --------------------------------------------------------------------------------------


def fit_exponential(sample: Sample) -> DurationFit:
    """The exponential distribution: mean = total time / observed ends, and from the chi-squared
    distribution an interval that is exact if nothing was censored. It needs one observed time."""
    n, total = sample.size, sample.total
    mean = total / n
    tail = (1 - CONFIDENCE) / 2
    low = 2 * total / quantiles.chi_squared(tail, 2 * n + 2)
    high = 2 * total / quantiles.chi_squared(1 - tail, 2 * n)
    duration = Duration.exponential(mean)
    return DurationFit(duration, (low, high), likelihood(duration, sample), 1)


def fit_gamma(sample: Sample) -> DurationFit:
    """The gamma distribution. It needs two observed times."""
    found = _fit_two(sample, _Gamma(sample))
    return found._replace(interval=_profile_interval(sample, _Gamma(sample)))


def fit_lognormal(sample: Sample) -> DurationFit:
    """The lognormal distribution. It needs two observed times."""
    found = _fit_two(sample, _Lognormal(sample))
    return found._replace(interval=_profile_interval(sample, _Lognormal(sample)))


def fit_erlang(sample: Sample, gamma: DurationFit) -> Optional[DurationFit]:
    """The Erlang distribution with the phases nearest to a fitted gamma's shape; None if it has too
    many phases or the data contradict it. The interval is that of the gamma distribution, because
    the number of phases is not known in advance."""
    shape = gamma.duration.parameters[0]
    found = []
    for phases in {max(1, math.floor(shape)), math.ceil(shape)}:
        if phases > MOST_FITTED_PHASES:
            return None
        mean = _best_mean(sample, float(phases), gamma.duration.mean)
        duration = Duration.erlang(phases, mean)
        found.append(DurationFit(duration, gamma.interval, likelihood(duration, sample), 2))
    best = max(found, key=lambda fit: fit.likelihood or 0.0)
    assert best.likelihood is not None and gamma.likelihood is not None
    allowed = quantiles.chi_squared(1 - CONFIDENCE, 1) / 2
    return best if gamma.likelihood - best.likelihood <= allowed else None


def fit_deterministic(sample: Sample) -> Optional[DurationFit]:
    """A fixed time; None if the observed times vary or contradict the censored ones."""
    mean, spread = float(sample.observed.mean()), _spread(sample.observed)
    negligible = spread <= max(NEGLIGIBLE * mean, 2 * SHORTEST_FITTED)
    if not negligible or (sample.censored > mean + 4 * spread + 2 * SHORTEST_FITTED).any():
        return None
    return DurationFit(Duration.deterministic(mean), _of_mean(sample.observed), None, 1)


def fit_hyper_erlang(sample: Sample) -> Optional[DurationFit]:
    """A mixture of Erlang branches, for times whose coefficient of variation exceeds 1; None if
    there are too few observations."""
    if sample.size < _FEWEST:
        return None
    best: Optional[Tuple[float, DurationFit]] = None
    for phases in ((1, 1), (1, 2), (2, 2), (1, 4), (1, 1, 1), (1, 1, 2)):
        fit = _expectation_maximisation(sample, phases)
        if fit is None or fit.likelihood is None:
            continue
        value = criterion(fit, sample.size)
        if best is None or value < best[0]:
            best = value, fit
    return best[1] if best is not None else None


def fit_empirical(sample: Sample) -> DurationFit:
    """Quantiles of the observed times; with censored ones, of the Kaplan-Meier estimate."""
    times, survival = kaplan_meier(sample)
    levels = np.linspace(0.0, 1.0, _QUANTILES)
    steps = np.concatenate(([0.0], 1 - survival))
    steps /= steps[-1]
    middle = (steps[1:] + steps[:-1]) / 2  # each time stands for the middle of its step
    values = np.interp(levels, middle, times)
    duration = Duration.empirical(np.maximum.accumulate(values).tolist())
    mean = float(np.dot(np.diff(steps), times))
    duration = duration.scaled(mean / duration.mean)
    return DurationFit(duration, _of_mean(sample.observed, mean), None, _QUANTILES)


def criterion(fit: DurationFit, size: int) -> float:
    """Schwarz's criterion (BIC): the smaller it is, the better the distribution explains the data
    for its number of parameters."""
    assert fit.likelihood is not None
    return fit.parameters * math.log(size) - 2 * fit.likelihood


def family_choices() -> List[str]:
    """The families that :func:`fit_duration` can be asked for."""
    return ["auto", "exponential", "gamma", *(f.value for f in FAMILIES.values() if f.estimate)]


def fit_duration(
    sample: Sample, family: Union[str, Family] = "auto", *, fits: bool = True
) -> DurationFit:
    """Fit a distribution.

    :param sample: at least two observed times; for the exponential family, one.
    :param family: ``exponential``, ``gamma``, one that another package has added and that has an
        estimator, or ``auto``: whichever family explains the data best, by Schwarz's criterion.
    :param fits: tests whether the data do not contradict a fit; if they contradict all families,
        quantiles are used.
    :raises UsageError: there are too few observations, or no such family.
    """
    if sample.size < (1 if family == "exponential" else 2):
        raise UsageError("%d observed times are too few" % sample.size)
    if family == "exponential":
        return fit_exponential(sample)
    if family == "gamma":
        return fit_gamma(sample)
    if isinstance(family, Family) and family.estimate is not None:
        return _fit_of(compose(family, family.estimate(sample)), sample, len(family.form))
    if family != "auto":
        known = ", ".join(family_choices())
        raise UsageError("there is no family '%s' to fit" % family, hint="choose from: " + known)
    fixed = fit_deterministic(sample)
    if fixed is not None:
        return fixed
    if not fits:
        return fit_empirical(sample)
    # the intervals take longest, so only that of the best family is computed
    gamma = _fit_two(sample, _Gamma(sample))
    lognormal = _fit_two(sample, _Lognormal(sample))
    found: List[DurationFit] = [fit_exponential(sample), gamma, lognormal]
    allowed = quantiles.chi_squared(1 - CONFIDENCE, 1) / 2
    clearly = (gamma.likelihood or 0.0) - (found[0].likelihood or 0.0) > allowed
    if gamma.duration.variation > 1 and clearly:
        mixed = fit_hyper_erlang(sample)
        found += [mixed] if mixed is not None else []
    best = min(
        found,
        key=lambda fit: criterion(fit, sample.size) + _PREFERENCE * (fit is lognormal),
    )
    if best is gamma or best is lognormal:
        # the family is uncertain too, so the other one widens the interval as far as it is as
        # likely
        apart = (gamma.likelihood or 0.0) - (lognormal.likelihood or 0.0)
        ends = [
            _profile_interval(sample, family, max(behind, 0.0))
            for family, behind in ((_Gamma(sample), -apart), (_Lognormal(sample), apart))
        ]
        best = best._replace(interval=(min(e[0] for e in ends), max(e[1] for e in ends)))
        if best.duration.kind is Kind.GAMMA:
            return fit_erlang(sample, best) or best
    return best


def most_likely(sample: Sample, like: Duration) -> Duration:
    """The most likely distribution of the same family as ``like``; for Erlang the phases, for
    hyper-Erlang the branches are fitted again, but not their numbers of phases.

    :raises UsageError: the family has no parameters to fit (empirical), or no estimator.
    """
    if isinstance(like.kind, Family) and like.kind.estimate is not None:
        return compose(like.kind, like.kind.estimate(sample))
    if like.kind is Kind.EXPONENTIAL:
        return Duration.exponential(sample.total / sample.size)
    if like.kind is Kind.GAMMA:
        return _most_likely(sample, _Gamma(sample), like)
    if like.kind is Kind.LOGNORMAL:
        return _most_likely(sample, _Lognormal(sample), like)
    if like.kind is Kind.ERLANG:
        gamma = _most_likely(sample, _Gamma(sample), like)
        return Duration.erlang(max(1, round(gamma.parameters[0])), gamma.mean)
    if like.kind is Kind.HYPER_ERLANG:
        branches = np.array(like.parameters).reshape(-1, 3)
        phases = [int(k) for k in branches[:, 1]]
        fit = _expectation_maximisation(sample, phases, (branches[:, 0], branches[:, 2]), 15)
        return fit.duration if fit is not None else like
    raise UsageError("distributions of the family %s cannot be fitted" % like.kind.value)


def _most_likely(sample: Sample, family: Any, like: Duration) -> Duration:
    start = like.mean, math.log(like.parameters[0])
    found: Duration = family.make(*(family.best() or _maximum(sample, family, start)))
    return found


# -- two parameters --------------------------------------------------------------------------------


class _Gamma:
    """The likelihood of a gamma distribution, by its mean and the logarithm of its shape."""

    low, high = -6.0, 18.0

    def __init__(self, sample: Sample) -> None:
        self.n = sample.size
        self.sum = float(sample.observed.sum())
        self.log_sum = float(np.log(sample.observed).sum())
        self.censored, self.weights = sample.grouped

    def __call__(self, mean: float, log_shape: float) -> float:
        shape = math.exp(log_shape)
        rate = shape / mean
        found = (
            self.n * (shape * math.log(rate) - math.lgamma(shape))
            + (shape - 1) * self.log_sum
            - rate * self.sum
        )
        if len(self.censored):
            hazard = self.make(mean, log_shape).hazard_integral(self.censored)
            found -= float(np.dot(hazard, self.weights))
        return found

    def make(self, mean: float, log_shape: float) -> Duration:
        return Duration.gamma(math.exp(log_shape), mean)

    def best(self) -> Optional[Tuple[float, float]]:
        """The best mean and second parameter, if they have a closed form."""
        if len(self.censored):
            return None
        mean = self.sum / self.n
        return mean, gamma_log_shape(math.log(mean) - self.log_sum / self.n)


class _Lognormal:
    """The likelihood of a lognormal distribution, by its mean and the logarithm of its sigma."""

    low, high = -14.0, 2.0

    def __init__(self, sample: Sample) -> None:
        self.n = sample.size
        logs = np.log(sample.observed)
        self.mean = float(logs.mean())
        self.square = float(((logs - self.mean) ** 2).mean())
        self.censored, self.weights = sample.grouped

    def __call__(self, mean: float, log_sigma: float) -> float:
        sigma = math.exp(log_sigma)
        mu = math.log(mean) - sigma**2 / 2
        off = (self.square + (self.mean - mu) ** 2) / sigma**2
        found = -self.n * (log_sigma + self.mean + math.log(2 * math.pi) / 2 + off / 2)
        if len(self.censored):
            tails = special.log_ndtr((mu - np.log(self.censored)) / sigma)
            found += float(np.dot(tails, self.weights))
        return found

    def make(self, mean: float, log_sigma: float) -> Duration:
        return Duration.lognormal(math.exp(log_sigma), mean)

    def best(self) -> Optional[Tuple[float, float]]:
        if len(self.censored):
            return None
        sigma = min(max(math.sqrt(self.square), math.exp(self.low)), math.exp(self.high))
        return math.exp(self.mean + sigma**2 / 2), math.log(sigma)


def gamma_log_shape(gap: float) -> float:
    """The logarithm of the most likely shape of a gamma distribution, from uncensored times.

    :param gap: the logarithm of their mean minus the mean of their logarithms.
    """
    gap = max(gap, 1e-9)
    # Minka's generalised Newton iteration converges in a few steps from this start
    shape = (3 - gap + math.sqrt((gap - 3) ** 2 + 24 * gap)) / (12 * gap)
    for _ in range(20):
        slope = 1 / shape - float(special.polygamma(1, shape))
        off = math.log(shape) - float(special.psi(shape)) - gap
        step = 1 / shape + off / (shape**2 * slope)
        new = 1 / step if step > 0 else shape / 2
        if abs(new - shape) <= 1e-10 * shape:
            break
        shape = new
    return min(max(math.log(shape), _Gamma.low), _Gamma.high)


def _fit_two(sample: Sample, family: Any) -> DurationFit:
    """Maximise the likelihood over both parameters; without an interval."""
    if sample.size < 2:
        raise UsageError("%d observed times are too few" % sample.size)
    mean, second = family.best() or _maximum(sample, family)
    no_interval = math.nan, math.nan
    return DurationFit(family.make(mean, second), no_interval, family(mean, second), 2)


def _profile_interval(sample: Sample, family: Any, behind: float = 0.0) -> Tuple[float, float]:
    """The profile interval of the mean.

    :param behind: how much less likely the best fit of this family is than that of another one,
        whose likelihood is the reference. The interval may be empty: (inf, -inf).
    """
    mean, second = family.best() or _maximum(sample, family)
    top = family(mean, second)
    last = [second]

    def profile(log_mean: float) -> float:
        """The loss of likelihood of a mean, with the best second parameter for it."""
        value, last[0] = _best_second(family, math.exp(log_mean), last[0])
        return top - value

    n = sample.size
    # the exact threshold if the times were normal, which chi-squared only is for large samples
    t = quantiles.student((1 + CONFIDENCE) / 2, n - 1)
    allowed = n * math.log1p(t**2 / (n - 1)) / 2 - behind
    if allowed <= 0:
        return math.inf, -math.inf
    step = min(max(2 * family.make(mean, second).variation / math.sqrt(n), 1e-7), 1.0)
    low = _crossing(profile, math.log(mean), -step, allowed, last, second)
    high = _crossing(profile, math.log(mean), step, allowed, last, second)
    return math.exp(low), math.exp(high)


def _maximum(
    sample: Sample, family: Any, start: Optional[Tuple[float, float]] = None
) -> Tuple[float, float]:
    """The best mean and second parameter with censored times.

    :param start: parameters from which the search starts.
    """
    if start is None:
        start = type(family)(Sample(sample.observed)).best()
    assert start is not None
    mean, middle = start
    spread = max(family.make(*start).variation, 1e-4)

    def better(x: float, y: float) -> float:
        if not family.low <= middle + y <= family.high or abs(x * spread) > 30:
            return -math.inf
        return float(family(mean * math.exp(x * spread), middle + y))

    found = _climb(better)
    if found is None:
        found = optimize.minimize(
            lambda at: -better(*at),
            np.zeros(2),
            method="Nelder-Mead",
            options={
                "xatol": 1e-6,
                "fatol": 1e-8,
                "maxiter": 600,
                "initial_simplex": np.array([[0.0, 0.0], [0.2, 0.0], [0.0, 0.2]]),
            },
        ).x
    return mean * math.exp(found[0] * spread), middle + float(found[1])


def _climb(better: Callable[[float, float], float]) -> Optional[Tuple[float, float]]:
    """The maximum near (0, 0), by Newton's method with differences; None if that fails."""
    x = y = 0.0
    h = 1e-3
    value = better(x, y)
    for _ in range(30):
        right, left, up, down = (
            better(x + h, y),
            better(x - h, y),
            better(x, y + h),
            better(x, y - h),
        )
        corner = better(x + h, y + h)
        gx, gy = (right - left) / (2 * h), (up - down) / (2 * h)
        gxx, gyy = (right - 2 * value + left) / h**2, (up - 2 * value + down) / h**2
        gxy = (corner - right - up + value) / h**2
        det = gxx * gyy - gxy**2
        if not (math.isfinite(det) and gxx < 0 and det > 0):
            return None
        dx, dy = (gxy * gy - gyy * gx) / det, (gxy * gx - gxx * gy) / det
        for _ in range(20):
            new = better(x + dx, y + dy)
            if new >= value - 1e-9 * abs(value):
                break
            dx, dy = dx / 2, dy / 2
        else:
            return None
        x, y, value = x + dx, y + dy, new
        if abs(dx) + abs(dy) < 1e-5:
            return x, y
    return None


def _best_second(family: Any, mean: float, near: float) -> Tuple[float, float]:
    """The largest likelihood for a mean and the second parameter there; the search starts near
    another value."""
    if isinstance(family, _Gamma) and not len(family.censored):
        gap = math.log(mean) - 1 - family.log_sum / family.n + family.sum / family.n / mean
        second = gamma_log_shape(gap)
        return family(mean, second), second
    for width in (1.0, 4.0, 30.0):
        low, high = max(near - width, family.low), min(near + width, family.high)
        found = optimize.minimize_scalar(
            lambda second: -family(mean, second),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-4},
        )
        second = float(found.x)
        inside = low + 1e-3 < second < high - 1e-3
        if inside or (low <= family.low and high >= family.high):
            break
    return -float(found.fun), second


def _crossing(
    loss: Callable[[float], float],
    start: float,
    step: float,
    allowed: float,
    last: List[float],
    second: float,
) -> float:
    """The point where ``loss``, which is 0 at ``start``, reaches ``allowed`` in the direction of
    ``step``."""
    last[0] = second
    near, far = start, start + step
    while loss(far) < allowed:
        if abs(far - start) > _WIDEST:
            return far
        near, far = far, start + 2 * (far - start)
    low, high = sorted((near, far))
    return float(optimize.brentq(lambda x: loss(x) - allowed, low, high, xtol=1e-9, rtol=1e-9))


def _best_mean(sample: Sample, shape: float, near: float) -> float:
    """The best mean of a gamma distribution with a given shape."""
    if not len(sample.censored):
        return float(sample.observed.mean())
    family = _Gamma(sample)
    log_shape = math.log(shape)
    found = optimize.minimize_scalar(
        lambda at: -family(near * math.exp(at), log_shape), bounds=(-3.0, 3.0), method="bounded"
    )
    return near * math.exp(float(found.x))


# -- mixtures --------------------------------------------------------------------------------------


def _expectation_maximisation(
    sample: Sample,
    phases: Sequence[int],
    start: Optional[Tuple[Any, Any]] = None,
    steps: int = _STEPS,
) -> Optional[DurationFit]:
    """A mixture of Erlang branches with these numbers of phases; None if it degenerates.

    :param start: probabilities and means to start from.
    """
    observed = sample.observed
    censored, number = sample.grouped
    tiny = np.finfo(np.float64).tiny
    k = np.array(phases, dtype=np.float64)
    constant = np.outer(k - 1, np.log(observed)) - special.gammaln(k)[:, None]
    levels = (np.arange(len(k)) + 0.5) / len(k)
    means = np.maximum(np.quantile(observed, levels), SHORTEST_FITTED)
    means = np.maximum(means, np.arange(1, len(k) + 1) * means[0])
    chances = np.full(len(k), 1 / len(k))
    if start is not None:
        chances, means = start
    total = sample.size + len(sample.censored)
    before = -math.inf
    for _ in range(steps):
        rates = k / means
        logs = constant + (np.log(chances) + k * np.log(rates))[:, None] - np.outer(rates, observed)
        density = special.logsumexp(logs, axis=0)
        log_likelihood = float(density.sum())
        weights = np.exp(logs - density)
        amounts, sums = weights.sum(axis=1), weights @ observed
        if len(censored):
            # a branch still running at c ends on average at m Q(k + 1, c) / Q(k, c)
            scaled = np.outer(rates, censored)
            tails = np.log(chances)[:, None] + np.log(special.gammaincc(k[:, None], scaled) + tiny)
            survival = special.logsumexp(tails, axis=0)
            log_likelihood += float(np.dot(survival, number))
            cut = np.exp(tails - survival) * number
            longer = special.gammaincc(k[:, None] + 1, scaled) + tiny
            rests = means[:, None] * longer / (special.gammaincc(k[:, None], scaled) + tiny)
            amounts = amounts + cut.sum(axis=1)
            sums = sums + (cut * np.maximum(rests, censored)).sum(axis=1)
        if amounts.min() < 2:  # a branch for a single observation has no explanatory value
            return None
        chances, means = amounts / total, sums / amounts
        if log_likelihood - before < 1e-7 * sample.size:
            break
        before = log_likelihood
    branches = zip((chances / chances.sum()).tolist(), phases, means.tolist())
    return _fit_of(Duration.hyper_erlang(list(branches)), sample, 2 * len(k) - 1)


def _fit_of(duration: Duration, sample: Sample, parameters: int) -> DurationFit:
    """A fit, with an interval from the normal distribution of the logarithm of the mean."""
    level = quantiles.normal_quantile((1 + CONFIDENCE) / 2)
    half = level * duration.variation / math.sqrt(sample.size)
    interval = duration.mean * math.exp(-half), duration.mean * math.exp(half)
    return DurationFit(duration, interval, likelihood(duration, sample), parameters)


# -- without a family ------------------------------------------------------------------------------


def kaplan_meier(sample: Sample) -> Tuple[Any, Any]:
    """The distinct observed times, and the estimated survival after each of them."""
    times, ends = np.unique(sample.observed, return_counts=True)
    everything = np.sort(np.concatenate((sample.observed, sample.censored)))
    at_risk = len(everything) - np.searchsorted(everything, times, side="left")
    return times, np.cumprod(1 - ends / at_risk)


def _spread(times: Any) -> float:
    return float(times.std(ddof=1)) if len(times) > 1 else math.inf


def _of_mean(times: Any, mean: Optional[float] = None) -> Tuple[float, float]:
    """The interval of a mean by Student's t distribution."""
    n = len(times)
    middle = float(times.mean()) if mean is None else mean
    t = quantiles.student((1 + CONFIDENCE) / 2, n - 1)
    half = t * _spread(times) / math.sqrt(n)
    return max(middle - half, 0.0), middle + half

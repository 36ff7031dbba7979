"""Quantiles of common distributions. ``scipy.stats`` has them too, but importing it takes longer
than most commands take to run."""

from __future__ import annotations

from scipy import special


def normal_quantile(probability: float) -> float:
    """The value that a standard normal number stays below with this probability."""
    return float(special.ndtri(probability))


def student(probability: float, freedom: float) -> float:
    """The same for Student's t with the given degrees of freedom."""
    return float(special.stdtrit(freedom, probability))


def chi_squared(above: float, freedom: float) -> float:
    """The value that chi-squared with the given degrees of freedom exceeds with probability
    ``above``."""
    return float(special.chdtri(freedom, above))


def chi_squared_above(value: float, freedom: float) -> float:
    """The probability that chi-squared with the given degrees of freedom exceeds ``value``."""
    return float(special.chdtrc(freedom, value))

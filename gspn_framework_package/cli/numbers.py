"""Bounded numbers on the command line; a number out of bounds is a one-line usage error."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from typing import Optional

MOST_MARKINGS = 10**12
"""Largest limit on markings: no machine can store more."""

MOST_SECONDS = 10.0**12
"""Maximum time in seconds: about 30,000 years."""

MOST_REPLICATIONS = 10**6
"""Maximum number of runs of a simulation: the confidence interval is then a thousandth as wide as
the spread of a single run."""


@dataclass(frozen=True)
class WholeNumbers:
    """The whole numbers from ``least`` to ``most``. Calling it reads one from a text."""

    least: int
    most: int

    def __call__(self, text: str) -> int:
        """Read a number. :raises ArgumentTypeError: it is not one of these."""
        try:
            value = int(text) if len(text) <= 40 else None
        except ValueError:
            value = None
        if value is None or not self.least <= value <= self.most:
            raise argparse.ArgumentTypeError(
                "'%.40s' is not a whole number from %d to %d" % (text, self.least, self.most)
            )
        return value


@dataclass(frozen=True)
class RealNumbers:
    """The numbers from ``least`` (or, with ``above``, greater than ``above``) to ``most``, which
    may be infinite; never NaN. Calling it reads one from a text."""

    least: float
    most: float
    above: Optional[float] = None

    def __call__(self, text: str) -> float:
        """Read a number. :raises ArgumentTypeError: it is not one of these."""
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        above = self.above is None or value > self.above
        if not (self.least <= value <= self.most and above):
            begin = "from %g" % self.least if self.above is None else "above %g" % self.above
            end = "" if self.most == math.inf else " to %g" % self.most
            raise argparse.ArgumentTypeError("'%.40s' is not a number %s%s" % (text, begin, end))
        return value


def whole(least: int, most: int) -> WholeNumbers:
    """Return a type for ``add_argument``: a whole number from ``least`` to ``most``."""
    return WholeNumbers(least, most)


def number(least: float, most: float, *, above: Optional[float] = None) -> RealNumbers:
    """Return a type for ``add_argument``: a number; see :class:`RealNumbers`."""
    return RealNumbers(least, most, above)


markings = whole(1, MOST_MARKINGS)
"""A limit on markings."""

robots = whole(1, 10_000)
"""The number of robots in a team."""

seconds = number(0.0, MOST_SECONDS)
"""A time in seconds."""

port = whole(0, 65_535)
"""A port of this machine; 0 means any free port."""

duration = number(0.0, MOST_SECONDS, above=0.0)
"""A positive time in seconds."""

replications = whole(1, MOST_REPLICATIONS)
"""The number of runs of a simulation."""

seed = whole(-(2**63), 2**63 - 1)
"""A seed for the policy's random draws."""

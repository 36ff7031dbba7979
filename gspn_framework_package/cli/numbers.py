"""Bounded numbers on the command line; a number out of bounds is a one-line usage error."""

from __future__ import annotations

import argparse
import math
from typing import Callable, Optional

MOST_MARKINGS = 10**12
"""Largest limit on markings: no machine can store more."""

MOST_SECONDS = 10.0**12
"""Maximum time in seconds: about 30,000 years."""

MOST_REPLICATIONS = 10**6
"""Maximum number of runs of a simulation: the confidence interval is then a thousandth as wide as
the spread of a single run."""


def whole(least: int, most: int) -> Callable[[str], int]:
    """Return a type for ``add_argument``: a whole number from ``least`` to ``most``."""

    def read(text: str) -> int:
        try:
            value = int(text) if len(text) <= 40 else None
        except ValueError:
            value = None
        if value is None or not least <= value <= most:
            raise argparse.ArgumentTypeError(
                "'%.40s' is not a whole number from %d to %d" % (text, least, most)
            )
        return value

    return read


def number(least: float, most: float, *, above: Optional[float] = None) -> Callable[[str], float]:
    """Return a type for ``add_argument``: a number from ``least`` (or, with ``above``, greater than
    ``above``) to ``most``, which may be infinite; never NaN."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most or (above is not None and value <= above):
            begin = "from %g" % least if above is None else "above %g" % above
            end = "" if most == math.inf else " to %g" % most
            raise argparse.ArgumentTypeError("'%.40s' is not a number %s%s" % (text, begin, end))
        return value

    return read


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

"""The arcs of a net as arrays, for questions that consider all arcs of a large net at once."""

from __future__ import annotations

from itertools import chain
from typing import List, NamedTuple, Sequence

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices
from gspn_framework_package.model.net import Net, WeightedPlaces


class Incidence(NamedTuple):
    """Arcs, or changes, one per entry: the numbers of their ``transitions`` and ``places``, and
    their ``values`` (not an array: a value may be too large for one), and whether these are
    ``positive``."""

    transitions: Indices
    places: Indices
    values: List[int]
    positive: Booleans


def flatten(rows: Sequence[WeightedPlaces]) -> Incidence:
    """The entries of ``net.inputs`` and similar lists."""
    lengths = np.fromiter(map(len, rows), dtype=np.int64, count=len(rows))
    of = np.repeat(np.arange(len(rows)), lengths)
    flat = list(chain.from_iterable(rows))
    try:
        table = np.fromiter(chain.from_iterable(flat), dtype=np.int64, count=2 * len(flat))
    except OverflowError:  # parallel arcs of large weights
        places = np.fromiter((p for p, _ in flat), dtype=np.int64, count=len(flat))
        positive = np.fromiter((value > 0 for _, value in flat), dtype=bool, count=len(flat))
        return Incidence(of, places, [value for _, value in flat], positive)
    values = table[1::2]
    return Incidence(of, table[::2].copy(), values.tolist(), values > 0)


def effects(net: Net) -> Incidence:
    """The changes made by the firings of the transitions."""
    return flatten([net.effect(t) for t in range(len(net.transitions))])

"""The order in which Gauss-Seidel sweeps visit the states of a chain.

A sweep carries probability along a whole path of states at once, as long as the path follows the
order; probability that flows against the order waits for the next sweep. The best order therefore
has the least backward flow. The candidates are the order of discovery, and those that sort the
markings place by place.
"""

from __future__ import annotations

from typing import Dict, List, Optional

import numpy as np

from gspn_framework_package.analysis.arrays import Indices
from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.graph import flat_ranges

_SAMPLE = 1_000
"""Number of states whose arcs are sampled."""

_PLACES = 2_000
"""With more places than this, the markings are not considered and the states keep the order of
discovery."""

_WORTH = 0.7
"""Another order is worth the sorting if it leaves less than this share of the backward flow."""


def sweep_order(chain: Chain, states: Indices) -> Optional[Indices]:
    """The order in which to sweep, as positions in ``states``; None for the present order.

    :param states: int array: states of the chain, ascending.
    """
    if len(chain.graph.net.places) > _PLACES:
        return None
    rows = states[:: max(1, len(states) // _SAMPLE)]
    begin, end = chain.rates.indptr[rows], chain.rates.indptr[rows + 1]
    arcs = flat_ranges(begin, end)
    sources, targets = np.repeat(rows, end - begin), chain.rates.indices[arcs]
    inside = np.zeros(len(chain), dtype=bool)
    inside[states] = True
    arcs, sources = arcs[inside[targets]], sources[inside[targets]]
    targets = targets[inside[targets]]
    weight = chain.rates.data[arcs] / chain.exit_rates[sources]
    change = chain.graph.markings(chain.states[targets]) - chain.graph.markings(
        chain.states[sources]
    )
    if not change.size:
        return None
    arc, moved = np.arange(len(arcs)), change != 0
    first = change[arc, moved.argmax(axis=1)]
    last = change[arc, change.shape[1] - 1 - moved[:, ::-1].argmax(axis=1)]
    backward: Dict[str, float] = {
        "first": weight[first < 0].sum(),
        "first falling": weight[first > 0].sum(),
        "last": weight[last < 0].sum(),
        "last falling": weight[last > 0].sum(),
    }
    best = min(backward, key=lambda name: backward[name])
    if backward[best] >= _WORTH * weight[targets < sources].sum():
        return None
    order = np.lexsort(_sort_keys(chain, states, reverse=best.startswith("first")))
    return order[::-1] if best.endswith("falling") else order


def _sort_keys(chain: Chain, states: Indices, reverse: bool = False) -> List[Indices]:
    """The markings as sort keys of a few integers each: the last key is the most significant, and
    in it the last place (or the first, with ``reverse``)."""
    keys: List[Indices] = []
    room = 0
    places = range(len(chain.graph.net.places))
    for p in reversed(places) if reverse else places:
        column = chain.column(p)[states]
        values = int(column.max(initial=0)) + 1
        if room * values and room * values < 2**62:
            keys[-1] = keys[-1] + column * room
            room *= values
        else:
            keys.append(column)
            room = values
    return keys

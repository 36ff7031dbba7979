"""A part of a state space too large for one process: a few states, the firings from them, and the
immediate firings that follow."""

from __future__ import annotations

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Words
from gspn_framework_package.analysis.state_space.exploration import Growing, RawGraph, label_type
from gspn_framework_package.analysis.state_space.marking_store import PackedStore
from gspn_framework_package.analysis.state_space.numpy_engine import StateTable, enabled, fire
from gspn_framework_package.analysis.state_space.packing import PackedNet, Packing
from gspn_framework_package.analysis.state_space.space import StateSpace

_ROWS = 1 << 13
"""Largest number of states expanded at once."""

_ROUND = 1 << 19
"""Largest product of states and transitions expanded at once."""


def timed_in(packed: PackedNet) -> Booleans:
    """Whether each transition, in engine order, is exponential."""
    return np.array([packed.net.transitions[t].timed for t in packed.order.tolist()], dtype=bool)


def rows_of_round(transitions: int) -> int:
    """Largest number of states to expand at once."""
    return max(1, min(_ROWS, _ROUND // max(transitions, 1)))


def window(packed: PackedNet, words: Words) -> StateSpace:
    """A separate state space: some states (numbered first), the firings from them, and the
    immediate firings that follow, up to the next tangible states, which have no arcs.

    :param words: the packed markings of distinct states, one row each.
    """
    timed = timed_in(packed)
    size = len(packed.order)
    found = Growing(np.uint64, packed.words)
    table = StateTable(found)
    table.insert(words, found)
    targets, labels = Growing(np.int64), Growing(label_type(size))
    counts = []
    explored = 0
    while explored < found.used:
        first = explored < len(words)
        if not first and timed.all():
            counts.append(np.zeros(found.used - explored, dtype=np.int64))
            break
        stop = min(explored + rows_of_round(size), len(words) if first else found.used)
        block = found.array[explored:stop]
        sources, fired = enabled(packed, block)
        if not first:
            at_once = ~timed[fired]
            sources, fired = sources[at_once], fired[at_once]
        targets.extend(table.insert(fire(packed, block, sources, fired), found))
        labels.extend(fired)
        counts.append(np.bincount(sources, minlength=len(block)))
        explored = stop
    offsets = np.concatenate([[0], np.cumsum(np.concatenate([*counts, []]))]).astype(np.int64)
    states = found.finished()
    graph = RawGraph(states, offsets, targets.finished(), labels.finished(), len(states))
    store = PackedStore(Packing(packed.net, packed.widths), states)
    return StateSpace(packed.net, store, graph, packed.order, untimed=False, engine="window")

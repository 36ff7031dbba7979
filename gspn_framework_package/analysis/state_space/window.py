"""A few states of a state space that is too large for one process: with the firings from them, and
the immediate firings that follow."""

from __future__ import annotations

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Words
from gspn_framework_package.analysis.state_space.exploration import Growing, RawGraph, label_type
from gspn_framework_package.analysis.state_space.marking_store import PackedStore
from gspn_framework_package.analysis.state_space.numpy_engine import StateTable, enabled, fire
from gspn_framework_package.analysis.state_space.packing import PackedNet, Packing
from gspn_framework_package.analysis.state_space.space import StateSpace

_ROWS = 1 << 13
"""Most states that are expanded at once."""

_ROUND = 1 << 19
"""Most states times transitions that are expanded at once."""


def timed_in(packed: PackedNet) -> Booleans:
    """Whether each transition, in engine order, is exponential."""
    return np.array([packed.net.transitions[t].timed for t in packed.order.tolist()], dtype=bool)


def rows_of_round(transitions: int) -> int:
    """Most states that should be expanded at once."""
    return max(1, min(_ROWS, _ROUND // max(transitions, 1)))


def window(packed: PackedNet, words: Words) -> StateSpace:
    """A state space of its own: some states, which are numbered first, the firings from them, and
    whatever immediate firings follow, up to the next tangible states, from which nothing fires.

    :param words: the packed markings of different states, one row each.
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

"""Finds the reachable markings, storing those already found in files.

The search goes layer by layer. The successors of a layer are collected, sorted, and compared with
all markings found before, in one pass over these (delayed duplicate detection: R. E. Korf,
*Linear-time disk-based implicit graph search*, Journal of the ACM 55, 2008). The markings found
before are a few sorted sequences of geometrically growing sizes: each is merged a few times.
"""

from __future__ import annotations

import math
from typing import Dict, Iterable, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices, Words
from gspn_framework_package.analysis.on_disk.keys import KeyCode, Keys, differs, distinct
from gspn_framework_package.analysis.on_disk.scratch import Scratch, ScratchFile
from gspn_framework_package.analysis.on_disk.sorted_keys import (
    Budget,
    Pile,
    SortedKeys,
    Writer,
    by_ranges,
    merge_sorted,
)
from gspn_framework_package.analysis.state_space.exploration import in_wide_fields
from gspn_framework_package.analysis.state_space.numpy_engine import enabled, fire
from gspn_framework_package.analysis.state_space.packing import PackedNet
from gspn_framework_package.analysis.state_space.space import INVARIANT_EFFORT
from gspn_framework_package.analysis.structure.invariants import invariant_bounds
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.errors import LimitError, UsageError
from gspn_framework_package.model.net import Marking, Net

LEAST_MEMORY = 1 << 14
"""Least memory (bytes) of a search."""

_SPREAD = 2
"""A new sequence is merged with those up to this many times its size."""


class Counts(NamedTuple):
    """The counts of a search.

    :ivar states: number of markings.
    :ivar vanishing: number of them that enable an immediate transition.
    :ivar arcs: number of firings between them.
    :ivar dead: number of them that enable nothing.
    :ivar bounds: place -> largest number of tokens in it.
    :ivar firings: transition -> the number of markings in which it can fire.
    """

    states: int
    vanishing: int
    arcs: int
    dead: int
    bounds: Dict[str, int]
    firings: Dict[str, int]


class OnDiskSpace:
    """The reachable markings of a net, most of them on disk; made by :func:`search`.

    :ivar packed: the net, compiled to arithmetic on packed markings.
    :ivar code: translates packed markings to keys.
    :ivar scratch: the temporary files.
    :ivar budget: the memory shares of the search.
    :ivar counts: the counts of the search.
    :ivar layers: the number of layers: one more than the length of the longest shortest firing
        sequence.
    """

    def __init__(self, packed: PackedNet, scratch: Scratch, memory: float) -> None:
        self.net = packed.net
        self.packed = packed
        self.code = KeyCode(packed)
        self.scratch = scratch
        self.budget = Budget.of(memory, self.code.dtype.itemsize)
        self._queue: ScratchFile = scratch.file()  # all layers, one after the other
        self._layers: List[SortedKeys] = []
        self._found: List[SortedKeys] = []
        self._timed = np.array([packed.net.transitions[t].timed for t in packed.order], dtype=bool)
        self._states = self._vanishing = self._arcs = self._dead = 0
        self._first_dead: Optional[Tuple[int, Keys]] = None  # layer and key
        self._bounds: Indices = np.zeros(len(packed.widths), dtype=np.int64)
        self._firings: Indices = np.zeros(len(packed.order), dtype=np.int64)

    def __len__(self) -> int:
        return self._states

    @property
    def layers(self) -> int:
        """The number of layers: one more than the length of the longest shortest path."""
        return len(self._layers)

    @property
    def counts(self) -> Counts:
        """The counts."""
        net = self.net
        order = self.packed.order.tolist()
        firings = dict(zip((net.transitions[t].name for t in order), self._firings.tolist()))
        return Counts(
            self._states,
            self._vanishing,
            self._arcs,
            self._dead,
            {place.name: int(most) for place, most in zip(net.places, self._bounds)},
            {transition.name: firings[transition.name] for transition in net.transitions},
        )

    # -- the search --------------------------------------------------------------------------------

    def explore(self, limit: float, watch: Watch) -> None:
        """Find all markings.

        :raises FieldOverflowError: the fields are too narrow.
        :raises LimitError: there are more than ``limit``, or the disk is full.
        """
        layer = self._new_layer([self.code.encode(self.packed.initial[None, :])])
        while len(layer):
            pile = Pile(self.scratch, self.budget, self.code.dtype)
            for keys in layer.parts(self._rows):
                watch.step("states", self._states)
                pile.add(self._expand(keys))
            self._remember(layer, watch)
            layer = self._new_layer(self._unknown(pile, watch))
            if self._states > limit:
                raise LimitError(
                    "not decided within %d states" % self._states, hint="raise --limit"
                )
        self._layers.pop()  # which is empty

    @property
    def _rows(self) -> int:
        """Number of markings expanded together."""
        transitions = max(len(self.packed.order), 1)
        each = transitions * (48 + 16 * self.packed.words) + 64
        return max(self.budget.expanded // each, 1)

    def _expand(self, keys: Keys) -> Keys:
        """The successors of some markings; updates the counts."""
        states = self.code.decode(keys)
        sources, fired = enabled(self.packed, states)
        self._count(keys, states, sources, fired)
        return distinct(self.code.encode(fire(self.packed, states, sources, fired)))

    def _count(self, keys: Keys, states: Words, sources: Indices, fired: Indices) -> None:
        self._arcs += len(sources)
        self._firings = self._firings + np.bincount(fired, minlength=len(self._firings))
        first = np.flatnonzero(differs(sources))
        self._vanishing += int((~self._timed[fired[first]]).sum())
        dead = len(states) - len(first)
        if dead and self._first_dead is None:
            active = np.zeros(len(states), dtype=bool)
            active[sources] = True
            here = int(np.argmin(active))
            self._first_dead = len(self._layers) - 1, keys[here : here + 1].copy()
        self._dead += dead
        for p, most in enumerate(self._bounds.tolist()):
            self._bounds[p] = max(most, int(self.packed.column(states, p).max()))

    def _new_layer(self, parts: Iterable[Keys]) -> SortedKeys:
        writer = Writer(self.scratch, self.budget, self.code.dtype, self._queue)
        for keys in parts:
            self.scratch.require(keys.nbytes)
            writer.append(keys)
            self._states += len(keys)
        layer = writer.finished()
        self._layers.append(layer)
        return layer

    def _unknown(self, pile: Pile, watch: Watch) -> Iterator[Keys]:
        """The keys in the pile that were not found before."""
        for keys in pile.taken():
            watch.step("states", self._states)
            for run in self._found:
                keys = keys[~run.search(keys)[1]]
            yield keys

    @property
    def has_vanishing_start(self) -> bool:
        """Whether the initial marking enables an immediate transition."""
        return bool(self._at_once(self.packed.initial[None, :])[0])

    def _at_once(self, states: Words) -> Booleans:
        """Which states are vanishing."""
        sources, fired = enabled(self.packed, states)
        found = np.zeros(len(states), dtype=bool)
        found[sources[~self._timed[fired]]] = True
        return found

    def tangible(self, watch: Watch) -> SortedKeys:
        """The keys of all tangible markings, in one sequence.

        :raises LimitError: the disk is full.
        """
        if self._vanishing:
            writer = Writer(self.scratch, self.budget, self.code.dtype)
            for parts in by_ranges(self._found, self.budget.together):
                keys = distinct(np.concatenate(parts))
                for begin in range(0, len(keys), self._rows):
                    watch.step("states", len(self))
                    some = keys[begin : begin + self._rows]
                    writer.append(some[~self._at_once(self.code.decode(some))])
            return writer.finished()
        if len(self._found) > 1:
            whole = merge_sorted(
                self._found, self.scratch, self.budget, watch, "states", self._states
            )
            self._found = [whole]
        return self._found[0]

    def _remember(self, layer: SortedKeys, watch: Watch) -> None:
        """Add a layer to the markings found before."""
        together = [layer]
        size = len(layer)
        while self._found and len(self._found[-1]) <= _SPREAD * size:
            size += len(self._found[-1])
            together.append(self._found.pop())
        if len(together) > 1:
            layer = merge_sorted(together, self.scratch, self.budget, watch, "states", self._states)
        self._found.append(layer)

    # -- ways --------------------------------------------------------------------------------------

    def dead_marking(self) -> Optional[Tuple[List[str], Marking]]:
        """A marking that enables nothing, with a shortest firing sequence to it; None if there is
        none."""
        if self._first_dead is None:
            return None
        layer, key = self._first_dead
        marking = tuple(self.packed.unpack(self.code.decode(key))[0].tolist())
        return self.way_to(layer, key), marking

    def parts(self) -> Iterator[Tuple[int, Keys]]:
        """All markings in blocks, layer by layer: the number of the layer, and the keys."""
        for number, layer in enumerate(self._layers):
            for keys in layer.parts(self._rows):
                yield number, keys

    def way_to(self, layer: int, key: Keys) -> List[str]:
        """A shortest firing sequence to a marking of a layer, backwards from layer to layer."""
        way = []
        for number in range(layer - 1, -1, -1):
            state = self.code.decode(key)
            before = state - self.packed.change  # one candidate for each transition
            possible = np.flatnonzero(((before & self.packed.guard) == 0).all(axis=1))
            for t in possible.tolist():
                candidate = self.code.encode(before[t : t + 1])
                if not self._layers[number].search(candidate)[1][0]:
                    continue
                if t in enabled(self.packed, before[t : t + 1])[1]:
                    way.append(self.net.transitions[self.packed.order[t]].name)
                    key = candidate
                    break
            else:
                raise AssertionError("a marking has no predecessor")
        return way[::-1]


def search(
    net: Net,
    memory: float,
    *,
    scratch: Optional[Scratch] = None,
    limit: float = math.inf,
    seconds: float = math.inf,
    bounds: Optional[Sequence[Optional[int]]] = None,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> OnDiskSpace:
    """Find the reachable markings with little memory.

    :param memory: bytes of memory to use, in addition to those of the libraries.
    :param scratch: the place for files; None: the default folder. It is closed if there is an
        error; otherwise, the caller closes it after use.
    :param limit: largest number of markings.
    :param seconds: longest time (s).
    :param bounds: as for :func:`~gspn_framework_package.analysis.state_space.space.explore`.
    :raises LimitError: there are too many markings, it takes too long, or the disk is full.
    :raises CancelledError: ``cancel`` returned true.
    """
    if memory < LEAST_MEMORY:
        raise UsageError(
            "%d bytes of memory are too few for a search" % memory,
            hint="give at least %d" % LEAST_MEMORY,
        )
    watch = Watch(progress, cancel, seconds=seconds)
    scratch = scratch or Scratch()
    if bounds is None:
        bounds = invariant_bounds(net, INVARIANT_EFFORT, watch)
    files = scratch

    def run(packed: PackedNet) -> OnDiskSpace:
        space = OnDiskSpace(packed, files, memory)
        try:
            space.explore(limit, watch)
        except BaseException:
            files.close()
            raise
        return space

    return in_wide_fields(net, bounds, run)

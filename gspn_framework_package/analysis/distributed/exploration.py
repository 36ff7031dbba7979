"""The exploration of the reachable markings by several ranks."""

from __future__ import annotations

import functools
import math
import time
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices, Words
from gspn_framework_package.analysis.distributed.ranks import Ranks, divided
from gspn_framework_package.analysis.limits import STATE_LIMIT
from gspn_framework_package.analysis.state_space.exploration import (
    Allowance,
    Growing,
    in_wide_fields,
)
from gspn_framework_package.analysis.state_space.marking_store import PackedStore
from gspn_framework_package.analysis.state_space.numpy_engine import (
    StateTable,
    enabled,
    fire,
    hashed,
)
from gspn_framework_package.analysis.state_space.packing import (
    PackedNet,
    Packing,
)
from gspn_framework_package.analysis.state_space.space import StateSpace, is_sparse
from gspn_framework_package.analysis.state_space.window import rows_of_round, timed_in, window
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError, RefusedError
from gspn_framework_package.model.net import Net

_UPPER = np.int64(40)
"""The owner of a state follows from the bits of its hash above this one; the hash table of the
owner takes the lower ones."""


class RankStates:
    """The states that belong to one rank.

    :ivar ranks: all ranks.
    :ivar packed: the net, compiled.
    :ivar vanishing: boolean array: no time is spent there.
    :ivar dead: boolean array: no transition is enabled.
    :ivar arcs: the number of firings from these states.
    """

    def __init__(
        self,
        ranks: Ranks,
        packed: PackedNet,
        table: StateTable,
        states: Growing,
        vanishing: Booleans,
        dead: Booleans,
        arcs: int,
    ) -> None:
        self.ranks, self.packed = ranks, packed
        self._table, self._states = table, states
        self.vanishing, self.dead, self.arcs = vanishing, dead, arcs

    def __len__(self) -> int:
        return self._states.used

    @property
    def words(self) -> Words:
        """The packed markings, one row each; a view until the next look-up."""
        return self._states.array[: self._states.used]

    @property
    def has_initial(self) -> bool:
        """Whether the initial state belongs to this rank; it is number 0 then."""
        return bool(len(self)) and bool((self.words[0] == self.packed.initial).all())

    @property
    def store(self) -> PackedStore:
        """The markings."""
        return PackedStore(Packing(self.packed.net, self.packed.widths), self.words)

    @property
    def memory(self) -> int:
        """Bytes that the states take."""
        return int(self.words.nbytes + self._table.nbytes + 2 * len(self))

    def numbers(self, words: Words) -> Indices:
        """The numbers of packed markings that belong to this rank."""
        return self._table.insert(words, self._states)

    def numbers_anywhere(self, words: Words) -> Tuple[Indices, Indices]:
        """The owners of packed markings of all ranks, and their numbers there. All ranks call it
        together."""
        owners = owners_of(words, self.ranks.size)
        (parts,) = divided(owners, self.ranks.size, words)
        asked = self.ranks.exchange(parts)
        answers = self.ranks.exchange([self.numbers(part).astype(np.int64) for part in asked])
        numbers = np.empty(len(words), dtype=np.int64)
        numbers[np.argsort(owners, kind="stable")] = np.concatenate(answers)
        return owners, numbers

    def window(self, states: Indices) -> StateSpace:
        """A state space of its own around some ``states`` of this rank, see
        :func:`~gspn_framework_package.analysis.state_space.window.window`."""
        return window(self.packed, self.words[states])


def owners_of(words: Words, size: int) -> Indices:
    """The ranks that packed markings belong to."""
    return (hashed(words) >> _UPPER) % size


def explore(
    net: Net,
    ranks: Ranks,
    *,
    bounds: Sequence[Optional[int]],
    limit: int = STATE_LIMIT,
    watch: Callable[[], Watch] = Watch,
    memory: float = math.inf,
    seconds: float = math.inf,
) -> RankStates:
    """Find the reachable markings, together with the other ranks.

    :param bounds: for each place, the most tokens it can hold (None: unknown), the same on every
        rank; a bound that is too low costs time, never correctness.
    :param limit: most states on all ranks together.
    :param watch: makes what receives the progress, and cancels the work.
    :param memory: most bytes that the states of a rank may take.
    :param seconds: longest time (s).
    :raises LimitError: a limit was reached.
    :raises RefusedError: the net has too many places for packed markings.
    """
    if is_sparse(net):
        raise RefusedError(
            "a net of so many places and transitions is not distributed", hint="leave --on out"
        )
    room = Allowance(memory, time.monotonic() + seconds)
    return in_wide_fields(
        net,
        bounds,
        lambda packed: _Exploration(packed, ranks, limit, watch(), room).explore(),
    )


class _Exploration:
    """The work of one rank: it expands some states, sends the successors away, and enters those
    that it gets."""

    def __init__(
        self, packed: PackedNet, ranks: Ranks, limit: int, watch: Watch, room: Allowance
    ) -> None:
        self._packed, self._ranks = packed, ranks
        self._limit, self._watch, self._room = limit, watch, room
        self._timed = timed_in(packed)
        self._rows = rows_of_round(len(packed.order))
        self._states = Growing(np.uint64, packed.words)
        self._table = StateTable(self._states)
        self._vanishing, self._dead = Growing(np.bool_), Growing(np.bool_)
        self._arcs = self._explored = self._known = 0
        self._parts: List[Words] = []

    def explore(self) -> RankStates:
        ranks = self._ranks
        initial = self._packed.initial[None, :]
        if owners_of(initial, ranks.size)[0] == ranks.rank:
            self._table.insert(initial, self._states)
        waiting = 1
        while waiting:
            ranks.agreed(self._expand)
            received = ranks.exchange(self._parts)
            found = ranks.agreed(functools.partial(self._enter, received))
            waiting, self._known = (sum(numbers) for numbers in zip(*found))
            if self._known > self._limit:
                raise LimitError(
                    "not decided within %d states" % self._limit,
                    hint="raise --limit, or ask about a smaller net",
                )
        return RankStates(
            ranks,
            self._packed,
            self._table,
            self._states,
            self._vanishing.finished(),
            self._dead.finished(),
            self._arcs,
        )

    def _expand(self) -> None:
        packed, states = self._packed, self._states
        block = states.array[self._explored : min(self._explored + self._rows, states.used)]
        sources, fired = enabled(packed, block)
        successors = fire(packed, block, sources, fired)
        at_once = np.zeros(len(block), dtype=bool)
        at_once[sources[~self._timed[fired]]] = True
        self._vanishing.extend(at_once)
        self._dead.extend(np.bincount(sources, minlength=len(block)) == 0)
        self._arcs += len(sources)
        self._explored += len(block)
        owners = owners_of(successors, self._ranks.size)
        (self._parts,) = divided(owners, self._ranks.size, successors)

    def _enter(self, received: List[Words]) -> Tuple[int, int]:
        """Enter the states that are new; returns how many wait to be expanded, and how many there
        are."""
        for words in received:
            self._table.insert(words, self._states)
        arrays = (self._states, self._vanishing, self._dead)
        used = self._table.nbytes + sum(growing.array.nbytes for growing in arrays)
        if not self._room.left(used):
            late = time.monotonic() >= self._room.until
            raise LimitError(
                "not decided within %s (%s states)"
                % (
                    "the limit of time" if late else "%.3g GB on each rank" % (used / 1e9),
                    format(self._known, ","),
                ),
                hint="raise %s, or take more ranks"
                % ("--limit-time" if late else "--limit-memory"),
            )
        self._watch.step("states", self._known)
        return self._states.used - self._explored, self._states.used

"""The markings of a state space, in one of two representations with the same interface.

:class:`PackedStore` keeps machine words with a field for each place. In nets of thousands of
places, nearly all fields would repeat the initial marking, so :class:`SparseStore` keeps only the
places that differ from a base marking.
"""

from __future__ import annotations

from typing import Dict, List, Optional, Sequence, Tuple, Union

import numpy as np

from gspn_framework_package.analysis.arrays import Floats, Indices, Selection, Words
from gspn_framework_package.analysis.graph import flat_ranges
from gspn_framework_package.analysis.state_space.packing import Packing


class PackedStore:
    """Markings as machine words.

    :param packing: the position of each place's field.
    :param words: uint64 array, one row per marking.
    """

    def __init__(self, packing: Packing, words: Words) -> None:
        self.packing = packing
        self._words = words

    def __len__(self) -> int:
        return len(self._words)

    @property
    def nbytes(self) -> int:
        """Size in bytes."""
        return int(self._words.nbytes)

    def packed(self, states: Selection = None) -> Words:
        """The words of all states, or of those selected by ``states``."""
        return self._words if states is None else self._words[states]

    def rows(self, states: Selection = None) -> Indices:
        """Markings as an int64 array, one row per state: all, or those selected by ``states``
        (numbers, slice or mask)."""
        return self.packing.unpack(self.packed(states))

    def column(self, place: int, states: Selection = None) -> Indices:
        """The token counts of place number ``place`` as an int64 array, in all states or in
        ``states``."""
        return self.packing.column(self.packed(states), place)

    def find(self, counts: Sequence[int]) -> Indices:
        """The numbers of the states with this marking."""
        if not self.packing.fits(counts):
            return np.zeros(0, dtype=np.int64)
        return np.flatnonzero((self._words == self.packing.pack(counts)).all(axis=1))

    def largest(self) -> List[int]:
        """The maximum number of tokens of each place."""
        return [int(self.column(p).max()) for p in range(len(self.packing.widths))]

    def means(self, states: Indices, weights: Floats) -> List[float]:
        """For each place the sum of its counts in ``states`` (numbers), weighted by ``weights``
        (floats)."""
        return [float(weights @ self.column(p)[states]) for p in range(len(self.packing.widths))]

    def distributions(self, states: Indices, weights: Floats) -> List[Dict[int, float]]:
        """For each place: count -> total weight of the ``states`` with that count; counts of weight
        0 are omitted."""
        found = []
        for p in range(len(self.packing.widths)):
            totals = np.bincount(self.column(p)[states], weights=weights)
            found.append({n: float(v) for n, v in enumerate(totals) if v > 0})
        return found


class SparseStore:
    """Markings as the places that differ from ``base``.

    :param base: a marking: int array, or a sequence of counts.
    :param offsets: int array: the entries of state ``s`` are ``offsets[s]`` to ``offsets[s + 1]``.
    :param places: int array: the place of each entry, ascending within a state.
    :param counts: int array: its token count, which differs from that in ``base``.
    """

    def __init__(
        self,
        base: Union[Indices, Sequence[int]],
        offsets: Indices,
        places: Indices,
        counts: Indices,
    ) -> None:
        self._base = np.array(base, dtype=np.int64)
        self._offsets, self._places, self._counts = offsets, places, counts
        self._by_place: Optional[Tuple[Indices, Indices]] = None

    def __len__(self) -> int:
        return len(self._offsets) - 1

    @property
    def nbytes(self) -> int:
        """Size in bytes."""
        return int(
            self._offsets.nbytes + self._places.nbytes + self._counts.nbytes + self._base.nbytes
        )

    def rows(self, states: Selection = None) -> Indices:
        """See :meth:`PackedStore.rows`; the array is dense: a number for every place of every
        state."""
        chosen = self._chosen(states)
        found = np.tile(self._base, (len(chosen), 1))
        entries, lengths = self._entries(chosen)
        found[np.repeat(np.arange(len(chosen)), lengths), self._places[entries]] = self._counts[
            entries
        ]
        return found

    def column(self, place: int, states: Selection = None) -> Indices:
        """See :meth:`PackedStore.column`."""
        order, ends = self._sorted_by_place()
        entries = order[ends[place] : ends[place + 1]]
        found = np.full(len(self), self._base[place], dtype=np.int64)
        found[np.searchsorted(self._offsets, entries, side="right") - 1] = self._counts[entries]
        return found if states is None else found[states]

    def find(self, counts: Sequence[int]) -> Indices:
        """See :meth:`PackedStore.find`."""
        wanted = np.array(counts, dtype=np.int64)
        places = np.flatnonzero(wanted != self._base)
        alike = np.flatnonzero(np.diff(self._offsets) == len(places))
        entries = self._offsets[alike][:, None] + np.arange(len(places))
        same = (self._places[entries] == places) & (self._counts[entries] == wanted[places])
        return alike[same.all(axis=1)]

    def largest(self) -> List[int]:
        """See :meth:`PackedStore.largest`."""
        most = np.full(len(self._base), -1, dtype=np.int64)
        np.maximum.at(most, self._places, self._counts)
        unchanged = np.bincount(self._places, minlength=len(self._base)) < len(self)
        return np.where(unchanged, np.maximum(most, self._base), most).tolist()

    def means(self, states: Indices, weights: Floats) -> List[float]:
        """See :meth:`PackedStore.means`."""
        entries, each = self._weighed(states, weights)
        places = self._places[entries]
        found = np.bincount(places, weights=each * self._counts[entries], minlength=len(self._base))
        return (found + self._base * self._unchanged(places, each, weights)).tolist()

    def distributions(self, states: Indices, weights: Floats) -> List[Dict[int, float]]:
        """See :meth:`PackedStore.distributions`."""
        entries, each = self._weighed(states, weights)
        places, counts = self._places[entries], self._counts[entries]
        order = np.lexsort((counts, places))
        places, counts, each_sorted = places[order], counts[order], each[order]
        first = np.ones(len(order), dtype=bool)
        first[1:] = (places[1:] != places[:-1]) | (counts[1:] != counts[:-1])
        group = np.cumsum(first) - 1
        totals = np.bincount(group, weights=each_sorted, minlength=int(first.sum()))
        rest = self._unchanged(places, each_sorted, weights)
        found: List[Dict[int, float]] = [
            {int(n): float(v)} if v > 0 else {} for n, v in zip(self._base, rest)
        ]
        for p, n, v in zip(places[first].tolist(), counts[first].tolist(), totals.tolist()):
            if v > 0:
                found[p][n] = v
        return [dict(sorted(counts.items())) for counts in found]

    def _weighed(self, states: Indices, weights: Floats) -> Tuple[Indices, Floats]:
        """The entries of the ``states`` with a non-zero weight, and the weight of each entry."""
        chosen = np.flatnonzero(weights)
        entries, lengths = self._entries(np.asarray(states)[chosen])
        return entries, np.repeat(weights[chosen], lengths)

    def _unchanged(self, places: Indices, each: Floats, weights: Floats) -> Floats:
        """For each place the weight of the states in which its count equals the base marking's."""
        changed = np.bincount(places, weights=each, minlength=len(self._base))
        everywhere = np.bincount(places, minlength=len(self._base)) == np.count_nonzero(weights)
        return np.where(everywhere, 0.0, np.maximum(weights.sum() - changed, 0.0))

    def _chosen(self, states: Selection) -> Indices:
        numbers = np.arange(len(self))
        return numbers if states is None else np.atleast_1d(numbers[states])

    def _entries(self, states: Indices) -> Tuple[Indices, Indices]:
        begin, end = self._offsets[states], self._offsets[states + 1]
        return flat_ranges(begin, end), end - begin

    def _sorted_by_place(self) -> Tuple[Indices, Indices]:
        if self._by_place is None:
            order = np.argsort(self._places, kind="stable")
            self._by_place = (
                order,
                np.searchsorted(self._places[order], np.arange(len(self._base) + 1)),
            )
        return self._by_place


class Columns:
    """The columns of some markings, computed on access.

    :param store: the markings.
    :param part: the selected ones; by default all.
    """

    def __init__(self, store: Union[PackedStore, SparseStore], part: slice = slice(None)) -> None:
        self._store, self._part = store, part

    def __getitem__(self, place: int) -> Indices:
        return self._store.column(place, self._part)

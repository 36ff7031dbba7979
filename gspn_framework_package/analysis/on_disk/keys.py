"""Markings as sortable keys: one value each, so that files of markings can be sorted and merged.

A key holds the fields of all places, without their guard bits if that makes it fit one machine
word. Otherwise it is a string of bytes. Since every field of a key is wide enough, firing a
transition adds the same number to each key: the successors of sorted keys by one transition are
sorted, which makes sorting all successors cheap.
"""

from __future__ import annotations

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Words
from gspn_framework_package.analysis.state_space.packing import WORD_BITS, Packing

Keys = np.ndarray
"""A one-dimensional array of keys: uint64, or strings of bytes."""


class KeyCode:
    """Translates packed markings to keys and back.

    :param packing: the fields of a packed marking.
    :ivar dtype: the type of a key.
    """

    def __init__(self, packing: Packing) -> None:
        self._packing = packing
        self._squeezed = packing.words > 1 and sum(packing.widths) <= WORD_BITS
        one_word = packing.words == 1 or self._squeezed
        self.dtype = np.dtype(np.uint64 if one_word else "S%d" % (8 * packing.words))

    def encode(self, states: Words) -> Keys:
        """The keys of packed markings (shape ``(n, words)``)."""
        if self._squeezed:
            return self._squeeze(states)
        if self._packing.words == 1:
            return states[:, 0]
        return np.ascontiguousarray(states.astype(">u8")).view(self.dtype).reshape(-1)

    def decode(self, keys: Keys) -> Words:
        """The packed markings (shape ``(n, words)``) of keys."""
        if self._squeezed:
            return self._stretch(keys)
        if self._packing.words == 1:
            return keys[:, None]
        words = np.ascontiguousarray(keys).view(">u8").reshape(len(keys), self._packing.words)
        return words.astype(np.uint64)

    def _squeeze(self, states: Words) -> Keys:
        packing = self._packing
        keys = np.zeros(len(states), dtype=np.uint64)
        begin = 0
        for word, shift, width in zip(packing.word_of, packing.shift_of, packing.widths):
            field = (states[:, word] >> np.uint64(shift)) & np.uint64((1 << width) - 1)
            keys |= field << np.uint64(begin)
            begin += width
        return keys

    def _stretch(self, keys: Keys) -> Words:
        packing = self._packing
        states = np.zeros((len(keys), packing.words), dtype=np.uint64)
        begin = 0
        for word, shift, width in zip(packing.word_of, packing.shift_of, packing.widths):
            field = (keys >> np.uint64(begin)) & np.uint64((1 << width) - 1)
            states[:, word] |= field << np.uint64(shift)
            begin += width
        return states


def distinct(keys: Keys) -> Keys:
    """The distinct keys of an array, sorted."""
    # the stable sort merges the sorted runs of the array
    ordered = np.sort(keys, kind="stable")
    return ordered[differs(ordered)]


def differs(values: np.ndarray) -> Booleans:
    """Boolean array: whether each value differs from the previous one; true for the first."""
    first = np.ones(len(values), dtype=bool)
    first[1:] = values[1:] != values[:-1]
    return first

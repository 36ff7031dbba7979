"""Markings packed into machine words, and a net compiled to arithmetic on them.

Every place has a field of ``width`` bits and one guard bit above it. With the guard bits of the
input places set, one subtraction tests all of them at once: a guard bit that survives means "enough
tokens". Inhibitor arcs and capacities use the same test with the answer inverted, and firing is one
addition. A guard bit that is set after an addition means that a count outgrew its field; the
exploration then restarts with wider fields, so no count ever wraps silently.
"""

from __future__ import annotations

from typing import List, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Indices, Words
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net

WORD_BITS = 64
MAX_WIDTH = 62
"""Widest field, in bits: counts stay below 2**62."""


class Packing:
    """The fields of the places of a net in machine words.

    :param widths: bits of the field of each place, without the guard bit.
    """

    def __init__(self, net: Net, widths: Sequence[int]) -> None:
        self.net = net
        self.widths = tuple(widths)
        self.word_of: List[int] = []
        self.shift_of: List[int] = []
        word, used = 0, 0
        for width in self.widths:
            if used + width + 1 > WORD_BITS:
                word, used = word + 1, 0
            self.word_of.append(word)
            self.shift_of.append(used)
            used += width + 1
        self.words = word + 1
        """Number of words of a packed marking."""

    def pack(self, marking: Sequence[int]) -> Words:
        """The packed form of one marking: an array of ``words`` machine words."""
        words = [0] * self.words
        for p, count in enumerate(marking):
            words[self.word_of[p]] |= int(count) << self.shift_of[p]
        return np.array(words, dtype=np.uint64)

    def pack_all(self, markings: Indices) -> Words:
        """Many markings (int array, one row each) packed, of shape ``(n, words)``."""
        states = np.zeros((len(markings), self.words), dtype=np.uint64)
        for p in range(len(self.widths)):
            states[:, self.word_of[p]] |= markings[:, p].astype(np.uint64) << np.uint64(
                self.shift_of[p]
            )
        return states

    def fits(self, marking: Sequence[int]) -> bool:
        """Whether every count of ``marking`` fits its field."""
        return all(0 <= count >> width == 0 for count, width in zip(marking, self.widths))

    def column(self, states: Words, p: int) -> Indices:
        """Token counts of place number ``p`` in packed ``states`` (shape ``(n, words)``), as
        int64."""
        mask = np.uint64((1 << self.widths[p]) - 1)
        return ((states[:, self.word_of[p]] >> np.uint64(self.shift_of[p])) & mask).astype(np.int64)

    def unpack(self, states: Words) -> Indices:
        """Packed states (shape ``(n, words)``) as an int64 array of shape ``(n, places)``."""
        markings = np.empty((len(states), len(self.widths)), dtype=np.int64)
        for p in range(len(self.widths)):
            markings[:, p] = self.column(states, p)
        return markings

    def wider(self, overflow: Sequence[int]) -> Tuple[int, ...]:
        """Field widths for another attempt.

        :param overflow: the guard bits that were set (one int per word).
        :raises LimitError: a field already has the maximum width.
        """
        widths = list(self.widths)
        for p, width in enumerate(widths):
            if int(overflow[self.word_of[p]]) >> (self.shift_of[p] + width) & 1:
                if width >= MAX_WIDTH:
                    raise LimitError(
                        "a count of place '%s' exceeds 2**%d" % (self.net.places[p].name, width)
                    )
                widths[p] = min(2 * width + 2, MAX_WIDTH)
        return tuple(widths)


class PackedNet(Packing):
    """A net compiled for the exploration engines.

    :param widths: bits of the field of each place, without the guard bit.
    :param by_priority: whether immediate transitions take precedence over exponential ones, and
        higher priorities over lower ones. Without it every transition with concession may fire.

    Arrays over transitions are in *engine order*: classes of decreasing precedence, file order
    within a class.
    """

    def __init__(self, net: Net, widths: Sequence[int], *, by_priority: bool = True) -> None:
        super().__init__(net, widths)
        guard = [0] * self.words
        for p, width in enumerate(self.widths):
            guard[self.word_of[p]] |= 1 << (self.shift_of[p] + width)
        self.guard = np.array(guard, dtype=np.uint64)
        classes = precedence_classes(net) if by_priority else [list(range(len(net.transitions)))]
        self.order = np.array([t for members in classes for t in members], dtype=np.int32)
        """Engine order -> number of the transition in the net."""
        self.class_ends = np.cumsum([len(members) for members in classes]).astype(np.int64)
        """The end of each precedence class in engine order."""
        size = (len(self.order), self.words)
        self.need = np.zeros(size, dtype=np.uint64)
        self.need_guard = np.zeros(size, dtype=np.uint64)
        self.inhibit = np.zeros(size, dtype=np.uint64)
        self.inhibit_guard = np.zeros(size, dtype=np.uint64)
        self.change = np.zeros(size, dtype=np.uint64)
        for row, t in enumerate(self.order.tolist()):
            self._compile(row, t)
        self.first_word = (self.need_guard != 0).argmax(axis=1)
        """int array: the word of the first input place of each transition."""
        rows = np.arange(len(self.order))
        self.first_need = self.need[rows, self.first_word]
        self.first_guard = self.need_guard[rows, self.first_word]
        self.initial = self.pack(net.initial_marking)

    def _compile(self, row: int, t: int) -> None:
        net = self.net
        need, need_guard, inhibit, inhibit_guard, change = ([0] * self.words for _ in range(5))
        for p, weight in net.inputs[t]:
            need[self.word_of[p]] += weight << self.shift_of[p]
            need_guard[self.word_of[p]] |= 1 << (self.shift_of[p] + self.widths[p])
        for p, threshold in thresholds(net, t).items():
            if threshold >> self.widths[p]:
                # more than the field can hold: such a count would cause an overflow first
                continue
            inhibit[self.word_of[p]] += threshold << self.shift_of[p]
            inhibit_guard[self.word_of[p]] |= 1 << (self.shift_of[p] + self.widths[p])
        for p, by in net.effect(t):
            change[self.word_of[p]] += by * (1 << self.shift_of[p])
        for into, values in (
            (self.need, need),
            (self.need_guard, need_guard),
            (self.inhibit, inhibit),
            (self.inhibit_guard, inhibit_guard),
            (self.change, change),
        ):
            into[row] = [value % (1 << WORD_BITS) for value in values]


def thresholds(net: Net, t: int) -> dict[int, int]:
    """Place number -> the smallest count at which it disables transition number ``t``, by an
    inhibitor arc or because firing would exceed the place's capacity."""
    found: dict[int, int] = {}
    for p, most in net.most_tokens(t):
        full = max(most + 1, 0)
        found[p] = min(found.get(p, full), full)
    return found


def starting_widths(net: Net, bounds: Sequence[Optional[int]]) -> Tuple[int, ...]:
    """Field widths in bits: enough for the known bound of a place (None: unknown), its initial
    count and the arc weights at it."""
    largest = [0] * len(net.places)
    for t in range(len(net.transitions)):
        for p, weight in net.inputs[t]:
            largest[p] = max(largest[p], weight)
        for p, by in net.effect(t):
            largest[p] = max(largest[p], abs(by))
    widths = []
    for p, place in enumerate(net.places):
        bound = bounds[p]
        if bound is None:
            need = max(largest[p], 2 * place.tokens, 3)
        else:
            need = max(largest[p], bound, place.tokens, 1)
        widths.append(min(int(need).bit_length(), MAX_WIDTH))
    return tuple(widths)


def precedence_classes(net: Net) -> List[List[int]]:
    """Numbers of transitions in groups of decreasing precedence; exponential ones are the last
    group."""
    immediate = {t.priority for t in net.transitions if not t.timed}
    classes = [
        [i for i, t in enumerate(net.transitions) if not t.timed and t.priority == priority]
        for priority in sorted(immediate, reverse=True)
    ]
    timed = [i for i, t in enumerate(net.transitions) if t.timed]
    return classes + [timed] if timed or not classes else classes

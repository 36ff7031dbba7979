"""Groups of permutations of the places, in forms for which the least marking of an orbit is found
quickly.

A group falls into *factors* that move different places. Each is one of

- an :class:`Exchange`: equal blocks of places in any order (all permutations of the blocks), such
  as the places of equal robots or machines. A block may have inner factors. Sorting the blocks
  gives the least marking.
- a :class:`Listed` group: up to ``MOST_LISTED`` permutations, such as the turns and reflections of
  a ring. The least of all images is the least marking.
- a :class:`Turned` group: such a list for parts with inner factors, such as a ring of cells with
  equal machines in each. The least of all images, after reduction by the inner factors, is the
  least marking.

Of other groups, a subgroup of these forms is used. That is exact too, since any group of
automorphisms is.
"""

from __future__ import annotations

import math
from typing import Dict, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

import numpy as np

from gspn_framework_package.analysis.arrays import Floats, Indices
from gspn_framework_package.analysis.graph import components
from gspn_framework_package.model.errors import LimitError

MOST_LISTED = 1_024
"""Largest number of permutations of a listed group."""

_MOST_TRIED = 200
"""Largest number of generators of a group of unknown form from which a subgroup is chosen."""

_KEY_BITS = 63
_EXACT_BITS = 52
"""Number of bits of a whole number that a float represents exactly."""


class Exchange:
    """All permutations of equal blocks.

    :ivar blocks: int array, a row of places for each block; places in one column correspond.
    :ivar inner: the factors of the places within the blocks.
    """

    def __init__(self, blocks: Indices, inner: Sequence[Factor] = ()) -> None:
        self.blocks = blocks
        self.inner = list(inner)

    @property
    def order(self) -> int:
        """The number of permutations."""
        return math.factorial(len(self.blocks)) * math.prod(f.order for f in self.inner)

    @property
    def text(self) -> str:
        """The exchanged parts, in words."""
        blocks, places = self.blocks.shape
        inside = ", and within them %s" % self.inner[0].text if self.inner else ""
        return "%d equal parts of %d place%s, in any order%s" % (
            blocks,
            places,
            "" if places == 1 else "s",
            inside,
        )

    def moved(self, to: Indices) -> Exchange:
        """The same group on other places; ``to`` maps each to its new number."""
        return Exchange(to[self.blocks], [factor.moved(to) for factor in self.inner])

    def reduce(self, counts: Indices) -> Indices:
        """Replace markings (int array, one row per place) by the least of their orbits, in place.

        :return: the size of each orbit (int array, of Python integers if the group is large).
        """
        sizes = ones(counts.shape[1], self.order)
        for factor in self.inner:
            sizes = sizes * factor.reduce(counts)
        keys = self._keys(counts)
        order = np.argsort(keys[0], axis=1) if len(keys) == 1 else np.lexsort(keys[::-1])
        for column in self.blocks.T:
            counts[column] = np.take_along_axis(counts[column].T, order, axis=1).T
        return sizes * self._arrangements([np.take_along_axis(k, order, axis=1) for k in keys])

    def _keys(self, counts: Indices) -> List[Indices]:
        """The words of each block (arrays with a row per marking and a column per block), so that
        blocks compare like the tuples of their counts."""
        keys: List[Indices] = []
        free = 0
        for column in self.blocks.T:
            values = counts[column]
            width = max(int(values.max(initial=0)).bit_length(), 1)
            if width > free:
                keys.append(np.zeros(values.T.shape, dtype=np.int64))
                free = _KEY_BITS
            keys[-1] = (keys[-1] << width) | values.T
            free -= width
        return keys

    def _arrangements(self, keys: Sequence[Indices]) -> Indices:
        """The number of arrangements of blocks with these sorted words."""
        markings, blocks = keys[0].shape
        repeats = ones(markings, self.order)
        run = np.ones(markings, dtype=np.int64)
        for i in range(1, blocks):
            same = np.ones(markings, dtype=bool)
            for key in keys:
                same &= key[:, i] == key[:, i - 1]
            run = np.where(same, run + 1, 1)
            repeats = repeats * run
        return math.factorial(blocks) // repeats


class Listed:
    """A small group of permutations.

    :ivar places: int array: the places that it moves.
    :ivar images: int array, a row for each permutation: the places that ``places`` become.
    """

    def __init__(self, places: Indices, images: Indices) -> None:
        self.places = places
        self.images = images

    @property
    def order(self) -> int:
        """The number of permutations."""
        return len(self.images)

    @property
    def text(self) -> str:
        """The exchanged parts, in words."""
        return "%d arrangements of %d places" % (self.order, len(self.places))

    def moved(self, to: Indices) -> Listed:
        """See :meth:`Exchange.moved`."""
        return Listed(to[self.places], to[self.images])

    def reduce(self, counts: Indices) -> Indices:
        """See :meth:`Exchange.reduce`."""
        values = counts[self.places]
        sizes = np.empty(counts.shape[1], dtype=np.int64)
        weights, fields = self._weights(max(int(values.max(initial=0)).bit_length(), 1))
        rows = max(1, (1 << 22) // weights.size * len(self.places))
        for begin in range(0, len(sizes), rows):
            part = slice(begin, begin + rows)
            words, same = self._least(values[:, part].T.astype(np.float64), weights)
            sizes[part] = self.order // same
            for place, (word, shift, mask) in zip(self.places, fields):
                counts[place, part] = (words[:, word] >> shift) & mask
        return sizes

    def _least(self, values: Floats, weights: Floats) -> Tuple[Indices, Indices]:
        """The words of the least images of markings (one row each), and the number of permutations
        that fix each marking."""
        codes = (values @ weights).reshape(len(values), self.order, -1)
        same = (codes == codes[:, :1]).all(axis=2).sum(axis=1)
        alive = np.ones(codes.shape[:2], dtype=bool)
        least = np.empty((len(values), codes.shape[2]), dtype=np.int64)
        for word in range(codes.shape[2]):
            found = np.where(alive, codes[:, :, word], np.inf)
            best = found.min(axis=1)
            alive &= found == best[:, None]
            least[:, word] = best
        return least, same

    def _weights(self, width: int) -> Tuple[Floats, List[Tuple[int, int, int]]]:
        """The matrix that turns a marking into the words of all its images, and the word, shift and
        mask of the field of each place. All numbers stay below 2**52, so floats are exact.

        :raises LimitError: a count is too large for that.
        """
        if width > _EXACT_BITS:
            raise LimitError("a count exceeds 2**%d" % _EXACT_BITS)
        per_word = _EXACT_BITS // width
        words = -(-len(self.places) // per_word)
        fields = [
            (i // per_word, width * (per_word - 1 - i % per_word), (1 << width) - 1)
            for i in range(len(self.places))
        ]
        number = {place: i for i, place in enumerate(self.places.tolist())}
        weights = np.zeros((len(self.places), self.order, words))
        for row, image in enumerate(self.images.tolist()):
            for i, place in enumerate(image):
                word, shift, _ = fields[number[place]]
                weights[i, row, word] = float(1 << shift)
        return weights.reshape(len(self.places), -1), fields


class Turned:
    """A small group of permutations of parts with inner factors.

    :param inner: the factors within the parts: a normal subgroup N (q N = N q).
    :param turns: the others.
    :ivar order: the number of permutations.
    """

    def __init__(self, inner: Sequence[Factor], turns: Listed) -> None:
        self.inner = list(inner)
        self.turns = turns
        both = sum(_in_product(self.inner, turns.places, image) for image in turns.images)
        self.order: int = math.prod(f.order for f in self.inner) * turns.order // both

    @property
    def text(self) -> str:
        """The exchanged parts, in words."""
        return "%s, and within them %s" % (self.turns.text, self.inner[0].text)

    def moved(self, to: Indices) -> Turned:
        """See :meth:`Exchange.moved`."""
        return Turned([factor.moved(to) for factor in self.inner], self.turns.moved(to))

    def reduce(self, counts: Indices) -> Indices:
        """See :meth:`Exchange.reduce`."""
        sizes = ones(counts.shape[1], self.order)
        for factor in self.inner:
            sizes = sizes * factor.reduce(counts)
        places = self.turns.places
        first = counts[places]
        least = first.copy()
        same = np.zeros(counts.shape[1], dtype=np.int64)
        everywhere = np.arange(counts.shape[1])
        for image in self.turns.images:
            turned = counts.copy()
            turned[image] = first
            for factor in self.inner:
                factor.reduce(turned)
            found = turned[places]
            same += (found == first).all(axis=0)
            differs = (found != least).argmax(axis=0)
            less = found[differs, everywhere] < least[differs, everywhere]
            least[:, less] = found[:, less]
        counts[places] = least
        # the number of orbits of the inner factors is that of turns divided by those that keep the
        # first orbit
        return sizes * (self.turns.order // same)


Factor = Union[Exchange, Listed, Turned]


class Factors(NamedTuple):
    """The factors of a group, and the numbers of the ``generators`` that they cover."""

    factors: List[Factor]
    generators: List[int]


def factors_of(generators: Sequence[Indices]) -> Factors:
    """The factors of the group with these generators (int arrays over the places).

    If its form is unknown, those of a subgroup, which does not cover all generators.
    """
    factors: List[Factor] = []
    covered: List[int] = []
    for numbers in _connected(generators):
        found = _recognise([generators[n] for n in numbers])
        if found is None:
            found, numbers = _part(generators, numbers)
        factors += found
        covered += numbers
    return Factors(factors, sorted(covered))


def _connected(generators: Sequence[Indices]) -> List[List[int]]:
    """The numbers of the generators, in groups that move different places."""
    if not generators:
        return []
    places = len(generators[0])
    links = [(places + n, p) for n, g in enumerate(generators) for p in _support(g).tolist()]
    sources, targets = np.array(links, dtype=np.int64).T
    of = components(
        places + len(generators),
        np.concatenate([sources, targets]),
        np.concatenate([targets, sources]),
    ).of
    groups: Dict[int, List[int]] = {}
    for n in range(len(generators)):
        groups.setdefault(int(of[places + n]), []).append(n)
    return list(groups.values())


def _support(generator: Indices) -> Indices:
    """The places that a permutation moves."""
    return np.flatnonzero(generator != np.arange(len(generator)))


def _recognise(generators: Sequence[Indices]) -> Optional[List[Factor]]:
    """The factor of a group whose generators are connected, as a list of one; None if its form is
    unknown."""
    blocks = _exchanged(generators)
    if blocks is not None:
        return [Exchange(blocks)]
    nested = _nested(generators)
    if nested is not None:
        return [nested]
    listed = _listed(generators)
    return None if listed is None else [listed]


def _part(generators: Sequence[Indices], numbers: List[int]) -> Tuple[List[Factor], List[int]]:
    """The factors of a subgroup of a group of unknown form, and the numbers of its generators,
    chosen greedily, those that move few places first."""
    factors: List[Factor] = []
    kept: List[int] = []
    for n in sorted(numbers, key=lambda n: len(_support(generators[n])))[:_MOST_TRIED]:
        tried: List[Factor] = []
        for group in _connected([generators[m] for m in [*kept, n]]):
            found = _recognise([generators[[*kept, n][i]] for i in group])
            if found is None:
                break
            tried += found
        else:
            factors, kept = tried, [*kept, n]
    return factors, kept


def _exchanged(generators: Sequence[Indices]) -> Optional[Indices]:
    """The blocks, if each generator swaps two of at least three, and they are all permutations of
    blocks (swaps that connect the blocks generate all)."""
    moves = np.array([g != np.arange(len(g)) for g in generators])
    if len(generators) < 2 or any((g[g] != np.arange(len(g))).any() for g in generators):
        return None
    # each block is moved by a different set of two or more generators
    blocks: Dict[bytes, List[int]] = {}
    for place in np.flatnonzero(moves.any(axis=0)).tolist():
        blocks.setdefault(moves[:, place].tobytes(), []).append(place)
    return _in_order(list(blocks.values()), generators)


def _in_order(blocks: List[List[int]], generators: Sequence[Indices]) -> Optional[Indices]:
    """The blocks with corresponding places in the same column; None if the generators do not swap
    them this way."""
    block_of = {place: b for b, block in enumerate(blocks) for place in block}
    swaps: List[Tuple[int, int, Indices]] = []
    for generator in generators:
        support = set(_support(generator).tolist())
        first = block_of[min(support)]
        image = [int(generator[p]) for p in blocks[first]]
        second = block_of[image[0]]
        if first == second or support != {*blocks[first], *blocks[second]}:
            return None
        if set(image) != set(blocks[second]):
            return None
        swaps.append((first, second, generator))
    ordered: Dict[int, Indices] = {0: np.array(blocks[0], dtype=np.int64)}
    known = 0
    while known < len(ordered) < len(blocks):
        known = len(ordered)
        for first, second, generator in [*swaps, *reversed(swaps)]:
            for a, b in ((first, second), (second, first)):
                if a in ordered and b not in ordered:
                    ordered[b] = generator[ordered[a]]
    if len(ordered) < len(blocks):
        return None
    if any((generator[ordered[a]] != ordered[b]).any() for a, b, generator in swaps):
        return None
    return np.array([ordered[b] for b in range(len(blocks))])


def _listed(generators: Sequence[Indices]) -> Optional[Listed]:
    """The group, if it is small."""
    places = np.flatnonzero(np.any([g != np.arange(len(g)) for g in generators], axis=0))
    number = np.full(len(generators[0]), -1, dtype=np.int64)
    number[places] = np.arange(len(places))
    moves = [number[g[places]] for g in generators]
    found = [np.arange(len(places))]
    seen: Set[bytes] = {found[0].tobytes()}
    for element in found:  # grows during the loop
        for move in moves:
            image = move[element]
            if image.tobytes() not in seen:
                if len(found) == MOST_LISTED:
                    return None
                seen.add(image.tobytes())
                found.append(image)
    return Listed(places, places[np.array(found)])


def _nested(generators: Sequence[Indices]) -> Optional[Factor]:
    """Permutations of blocks with inner factors: the generators that move few places
    are those within a block, the others exchange blocks."""
    order = sorted(generators, key=lambda g: len(_support(g)))
    sizes = [len(_support(g)) for g in order]
    for split in range(1, len(order)):
        if sizes[split] > sizes[split - 1]:
            found = _wreath(order[:split], order[split:]) or _turned(order[:split], order[split:])
            if found is not None:
                return found
    return None


def _turned(inner: Sequence[Indices], outer: Sequence[Indices]) -> Optional[Turned]:
    turns = _listed(outer)
    if turns is None:
        return None
    first = factors_of(inner)
    if len(first.generators) < len(inner):
        return None
    everywhere = np.arange(len(inner[0]))
    for turn in outer:
        back = np.argsort(turn)
        if not all(_in_product(first.factors, everywhere, turn[g[back]]) for g in inner):
            return None
    return Turned(first.factors, turns)


def _in_product(factors: Sequence[Factor], places: Indices, image: Indices) -> bool:
    """Whether the permutation that takes ``places`` to ``image`` and moves no others belongs to the
    product of the groups; may be False although it does."""
    moved = dict(zip(places.tolist(), image.tolist()))
    rest = {p for p, q in moved.items() if p != q}
    for factor in factors:
        if isinstance(factor, Exchange) and not factor.inner:
            blocks = {tuple(block) for block in factor.blocks.tolist()}
            if any(tuple(moved.get(p, p) for p in block) not in blocks for block in blocks):
                return False
            rest -= {p for block in blocks for p in block}
        elif isinstance(factor, Listed):
            own = factor.places.tolist()
            if [moved.get(p, p) for p in own] not in factor.images.tolist():
                return False
            rest -= set(own)
    return not rest


def _wreath(inner: Sequence[Indices], outer: Sequence[Indices]) -> Optional[Exchange]:
    blocks = _exchanged(outer) if len(outer) > 1 else _halves(inner, outer[0])
    if blocks is None:
        return None
    block_of = np.full(len(outer[0]), -1, dtype=np.int64)
    block_of[blocks] = np.arange(len(blocks))[:, None]
    # the same moves within the first block
    moves: List[Indices] = []
    for generator in inner:
        own = np.unique(block_of[_support(generator)])
        if len(own) != 1 or own[0] < 0:
            return None
        here = blocks[own[0]]
        there = np.arange(len(generator))
        there[here] = blocks[0]
        move = np.arange(len(generator))
        move[blocks[0]] = there[generator[here]]
        moves.append(move)
    first = factors_of(moves)
    if len(first.generators) < len(moves):
        return None
    factors: List[Factor] = []
    for block in blocks:
        to = np.arange(len(outer[0]))
        to[blocks[0]] = block
        factors += [factor.moved(to) for factor in first.factors]
    return Exchange(blocks, factors)


def _halves(inner: Sequence[Indices], swap: Indices) -> Optional[Indices]:
    """Two blocks swapped by a permutation, such that each of ``inner`` moves places of one
    block."""
    if (swap[swap] != np.arange(len(swap))).any():
        return None
    half: Dict[int, bool] = {}
    for group in _connected(inner):
        places = sorted({int(p) for n in group for p in _support(inner[n])})
        if any(p in half for p in places):
            continue
        half.update((p, True) for p in places)
        half.update((int(swap[p]), False) for p in places)
        if not all(half[p] for p in places):
            return None
    for p in _support(swap).tolist():
        if p not in half:
            half[p], half[int(swap[p])] = True, False
    first = np.array([p for p in sorted(half) if half[p] and swap[p] != p], dtype=np.int64)
    if 2 * len(first) != len(_support(swap)):
        return None
    return np.array([first, swap[first]])


def ones(number: int, order: int) -> Indices:
    """An array of ``number`` ones that can hold the orbit sizes of a group of this order."""
    return np.ones(number, dtype=np.int64 if order < 2**62 else object)

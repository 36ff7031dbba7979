"""The random numbers of a run: hashes of the log position, so that every replica makes the same
draw."""

from __future__ import annotations

import hashlib
from typing import Iterable, Iterator, Sequence, Tuple, TypeVar

T = TypeVar("T")


def uniform(seed: int, slot: int, index: int, who: str) -> float:
    """A number in [0, 1): the first 53 bits of the SHA-256 of the seed, the log slot, the index in
    the slot, and what the draw is for: the name of a robot, or words that name none."""
    digest = hashlib.sha256(("%d|%d|%d|%s" % (seed, slot, index, who)).encode()).digest()
    return (int.from_bytes(digest[:7], "big") >> 3) / (1 << 53)


def choose(choices: Sequence[Tuple[T, float]], number: float) -> T:
    """The choice that ``number`` in [0, 1) selects.

    :param choices: choices with their weights (>= 0, at least one > 0), which need not sum to 1.
    """
    target = number * sum(weight for _, weight in choices)
    for choice, weight in choices:
        target -= weight
        if target < 0:
            return choice
    return [choice for choice, weight in choices if weight > 0][-1]


def shuffled(items: Iterable[T], seed: int, slot: int, index: int, who: str) -> Iterator[T]:
    """The items in random order, each drawn from those that are left when it is asked for; see
    :func:`uniform`."""
    left = list(items)
    for k in range(len(left) - 1):
        yield left.pop(int(uniform(seed, slot, index, "%s#%d" % (who, k)) * len(left)))
    yield from left

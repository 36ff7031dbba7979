"""A bounded cache of values that are costly to make: like ``functools.lru_cache``, but for values
that depend on more than their key."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Callable, Generic, Hashable, TypeVar

_Key = TypeVar("_Key", bound=Hashable)
_Value = TypeVar("_Value")


class Kept(Generic[_Key, _Value]):
    """Caches the ``most`` values requested last. Thread-safe.

    >>> squares = Kept(most=2)
    >>> [squares.get(n, lambda: n * n) for n in (1, 2, 1, 3)], len(squares)
    ([1, 4, 1, 9], 2)
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._values: OrderedDict[_Key, _Value] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: _Key, make: Callable[[], _Value]) -> _Value:
        """Get the value of a key. If it is not cached, ``make`` creates it; exceptions propagate.
        Two threads that request a new key at once may both create its value."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
        value = make()
        with self._lock:
            self._values[key] = value
            while len(self._values) > self._most:
                self._values.popitem(last=False)
        return value

    def __len__(self) -> int:
        return len(self._values)

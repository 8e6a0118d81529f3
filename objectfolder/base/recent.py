"""The last few of the values that a method has computed."""

import threading
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

_Value = TypeVar("_Value")


class Recent(Generic[_Value]):
    """Values by key, of which the ones asked for last are kept.

    Unlike a method in `functools.lru_cache`, it holds no reference to the object whose method it is, which
    can therefore go as soon as nobody else needs it, and its memory with it.

    ``size``: values that are kept.
    """

    def __init__(self, size: int):
        self._size, self._kept, self._lock = size, dict[Hashable, _Value](), threading.Lock()

    def of(self, key: Hashable, make: Callable[[], _Value]) -> _Value:
        """Return the value of a key; make it unless it is kept. Threads may make one at the same time."""
        with self._lock:
            if key in self._kept:
                value = self._kept[key] = self._kept.pop(key)  # now the last
                return value
        value = make()
        with self._lock:
            self._kept[key] = value
            while len(self._kept) > self._size:
                del self._kept[next(iter(self._kept))]
        return value

"""Which stage comes next: a ready queue ordered by group and longest remaining path. Knows nothing of DVC."""

import heapq
from collections.abc import Callable, Iterable, Mapping, Set


def object_groups(addresses: Iterable[str], size: int) -> Callable[[str], int]:
    """Group stages by their objects, so many to a group; stages of no object come first.

    A build of a thousand objects then finishes them a few at a time, and not all of them at its end.
    """
    keys = dict.fromkeys(key for _, _, key in (address.partition("@") for address in addresses) if key)
    places = {key: place // size for place, key in enumerate(keys)}
    return lambda address: places.get(address.partition("@")[2], -1)


def remaining_paths(upstream: Mapping[str, Set[str]], weight: Callable[[str], float]) -> dict[str, float]:
    """Length of the longest path from each stage to the end of the graph, the stage included.

    Parameters
    ----------
    upstream : mapping of str to set of str
        Direct upstream stages of every stage; the keys are in topological order.
    weight : callable
        Cost of a stage.
    """
    below = dict.fromkeys(upstream, 0.0)
    for address in reversed(list(upstream)):
        for parent in upstream[address]:
            below[parent] = max(below[parent], below[address] + weight(address))
    return {address: below[address] + weight(address) for address in upstream}


class Schedule:
    """Stages whose upstream is done, the most urgent first.

    Parameters
    ----------
    upstream : mapping of str to set of str
        Direct upstream stages of every stage; the keys are in topological order.
    weight : callable
        Rough cost of a stage. Only the order matters: the longest chain should start first.
    group : callable
        Number of the group that a stage belongs to; a lower one comes first, whatever is left to do after it.
    """

    def __init__(
        self,
        upstream: Mapping[str, Set[str]],
        weight: Callable[[str], float],
        group: Callable[[str], int] = lambda address: 0,
    ):
        self._waiting = {address: set(parents) for address, parents in upstream.items()}
        self._downstream: dict[str, list[str]] = {address: [] for address in upstream}
        for address, parents in upstream.items():
            for parent in parents:
                self._downstream[parent].append(address)
        lengths = remaining_paths(upstream, weight)
        # Ties go to the topological order, so that a build is the same every time.
        self.rank = {
            address: (group(address), -lengths[address], place) for place, address in enumerate(upstream)
        }
        self._ready: list[tuple[tuple[int, float, int], str]] = []
        for address, parents in self._waiting.items():
            if not parents:
                self._push(address)

    def pop(self) -> str | None:
        """Take the most urgent ready stage; None if there is none at the moment."""
        return heapq.heappop(self._ready)[1] if self._ready else None

    def finish(self, address: str) -> None:
        """Record that a stage is done: what waited only for it becomes ready."""
        for child in self._downstream[address]:
            self._waiting[child].discard(address)
            if not self._waiting[child]:
                self._push(child)

    def downstream(self, address: str) -> list[str]:
        """All stages that depend on this one, directly or not, in topological order."""
        found: set[str] = set()
        stack = [address]
        while stack:
            new = set(self._downstream[stack.pop()]) - found
            found |= new
            stack.extend(new)
        return sorted(found, key=lambda name: self.rank[name][-1])

    def _push(self, address: str) -> None:
        heapq.heappush(self._ready, (self.rank[address], address))

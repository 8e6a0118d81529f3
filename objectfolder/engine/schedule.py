"""Order of stages: a queue of ready stages by group and longest remaining path, independent of DVC."""

import heapq
from collections.abc import Callable, Iterable, Mapping, Set


def object_groups(addresses: Iterable[str], size: int) -> Callable[[str], int]:
    """Return a function from stages to groups of ``size`` objects; stages without an object come first.

    With groups, a build of a thousand objects finishes them a few at a time instead of all at the end.
    """
    keys = dict.fromkeys(key for _, _, key in (address.partition("@") for address in addresses) if key)
    places = {key: place // size for place, key in enumerate(keys)}
    return lambda address: places.get(address.partition("@")[2], -1)


def remaining_paths(upstream: Mapping[str, Set[str]], weight: Callable[[str], float]) -> dict[str, float]:
    """Return the length of the longest path from each stage to the end of the graph, including the stage.

    ``upstream``: direct upstream stages of every stage; the keys are in topological order; ``weight``: cost
    of a stage.
    """
    below = dict.fromkeys(upstream, 0.0)
    for address in reversed(list(upstream)):
        for parent in upstream[address]:
            below[parent] = max(below[parent], below[address] + weight(address))
    return {address: below[address] + weight(address) for address in upstream}


class Schedule:
    """Priority queue of the stages whose upstream stages are done.

    ``upstream``: direct upstream stages of every stage; the keys are in topological order; ``weight``: rough
    cost of a stage; only the order of the sums matters, since the longest chain starts first; ``group``:
    group number of a stage; lower numbers come first, whatever their remaining paths.
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
        # Topological order breaks ties, so that builds are reproducible.
        self.rank = {
            address: (group(address), -lengths[address], place) for place, address in enumerate(upstream)
        }
        self._ready: list[tuple[tuple[int, float, int], str]] = []
        for address, parents in self._waiting.items():
            if not parents:
                self._push(address)

    def pop(self) -> str | None:
        """Remove and return the first ready stage; None if no stage is ready."""
        return heapq.heappop(self._ready)[1] if self._ready else None

    def finish(self, address: str) -> None:
        """Mark a stage as done; stages that waited only for it become ready."""
        for child in self._downstream[address]:
            self._waiting[child].discard(address)
            if not self._waiting[child]:
                self._push(child)

    def downstream(self, address: str) -> list[str]:
        """Return all direct and indirect downstream stages, in topological order."""
        found: set[str] = set()
        stack = [address]
        while stack:
            new = set(self._downstream[stack.pop()]) - found
            found |= new
            stack.extend(new)
        return sorted(found, key=lambda name: self.rank[name][-1])

    def _push(self, address: str) -> None:
        heapq.heappush(self._ready, (self.rank[address], address))

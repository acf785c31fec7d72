"""Maximum-weight clique of a small graph whose vertices fall into groups that exclude each other."""

import numpy as np

from neuse.geometry import Array

LIKENESS = 0.25  # what perfect likeness adds to the weight of a possible match: it only breaks ties of number


def max_weight_clique(adjacent: np.ndarray, weights: Array, groups: np.ndarray) -> list[int]:
    """Heaviest set of mutually adjacent vertices, by branch and bound; the first found wins a tie.

    Args:
        adjacent: (p, p) bool, symmetric; vertices of one group are never adjacent.
        weights: (p,) positive.    groups: (p,) integers.
    Returns:
        Indices in increasing order; empty if there is no vertex.
    """
    search = _Search(adjacent, weights, groups)
    search.expand([], 0.0, [int(v) for v in np.argsort(-weights, kind="stable")])
    return sorted(search.best)


def match_weights(shapes: Array) -> Array:
    """Weights of possible matches, by the cosines of their descriptors."""
    return 1.0 + LIKENESS * np.maximum(shapes, 0.0)


class _Search:
    def __init__(self, adjacent: np.ndarray, weights: Array, groups: np.ndarray) -> None:
        self.neighbors = [set(np.flatnonzero(row).tolist()) for row in adjacent]
        self.weights, self.groups = weights.tolist(), groups.tolist()
        self.best: list[int] = []
        self.best_weight = 0.0

    def expand(self, chosen: list[int], weight: float, candidates: list[int]) -> None:
        """Try every way to extend `chosen` by candidates, which come heaviest first."""
        if weight > self.best_weight:
            self.best, self.best_weight = chosen, weight
        for position, vertex in enumerate(candidates):
            rest = candidates[position:]
            if weight + self._bound(rest) <= self.best_weight:
                return
            compatible = [u for u in rest[1:] if u in self.neighbors[vertex]]
            self.expand([*chosen, vertex], weight + self.weights[vertex], compatible)

    def _bound(self, candidates: list[int]) -> float:
        """No clique among candidates weighs more: the heaviest vertex of each group."""
        heaviest = {self.groups[v]: self.weights[v] for v in reversed(candidates)}
        return sum(heaviest.values())

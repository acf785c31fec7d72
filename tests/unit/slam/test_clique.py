"""The clique search against brute force."""

from itertools import combinations

import numpy as np
import pytest

from neuse.slam.clique import max_weight_clique


def brute_force_weight(adjacent, weights):
    """Weight of the heaviest clique by trying every set."""
    best = 0.0
    for size in range(1, len(weights) + 1):
        for chosen in combinations(range(len(weights)), size):
            if all(adjacent[u, v] for u, v in combinations(chosen, 2)):
                best = max(best, weights[list(chosen)].sum())
    return best


def random_graph(rng, n):
    groups = rng.integers(0, 4, size=n)
    adjacent = rng.random((n, n)) < 0.6
    adjacent = np.triu(adjacent, 1) & (groups[:, None] != groups[None])
    return adjacent | adjacent.T, rng.uniform(1.0, 1.5, size=n), groups


@pytest.mark.parametrize("seed", range(20))
def test_clique_weighs_as_much_as_the_heaviest_of_all_sets(seed):
    adjacent, weights, groups = random_graph(np.random.default_rng(seed), 11)
    clique = max_weight_clique(adjacent, weights, groups)
    assert all(adjacent[u, v] for u, v in combinations(clique, 2))
    assert weights[clique].sum() == pytest.approx(brute_force_weight(adjacent, weights))


def test_graph_without_vertices_has_no_clique():
    assert max_weight_clique(np.zeros((0, 0), bool), np.zeros(0), np.zeros(0, int)) == []


def test_first_of_equal_cliques_wins():
    adjacent = ~np.eye(4, dtype=bool) & (np.arange(4)[:, None] // 2 == np.arange(4)[None] // 2)
    assert max_weight_clique(adjacent, np.ones(4), np.array([0, 1, 0, 1])) == [0, 1]

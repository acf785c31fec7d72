"""Mugs: walls and families."""

import numpy as np
import pytest

from neuse.simulation.handles import HANDLES, sample_handle
from neuse.simulation.mugs import BODIES, HELD_OUT_BODIES, sample_mug
from neuse.simulation.solids import to_trimesh


@pytest.mark.parametrize("seed", range(12))
def test_wall_is_between_one_and_eight_millimetres_thick(seed: int) -> None:
    _, mesh = sample_mug(np.random.default_rng(seed))
    heights = np.linspace(0.35, 0.85, 8) * mesh.bounds[1, 2]
    origins = np.stack([np.zeros(8), np.zeros(8), heights], axis=1)
    hits, rays, _ = mesh.ray.intersects_location(origins, np.tile([-0.6, 0.8, 0.0], (8, 1)))
    radius = np.linalg.norm(hits[:, :2], axis=1)
    walls = [np.ptp(radius[rays == ray]) for ray in range(8)]
    # measured level, a slanted wall is thicker than it is
    assert min(walls) > 0.0019
    assert min(walls) < 0.0075


def test_held_out_mugs_have_a_held_out_body_or_handle() -> None:
    for seed in range(10):
        name, _ = sample_mug(np.random.default_rng(seed), held_out=True)
        assert any(family in name for family in (*HELD_OUT_BODIES, "hook", "triangle"))


@pytest.mark.parametrize("name", HANDLES)
def test_handle_is_one_closed_solid_from_inside_the_body_to_beyond_it(name: str) -> None:
    for seed in range(8):
        handle = sample_handle(
            name, lambda z: np.full_like(z, 0.04, dtype=float), 0.09, np.random.default_rng(seed)
        )
        mesh = to_trimesh(handle)
        assert mesh.is_volume
        assert mesh.body_count == 1
        assert mesh.bounds[0, 0] < 0.03
        assert mesh.bounds[1, 0] > 0.05
        assert mesh.bounds[0, 2] > 0
        assert mesh.bounds[1, 2] < 0.09


def test_bodies_reach_from_foot_to_rim() -> None:
    for corners in BODIES.values():
        assert corners[0][1] == (0, 0)
        assert corners[-1][1] == (1, 1)

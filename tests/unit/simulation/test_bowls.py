"""Bowls: wide, round, open at the top, with a wall of some thickness."""

import numpy as np
import pytest

from neuse.simulation import bowls
from neuse.simulation.bowls import FAMILIES, HELD_OUT, sample_bowl


@pytest.mark.parametrize("family", FAMILIES)
def test_bowl_is_a_round_vessel_of_real_size_and_wall(family: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bowls, "FAMILIES", {family: FAMILIES[family]})
    for seed in range(3):
        name, mesh = sample_bowl(np.random.default_rng(seed), held_out=family in HELD_OUT)
        width, depth, height = mesh.extents
        assert name == family
        assert mesh.is_volume
        assert 0.09 * 0.99 <= width <= 0.25
        assert width == pytest.approx(depth, rel=1e-3)
        assert 0.028 * 0.99 <= height <= 0.6 * width
        thickness = mesh.volume / (mesh.area / 2)
        assert 0.001 < thickness < 0.012


@pytest.mark.parametrize("seed", range(4))
def test_rays_down_the_axis_reach_the_floor_and_rays_up_do_not_enter(seed: int) -> None:
    _, mesh = sample_bowl(np.random.default_rng(seed))
    height = mesh.extents[2]
    hits, rays, _ = mesh.ray.intersects_location(
        [[0.004, 0.003, 1.0], [0.004, 0.003, -1.0]], [[0, 0, -1.0], [0, 0, 1.0]], multiple_hits=False
    )
    floor, foot = hits[np.argsort(rays), 2]
    assert foot < floor < 0.5 * height
    assert foot < 0.2 * height

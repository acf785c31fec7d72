"""Procedural colours."""

import numpy as np
import pytest

from neuse.simulation.textures import KINDS, Texture, sample_texture, texture_color

A, B = (10, 20, 30), (200, 210, 220)


def cylinder_points() -> np.ndarray:
    angle, z = np.meshgrid(np.linspace(-np.pi, np.pi, 100), np.linspace(-0.05, 0.05, 101))
    return np.stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), z], axis=-1).reshape(-1, 3)


def test_plain_texture_has_one_color() -> None:
    colors = texture_color(Texture("plain", A, B), cylinder_points())
    assert colors.dtype == np.uint8
    assert np.all(colors == A)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "plain"])
def test_pattern_shows_both_colors_and_only_inside_its_band(kind: str) -> None:
    points = cylinder_points()
    texture = Texture(kind, A, B, scale_m=0.02, band_m=(-0.03, 0.03), twist=1)
    patterned = np.all(texture_color(texture, points) == B, axis=1)
    inside = np.abs(points[:, 2]) <= 0.03
    assert 0.1 < patterned[inside].mean() < 0.9
    assert not patterned[~inside].any()


def test_straight_stripes_repeat_with_their_period() -> None:
    points = cylinder_points() + np.array([0, 0, 1e-4])
    texture = Texture("stripes", A, B, scale_m=0.02)
    shifted = texture_color(texture, points + np.array([0, 0, 0.02]))
    np.testing.assert_array_equal(texture_color(texture, points), shifted)


@pytest.mark.parametrize("twist", [-2, 1])
def test_twisted_pattern_has_no_seam(twist: int) -> None:
    z = np.linspace(-0.05, 0.05, 500)
    sides = [np.stack([np.full(500, -0.03), np.full(500, y), z], axis=1) for y in (-1e-9, 1e-9)]
    texture = Texture("stripes", A, B, twist=twist)
    left, right = (texture_color(texture, side) for side in sides)
    assert np.mean(left != right) < 0.01


def test_sampled_textures_are_of_all_kinds() -> None:
    rng = np.random.default_rng(0)
    textures = [sample_texture(rng, 0.1) for _ in range(60)]
    assert {texture.kind for texture in textures} == set(KINDS)
    assert all(-0.05 < texture.band_m[0] < texture.band_m[1] < 0.05 for texture in textures)

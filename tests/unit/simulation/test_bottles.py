"""Bottles: sizes and outlines of each family."""

import numpy as np
import pytest

from neuse.simulation import bottles
from neuse.simulation.bottles import FAMILIES, HELD_OUT, sample_bottle


@pytest.fixture(params=FAMILIES)
def only_family(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(bottles, "FAMILIES", {request.param: FAMILIES[request.param]})
    return request.param


def test_bottle_keeps_the_size_and_slenderness_of_its_family(only_family: str) -> None:
    family = FAMILIES[only_family]
    for seed in range(4):
        _, mesh = sample_bottle(np.random.default_rng(seed), held_out=only_family in HELD_OUT)
        height, widths = mesh.extents[2], mesh.extents[:2]
        assert mesh.is_volume
        assert family.height_m[0] <= height * (1 + 1e-6)
        assert height * (1 - 1e-6) <= family.height_m[1]
        slenderness = np.sqrt(widths.prod()) / 2 / height  # independent of the aspect
        assert family.slenderness[0] * 0.97 <= slenderness <= family.slenderness[1] * 1.03
        assert widths[0] / widths[1] == pytest.approx(
            np.clip(widths[0] / widths[1], *family.aspect), abs=0.01
        )


def test_neck_is_round_where_the_body_is_elliptic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bottles, "FAMILIES", {"shampoo": FAMILIES["shampoo"]})
    _, mesh = sample_bottle(np.random.default_rng(1))
    top = mesh.vertices[mesh.vertices[:, 2] > 0.95 * mesh.bounds[1, 2]]
    assert np.ptp(top[:, 0]) == pytest.approx(np.ptp(top[:, 1]), rel=0.05)
    assert mesh.extents[0] > 1.08 * mesh.extents[1]


def test_pump_has_a_small_spout_towards_x(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bottles, "FAMILIES", {"pump": FAMILIES["pump"]})
    for seed in range(5):
        _, mesh = sample_bottle(np.random.default_rng(seed))
        top = mesh.vertices[mesh.vertices[:, 2] > 0.94 * mesh.bounds[1, 2]]
        assert top[:, 0].max() > 1.3 * -top[:, 0].min()
        assert top[:, 0].max() < 0.95 * mesh.bounds[1, 0]

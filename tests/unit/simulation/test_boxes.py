"""Boxes: their sizes, and that half a turn about any of their axes hardly shows."""

import numpy as np
import pytest
import trimesh

from neuse.simulation import boxes
from neuse.simulation.boxes import FAMILIES, HELD_OUT, LEAST_M, LONGEST_M, sample_box
from neuse.simulation.self_similarity import symmetry_of_mesh
from neuse.symmetry import BOX


def drawn(family: str, monkeypatch: pytest.MonkeyPatch) -> list[trimesh.Trimesh]:
    monkeypatch.setattr(boxes, "FAMILIES", {family: FAMILIES[family]})
    return [sample_box(np.random.default_rng(seed), held_out=family in HELD_OUT)[1] for seed in range(4)]


@pytest.mark.parametrize("family", FAMILIES)
def test_box_is_a_centred_solid_of_real_size(family: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for mesh in drawn(family, monkeypatch):
        assert mesh.is_volume
        assert mesh.body_count == 1
        np.testing.assert_allclose(mesh.bounds.mean(axis=0), 0, atol=1e-6)
        assert mesh.extents.min() >= LEAST_M * 0.999
        assert LONGEST_M[0] * 0.999 <= mesh.extents.max() <= LONGEST_M[1] * 1.001
        assert 0.6 < mesh.volume / mesh.extents.prod() <= 1.0 + 1e-9


@pytest.mark.parametrize("family", FAMILIES)
def test_box_has_the_symmetry_of_a_box(family: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert all(symmetry_of_mesh(mesh) is BOX for mesh in drawn(family, monkeypatch)[:2])


def test_any_edge_may_be_the_longest() -> None:
    longest = {int(sample_box(np.random.default_rng(seed))[1].extents.argmax()) for seed in range(12)}
    assert longest == {0, 1, 2}

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from neuse import geometry
from neuse.errors import MeshError
from neuse.geometry import transform_points
from neuse.mapping.reconstruction import TOLERANCE_M, MeshCache, align_points, bounding_box, lighter

from .synthetic import RECONSTRUCT, decode, make_code, standing

MUG = standing("mug", 0.2, 0.1, category="mug")
BOTTLE = standing("bottle", -0.2, 0.1, height_m=0.2)
RNG = np.random.default_rng(0)


class CountingDecoder:
    def __init__(self):
        self.calls = 0

    def __call__(self, code):
        self.calls += 1
        return decode(code)


@pytest.mark.parametrize("thing", [MUG, BOTTLE], ids=["mug", "bottle"])
def test_shape_is_decoded_once_and_moves_with_the_code(thing):
    decoder = CountingDecoder()
    cache = MeshCache({thing.category: decoder}, 0.005)
    code = make_code(thing, thing.T_world_object, RNG)
    for _ in range(3):
        code = code.transformed(geometry.exp([0.1, 0.2, 0.3, 1.0, -1.0, 0.5]))
        moved, fresh = cache.mesh(7, code), decode(code)
        assert abs(moved.bounding_box_oriented.volume - fresh.bounding_box_oriented.volume) < 1e-6
        np.testing.assert_allclose(moved.center_mass, fresh.center_mass, atol=1e-9)
    assert decoder.calls == 1


def test_shape_is_decoded_anew_when_the_code_grows():
    decoder = CountingDecoder()
    cache = MeshCache({"mug": decoder}, 0.005)
    code = make_code(MUG, MUG.T_world_object, RNG)
    cache.mesh(7, code)
    cache.mesh(7, replace(code, z=code.center + 1.02 * (code.z - code.center)))
    assert decoder.calls == 1
    larger = replace(code, z=code.center + 1.3 * (code.z - code.center))
    assert cache.mesh(7, larger).volume == pytest.approx(decode(larger).volume)
    assert decoder.calls == 2


def test_forgotten_object_is_decoded_again():
    decoder = CountingDecoder()
    cache = MeshCache({"mug": decoder}, 0.005)
    code = make_code(MUG, MUG.T_world_object, RNG)
    cache.mesh(7, code)
    cache.forget(7)
    cache.forget(7)
    cache.mesh(7, code)
    assert decoder.calls == 2


def test_mesh_handed_out_may_be_changed():
    cache = MeshCache(RECONSTRUCT, 0.005)
    code = make_code(MUG, MUG.T_world_object, RNG)
    cache.mesh(7, code).apply_scale(10.0)
    assert cache.mesh(7, code).volume == pytest.approx(decode(code).volume)


def test_box_encloses_the_mesh_and_follows_the_code():
    cache = MeshCache(RECONSTRUCT, 0.005)
    code = make_code(MUG, MUG.T_world_object, RNG)
    for T in (np.eye(4), geometry.exp([0.5, 0.1, 0.2, 1.0, 2.0, 3.0])):
        box = cache.box(7, code.transformed(T), np.zeros((1, 3)))
        vertices = transform_points(
            geometry.inverse(box.T_map_box), cache.mesh(7, code.transformed(T)).vertices
        )
        np.testing.assert_allclose(np.abs(vertices).max(axis=0), box.size / 2, atol=1e-9)


def test_category_without_decoder_has_no_mesh_but_a_box_of_its_points():
    cache = MeshCache({}, 0.005)
    code = make_code(MUG, MUG.T_world_object, RNG)
    with pytest.raises(MeshError, match="mug"):
        cache.mesh(7, code)
    points = code.center + RNG.uniform(-0.05, 0.05, size=(500, 3))
    assert cache.box(7, code, points).size == pytest.approx([0.1, 0.1, 0.1], rel=0.5)


def test_decoder_that_refuses_leaves_the_box_of_the_points():
    def refuse(code):
        raise MeshError("empty")

    code = make_code(MUG, MUG.T_world_object, RNG)
    points = code.center + RNG.uniform(-0.05, 0.05, size=(50, 3))
    cache = MeshCache({"mug": refuse}, 0.005)
    np.testing.assert_array_equal(
        cache.box(7, code, points).size, bounding_box(points, code.T_frame_object).size
    )


def test_code_that_is_refused_is_not_tried_again_until_it_changes():
    calls = []

    def refuse(code):
        calls.append(code)
        raise MeshError("empty")

    code = make_code(MUG, MUG.T_world_object, RNG)
    cache = MeshCache({"mug": refuse}, 0.005)
    for moved in (code, code.transformed(geometry.exp([0.1, 0.2, 0.3, 1.0, -1.0, 0.5]))):
        with pytest.raises(MeshError, match="empty"):
            cache.mesh(7, moved)
    assert len(calls) == 1
    with pytest.raises(MeshError, match="empty"):
        cache.mesh(7, replace(code, z=code.center + 1.3 * (code.z - code.center)))
    assert len(calls) == 2


def test_who_has_no_time_gets_the_latest_shape_and_before_it_the_box_of_the_points():
    decoder = CountingDecoder()
    cache = MeshCache({"mug": decoder}, 0.005)
    code = make_code(MUG, MUG.T_world_object, RNG)
    points = code.center + RNG.uniform(-0.05, 0.05, size=(50, 3))
    with pytest.raises(MeshError, match="not been decoded"):
        cache.mesh(7, code, now=False)
    box = cache.box(7, code, points, now=False)
    np.testing.assert_array_equal(box.size, bounding_box(points, code.T_frame_object).size)
    assert decoder.calls == 0
    cache.decode(7, code)
    larger = replace(code, z=code.center + 1.3 * (code.z - code.center))
    assert cache.mesh(7, larger, now=False).volume == pytest.approx(decode(code).volume)
    np.testing.assert_allclose(cache.box(7, larger, points, now=False).size, cache.box(7, code, points).size)
    assert decoder.calls == 1


def test_shape_lags_behind_until_it_is_decoded_and_while_the_code_differs():
    cache = MeshCache(RECONSTRUCT, 0.005)
    code = make_code(MUG, MUG.T_world_object, RNG)
    larger = replace(code, z=code.center + 1.3 * (code.z - code.center))
    assert cache.lag_m(7, code) == np.inf
    cache.decode(7, code)
    assert cache.lag_m(7, code.transformed(geometry.exp([0.1, 0.2, 0.3, 1.0, -1.0, 0.5]))) == 0.0
    assert cache.lag_m(7, larger) > 0.005
    cache.decode(7, larger)
    assert cache.lag_m(7, larger) == 0.0


def test_alignment_recovers_a_motion_and_never_a_mirror():
    points, T = RNG.normal(size=(20, 3)), geometry.exp([1.0, -2.0, 0.5, 3.0, 2.0, 1.0])
    found, rms_m = align_points(points, transform_points(T, points))
    np.testing.assert_allclose(found, T, atol=1e-9)
    assert rms_m < 1e-9
    mirrored, rms_m = align_points(points, points * [1, 1, -1])
    assert np.linalg.det(mirrored[:3, :3]) == pytest.approx(1.0)
    assert rms_m > 0.1


def test_box_of_a_real_mesh_is_its_extents():
    mesh = trimesh.creation.cylinder(0.03, 0.2)
    np.testing.assert_allclose(bounding_box(mesh.vertices, np.eye(4)).size, mesh.extents)


def test_lighter_mesh_is_closed_and_has_the_same_surface_with_far_fewer_triangles():
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    light = lighter(mesh)
    assert light.is_watertight
    assert len(light.faces) < len(mesh.faces) / 5
    np.testing.assert_allclose(np.linalg.norm(light.vertices, axis=1), 0.05, atol=TOLERANCE_M)
    assert light.volume == pytest.approx(mesh.volume, rel=0.05)


def test_open_mesh_stays_as_it_is():
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    mesh.update_faces(np.arange(len(mesh.faces)) > 3)
    assert lighter(mesh) is mesh

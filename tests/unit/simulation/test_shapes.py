"""Properties that every procedural shape has."""

import re
from functools import cache

import numpy as np
import pytest

from neuse.errors import InputError
from neuse.simulation import bottles, bowls, boxes, handles, mugs
from neuse.simulation.shapes import Shape, categories, make_shape, sample_shape
from neuse.symmetry import AXIAL, NONE

N_SHAPES = 120


@cache
def shapes(category: str) -> list[Shape]:
    splits = ("train", "test")
    return [sample_shape(category, np.random.default_rng(seed), splits[seed % 2]) for seed in range(N_SHAPES)]


@pytest.mark.parametrize("category", categories())
def test_shape_is_one_closed_solid_with_outward_normals(category: str) -> None:
    for shape in shapes(category):
        assert shape.mesh.is_watertight, shape.name
        assert shape.mesh.is_winding_consistent, shape.name
        assert shape.mesh.volume > 0, shape.name
        assert shape.mesh.body_count == 1, shape.name


@pytest.mark.parametrize("category", categories())
def test_mesh_is_detailed_but_small(category: str) -> None:
    least = 12 if category == "box" else 3000
    assert all(least <= len(shape.mesh.faces) <= 15000 for shape in shapes(category))


@pytest.mark.parametrize("category", categories())
def test_origin_is_at_mid_height_and_extents_bound_the_mesh(category: str) -> None:
    for shape in shapes(category):
        low, high = shape.mesh.bounds
        assert low[2] == pytest.approx(-high[2], abs=1e-9)
        assert shape.extents[2] == pytest.approx(high[2], abs=1e-9)
        assert shape.extents[0] >= high[0] - 1e-9
        assert shape.extents[1] >= high[1] - 1e-9
        assert shape.extents[0] >= -low[0] - 1e-9


def test_mug_has_its_handle_on_positive_x() -> None:
    for shape in shapes("mug"):
        low, high = shape.mesh.bounds
        assert high[0] > max(high[1], -low[0]) + 0.008, shape.name
        assert shape.extents[0] == pytest.approx(high[0])
        assert -low[0] == pytest.approx(shape.extents[1], rel=0.09), shape.name


def test_mug_is_mirror_symmetric_about_the_plane_of_its_handle() -> None:
    for shape in shapes("mug"):
        center, inertia = shape.mesh.center_mass, shape.mesh.moment_inertia
        assert abs(center[1]) < 1e-5, shape.name
        assert np.abs(inertia[1, [0, 2]]).max() < 2e-3 * inertia[1, 1], shape.name


def test_rays_down_the_axis_reach_the_floor_of_a_mug_and_rays_up_do_not_enter_it() -> None:
    for shape in shapes("mug"):
        half_height, radius = shape.extents[2], 0.1 * shape.extents[1]
        origins = [[radius, 0, 1.0], [0, radius, 1.0], [-radius, 0, -1.0], [0, -radius, -1.0]]
        directions = [[0, 0, -1.0]] * 2 + [[0, 0, 1.0]] * 2
        hits, rays, _ = shape.mesh.ray.intersects_location(origins, directions, multiple_hits=False)
        assert np.all(hits[rays < 2, 2] < -0.5 * half_height), shape.name
        assert np.all(hits[rays >= 2, 2] < -half_height + 0.008), shape.name


def test_handle_does_not_show_inside_the_cavity() -> None:
    for shape in shapes("mug"):
        heights = np.linspace(-0.4, 0.7, 12) * shape.extents[2]
        origins = np.stack([np.zeros(12), np.zeros(12), heights], axis=1)
        reach = [
            np.linalg.norm(
                shape.mesh.ray.intersects_location(origins, [[x, 0, 0]] * 12, False)[0][:, :2], axis=1
            )
            for x in (-1.0, 1.0)
        ]
        np.testing.assert_allclose(reach[0], reach[1], rtol=0.02, err_msg=shape.name)


def test_bottle_has_no_cavity() -> None:
    for shape in shapes("bottle"):
        hits = shape.mesh.ray.intersects_location([[1e-4, 2e-4, 1.0]], [[0, 0, -1.0]])[0]
        assert len(hits) == 2, shape.name


def test_bottle_is_much_the_same_around_its_axis() -> None:
    for shape in shapes("bottle"):
        moments = np.linalg.norm(shape.mesh.vertices[:, :2], axis=1).max() / (0.5 * shape.mesh.extents[:2])
        assert moments.max() < 1.4, shape.name


def test_sizes_cover_espresso_to_soup_and_vial_to_magnum() -> None:
    mug_radii = [shape.extents[1] for shape in shapes("mug")]
    bottle_heights = [2 * shape.extents[2] for shape in shapes("bottle")]
    assert min(mug_radii) < 0.03
    assert max(mug_radii) > 0.06
    assert min(bottle_heights) < 0.06
    assert max(bottle_heights) > 0.35


def test_held_out_families_never_train_and_are_a_part_of_the_test() -> None:
    held_out = {*mugs.HELD_OUT_BODIES, *handles.HELD_OUT_HANDLES}
    held_out |= {*bottles.HELD_OUT, *bowls.HELD_OUT, *boxes.HELD_OUT}

    def share(split: int) -> float:
        names = [shape.name for category in categories() for shape in shapes(category)[split::2]]
        return float(np.mean([not held_out.isdisjoint(re.findall("[a-z]+", name)) for name in names]))

    assert share(0) == 0
    assert 0.1 < share(1) < 0.4


def test_every_family_occurs() -> None:
    names = " ".join(shape.name for category in categories() for shape in shapes(category))
    families = {*mugs.BODIES, *handles.HANDLES, *bottles.FAMILIES, *bowls.FAMILIES, *boxes.FAMILIES}
    assert {family for family in families if family not in names} == set()


@pytest.mark.parametrize("category", categories())
def test_same_seed_gives_the_same_shape(category: str) -> None:
    again = sample_shape(category, np.random.default_rng(5), "test")
    shape = shapes(category)[5]
    assert (again.name, again.texture) == (shape.name, shape.texture)
    np.testing.assert_array_equal(again.mesh.vertices, shape.mesh.vertices)
    assert again != shape  # identity, so that shapes can be keys


def test_only_what_is_round_is_ambiguous() -> None:
    ambiguous = {category for category in categories() if shapes(category)[0].ambiguous}
    assert ambiguous == {"bottle", "bowl"}


def test_symmetry_is_that_of_the_category_unless_it_is_told() -> None:
    mesh = shapes("mug")[0].mesh
    assert make_shape("plain", "mug", mesh).symmetry is NONE
    assert make_shape("plain", "kettle", mesh).symmetry is NONE
    told = make_shape("plain", "kettle", mesh, symmetry=AXIAL)
    assert told.ambiguous
    assert told.extents[0] == told.extents[1]


def test_extents_of_a_box_are_its_half_sizes() -> None:
    for shape in shapes("box"):
        np.testing.assert_allclose(shape.extents, shape.mesh.extents / 2, atol=1e-6)


def test_color_is_the_ground_of_the_texture() -> None:
    shape = shapes("mug")[0]
    assert shape.color == shape.texture.color_a
    assert make_shape("plain", "mug", shape.mesh).texture.kind == "plain"


def test_unknown_category_is_refused() -> None:
    with pytest.raises(InputError, match="teapot"):
        sample_shape("teapot", np.random.default_rng(0))


def test_unknown_split_is_refused() -> None:
    with pytest.raises(InputError, match="holdout"):
        sample_shape("mug", np.random.default_rng(0), "holdout")

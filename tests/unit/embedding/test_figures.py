from dataclasses import replace

import numpy as np
import pytest

from neuse.embedding.figures import (
    PairError,
    descriptor_figures,
    flip_rate,
    handle_seen,
    nees_by_bin,
    pair_errors,
    shape_figures,
    spread,
    summarise,
)
from neuse.embedding.sightings import Sighting
from neuse.errors import InputError
from neuse.geometry import Array, exp, inverse

from .tiny import block_bottle, block_mug, make_code

MUGS, BOTTLES = [block_mug(), block_mug()], [block_bottle(), block_bottle()]
PLACES = {id(shape): exp([0, 0, i, 0.2 * i, 0.1 * i**2, 1.5]) for i, shape in enumerate(MUGS + BOTTLES)}
NO_ERROR = np.eye(4)
T_B_A = exp([0.1, 0.7, -0.2, 0.4, -0.1, 0.2])


def sighting(shape, view, T_camera_scene, T_error: Array = NO_ERROR, **changes) -> Sighting:
    """What a perfect encoder, or one that is wrong by T_error in the object frame, makes of a view."""
    T_camera_object = T_camera_scene @ PLACES[id(shape)]
    code = make_code(T_camera_object @ T_error, shape.category)
    code = replace(code, sigmas=np.full(6, 0.01))
    return replace(Sighting(0, view, shape, T_camera_object, 1.0, 0.1, code), **changes)


def two_views(shapes, T_error: Array = NO_ERROR):
    first = [sighting(shape, 0, np.eye(4)) for shape in shapes]
    return first + [sighting(shape, 1, T_B_A, T_error) for shape in shapes]


@pytest.mark.parametrize(
    "n_each", [{"mug": 1}, {"bottle": 1}, {"mug": 1, "bottle": 1}, {"mug": 2, "bottle": 2}], ids=str
)
def test_perfect_codes_have_no_error(n_each):
    (error,) = pair_errors(two_views(MUGS + BOTTLES), n_each)
    assert error.angle_deg == pytest.approx(0.0, abs=1e-4)
    assert error.shift_m == pytest.approx(0.0, abs=1e-9)


def test_error_of_a_lone_mug_is_that_of_its_code():
    (error,) = pair_errors(two_views(MUGS[:1], exp([0.0, 0.2, 0.0, 0.003, 0.0, 0.004])), {"mug": 1})
    assert error.angle_deg == pytest.approx(np.degrees(0.2), abs=1e-3)
    assert error.shift_m == pytest.approx(0.005, abs=1e-4)
    assert error.nees > 20  # its sigmas are 0.01 rad and m


def test_error_of_a_lone_bottle_is_that_of_its_axis():
    about_the_axis, tilt = exp([0, 0, 1.0, 0, 0, 0]), exp([0.2, 0, 0, 0, 0, 0.006])
    (error,) = pair_errors(two_views(BOTTLES[:1], tilt @ about_the_axis), {"bottle": 1})
    assert error.angle_deg == pytest.approx(np.degrees(0.2), abs=1e-3)
    assert error.shift_m == pytest.approx(0.006, abs=1e-4)
    assert error.nees is None


def test_view_change_is_the_angle_between_the_directions_of_sight():
    (error,) = pair_errors(two_views(MUGS[:1]), {"mug": 1})
    T_a, T_b = PLACES[id(MUGS[0])], T_B_A @ PLACES[id(MUGS[0])]
    eyes = [inverse(T)[:3, 3] / np.linalg.norm(T[:3, 3]) for T in (T_a, T_b)]  # seen from the object
    assert error.view_change_deg == pytest.approx(np.degrees(np.arccos(eyes[0] @ eyes[1])), abs=1e-6)


def test_every_two_views_are_a_pair_and_the_worse_view_counts():
    views = [
        sighting(MUGS[0], 0, np.eye(4), visible=0.9, handle=0.2),
        sighting(MUGS[0], 1, T_B_A, visible=0.4, handle=0.3),
        sighting(MUGS[0], 2, inverse(T_B_A), visible=0.8, handle=0.0),
    ]
    errors = pair_errors(views, {"mug": 1})
    assert [(e.visible, e.handle) for e in errors] == [(0.4, 0.2), (0.8, 0.0), (0.4, 0.0)]


def test_views_without_enough_common_objects_are_no_pair():
    views = [sighting(MUGS[0], 0, np.eye(4)), sighting(MUGS[1], 1, T_B_A)]
    assert pair_errors(views, {"mug": 1}) == []
    assert pair_errors(two_views(MUGS[:1]), {"mug": 2}) == []


def test_pair_that_determines_no_pose_is_left_out():
    views = two_views(MUGS[:1])
    views[0] = replace(views[0], code=replace(views[0].code, sigmas=np.full(6, np.pi)))
    assert pair_errors(views, {"mug": 1}) == []


def error(**changes) -> PairError:
    """An error of 10 degrees and 2 mm, close and well seen, unless changed."""
    return replace(PairError(10.0, 0.002, 6.0, 45.0, 1.0, 1.0, 0.1), **changes)


def test_summary_is_of_the_view_changes_asked_for_in_degrees_and_millimetres():
    errors = [error(), error(view_change_deg=70.0, angle_deg=30.0)]
    summary = summarise(errors, 0, 60)
    assert summary["rotation_deg"] == {"n": 1, "median": 10.0, "p90": 10.0}
    assert summary["translation_mm"]["median"] == pytest.approx(2.0)
    assert summarise(errors)["rotation_deg"]["median"] == 20.0


def test_spread_of_nothing_is_not_a_number():
    assert spread([])["n"] == 0
    assert np.isnan([spread([])["median"], spread([])["p90"]]).all()


def test_handle_counts_as_seen_only_where_both_views_show_it():
    assert handle_seen([error(handle=0.1), error(handle=0.01)]) == [error(handle=0.1)]


def test_flips_are_counted_among_near_and_visible_pairs():
    errors = [error(angle_deg=170.0), error(), error(), error()]
    unfair = [error(angle_deg=170.0, range_m=3.5), error(angle_deg=170.0, visible=0.5)]
    assert flip_rate(errors + unfair) == {"n": 4, "rate": 0.25}
    assert np.isnan(flip_rate(unfair)["rate"])


def test_nees_is_per_degree_of_freedom_in_its_bin():
    errors = [error(nees=6.0), error(nees=18.0), error(nees=None), error(nees=60.0, visible=0.3)]
    bins = nees_by_bin(errors)
    assert bins["30-60 deg, visible"]["n"] == 2
    assert bins["30-60 deg, visible"]["mean"] == pytest.approx(2.0)
    assert bins["30-60 deg, occluded"]["mean"] == pytest.approx(10.0)
    assert bins["0-30 deg, visible"]["n"] == 0


def test_descriptors_that_name_the_shape_are_perfect():
    rng = np.random.default_rng(0)
    shapes = [block_mug() for _ in range(8)]
    seen = []
    for index, shape in enumerate(shapes):
        code = replace(make_code(np.eye(4)), descriptor=np.eye(8)[index])
        seen += [Sighting(0, view, shape, np.eye(4), 1.0, 0.1, code) for view in range(3)]
    assert descriptor_figures(seen, rng) == {"n": 24, "eer": 0.0, "retrieval": 1.0}
    confused = [replace(s, code=replace(s.code, descriptor=rng.normal(size=8))) for s in seen]
    assert descriptor_figures(confused, rng)["retrieval"] < 0.6


class FakeEmbedding:
    """Decodes to the true bottle at its place, scaled; or to nothing."""

    def __init__(self, scale):
        self.scale = scale

    def reconstruct(self, code):
        if self.scale is None:
            raise InputError("empty_reconstruction", "nothing")
        mesh = block_bottle().mesh.copy().apply_scale(self.scale)
        return mesh.apply_transform(code.T_frame_object)


def test_shape_figures_compare_solids_at_their_places():
    rng = np.random.default_rng(1)
    seen = [sighting(BOTTLES[0], 0, np.eye(4))]
    perfect = shape_figures(FakeEmbedding(1.0), seen, rng)
    assert perfect["iou"]["median"] > 0.99
    assert perfect["surface_mm"]["median"] < 2.5  # the distance between samples
    larger = shape_figures(FakeEmbedding(1.1), seen, rng)
    assert larger["iou"]["median"] == pytest.approx(1.1**-3, abs=0.05)
    assert larger["surface_mm"]["median"] > perfect["surface_mm"]["median"] + 1.0


def test_codes_that_decode_to_nothing_are_counted():
    figures = shape_figures(
        FakeEmbedding(None), [sighting(BOTTLES[0], 0, np.eye(4))], np.random.default_rng(2)
    )
    assert figures["failed"] == 1
    assert figures["iou"]["n"] == 0

"""Changes by geometry: boxes on a table below a camera that looks straight down."""

import numpy as np
import pytest

from neuse.embedding.code import Code
from neuse.evaluation.occupied_space import geometric_changes
from neuse.evaluation.trajectory import trajectory_of
from neuse.geometry import make_transform, transform_points
from neuse.records import ChangeKind, Intrinsics, Observation, ObservedFrame

CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
HEIGHT_M, TOP_M = 1.2, 0.15
DOWN = make_transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, HEIGHT_M])  # p_map = DOWN @ p_camera
S = 10**9
SMALL, WIDE = np.array([0.08, 0.08]), np.array([0.16, 0.14])
CODE = Code("mug", False, np.zeros((128, 3)), np.full(128, 128**-0.5), np.full(6, 0.01))


def frame(stamp_ns, boxes):
    """What the camera sees of boxes {(x, y): sides} with tops at TOP_M; the table is at 0."""
    v, u = np.mgrid[:60, :80]
    x, y = ((u + 0.5) * 8 - CAMERA.cx) / CAMERA.fx, ((v + 0.5) * 8 - CAMERA.cy) / CAMERA.fy
    depth_m, observations = np.full((60, 80), HEIGHT_M, np.float32), []
    for (center_x, center_y), sides in boxes.items():
        top = HEIGHT_M - TOP_M
        inside = (np.abs(x * top - center_x) <= sides[0] / 2) & (np.abs(-y * top - center_y) <= sides[1] / 2)
        depth_m[inside] = top
        grid = np.stack(np.meshgrid(*(np.linspace(-s / 2, s / 2, 16) for s in sides)), -1).reshape(-1, 2)
        points = np.column_stack([grid + np.array([center_x, center_y]), np.full(256, TOP_M)])
        cloud = transform_points(np.linalg.inv(DOWN), points).astype(np.float32)
        observations.append(Observation(1, 0.9, CODE, cloud, cloud.mean(axis=0), 2000))
    return ObservedFrame(stamp_ns, tuple(observations), CAMERA, depth_m)


def changes(before, after):
    """Ten seconds of one layout, then of another."""
    stamps = [i * S // 5 for i in range(100)]
    frames = [frame(stamp, before if i < 50 else after) for i, stamp in enumerate(stamps)]
    return geometric_changes(frames, trajectory_of(stamps, [DOWN] * len(stamps)))


A, B, C = (-0.3, 0.0), (0.3, 0.1), (0.0, -0.25)


def test_scene_that_stays_has_no_changes():
    assert changes({A: SMALL, B: SMALL}, {A: SMALL, B: SMALL}) == ()


def test_object_that_is_looked_through_has_gone():
    (change,) = changes({A: SMALL, B: SMALL}, {B: SMALL})
    assert change.kind == ChangeKind.REMOVED
    assert change.stamp_ns >= 50 * S // 5
    np.testing.assert_allclose(change.T_map_before[:3, 3], [*A, TOP_M], atol=0.02)


def test_object_where_nothing_was_has_come():
    (change,) = changes({A: SMALL}, {A: SMALL, C: SMALL})
    assert change.kind == ChangeKind.ADDED
    np.testing.assert_allclose(change.T_map_after[:3, 3], [*C, TOP_M], atol=0.02)


def test_what_goes_and_comes_with_one_size_has_moved():
    (change,) = changes({A: SMALL, B: WIDE}, {C: SMALL, B: WIDE})
    assert change.kind == ChangeKind.MOVED
    np.testing.assert_allclose(change.T_map_before[:3, 3], [*A, TOP_M], atol=0.02)
    np.testing.assert_allclose(change.T_map_after[:3, 3], [*C, TOP_M], atol=0.02)


def test_what_goes_and_comes_with_another_size_has_not_moved():
    kinds = {change.kind for change in changes({A: SMALL}, {C: WIDE})}
    assert kinds == {ChangeKind.REMOVED, ChangeKind.ADDED}


def test_objects_of_one_size_that_trade_places_are_not_noticed():
    assert changes({A: SMALL, B: SMALL}, {B: SMALL, A: SMALL}) == ()


@pytest.mark.parametrize("missing", [1, 4])
def test_mask_that_is_missing_a_few_times_is_no_change(missing):
    stamps = [i * S // 5 for i in range(60)]
    frames = [frame(stamp, {A: SMALL}) for stamp in stamps]
    bare = [
        ObservedFrame(f.stamp_ns, (), CAMERA, f.coarse_depth_m) if 30 <= i < 30 + missing else f
        for i, f in enumerate(frames)
    ]
    assert geometric_changes(bare, trajectory_of(stamps, [DOWN] * len(stamps))) == ()

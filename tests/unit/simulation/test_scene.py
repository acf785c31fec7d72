import numpy as np
import pytest
import trimesh

from neuse.geometry import exp, make_transform, transform_points
from neuse.records import ChangeKind
from neuse.simulation.scene import SceneChange, Table, Timeline, TrueObject, footprint, gap, stands_free
from neuse.simulation.shapes import make_shape

BOX = make_shape("box", "bottle", trimesh.creation.box((0.2, 0.1, 0.3)))


def box_at(x, y, yaw_rad=0.0, object_id=0):
    R_world_object = exp([0, 0, yaw_rad, 0, 0, 0])[:3, :3]
    return TrueObject(object_id, BOX, make_transform(R_world_object, [x, y, 0.0]))


def square(center, half=0.5, yaw_rad=0.0):
    corners = half * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return corners @ np.array([[cos, sin], [-sin, cos]]) + center


def test_table_stands_on_the_floor_with_its_top_at_its_frame():
    table = Table((1.0, 2.0), (1.2, 0.6), yaw_rad=0.5, height_m=0.7)
    mesh = table.mesh().apply_transform(table.T_world_table)
    assert mesh.bounds[:, 2] == pytest.approx([0.0, 0.7])
    assert mesh.bounds.mean(axis=0)[:2] == pytest.approx([1.0, 2.0])
    assert table.mesh().extents == pytest.approx([1.2, 0.6, 0.7])
    assert table.mesh().is_watertight
    assert table.mesh().volume > 0.0


def test_table_holds_what_is_inside_its_turned_edges():
    table = Table((1.0, 2.0), (1.2, 0.6), yaw_rad=np.pi / 2)
    assert table.holds(np.array([[1.29, 2.59], [0.71, 1.41]]))
    assert not table.holds(np.array([[1.29, 2.59]]), margin_m=0.02)
    assert not table.holds(np.array([[1.0, 2.0], [1.31, 2.0]]))


def test_footprint_is_the_outline_from_above():
    corners = footprint(BOX, exp([0, 0, 0.3, 1.0, 2.0, 0.5]))
    assert len(corners) == 4
    expected = transform_points(exp([0, 0, 0.3, 1.0, 2.0, 0.5]), BOX.mesh.vertices)[:, :2]
    assert {tuple(c) for c in corners.round(9)} == {tuple(c) for c in expected.round(9)}


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (square([2.0, 0.3]), 1.0),
        (square([2.0, 0.0], yaw_rad=np.pi / 4), 1.5 - np.sqrt(0.5)),
        (square([0.8, 0.0]), -0.2),
        (square([0.0, 0.0], half=0.1), -0.6),
    ],
    ids=["apart", "corner to edge", "overlapping", "inside"],
)
def test_gap_of_convex_polygons(other, expected):
    assert gap(square([0.0, 0.0]), other) == pytest.approx(expected)
    assert gap(other, square([0.0, 0.0])) == pytest.approx(expected)


def test_gap_never_exceeds_the_distance():
    rng = np.random.default_rng(0)
    for _ in range(50):
        a, b = (square(rng.uniform(-2, 2, 2), yaw_rad=rng.uniform(0, 3)) for _ in range(2))
        samples = [
            np.concatenate([np.linspace(p, q, 40) for p, q in zip(s, np.roll(s, -1, 0), strict=True)])
            for s in (a, b)
        ]
        distance = np.linalg.norm(samples[0][:, None] - samples[1], axis=2).min()
        assert gap(a, b) <= distance + 1e-9


def test_object_stands_free_only_at_its_distance_from_others():
    assert stands_free(BOX, np.eye(4), [box_at(0.23, 0.0)], min_gap_m=0.02)
    assert not stands_free(BOX, np.eye(4), [box_at(0.21, 0.0)], min_gap_m=0.02)
    # side by side they would meet, turned by a right angle the short side leaves room
    assert stands_free(BOX, np.eye(4), [box_at(0.18, 0.0, np.pi / 2)], min_gap_m=0.02)


def test_timeline_applies_changes_from_their_frame_on():
    stays, goes, moves, comes = (box_at(i, 0.0, object_id=i) for i in range(4))
    moved = box_at(2.0, 5.0, object_id=2)
    changes = (
        SceneChange(10, ChangeKind.REMOVED, goes, None),
        SceneChange(10, ChangeKind.MOVED, moves, moved),
        SceneChange(20, ChangeKind.ADDED, None, comes),
    )
    timeline = Timeline((stays, goes, moves), changes)
    assert timeline.objects_at(9) == (stays, goes, moves)
    assert timeline.objects_at(10) == (stays, moved)
    assert timeline.objects_at(20) == (stays, moved, comes)
    assert timeline.changes_at(10) == changes[:2]
    assert [change.subject.object_id for change in changes] == [1, 2, 3]

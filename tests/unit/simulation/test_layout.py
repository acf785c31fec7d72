import numpy as np
import pytest
import trimesh

from neuse.errors import ParamError
from neuse.geometry import make_transform
from neuse.records import Intrinsics
from neuse.simulation.camera import look_at
from neuse.simulation.layout import Decorator, Sight
from neuse.simulation.scene import Table, TrueObject, footprint, gap
from neuse.simulation.shapes import make_shape
from neuse.simulation.trajectory import Trajectory

INTRINSICS = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
TABLES = (Table((0.0, 0.0)), Table((3.0, 0.0)))
BOX = make_shape("box", "bottle", trimesh.creation.box((0.06, 0.06, 0.2)))
WIDE = make_shape("wide", "bottle", trimesh.creation.box((2.0, 0.1, 0.1)))


def sight_of_first_table():
    """Two traversals of one frame each, which look at the first table from either side, 1 m away."""
    target = np.array([0.0, 0.0, 0.8])
    eyes = target + np.array([[0.0, -0.8, 0.6], [0.0, 0.8, 0.6]])
    return Sight(Trajectory(look_at(eyes, target), np.array([0, 1])), INTRINSICS)


@pytest.fixture
def decorator():
    return Decorator(TABLES, sight_of_first_table(), approach_m=1.2, rng=np.random.default_rng(0))


def test_closest_view_is_that_of_the_traversal_that_stays_farther_away():
    point = np.array([0.0, -0.2, 0.8])
    assert sight_of_first_table().closest_view_m(point) == pytest.approx(np.hypot(1.0, 0.6))


def test_point_that_a_traversal_never_sees_has_no_closest_view():
    assert sight_of_first_table().closest_view_m(np.array([3.0, 0.0, 0.8])) == np.inf


def test_hidden_means_out_of_this_frame_and_the_one_before():
    target = np.array([0.0, 0.0, 0.8])
    away = look_at(np.array([0.0, -1.0, 1.4]), np.array([0.0, -3.0, 0.8]))
    toward = look_at(np.array([0.0, -1.0, 1.4]), target)
    sight = Sight(Trajectory(np.stack([away, away, toward, away, away]), np.zeros(5, dtype=int)), INTRINSICS)
    assert [sight.is_hidden(target, frame) for frame in range(5)] == [True, True, False, False, True]


def test_objects_fill_a_table_without_touching_or_overhanging(decorator):
    objects = []
    for object_id in range(12):
        T_world_object = decorator.find_place(BOX, "upright", TABLES[:1], objects)
        objects.append(TrueObject(object_id, BOX, T_world_object))
    outlines = [footprint(o.shape, o.T_world_object) for o in objects]
    assert all(TABLES[0].holds(outline) for outline in outlines)
    assert min(gap(a, b) for i, a in enumerate(outlines) for b in outlines[:i]) >= 0.02
    assert all(o.position[2] == pytest.approx(0.72 + 0.1) for o in objects)


def test_place_is_where_every_traversal_comes_close(decorator):
    places = [decorator.find_place(BOX, "upright", TABLES, []) for _ in range(20)]
    assert all(decorator.sight.closest_view_m(T[:3, 3]) <= 1.2 for T in places)


def test_table_that_is_never_seen_is_used_when_there_is_no_other(decorator):
    T_world_object = decorator.find_place(BOX, "upright", TABLES[1:], [])
    assert TABLES[1].holds(T_world_object[None, :2, 3])


def test_place_suits_the_caller(decorator):
    T_world_object = decorator.find_place(BOX, "upright", TABLES, [], lambda T: T[0, 3] > 0.4)
    assert T_world_object[0, 3] > 0.4


def test_object_that_fits_nowhere_is_refused(decorator):
    with pytest.raises(ParamError, match="no room for wide among 0 objects"):
        decorator.find_place(WIDE, "upright", TABLES, [])


def test_fits_asks_for_a_table_and_free_space(decorator):
    here = TrueObject(0, BOX, make_transform(np.eye(3), [0.0, 0.0, 0.82]))
    beside = TrueObject(1, BOX, make_transform(np.eye(3), [0.2, 0.0, 0.82]))
    off = TrueObject(2, BOX, make_transform(np.eye(3), [0.6, 0.0, 0.82]))
    assert decorator.fits(here, [beside])
    assert not decorator.fits(here, [here])
    assert not decorator.fits(off, [])

import numpy as np
import pytest
import trimesh

from neuse.errors import ParamError
from neuse.records import ChangeKind, Intrinsics
from neuse.simulation.camera import look_at
from neuse.simulation.changes import MIN_MOVE_M, change_scene
from neuse.simulation.layout import Decorator, Sight
from neuse.simulation.presets import ChangePlan
from neuse.simulation.scene import Table, TrueObject, footprint, gap
from neuse.simulation.shapes import make_shape
from neuse.simulation.trajectory import Trajectory

TABLES = tuple(Table((float(x), 0.0)) for x in (-2, 0, 2))
SHAPES = [
    make_shape(f"box {i}", category, trimesh.creation.box((0.05, 0.05, 0.1 + 0.01 * i)))
    for i, category in enumerate(["mug", "bottle"] * 20)
]


@pytest.fixture
def decorator():
    """The camera looks at the table in the middle when the second of two traversals begins, in frame 1."""
    target = np.array([0.0, 0.0, 0.8])
    poses = look_at(target + np.array([[0.0, -0.8, 0.6], [0.0, 0.8, 0.6]]), target)
    sight = Sight(Trajectory(poses, np.array([0, 1])), Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5))
    return Decorator(TABLES, sight, approach_m=1.0, rng=np.random.default_rng(0))


@pytest.fixture
def initial(decorator):
    objects = []
    for object_id, shape in enumerate(SHAPES[:18]):
        table = TABLES[object_id // 2 % 3]
        objects.append(TrueObject(object_id, shape, decorator.find_place(shape, "upright", [table], objects)))
    return objects


def new_items():
    return ((shape, "upright") for shape in SHAPES[18:])


def changed(initial, decorator, **counts):
    return change_scene(initial, [ChangePlan(traversal=1, **counts)], new_items(), decorator)


def test_changes_are_as_many_as_planned_and_touch_each_object_once(initial, decorator):
    timeline = changed(initial, decorator, added=3, removed=2, moved=2, swapped_pairs=2)
    kinds = [change.kind for change in timeline.changes]
    assert [kinds.count(kind) for kind in ChangeKind] == [3, 2, 6]
    assert len({change.subject.object_id for change in timeline.changes}) == 11
    assert {change.frame for change in timeline.changes} == {1}


def test_nothing_changes_in_sight(initial, decorator):
    timeline = changed(initial, decorator, added=3, removed=2, moved=3, swapped_pairs=1)
    for change in timeline.changes:
        for place in filter(None, (change.before, change.after)):
            assert decorator.sight.is_hidden(place.position, 1)


def test_moved_object_keeps_its_shape_and_goes_some_way(initial, decorator):
    for change in changed(initial, decorator, moved=3).changes:
        assert change.before.shape is change.after.shape
        assert np.linalg.norm(change.before.position - change.after.position) >= MIN_MOVE_M


def test_swapped_objects_take_each_others_place(initial, decorator):
    first, second = changed(initial, decorator, swapped_pairs=1).changes
    assert first.after.position[:2] == pytest.approx(second.before.position[:2])
    assert second.after.position[:2] == pytest.approx(first.before.position[:2])
    assert first.before.shape.category == second.before.shape.category
    assert first.before.shape is not second.before.shape
    for change in (first, second):  # each stands on the table as before
        assert change.after.position[2] == change.before.position[2]


def test_objects_are_free_of_each_other_after_the_changes(initial, decorator):
    objects = changed(initial, decorator, added=3, removed=1, moved=3, swapped_pairs=2).objects_at(1)
    outlines = [footprint(o.shape, o.T_world_object) for o in objects]
    assert len(outlines) == 20
    assert min(gap(a, b) for i, a in enumerate(outlines) for b in outlines[:i]) >= 0.02


def test_added_objects_get_ids_never_used_before(initial, decorator):
    added = [
        c.after.object_id for c in changed(initial, decorator, removed=1, added=2).changes if not c.before
    ]
    assert added == [18, 19]


def test_more_changes_than_hidden_objects_are_refused(initial, decorator):
    with pytest.raises(ParamError, match="out of sight in frame 1"):
        changed(initial, decorator, removed=13)


def test_swap_without_two_objects_of_a_category_is_refused(initial, decorator):
    with pytest.raises(ParamError, match="no two objects can swap"):
        changed(initial[:4], decorator, swapped_pairs=1)

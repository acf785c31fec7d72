import numpy as np
import pytest

from neuse import geometry
from neuse.mapping.history import History
from neuse.mapping.object_record import ObjectRecord
from neuse.mapping.views import View
from neuse.records import ChangeKind

from .synthetic import make_code, standing

ADDED, REMOVED, MOVED = ChangeKind.ADDED, ChangeKind.REMOVED, ChangeKind.MOVED


@pytest.fixture
def poses():
    return {1: np.eye(4), 2: np.eye(4)}


def record(object_id, poses, keyframe_id, x):
    """A bottle seen from one keyframe."""
    thing = standing("thing", x, 0.0)
    code = make_code(thing, thing.T_world_object, np.random.default_rng(object_id), 0.0)
    return ObjectRecord(
        object_id, "bottle", poses, 0, 0, 1, 1, views={keyframe_id: View(code, code.center[None])}
    )


def test_places_of_changes_follow_the_keyframes_that_saw_them(poses):
    history = History(poses)
    old, new = record(1, poses, 1, 0.0), record(2, poses, 2, 1.0)
    reported = history.report(5, MOVED, old, old, new)
    assert (reported.object_id, reported.merged_id) == (1, 2)
    correction = geometry.exp(np.array([0.0, 0.0, 0.1, 0.3, 0.0, -0.1]))
    poses[2] = correction
    (change,) = history.changes
    np.testing.assert_allclose(change.T_map_before, reported.T_map_before, atol=1e-12)
    np.testing.assert_allclose(change.T_map_after, correction @ reported.T_map_after, atol=1e-12)


def test_half_of_a_move_that_was_reported_before_is_left_out(poses):
    history = History(poses)
    old, new = record(1, poses, 1, 0.0), record(2, poses, 2, 1.0)
    removed = history.report(3, REMOVED, old, before=old)
    added = history.report(4, ADDED, new, after=new)
    assert removed.T_map_after is None
    assert added.T_map_before is None
    assert [change.kind for change in history.changes] == [REMOVED, ADDED]
    history.report(5, MOVED, old, old, new)
    assert [change.kind for change in history.changes] == [MOVED]


def test_what_turned_out_to_be_known_was_not_added(poses):
    history = History(poses)
    known, doubled = record(1, poses, 1, 0.0), record(2, poses, 2, 1.0)
    history.report(3, REMOVED, known, before=known)
    history.report(4, ADDED, doubled, after=doubled)
    history.take_back_added(1)  # it was removed last
    history.take_back_added(7)  # nobody knows it
    assert [change.object_id for change in history.changes] == [1, 2]
    history.take_back_added(2)
    assert [change.object_id for change in history.changes] == [1]

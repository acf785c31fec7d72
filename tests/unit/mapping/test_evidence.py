from dataclasses import replace

import numpy as np
import pytest

from neuse import geometry
from neuse.geometry import inverse, make_transform, transform_points
from neuse.mapping.evidence import Evidence
from neuse.mapping.free_space import FreeSpaceParams
from neuse.mapping.keyframe_memory import KeyframeMemory
from neuse.mapping.object_graph import LayoutParams
from neuse.mapping.object_library import ObjectLibrary
from neuse.mapping.object_record import ObjectRecord
from neuse.mapping.views import View
from neuse.records import ObjectStatus, TrackedFrame

from .synthetic import CAMERA, COARSE, make_code, standing

PLACES = {1: [0.2, 0.0, 1.5], 2: [-0.2, 0.1, 1.5], 3: [0.0, -0.2, 1.4]}
BALL = np.random.default_rng(0).normal(scale=0.01, size=(50, 3)) + np.array([0.0, 0.1, 1.45])


@pytest.fixture
def seen():
    """Three objects, known since step 0, in view of keyframe 0 (step 5); a wall stands at 3 m."""
    memory, library = KeyframeMemory(10), ObjectLibrary()
    wall = np.full(COARSE, 3.0, dtype=np.float32)
    memory.update(TrackedFrame(0, np.eye(4), np.eye(6), (), CAMERA, wall, 0), (), 5)
    thing, rng = standing("thing", 0.0, 0.0), np.random.default_rng(0)
    for object_id, place in PLACES.items():
        record = ObjectRecord(object_id, "bottle", dict(memory.poses), 0, 0, since_tick=0, last_tick=5)
        code = make_code(thing, make_transform(np.eye(3), place), rng, noise_m=0.0)
        record.add_view(0, View(code, code.center[None]), 10)
        library.records[object_id] = record
        memory.seen[0].centers[object_id] = code.center
    return Evidence(memory, library, LayoutParams(), FreeSpaceParams()), memory, library


def anchor_ids(seen, center=(0.0, 0.0, 1.5), known_by=5, excluded_id=-1):
    evidence, memory, _ = seen
    tie = evidence.tie(memory.seen[0], np.array(center), [known_by], excluded_id)
    return [] if tie is None else [anchor.object_id for anchor in tie.anchors]


def test_objects_that_the_keyframe_saw_around_a_place_are_anchors(seen):
    assert anchor_ids(seen) == [1, 2, 3]
    assert anchor_ids(seen, center=(0.0, 0.0, 9.0)) == []
    assert anchor_ids(seen, excluded_id=2) == [1, 3]


def test_object_younger_than_what_it_is_to_confirm_is_no_anchor(seen):
    seen[2].records[1].since_tick = 4
    assert anchor_ids(seen, known_by=3) == [2, 3]
    assert anchor_ids(seen, known_by=4) == [1, 2, 3]


def test_object_that_has_moved_or_was_gone_by_then_is_no_anchor(seen):
    seen[2].records[1].since_tick = 8
    seen[2].records[3].status, seen[2].records[3].last_tick = ObjectStatus.REMOVED, 4
    assert anchor_ids(seen, known_by=9) == [2]


def test_keyframe_from_before_an_object_went_still_has_it_as_anchor(seen):
    library = seen[2]
    library.records[3].status = ObjectStatus.REMOVED
    library.left.append(replace(library.records[1]))
    library.records[1].since_tick, library.records[1].status = 8, ObjectStatus.MOVED
    assert anchor_ids(seen) == [1, 2, 3]


def test_objects_far_away_are_anchors_only_where_those_nearby_do_not_suffice(seen):
    assert anchor_ids(seen, center=(-1.5, 0.0, 1.5)) == [2]  # it lies where it is expected: that is enough
    assert anchor_ids(seen, center=(-3.0, 0.0, 1.5)) == [1, 2, 3]


def test_objects_met_just_after_the_last_sight_count_as_long_as_something_was_in_sight(seen):
    evidence, memory, library = seen
    for record in library:
        record.since_tick = 15
    keyframe = replace(memory.seen[0], tick=16)
    assert evidence.sight(BALL, keyframe, 10, -1) is not None
    assert evidence.sight(BALL, keyframe, -50, -1) is None
    wall = np.full(COARSE, 3.0, dtype=np.float32)
    blind = TrackedFrame(0, np.eye(4), np.eye(6), (), CAMERA, wall, odometry_only=True)
    for tick in (11, 12, 13):
        memory.update(blind, (), tick)
    assert evidence.sight(BALL, keyframe, 10, -1) is not None
    memory.update(blind, (), 14)
    assert evidence.sight(BALL, keyframe, 10, -1) is None


def test_place_is_looked_up_relative_to_the_anchors(seen):
    """The keyframe's pose estimate is 30 cm off; only the anchors tell where the place is in its image."""
    evidence, memory, _ = seen
    depth_mm = memory.seen[0].depth_mm
    u, v = (int(BALL.mean(axis=0)[i] / 1.45 * 520 + c) // 8 for i, c in ((0, 319.5), (1, 239.5)))
    depth_mm[v - 3 : v + 4, u - 3 : u + 4] = 1450
    for drift in (np.zeros(6), np.array([0, 0, 0, 0.3, -0.1, 0.1])):
        memory.poses[0] = geometry.exp(drift)
        assert evidence.sight(BALL, memory.seen[0], 5, -1).is_taken


def test_place_without_anchors_or_depth_gives_no_evidence(seen):
    evidence, memory, _ = seen
    assert evidence.sight(BALL, memory.seen[0], 5, -1).emptiness
    assert evidence.sight(BALL, memory.seen[0], -50, -1) is None
    assert evidence.sights(BALL, [memory.seen[0]], seen[2].records[1]) != []
    memory.seen[0].depth_mm = None
    assert evidence.sight(BALL, memory.seen[0], 5, -1) is None
    assert evidence.sights(BALL, [memory.seen[0]], seen[2].records[1]) == []


def test_observation_is_in_place_of_a_known_object_in_spite_of_drift(seen):
    evidence, memory, library = seen
    T = geometry.exp([0.0, 0.02, 0.0, 0.3, 0.1, -0.2])
    center = memory.seen[0].centers.pop(1)
    memory.poses[0] = T
    assert evidence.is_in_place(center + 0.005, library.records[1], memory.seen[0])
    assert not evidence.is_in_place(center + 0.05, library.records[1], memory.seen[0])


def test_views_among_older_anchors_are_aligned_by_them(seen):
    evidence, memory, library = seen
    newcomer = library.records[1]
    newcomer.since_tick = 5
    T = geometry.exp([0.0, 0.0, 0.0, 0.3, 0.1, -0.2])
    memory.poses[0] = T
    newcomer.poses[0] = T
    (view,) = evidence.anchored_views(newcomer, 6)
    assert {anchor.object_id for anchor in view.anchors} == {2, 3}
    np.testing.assert_allclose(transform_points(inverse(T), view.center), PLACES[1], atol=1e-9)
    np.testing.assert_allclose(view.points[0], PLACES[1], atol=1e-3)
    newcomer.since_tick = 0
    assert evidence.anchored_views(newcomer, 6) == []


def test_anchors_seen_a_moment_before_tie_a_view_that_has_none_itself(seen):
    evidence, memory, _ = seen
    wall = np.full(COARSE, 3.0, dtype=np.float32)

    def look_on(keyframe_id, tick):
        memory.update(TrackedFrame(0, np.eye(4), np.eye(6), (), CAMERA, wall, keyframe_id), (), tick)
        return memory.seen[keyframe_id]

    soon = look_on(1, 5 + LayoutParams().carried_frames)
    assert evidence.sight(BALL, soon, 5, -1) is None
    assert evidence.sight(BALL, soon, 5, -1, carried=True).emptiness
    assert evidence.sight(BALL, look_on(2, soon.tick + 1), 5, -1, carried=True) is None
    of_another_session = look_on(1_000_001, soon.tick)
    assert evidence.sight(BALL, of_another_session, 5, -1, carried=True) is None
    blind = TrackedFrame(0, np.eye(4), np.eye(6), (), CAMERA, wall, odometry_only=True)
    for tick in range(6, 10):
        memory.update(blind, (), tick)
    assert evidence.sight(BALL, soon, 5, -1, carried=True) is None


def test_keyframes_at_a_place_come_by_age(seen):
    evidence, memory, _ = seen
    wall = np.full(COARSE, 3.0, dtype=np.float32)
    for i, z in ((1, 0.8), (2, 0.4)):
        T = make_transform(np.eye(3), [0.0, 0.0, z])
        memory.update(TrackedFrame(0, T, np.eye(6), (), CAMERA, wall, i), (), 5 + i)
    place = np.array([0.0, 0.0, 2.0])
    assert [k.keyframe_id for k in evidence.keyframes_at(place, range(10), 2)] == [1, 2]
    assert [k.keyframe_id for k in evidence.keyframes_at(place, range(6), 2)] == [0]

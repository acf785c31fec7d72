from dataclasses import replace

import numpy as np
import pytest

from neuse import geometry
from neuse.geometry import make_transform
from neuse.mapping.object_library import ObjectLibrary, associated
from neuse.mapping.object_record import ObjectRecord
from neuse.mapping.views import View
from neuse.records import (
    NO_ID,
    MatchStatus,
    ObjectStatus,
    Observation,
    TrackedFrame,
    TrackedObservation,
)

from .synthetic import CAMERA, COARSE, make_code
from .test_views import MUG, poses, views_from


def record(object_id, T_map_keyframes, since_tick=0, last_tick=0):
    known = {NO_ID: np.eye(4)} | dict(enumerate(T_map_keyframes))
    made = ObjectRecord(object_id, "mug", known, 10, 20, since_tick, last_tick)
    for i, code in enumerate(views_from(T_map_keyframes)):
        made.add_view(i, View(code, np.zeros((5, 3)) + code.center), max_views=100)
    return made


def test_corrected_keyframe_moves_the_object_that_hangs_on_it():
    known = record(3, [np.eye(4)])
    library = ObjectLibrary()
    library.records[3] = known
    before = known.center
    known.poses[0][:3, 3] += [0.5, 0.0, 0.0]
    np.testing.assert_array_equal(known.center, before)
    library.invalidate({7})
    np.testing.assert_array_equal(known.center, before)
    library.invalidate({0})
    np.testing.assert_allclose(known.center, before + np.array([0.5, 0.0, 0.0]))
    np.testing.assert_allclose(known.points.mean(axis=0), known.center, atol=1e-9)


def test_views_are_bounded_and_spread_evenly():
    known = record(3, [np.eye(4)] * 2)
    view = known.views[0]
    known.poses.update({i: np.eye(4) for i in range(200)})
    for i in range(2, 200):
        known.add_view(i, view, max_views=8)
    kept = sorted(known.views)
    assert len(kept) == 8
    assert kept[0] == 0
    assert kept[-1] == 199
    assert max(np.diff(kept)) <= 60


def test_first_view_of_a_keyframe_is_kept():
    known = record(3, [np.eye(4)])
    first = known.views[0]
    known.add_view(0, replace(first, weight=7.0), max_views=8)
    assert known.views[0] is first


def test_merged_id_means_the_object_that_is_kept():
    library = ObjectLibrary()
    library.records = {i: record(i, poses(1), last_tick=i) for i in (1, 2, 3)}
    library.merge(3, 2)
    library.merge(2, 1)
    assert library.find(3) is library.find(2) is library.records[1]
    assert list(library.records) == [1]
    assert library.records[1].last_tick == 3
    assert library.find(9) is None


def test_moved_object_takes_over_the_newcomers_place():
    library = ObjectLibrary()
    here, there = record(1, poses(2), since_tick=1), record(2, poses(2, seed=5), since_tick=9, last_tick=12)
    library.records = {1: here, 2: there}
    library.move(1, 2)
    assert here.status == ObjectStatus.MOVED
    assert (here.since_tick, here.last_tick) == (9, 12)
    assert here.views is there.views
    assert library.find(2) is here


def test_other_names_of_a_moved_object_mean_it_no_longer_where_it_stood():
    library = ObjectLibrary()
    library.records = {i: record(i, poses(2), since_tick=i) for i in (1, 2, 3, 4)}
    library.merge(4, 3)
    library.merge(3, 1)
    library.move(1, 2)
    assert library.find(3) is library.find(4) is None
    assert library.find(2) is library.records[1]


@pytest.mark.parametrize("first", [0, 1])
def test_of_two_observations_for_one_object_the_nearer_to_its_place_counts(first):
    library = ObjectLibrary()
    library.records = {1: record(1, poses(1))}
    library.aliases = {2: 1}
    right, wrong = library.records[1].center, library.records[1].center + 0.1
    observations = [tracked(1, right), tracked(2, wrong)]
    frame = frame_with([observations[first], observations[1 - first]])
    assert list(associated(frame, library).items()) == [(1, observations[0])]


def test_unknown_ids_are_associated_and_observations_without_object_are_not():
    frame = frame_with([tracked(7, np.ones(3)), tracked(NO_ID, np.ones(3), MatchStatus.UNMATCHED)])
    assert list(associated(frame, ObjectLibrary())) == [7]


def tracked(object_id, center, status=MatchStatus.MATCHED):
    code = make_code(MUG, make_transform(np.eye(3), center), np.random.default_rng(0), 0.0)
    return TrackedObservation(Observation(0, 1.0, code, np.ones((5, 3)), center, 5000), status, object_id)


def frame_with(observations):
    return TrackedFrame(0, np.eye(4), np.eye(6), tuple(observations), CAMERA, np.ones(COARSE, np.float32))


def test_place_that_an_object_left_stays_known_and_follows_its_keyframes():
    library = ObjectLibrary()
    here, there = record(1, poses(2), since_tick=1, last_tick=5), record(2, poses(2, seed=5), last_tick=12)
    views, center = here.views, here.center
    library.records = {1: here, 2: there}
    library.move(1, 2)
    (left,) = library.left
    assert (left.views, left.last_tick) == (views, 5)
    np.testing.assert_allclose(left.center, center)
    left.poses = {NO_ID: np.eye(4)} | dict(enumerate(geometry.exp([0, 0, 0, 1, 0, 0]) @ poses(2)))
    library.invalidate({0})
    np.testing.assert_allclose(left.center - center, [1, 0, 0], atol=1e-9)


def test_view_that_tells_no_shape_does_not_show_that_a_known_object_is_still_there():
    known = record(1, poses(2), last_tick=1)
    clear = replace(known.views[0].code, sigmas=np.full(6, 0.001))
    poor = replace(clear, sigmas=np.full(6, 0.05))
    for tick, code, last_tick in ((2, poor, 2), (3, clear, 3), (4, poor, 3), (5, clear, 5)):
        known.seen(tick, 100 * tick, code)
        assert (known.last_tick, known.last_seen_ns) == (last_tick, 100 * tick)
    assert known.n_observations == 4


def test_poor_view_that_looks_otherwise_does_not_show_that_an_object_never_seen_well_is_still_there():
    known = record(1, poses(2), last_tick=1)
    poor = replace(known.views[0].code, sigmas=np.full(6, 0.05))
    known.seen(2, 200, replace(poor, descriptor=-poor.descriptor))
    assert known.last_tick == 1
    known.seen(3, 300, poor)
    assert known.last_tick == 3


def test_poor_view_does_not_show_that_an_object_seen_well_in_an_earlier_run_is_still_there():
    clear = record(1, poses(2), last_tick=1)
    code = replace(clear.views[0].code, sigmas=np.full(6, 0.001))
    known = replace(clear, views={0: replace(clear.views[0], code=code)})
    known.seen(2, 200, replace(code, sigmas=np.full(6, 0.05)))
    assert known.last_tick == 1


def test_poor_view_does_not_show_that_an_object_is_still_there_whose_duplicate_was_seen_well():
    known, duplicate = (record(i, poses(2), last_tick=1) for i in (1, 2))
    clear = replace(duplicate.views[0].code, sigmas=np.full(6, 0.001))
    duplicate.seen(2, 200, clear)
    known.take_views(duplicate)
    known.seen(3, 300, replace(clear, sigmas=np.full(6, 0.05)))
    assert known.last_tick == 1

"""Consistency of possible matches."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.geometry import exp
from neuse.slam.layout import Pairs, same_directions, same_layout
from neuse.slam.track import places_of

from .synthetic import make_thing
from .test_association import SPOTS, moved, scene_of, view_of

TURN = exp([0, 0, 0.3, 0, 0, 0])


@pytest.fixture
def scene():
    rng = np.random.default_rng(0)
    return scene_of([make_thing(i, False, spot, rng) for i, spot in enumerate(SPOTS[:3])])


def pairs_of(rows, columns):
    return Pairs(np.array(rows), np.array(columns), np.ones(len(rows)), np.ones(len(rows)))


def layout(scene, things, pairs, T_map_camera=None):
    return same_layout(view_of(things, T_map_camera), places_of(scene.tracks), pairs, 0.02, 0.35)


def test_true_matches_agree_from_any_pose_but_not_with_themselves(scene):
    agree = layout(scene, scene.things, pairs_of([0, 1, 2], [0, 1, 2]), TURN)
    np.testing.assert_array_equal(agree, ~np.eye(3, dtype=bool))


def test_matches_that_share_an_observation_or_a_track_exclude_each_other(scene):
    agree = layout(scene, [scene.things[0], scene.things[0]], pairs_of([0, 0, 1], [0, 1, 0]))
    assert not agree.any()


def test_object_that_moved_disagrees_with_the_others(scene):
    things = [moved(scene.things[0], [0, 0.2, 0.2]), *scene.things[1:]]
    agree = layout(scene, things, pairs_of([0, 1, 2], [0, 1, 2]))
    assert agree[1, 2]
    assert not agree[0].any()


def test_object_that_fell_over_disagrees_with_the_others(scene):
    fallen = scene.things[0].T_world_object @ exp([np.pi / 2, 0, 0, 0, 0, 0])
    things = [replace(scene.things[0], T_world_object=fallen), *scene.things[1:]]
    assert not layout(scene, things, pairs_of([0, 1], [0, 1])).any()


def test_axis_that_is_not_told_may_point_anywhere(scene):
    fallen = scene.things[0].T_world_object @ exp([np.pi / 2, 0, 0, 0, 0, 0])
    things = [replace(scene.things[0], T_world_object=fallen), *scene.things[1:]]
    view, places, pairs = view_of(things), places_of(scene.tracks), pairs_of([0, 1, 2], [0, 1, 2])
    view.frames.sigmas[0, :3] = np.pi
    agree = same_layout(view, places, pairs, 0.02, 0.35)
    np.testing.assert_array_equal(agree, ~np.eye(3, dtype=bool))


def test_directions_count_as_far_as_the_attitude_is_known(scene):
    view, places, pairs = view_of(scene.things, TURN), places_of(scene.tracks), pairs_of([0, 1], [0, 1])
    known = same_directions(view, places, pairs, TURN, np.zeros(2), 0.02)
    wrong = same_directions(view, places, pairs, np.eye(4), np.zeros(2), 0.02)
    doubtful = same_directions(view, places, pairs, np.eye(4), np.full(2, 0.4), 0.02)
    assert (known[0, 1], wrong[0, 1], doubtful[0, 1]) == (True, False, True)

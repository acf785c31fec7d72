"""The paper's one-at-a-time rule."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.geometry import exp
from neuse.slam.association import AssociationParams
from neuse.slam.nearest import associate_nearest

from .synthetic import make_thing
from .test_association import moved, scene_of, view_of

T_MAP_CAMERA = exp([0.1, 0.2, -0.1, 0.3, 0.1, 0.0])
SPOTS = np.array([[-0.3, 0.1, 1.2], [0.25, -0.05, 1.3], [0.0, 0.2, 1.7], [0.3, 0.25, 1.5]])


def make_scene(kinds):
    rng = np.random.default_rng(0)
    return scene_of([make_thing(i, kind == "b", SPOTS[i], rng) for i, kind in enumerate(kinds)])


def matched(scene, things):
    return scene.names(
        associate_nearest(view_of(things, T_MAP_CAMERA), scene.tracks, AssociationParams()).tracks
    )


@pytest.mark.parametrize("kinds", ["mm", "mb", "mbbb", "bb", "bbb"])
def test_known_objects_match_from_any_pose(kinds):
    scene = make_scene(kinds)
    assert matched(scene, scene.things) == list(range(len(kinds)))


def test_lone_bottle_has_no_transform_and_stays_free():
    scene = make_scene("bb")
    assert matched(scene, scene.things[:1]) == [None]


def test_unlike_object_stays_free():
    scene = make_scene("m")
    assert matched(scene, [replace(scene.things[0], descriptor=-scene.things[0].descriptor)]) == [None]


def test_bottle_that_moved_against_a_mug_stays_free():
    scene = make_scene("mb")
    assert matched(scene, [scene.things[0], moved(scene.things[1], [0.1, 0, 0])]) == [0, None]


def test_mug_that_moved_matches_all_the_same():
    """The weakness of the rule: the transform that is tested comes from the very pair."""
    scene = make_scene("m")
    assert matched(scene, [moved(scene.things[0], [0.5, 0.5, 0])]) == [0]


def test_pairs_of_bottles_at_another_distance_stay_free():
    scene = make_scene("bb")
    assert matched(scene, [scene.things[0], moved(scene.things[1], [0.3, 0, 0])]) == [None, None]


def test_two_like_observations_do_not_share_a_track():
    scene = make_scene("mb")
    bottle = scene.things[1]
    found = matched(scene, [scene.things[0], bottle, moved(bottle, [0.01, 0, 0])])
    assert found == [0, 1, None]

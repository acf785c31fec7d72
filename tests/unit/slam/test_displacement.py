"""Another shape in a known place, seen clearly and often enough, means that the known object has left."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.geometry import exp
from neuse.slam.association import AssociationParams
from neuse.slam.displacement import DisplacementWatch
from neuse.slam.layout import View

from .synthetic import make_thing
from .test_association import scene_of, view_of


@pytest.fixture
def scene():
    rng = np.random.default_rng(0)
    return scene_of([make_thing(i, False, np.array([0.3 * i, 0.0, 1.0]), rng) for i in range(2)])


@pytest.fixture
def watch():
    return DisplacementWatch(AssociationParams(), enough=3)


@pytest.fixture
def other(scene):
    """Another mug exactly where the first one stood."""
    thing = make_thing(9, False, np.zeros(3), np.random.default_rng(7))
    return replace(thing, T_world_object=scene.things[0].T_world_object)


def clear_view_of(things):
    view = view_of(things)
    codes = tuple(replace(code, sigmas=np.full(6, 0.001)) for code in view.codes)
    return View(codes, view.frames, view.partial_centers, (), view.rivals)


def look(watch, scene, view, matched=(None,), frame_index=0):
    return watch.displaced(view, matched, scene.tracks, np.eye(4), frame_index)


def test_third_clear_view_of_another_shape_displaces_the_object(watch, scene, other):
    displaced = [look(watch, scene, clear_view_of([other])) for _ in range(3)]
    assert displaced == [[], [], [scene.tracks[0]]]


def test_clear_match_in_between_starts_anew(watch, scene, other):
    for _ in range(2):
        look(watch, scene, clear_view_of([other]))
    look(watch, scene, clear_view_of(scene.things[:1]), (scene.tracks[0],))
    assert look(watch, scene, clear_view_of([other])) == []


def test_poor_views_contradict_nothing(watch, scene, other):
    view = clear_view_of([other])
    poor = replace(view.codes[0], sigmas=np.full(6, 0.01))
    for _ in range(5):
        assert look(watch, scene, View((poor,), view.frames, view.partial_centers, (), view.rivals)) == []


def test_another_shape_beside_the_place_displaces_nothing(watch, scene, other):
    aside = replace(other, T_world_object=exp([0, 0, 0, 0.0, 0.1, 0.0]) @ other.T_world_object)
    for _ in range(5):
        assert look(watch, scene, clear_view_of([aside])) == []


def test_unmatched_object_of_the_same_shape_is_no_contradiction(watch, scene):
    for _ in range(5):
        assert look(watch, scene, clear_view_of(scene.things[:1])) == []


def test_tentative_tracks_are_not_watched(watch, scene, other):
    scene.tracks[0].confirmed = False
    for _ in range(5):
        assert look(watch, scene, clear_view_of([other])) == []


def test_what_was_seen_a_moment_ago_may_look_more_unlike_however_old_the_rest_is(watch, scene, other):
    """A shape that is a little off is the same object, half hidden; a minute later it is another."""
    known, unlike = scene.things[0].descriptor, other.descriptor
    across = unlike - (unlike @ known) * known
    cosine = 0.8
    descriptor = cosine * known + np.sqrt(1 - cosine**2) * across / np.linalg.norm(across)
    view = clear_view_of([replace(other, descriptor=descriptor)])
    for frame_index, displaced in ((10, []), (600, [scene.tracks[0]])):
        assert [look(watch, scene, view, frame_index=frame_index) for _ in range(3)][-1] == displaced


def test_object_in_whose_place_another_has_been_taken_into_the_library_has_left(watch, scene, other):
    """Both have a track there; whatever is seen there matches the newer one."""
    newer = scene_of([other]).tracks[0]
    newer.key = 9
    for _ in range(3):
        displaced = look(watch, scene, clear_view_of([other]), (newer,))
    assert displaced == [scene.tracks[0]]


def test_neighbour_that_drift_shows_in_a_place_displaces_nothing(watch, scene):
    neighbour = replace(scene.things[1], T_world_object=scene.things[0].T_world_object)
    for _ in range(5):
        assert look(watch, scene, clear_view_of([neighbour]), (scene.tracks[1],)) == []

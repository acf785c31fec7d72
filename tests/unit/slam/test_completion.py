"""Matches once the pose is known: filled in, dropped, never doubled, and patient where drift is open."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.slam.association import AssociationParams
from neuse.slam.completion import complete

from .synthetic import make_thing
from .test_association import EXACT, SPOTS, moved, scene_of, view_of


@pytest.fixture
def scene():
    rng = np.random.default_rng(0)
    return scene_of([make_thing(i, i % 2 == 1, spot, rng) for i, spot in enumerate(SPOTS)])


def test_completion_fills_in_what_stands_in_its_place(scene):
    view = view_of(scene.things)
    partial = (scene.tracks[0], None, None, None, None)
    matched = complete(
        view, partial, scene.tracks, np.zeros((len(scene.tracks), 2)), EXACT, AssociationParams(), 0
    )
    assert scene.names(matched) == [0, 1, 2, 3, 4]


def test_completion_drops_what_contradicts_the_pose(scene):
    view = view_of(scene.things[:2])
    wrong = (scene.tracks[2], scene.tracks[1])
    matched = complete(
        view, wrong, scene.tracks, np.zeros((len(scene.tracks), 2)), EXACT, AssociationParams(), 0
    )
    assert scene.names(matched) == [0, 1]


def test_completion_waits_where_drift_leaves_a_place_open(scene):
    """An object that was mapped after a blind gap may stand elsewhere, however near it seems."""
    for track, reading in zip(scene.tracks, (0.0, 0.001, 0.01, 0.01, 0.01), strict=True):
        track.mapped_at = np.array([0.0, reading])
    view = view_of(scene.things)
    partial = (scene.tracks[0], None, None, None, None)
    matched = complete(view, partial, scene.tracks, np.zeros((5, 2)), EXACT, AssociationParams(), 0)
    assert scene.names(matched) == [0, 1, None, None, None]


def test_completion_never_gives_one_track_twice(scene):
    thing = scene.things[0]
    view = view_of([moved(thing, [0.02, 0, 0]), moved(thing, [0.01, 0, 0])])
    matched = complete(
        view, (None, None), scene.tracks, np.zeros((len(scene.tracks), 2)), EXACT, AssociationParams(), 0
    )
    assert scene.names(matched) == [None, 0]


def test_completion_lets_unambiguous_objects_choose_first(scene):
    bottle = scene.things[1]
    mug = replace(scene.things[0], T_world_object=bottle.T_world_object)
    scene = scene_of([mug])
    scene.tracks[0].category = "cup"
    view = view_of([mug, bottle])
    codes = tuple(replace(code, category="cup", descriptor=mug.descriptor) for code in view.codes)
    order = complete(
        replace(view, codes=codes[::-1], frames=view.frames[[1, 0]]),
        (None, None),
        scene.tracks,
        np.zeros((1, 2)),
        EXACT,
        AssociationParams(),
        0,
    )
    assert scene.names(order) == [None, 0]

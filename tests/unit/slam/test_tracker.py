"""The front end: association, pose and instantiation together."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.geometry import exp
from neuse.records import Observation
from neuse.slam.association import AssociationParams
from neuse.slam.hypotheses import Hypothesis
from neuse.slam.instantiation import InstantiationParams
from neuse.slam.library import ids_by_likeness
from neuse.slam.localization import Belief
from neuse.slam.odometry import Motion
from neuse.slam.tracker import ObjectTracker

from .synthetic import make_thing
from .test_association import SPOTS, view_of

STEP = Motion(np.eye(4), np.diag([0.01] * 3 + [0.05] * 3) ** 2)


@pytest.fixture
def things():
    rng = np.random.default_rng(0)
    return [make_thing(i, i % 2 == 1, spot, rng) for i, spot in enumerate(SPOTS)]


@pytest.fixture
def tracker():
    return ObjectTracker(AssociationParams(), InstantiationParams(), use_ambiguous=True)


def observe(tracker, things, T_map_camera=None, mask_px=5000, motion=STEP):
    """One frame; returns what was located, the tracks, and the new objects."""
    seen = view_of(things, T_map_camera)
    view = tracker.view(seen.codes, seen.frames, seen.partial_centers)
    located = tracker.locate(view, [Hypothesis.after(tracker.belief, motion)])
    empty = np.zeros((0, 3), np.float32)
    observations = [
        Observation(i, 1.0, code, empty, code.center, mask_px) for i, code in enumerate(view.codes)
    ]
    tracks, fresh = tracker.update(view, observations, located)
    return located, tracks, fresh


def test_objects_come_into_being_at_the_third_sight(tracker, things):
    fresh = [len(observe(tracker, things)[2]) for _ in range(4)]
    assert fresh == [0, 0, 5, 0]


def test_small_masks_are_no_objects_but_may_be_recognised(tracker, things):
    for _ in range(4):
        observe(tracker, things[:2], mask_px=10)
    assert not any(track.confirmed for track in tracker.library.active())
    for _ in range(3):
        observe(tracker, things[:2])
    _, tracks, _ = observe(tracker, things[:2], mask_px=10)
    assert [(track.object_id, track.confirmed) for track in tracks] == [(0, True), (1, True)]


def test_small_masks_constrain_poses_from_the_third_sight(tracker, things):
    entering = []
    for _ in range(4):
        located, tracks, _ = observe(tracker, things[:2], mask_px=10)
        entering.append(len(tracker.enter_graph(tracks)))
    assert entering == [0, 0, 2, 0]
    assert not located.blind


def test_row_of_sightings_must_not_break(tracker, things):
    observe(tracker, things)
    observe(tracker, things)
    for _ in range(4):
        observe(tracker, [])
    assert observe(tracker, things)[2] == []


def test_pose_is_found_against_tentative_objects(tracker, things):
    observe(tracker, things)
    T_map_camera = exp([0.02, -0.01, 0.01, 0.05, 0.03, -0.04])
    loose = Motion(np.eye(4), 0.2**2 * np.eye(6))
    located, _, _ = observe(tracker, things, T_map_camera, motion=loose)
    assert not located.blind
    np.testing.assert_allclose(located.belief.T_map_camera, T_map_camera, atol=2e-3)


def test_frame_without_objects_is_blind_and_less_certain(tracker, things):
    sure, _, _ = observe(tracker, things)
    for _ in range(2):
        located, _, _ = observe(tracker, [])
    assert located.blind
    assert np.trace(located.belief.covariance) > np.trace(sure.belief.covariance)


def test_frame_of_bottles_is_blind_where_bottles_may_not_be_used(things):
    tracker = ObjectTracker(AssociationParams(), InstantiationParams(), use_ambiguous=False)
    bottles = [thing for thing in things if thing.ambiguous]
    observe(tracker, bottles)
    located, tracks, _ = observe(tracker, bottles)
    assert located.blind
    assert None not in tracks


def test_likeness_seen_in_the_dark_waits_before_it_is_new(tracker, things):
    """After a blind walk a lone mug near a known one is not a new object at once."""
    for _ in range(3):
        observe(tracker, things)
    for _ in range(10):
        observe(tracker, [])
    shifted = replace(things[0], T_world_object=exp([0, 0, 0, 0.2, 0, 0]) @ things[0].T_world_object)
    fresh = [len(observe(tracker, [shifted])[2]) for _ in range(10)]
    assert sum(fresh[:5]) == 0


def test_similar_ids_are_sorted_and_include_places_left(tracker, things):
    twin = replace(things[2], descriptor=things[0].descriptor)
    for _ in range(3):
        observe(tracker, [things[0], twin])
    tracker.library.tracks[0].retired = True
    alike, delta_shape = list(tracker.library.tracks.values()), tracker.association.delta_shape
    assert ids_by_likeness(view_of([things[0]]).codes, alike, delta_shape) == [(0, 1)]
    assert ids_by_likeness(view_of([things[1]]).codes, alike, delta_shape) == [()]


def test_correction_moves_the_belief_only(tracker):
    covariance = tracker.belief.covariance
    tracker.correct(exp([0, 0, 0, 1, 0, 0]))
    assert tracker.belief == Belief(tracker.belief.T_map_camera, covariance)
    assert tracker.belief.T_map_camera[0, 3] == 1.0


def test_papers_rule_can_be_chosen(things):
    tracker = ObjectTracker(AssociationParams(method="nearest"), InstantiationParams(), use_ambiguous=True)
    for _ in range(3):
        observe(tracker, things)
    far = exp([0.3, 0.2, 0.1, 2.0, 1.0, 0.5])
    located, _, _ = observe(tracker, things[:1], far)
    assert located.tracks[0] is None  # matched by the rule, refused by the pose

"""When an observation becomes an object."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.slam.instantiation import (
    InstantiationParams,
    expired,
    is_due,
    is_eligible,
    is_trackable,
    may_be_known,
)

from .synthetic import make_thing, small_world
from .test_association import scene_of

PARAMS = InstantiationParams()


def seen_at(range_m, mask_px=5000, touches_border=False):
    observation = next(small_world().steps()).frame.observations[0]
    code = observation.code
    code = replace(code, z=code.z * range_m / np.linalg.norm(code.center))
    return replace(observation, code=code, mask_px=mask_px, touches_border=touches_border)


@pytest.mark.parametrize(
    ("observation", "eligible"),
    [
        (seen_at(1.99), True),
        (seen_at(2.01), False),
        (seen_at(1.0, mask_px=PARAMS.min_mask_px), True),
        (seen_at(1.0, mask_px=PARAMS.min_mask_px - 1), False),
        (seen_at(1.0, touches_border=True), False),
    ],
)
def test_only_near_large_and_whole_observations_count(observation, eligible):
    assert is_eligible(observation, PARAMS) is eligible


def test_border_may_be_allowed():
    assert is_eligible(seen_at(1.0, touches_border=True), replace(PARAMS, allow_border=True))


@pytest.mark.parametrize(("sigma_m", "trackable"), [(0.02, True), (0.04, False)])
def test_objects_known_to_centimetres_are_followed(sigma_m, trackable):
    far = seen_at(4.0, mask_px=100)
    far = replace(far, code=replace(far.code, sigmas=np.array([0.1, 0.1, 0.1, 0.01, 0.01, sigma_m])))
    assert is_trackable(far, PARAMS) is trackable
    assert is_trackable(replace(far, touches_border=True), PARAMS) is trackable


@pytest.fixture
def tentative():
    rng = np.random.default_rng(0)
    scene = scene_of([make_thing(i, False, np.array([0.05 * i, 0, 1.0]), rng) for i in range(2)])
    scene.tracks[0].confirmed = False
    return scene


def test_three_sightings_make_an_object(tentative):
    track = tentative.tracks[0]
    for n, due in ((2, False), (3, True)):
        track.n_eligible = n
        assert is_due(track, False, PARAMS) is due


def test_doubtful_objects_wait_longer(tentative):
    track = tentative.tracks[0]
    for n, due in ((9, False), (10, True)):
        track.n_eligible = n
        assert is_due(track, True, PARAMS) is due


def test_object_does_not_become_one_twice(tentative):
    tentative.tracks[1].n_eligible = 5
    assert not is_due(tentative.tracks[1], False, PARAMS)


def test_tentative_tracks_expire_and_objects_do_not(tentative):
    assert expired(tentative.tracks, 3, PARAMS) == []
    assert expired(tentative.tracks, 4, PARAMS) == [tentative.tracks[0]]


def test_known_object_within_the_drift_makes_doubt(tentative):
    track, other = tentative.tracks
    alike, wide, narrow = np.array([True]), np.array([[0.0, 0.02**2]]), np.zeros((1, 2))
    assert may_be_known(track, alike, [other], wide, set(), 0.03)
    assert not may_be_known(track, alike, [other], narrow, set(), 0.03)
    assert not may_be_known(track, ~alike, [other], wide, set(), 0.03)
    assert not may_be_known(track, alike, [other], wide, {other.key}, 0.03)

"""Pose of a frame against known places."""

import numpy as np
import pytest

from neuse.geometry import exp, inverse, log
from neuse.slam.localization import Belief, localize, to_camera, to_map
from neuse.slam.object_frames import reduce_codes

from .synthetic import make_code, make_thing

SIGMAS = np.array([0.03, 0.03, 0.1, 0.003, 0.003, 0.003])
WIDE = np.diag([0.1, 0.1, 0.1, 0.3, 0.3, 0.3]) ** 2


@pytest.fixture
def truth():
    return exp([0.1, -0.2, 0.3, 0.5, -0.4, 0.2])


def seen_and_places(T_map_camera, kinds, seed=0):
    """Objects in front of the camera as it sees them, and where they are in the map."""
    rng = np.random.default_rng(seed)
    things = [
        make_thing(i, kind == "b", rng.uniform([-0.4, -0.4, 1], [0.4, 0.4, 2]), rng)
        for i, kind in enumerate(kinds)
    ]
    seen = reduce_codes([make_code(thing, thing.T_world_object, SIGMAS) for thing in things])
    return seen, to_map(T_map_camera, seen.vectors)


@pytest.mark.parametrize("kinds", ["m", "bb", "mbb"])
def test_exact_sightings_give_the_exact_pose(truth, kinds):
    seen, places = seen_and_places(truth, kinds)
    prior = Belief(truth @ exp([0.05, 0.02, -0.04, 0.1, -0.1, 0.05]), 1e6 * np.eye(6))
    np.testing.assert_allclose(localize(seen, places, prior).T_map_camera, truth, atol=1e-5)


def test_lone_bottle_leaves_the_turn_about_its_axis_to_the_prior(truth):
    seen, places = seen_and_places(truth, "b")
    prior = Belief(truth @ exp([0.02, 0.01, 0.03, 0.02, 0.02, -0.01]), WIDE)
    belief = localize(seen, places, prior)
    np.testing.assert_allclose(to_camera(belief.T_map_camera, places)[0], seen.centers, atol=1e-3)
    spread = np.linalg.eigvalsh(belief.covariance)
    assert spread[-1] > 100 * spread[0]


def test_without_sightings_the_prior_stays(truth):
    seen, places = seen_and_places(truth, "")
    belief = localize(seen, places, Belief(truth, WIDE))
    np.testing.assert_allclose(belief.T_map_camera, truth)
    np.testing.assert_allclose(belief.covariance, WIDE)


def test_flipped_handle_does_not_turn_the_camera(truth):
    seen, places = seen_and_places(truth, "mbb")
    places[2, 0] *= -1
    belief = localize(seen, places, Belief(truth @ exp([0, 0, 0, 0.1, 0, 0]), WIDE))
    assert np.linalg.norm(log(inverse(truth) @ belief.T_map_camera)[:3]) < 0.01


def test_object_that_moved_does_not_pull_the_camera(truth):
    seen, places = seen_and_places(truth, "mbmb")
    places[0, 1] += [0.1, 0.1, 0.0]
    belief = localize(seen, places, Belief(truth @ exp([0, 0, 0, 0.03, 0, 0]), WIDE))
    assert np.linalg.norm(log(inverse(truth) @ belief.T_map_camera)[3:]) < 0.01


def test_search_may_start_far_from_the_prior(truth):
    seen, places = seen_and_places(truth, "mbb")
    prior = Belief(truth @ exp([0.3, 0, 0, 1, 0, 0]), 100 * np.eye(6))
    np.testing.assert_allclose(localize(seen, places, prior, start=truth).T_map_camera, truth, atol=1e-4)


def test_to_camera_undoes_to_map(truth):
    seen, _ = seen_and_places(truth, "mb")
    np.testing.assert_allclose(to_camera(truth, to_map(truth, seen.vectors)), seen.vectors, atol=1e-12)


def test_motion_adds_its_covariance_in_the_new_frame(truth):
    turned = Belief(truth, np.diag([0, 0, 0, 4.0, 1.0, 0])).moved(exp([0, 0, np.pi / 2, 0, 0, 0]), np.eye(6))
    np.testing.assert_allclose(np.diag(turned.covariance), [1, 1, 1, 2, 5, 1], atol=1e-9)

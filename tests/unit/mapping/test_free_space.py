import numpy as np
import pytest

from neuse.mapping.free_space import FreeSpaceParams, Sight, free_share, look

from .synthetic import CAMERA, COARSE

PARAMS = FreeSpaceParams()


def ball(z_m=1.0, radius_m=0.04, count=200):
    """Points on the half of a ball that faces the camera."""
    directions = np.random.default_rng(0).normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions[:, 2] = -np.abs(directions[:, 2])
    return directions * radius_m + [0.0, 0.0, z_m]


def wall(z_m):
    return np.full(COARSE, z_m, dtype=np.float32)


def test_place_before_a_far_wall_is_empty():
    sight = look(ball(), wall(1.5), CAMERA, PARAMS)
    assert sight.free == 1.0
    assert sight.emptiness == 1.0
    assert not sight.is_taken


def test_place_with_a_surface_is_taken():
    sight = look(ball(), wall(0.99), CAMERA, PARAMS)
    assert sight.is_taken
    assert sight.emptiness == 0.0


def test_place_behind_something_is_neither():
    sight = look(ball(), wall(0.5), CAMERA, PARAMS)
    assert sight.hidden == 1.0
    assert sight.emptiness == 0.0
    assert not sight.is_taken


@pytest.mark.parametrize(
    ("free", "taken", "emptiness"),
    [(0.55, 0.4, 1.0), (0.3, 0.1, 0.5), (0.45, 0.4, 0.5), (0.4, 0.5, 0.0), (0.15, 0.0, 0.0)],
    ids=["mostly free", "mostly hidden", "on a table", "half taken", "free at its edge"],
)
def test_place_partly_seen_through_is_weaker_evidence(free, taken, emptiness):
    sight = Sight(free, taken, 1.0 - free - taken, PARAMS)
    assert sight.emptiness == emptiness
    assert not sight.is_taken


def test_shares_sum_to_one():
    depth = wall(1.5)
    depth[:, :40], depth[:30] = 0.7, 0.98
    sight = look(ball(), depth, CAMERA, PARAMS)
    assert sight.free + sight.taken + sight.hidden == pytest.approx(1.0)
    assert min(sight.free, sight.taken, sight.hidden) > 0.1


def test_sample_beside_the_object_does_not_pass_for_a_view_through_it():
    """Only every second column hits the object's surface; the nearest of four samples is one that does."""
    depth = wall(3.0)
    depth[:, ::2] = 0.97
    assert look(ball(), depth, CAMERA, PARAMS).free == 0.0


def test_margin_grows_with_range():
    for z_m, free in ((2.8, 0.0), (0.8, 1.0)):
        sight = look(ball(z_m, radius_m=0.003), wall(z_m + 0.03), CAMERA, PARAMS)
        assert sight.free == free


@pytest.mark.parametrize(
    ("points", "depth"),
    [
        (ball(3.5), wall(5.0)),
        (ball() + np.array([5.0, 0.0, 0.0]), wall(5.0)),
        (ball() - np.array([0.0, 0.0, 2.0]), wall(5.0)),
        (ball(), wall(0.0)),
        (ball(), wall(np.nan)),
        (ball(count=5), wall(5.0)),
    ],
    ids=["too far", "out of view", "behind the camera", "no reading", "nan", "too few points"],
)
def test_what_cannot_be_seen_is_no_evidence(points, depth):
    assert look(points, depth, CAMERA, PARAMS) is None


def test_free_share_is_the_median_and_zero_without_sights():
    sights = [Sight(free, 1.0 - free, 0.0, PARAMS) for free in (0.1, 0.2, 0.9)]
    assert free_share(sights) == 0.2
    assert free_share([]) == 0.0

"""Which keyframes stay: a place is seen a few times, however often the camera comes by."""

import numpy as np
import pytest

from neuse.slam.thinning import Thinning

NEAR_M = 0.2
POSITIONS = np.array([[0.0, 0, 0], [0.15, 0, 0], [1.0, 0, 0], [0.1, 0, 0], [0.1, 0.5, 0]])


@pytest.fixture
def thinning():
    """Keyframes 0 and 1 are near each other and see different landmarks, 2 is far away."""
    thinning = Thinning(NEAR_M, views=1)
    for keyframe_id, landmarks in enumerate([{1, 2}, {3}, {1, 2, 3, 4}]):
        thinning.keep(keyframe_id, landmarks)
    return thinning


@pytest.mark.parametrize(
    ("landmarks", "stand_in"),
    [
        ({1}, 0),  # the only one near that sees it
        ({3}, 1),
        ({1, 3}, 1),  # all is seen from nearby, by two; the nearer one stands in
        ({1, 4}, None),  # 4 has not been seen from here
    ],
)
def test_keyframe_goes_that_sees_what_others_nearby_see(thinning, landmarks, stand_in):
    assert thinning.stand_in(3, landmarks, POSITIONS) == stand_in


def test_as_many_have_to_see_it_as_a_place_is_worth():
    thinning = Thinning(NEAR_M, views=2)
    thinning.keep(0, {1})
    assert thinning.stand_in(3, {1}, POSITIONS) is None
    thinning.keep(1, {1})
    assert thinning.stand_in(3, {1}, POSITIONS) == 1


def test_keyframe_stays_where_no_other_is_near(thinning):
    assert thinning.stand_in(4, {1}, POSITIONS) is None


def test_first_keyframe_stays():
    assert Thinning(NEAR_M, views=1).stand_in(0, {1}, POSITIONS) is None


def test_number_of_keyframes_does_not_grow_with_rounds():
    rng, kept = np.random.default_rng(0), []
    angles = np.linspace(0, 20 * np.pi, 2000)  # ten rounds
    positions = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1) + 0.01 * rng.normal(
        size=(2000, 3)
    )
    thinning = Thinning(NEAR_M, views=1)
    for i, angle in enumerate(angles):
        landmarks = {int(angle % (2 * np.pi) / 0.5)}
        if thinning.stand_in(i, landmarks, positions) is None:
            thinning.keep(i, landmarks)
            kept.append(i)
    assert 30 < len(kept) < 80  # at least one for every 0.2 m of 6.3 m
    assert max(kept) < 400

import numpy as np
import pytest

from neuse import geometry
from neuse.geometry import make_transform
from neuse.mapping.reconstruction import Box
from neuse.mapping.upkeep import UpkeepParams, is_displaced, is_residual, overlap

PARAMS = UpkeepParams()


def box(x=0.0, size=(0.1, 0.1, 0.1), R=None):
    return Box(make_transform(np.eye(3) if R is None else R, [x, 0.0, 0.0]), np.array(size))


@pytest.mark.parametrize(("shift", "share"), [(0.0, 1.0), (0.05, 0.5), (0.02, 0.8), (0.1, 0.0), (3.0, 0.0)])
def test_overlap_of_shifted_boxes(shift, share):
    assert overlap(box(), box(shift)) == pytest.approx(share, abs=1e-9)


def test_overlap_is_a_share_of_the_first_box():
    small, large = box(size=(0.05, 0.05, 0.05)), box()
    assert overlap(small, large) == 1.0
    assert overlap(large, small) == pytest.approx(0.125, abs=0.1)


def test_overlap_does_not_depend_on_the_frame():
    T = geometry.exp([0.4, -1.0, 0.3, 1.0, 2.0, 3.0])
    turned = box(0.03, (0.2, 0.1, 0.05), geometry.exp([0.2, 0.5, 0, 0, 0, 0])[:3, :3])
    assert overlap(box().moved(T), turned.moved(T)) == overlap(box(), turned)


def test_small_box_inside_a_large_one_is_residual_and_not_the_reverse():
    small, large = box(0.01, (0.05, 0.05, 0.05)), box()
    assert is_residual(small, large, PARAMS)
    assert not is_residual(large, small, PARAMS)


def test_small_box_that_sticks_out_by_a_tenth_is_no_residual():
    assert not is_residual(box(0.03, (0.05, 0.05, 0.05)), box(), PARAMS)


@pytest.mark.parametrize(("shift", "displaced"), [(0.07, True), (0.09, False)])
def test_older_object_is_displaced_from_a_fifth_of_overlap(shift, displaced):
    assert is_displaced(box(), box(shift), PARAMS) is displaced


def test_tall_object_that_swallows_a_small_one_displaces_it():
    """Little of the tall one lies in the small one's box, but that box is full."""
    small = box(size=(0.08, 0.08, 0.08))
    tall = Box(make_transform(np.eye(3), [0.01, 0.0, 0.2]), np.array([0.09, 0.09, 0.48]))
    assert overlap(tall, small) < PARAMS.displacing_overlap
    assert is_displaced(small, tall, PARAMS)

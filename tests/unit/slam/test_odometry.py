"""Odometry and its faults: each is refused, counted, and does no harm to what follows."""

from collections import Counter

import numpy as np
import pytest

from neuse.errors import ParamError
from neuse.geometry import exp, inverse
from neuse.records import OdometrySample
from neuse.slam.odometry import OdometryParams, OdometryTracker

FRAME_NS = 100_000_000


def pose(i):
    return exp([0, 0, 0.01 * i, 0.05 * i, 0, 0])


def sample(i):
    return OdometrySample(i * FRAME_NS, pose(i))


@pytest.fixture
def tracker():
    return OdometryTracker(OdometryParams(), Counter())


def test_motion_between_two_samples_is_their_difference(tracker):
    first, second = (tracker.accept(sample(i), i * FRAME_NS) for i in (0, 1))
    motion = tracker.motion(first, second)
    np.testing.assert_allclose(motion.T_from_to, inverse(pose(0)) @ pose(1))
    np.testing.assert_allclose(np.diag(motion.covariance), [0.003**2] * 3 + [0.05**2] * 3)


def test_uncertainty_grows_with_the_frames_between(tracker):
    fixes = [tracker.accept(sample(i), i * FRAME_NS) for i in range(5)]
    near, far = tracker.motion(fixes[0], fixes[1]), tracker.motion(fixes[0], fixes[4])
    np.testing.assert_allclose(far.covariance, 4 * near.covariance)


def test_frames_without_sample_are_counted_and_bridged(tracker):
    first = tracker.accept(sample(0), 0)
    assert tracker.accept(None, FRAME_NS) is None
    third = tracker.accept(sample(2), 2 * FRAME_NS)
    np.testing.assert_allclose(tracker.motion(first, third).T_from_to, inverse(pose(0)) @ pose(2))
    assert tracker.counters == {"odometry_missing": 1}


def test_stopped_odometry_is_stale(tracker):
    tracker.accept(sample(0), 0)
    assert tracker.accept(sample(0), 3 * FRAME_NS) is None
    assert tracker.counters == {"odometry_stale": 1}


def test_same_sample_twice_says_nothing_of_the_second_frame(tracker):
    tracker.accept(sample(1), FRAME_NS)
    assert tracker.accept(sample(1), FRAME_NS + 30_000_000) is None
    assert tracker.counters == {"odometry_repeated": 1}


def test_sample_older_than_the_last_is_refused(tracker):
    tracker.accept(sample(5), 5 * FRAME_NS)
    assert tracker.accept(sample(4), 6 * FRAME_NS) is None
    assert tracker.counters == {"odometry_backwards": 1}


def test_jump_starts_a_new_segment(tracker):
    before = tracker.accept(sample(0), 0)
    jumped = OdometrySample(FRAME_NS, exp([0, 0, 0, 50.0, 0, 0]))
    after = tracker.accept(jumped, FRAME_NS)
    onward = tracker.accept(OdometrySample(2 * FRAME_NS, exp([0, 0, 0, 50.1, 0, 0])), 2 * FRAME_NS)
    assert tracker.motion(before, after) is None
    assert tracker.motion(after, onward).T_from_to[0, 3] == pytest.approx(0.1)
    assert tracker.counters == {"odometry_jump": 1}


def test_jump_in_heading_starts_a_new_segment(tracker):
    before = tracker.accept(sample(0), 0)
    after = tracker.accept(OdometrySample(FRAME_NS, exp([0, 0, 2.0, 0, 0, 0])), FRAME_NS)
    assert tracker.motion(before, after) is None


@pytest.mark.parametrize("T", [np.full((4, 4), np.nan), np.diag([2.0, 2, 2, 1]), np.eye(3)])
def test_pose_that_is_not_rigid_is_refused(tracker, T):
    assert tracker.accept(OdometrySample(0, T), 0) is None
    assert tracker.counters == {"odometry_not_rigid": 1}


def test_without_odometry_motion_is_slow(tracker):
    one, two = tracker.free_motion(0.1), tracker.free_motion(0.2)
    np.testing.assert_array_equal(one.T_from_to, np.eye(4))
    np.testing.assert_allclose(two.covariance, 4 * one.covariance)


def test_no_motion_from_a_frame_without_fix(tracker):
    assert tracker.motion(None, tracker.accept(sample(0), 0)) is None


def test_unknown_use_is_refused():
    with pytest.raises(ParamError, match="use = 'sometimes'"):
        OdometryParams(use="sometimes")

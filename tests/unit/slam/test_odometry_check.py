"""Odometry beside objects: lies are refused and counted, noise is learned, good odometry is left alone."""

from collections import Counter

import numpy as np
import pytest

from neuse.geometry import Array, exp, inverse
from neuse.records import Edge, EdgeKind, OdometrySample
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.object_frames import reduce_codes
from neuse.slam.odometry import Motion, OdometryParams, OdometryTracker
from neuse.slam.odometry_check import LEAST_OBJECTS, OdometryCheck

FRAME_NS = 100_000_000
STATED = np.array([0.003] * 3 + [0.05] * 3)
TIE = np.array([0.002] * 3 + [0.002] * 3)
STEP = exp([0, 0.05, 0, 0.04, 0, 0])
NO_OBJECTS = reduce_codes([])


class Run:
    """Keyframes at every frame of a smooth path, with odometry and edges from codes to the last nine."""

    def __init__(self, **params):
        self.counters: Counter[str] = Counter()
        self.rng = np.random.default_rng(0)
        self.odometry = OdometryTracker(OdometryParams(**params), self.counters)
        self.check = OdometryCheck(self.odometry)
        self.records: list[KeyframeRecord] = []
        self.T_odom_camera, self.blind_frames = np.eye(4), 0

    def step(self, error: Array, objects: int = 3) -> Motion | None:
        """One frame further, odometry being wrong by exp(error); what is believed of the last motion."""
        index = len(self.records)
        self.T_odom_camera = self.T_odom_camera @ STEP @ exp(error)
        stamp_ns = index * FRAME_NS
        sample = OdometrySample(stamp_ns, self.T_odom_camera)
        fix = self.odometry.accept(sample, stamp_ns, self.blind_frames)
        self.blind_frames = 0 if objects else self.blind_frames + 1
        new = KeyframeRecord(index, stamp_ns, np.zeros(0, int), NO_OBJECTS, fix)
        ties = [self._tie(old, new, objects) for old in self.records[-9:]] if objects else []
        motion = self.check.between(self.records[-1], new, ties) if self.records else None
        self.records.append(new)
        return motion

    def _tie(self, old: KeyframeRecord, new: KeyframeRecord, objects: int) -> Edge:
        T = np.linalg.matrix_power(STEP, new.keyframe_id - old.keyframe_id) @ exp(
            TIE * self.rng.normal(size=6)
        )
        ends = old.keyframe_id, new.keyframe_id, old.stamp_ns, new.stamp_ns
        return Edge(*ends, EdgeKind.SHORT_RANGE, T, np.diag(TIE**2), tuple(range(objects)))

    def play(self, sigmas: Array, frames: int, objects: int = 3) -> Motion:
        """Many frames with white errors; the last motion."""
        for _ in range(frames):
            motion = self.step(sigmas * self.rng.normal(size=6), objects)
        assert motion is not None
        return motion


def sigmas_of(motion: Motion) -> Array:
    """(2,) of rotation and translation."""
    return np.sqrt(np.diag(motion.covariance)[[0, 3]])


def test_good_odometry_is_not_touched():
    run = Run()
    motion = run.play(STATED, 300)
    assert not run.counters
    np.testing.assert_allclose(sigmas_of(motion) / STATED[[0, 3]], 1.0, atol=0.35)


@pytest.mark.parametrize("true", [(0.012, 0.2), (0.003, 0.01), (0.0015, 0.15)])
def test_noise_is_found_within_a_factor_of_one_and_a_half(true):
    found = sigmas_of(Run().play(np.repeat(true, 3), 400))
    assert np.abs(np.log(found / true)).max() < np.log(1.5)


def test_bias_makes_odometry_doubtful():
    run = Run()
    run.play(np.repeat([0.0, 1e-6], 3), 10)
    for _ in range(200):
        motion = run.step(np.array([0, 0, 0, 0.15, 0, 0]))
    assert sigmas_of(motion)[1] > 0.1


@pytest.mark.parametrize("lie", [(0, 0, 0, 0.5, 0, 0), (0, 0.35, 0, 0, 0, 0)])
def test_increment_that_objects_contradict_is_refused_and_counted(lie):
    run = Run()
    run.play(STATED, 50)
    assert run.step(np.array(lie)) is None
    assert run.counters == {"odometry_contradicted": 1}
    assert run.step(np.zeros(6)) is not None
    assert run.counters == {"odometry_contradicted": 1}


@pytest.mark.parametrize("objects", [0, LEAST_OBJECTS - 1])
def test_without_objects_odometry_is_taken_at_its_word(objects):
    run = Run()
    motion = run.play(3 * STATED, 100, objects)
    assert not run.counters
    np.testing.assert_allclose(motion.covariance, np.diag(STATED**2))


def test_what_was_good_beside_objects_is_no_better_than_stated_without():
    run = Run()
    seen = run.play(np.repeat([0.003, 0.005], 3), 300)
    blind = run.step(np.zeros(6), objects=0)
    assert sigmas_of(seen)[1] < 0.01
    np.testing.assert_allclose(sigmas_of(blind)[1], 0.05)


def test_what_was_bad_beside_objects_is_bad_without():
    run = Run()
    run.play(4 * STATED, 300)
    assert sigmas_of(run.step(np.zeros(6), objects=0))[1] > 2.5 * 0.05


def test_stated_noise_stands_if_so_wished():
    run = Run(adapt=False)
    motion = run.play(3 * STATED, 100)
    np.testing.assert_allclose(motion.covariance, np.diag(STATED**2))
    assert not run.counters


def test_motion_is_refuted_by_another():
    run = Run()
    run.play(STATED, 2)
    first, second = (record.fix for record in run.records)
    assert first is not None
    assert second is not None
    told = inverse(first.T_odom_camera) @ second.T_odom_camera
    covariance = np.diag(TIE**2)
    assert not run.check.is_refuted(first, second, Motion(told, covariance))
    assert run.check.is_refuted(first, second, Motion(told @ exp([0, 0, 0.2, 0, 0, 0]), covariance))


@pytest.mark.parametrize(("sigma_m", "bias"), [(0.005, OdometryParams().blind_bias), (0.05, 0.0)])
def test_noise_that_did_not_show_beside_objects_is_one_error_where_there_are_none(sigma_m, bias):
    run, n = Run(), 20
    run.play(np.repeat([0.003, sigma_m], 3), 300)
    blind = [run.step(np.zeros(6), objects=0) for _ in range(n)]
    variance = sum(sigmas_of(motion)[1] ** 2 for motion in blind)
    assert variance == pytest.approx(0.05**2 * (n + bias * n * (n - 1)), rel=0.35)

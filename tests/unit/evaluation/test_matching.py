"""Scans and features find the motion between simulated frames, from a guess that is off."""

import numpy as np
import pytest

from neuse.errors import InputError
from neuse.evaluation import external_runs as module
from neuse.evaluation.external_runs import FEATURES, SCANS, external_runs
from neuse.evaluation.feature_matching import FeatureMatcher, camera_matrix, project
from neuse.evaluation.scan_matching import ScanMatcher, ScanParams
from neuse.geometry import exp, inverse, log
from neuse.records import Intrinsics, RgbdFrame
from neuse.simulation.worlds import make_world, simulate

OFF = exp([0.005, -0.005, 0.005, 0.01, -0.01, 0.0])


@pytest.fixture(scope="module")
def frames():
    return list(simulate(make_world("tabletop", 101), 20, 23))


def test_features_find_the_motion_between_frames(frames):
    old, new = frames[0], frames[1]
    T_old_new = inverse(old.T_world_camera) @ new.T_world_camera
    matcher = FeatureMatcher()
    match = matcher.match(matcher.view(old.frame), matcher.view(new.frame), T_old_new @ OFF, 1.0)
    error = log(inverse(T_old_new) @ match.T_old_new)
    assert np.linalg.norm(error[:3]) < 0.01
    assert np.linalg.norm(error[3:]) < 0.01
    assert 0.3 < match.overlap <= 1.0


def test_scans_find_the_height_and_leave_to_the_guess_how_planes_slide(frames):
    old, new = frames[0], frames[1]
    matcher = ScanMatcher(ScanParams(guess_rad=0.02, guess_m=0.1))
    lifted = exp([0.0, 0.0, 0.0, 0.0, 0.0, 0.01]) @ new.T_world_camera
    guess = inverse(old.T_world_camera) @ lifted
    match = matcher.match(matcher.view(old.frame), matcher.view(new.frame), guess, 1.0)
    found = old.T_world_camera @ match.T_old_new
    assert abs(found[2, 3] - new.T_world_camera[2, 3]) < 0.004
    sigmas = np.sqrt(np.linalg.eigvalsh(match.covariance))
    assert 0 < sigmas[0] < sigmas[-1] <= 1.01 * matcher.params.guess_m


@pytest.mark.parametrize("matcher", [ScanMatcher(), FeatureMatcher()])
def test_frame_without_readings_matches_nothing(frames, matcher):
    seen = frames[0].frame
    empty = RgbdFrame(1, np.zeros_like(seen.depth_m), seen.mask, (), seen.intrinsics, seen.color)
    assert matcher.match(matcher.view(seen), matcher.view(empty), np.eye(4), 1.0) is None
    assert matcher.match(matcher.view(empty), matcher.view(seen), np.eye(4), 1.0) is None


def test_features_need_a_picture(frames):
    seen = frames[0].frame
    with pytest.raises(InputError, match="no colour image"):
        FeatureMatcher().view(RgbdFrame(1, seen.depth_m, seen.mask, (), seen.intrinsics))


def test_projection_is_that_of_the_camera_matrix():
    camera, points = (
        Intrinsics(640, 480, 600.0, 610.0, 320.0, 240.0),
        np.array([[0.1, -0.2, 2.0], [0, 0, -1.0]]),
    )
    expected = camera_matrix(camera) @ points[0]
    pixels = project(points, camera)
    np.testing.assert_allclose(pixels[0], expected[:2] / expected[2])
    assert np.all(pixels[1] < -1e5)


def test_both_run_on_a_world_once(tmp_path, monkeypatch):
    runs = external_runs("tabletop", 101, tmp_path, 3)
    assert set(runs) == {SCANS, FEATURES}
    assert all(len(run.odometry) == len(run.closures) == len(run.trajectory) == 3 for run in runs.values())
    monkeypatch.setattr(module, "run_externals", None)
    again = external_runs("tabletop", 101, tmp_path, 3)
    np.testing.assert_array_equal(
        again[SCANS].odometry[-1].T_odom_camera, runs[SCANS].odometry[-1].T_odom_camera
    )

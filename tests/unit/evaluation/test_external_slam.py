"""SLAM without objects, with a matcher that knows the truth, or what the test wants it to know."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pytest

from neuse.evaluation.external_slam import ExternalSlam, ExternalSlamParams, Match
from neuse.geometry import exp, inverse, log
from neuse.records import EdgeKind, Intrinsics, RgbdFrame

CAMERA = Intrinsics(4, 4, 4.0, 4.0, 1.5, 1.5)
LAP = 60
STEP = exp([0.0, 2 * np.pi / LAP, 0.0, 0.1, 0.0, 0.0])


@dataclass
class PoseMatcher:
    """Views are true poses. Increments have a bias; matches over a gap in time have none.

    blind: indices of views that match nothing.    wrong_m: {index of a view: by how much its matches err}.
    """

    bias: np.ndarray
    blind: frozenset = frozenset()
    wrong_m: Mapping[int, float] = field(default_factory=dict)
    index: int = -1

    def view(self, frame):
        self.index += 1
        T = np.eye(4)
        for _ in range(self.index % LAP):
            T = T @ STEP
        return self.index, T

    def match(self, old, new, T_old_new, slack):
        if new[0] in self.blind:
            return None
        near = new[0] - old[0] < LAP // 2
        assert slack == (1.0 if near else ExternalSlamParams().closure_slack)
        T_old_new = inverse(old[1]) @ new[1] @ exp((new[0] - old[0]) * self.bias * near)
        T_old_new = T_old_new @ exp([0.0, 0.0, 0.0, self.wrong_m.get(new[0], 0.0), 0.0, 0.0])
        return Match(T_old_new, 1e-4 * np.eye(6), 0.9)


def run(frames, bias=0.0, blind=(), wrong_m=None, **params):
    matcher = PoseMatcher(np.array([0.0, bias, 0.0, 0.0, 0.0, 0.0]), frozenset(blind), wrong_m or {})
    slam = ExternalSlam(matcher, ExternalSlamParams(**params))
    empty = np.zeros((4, 4), np.float32)
    steps = [slam.step(RgbdFrame(i + 1, empty, empty.astype(int), (), CAMERA)) for i in range(frames)]
    return slam, steps


def true_pose(index):
    return np.linalg.matrix_power(STEP, index)


def test_odometry_and_trajectory_follow_exact_matches():
    slam, steps = run(30)
    for i, step in enumerate(steps):
        np.testing.assert_allclose(step.odometry.T_odom_camera, true_pose(i), atol=1e-6)
    np.testing.assert_allclose(slam.trajectory().T_frame_camera[-1], true_pose(29), atol=1e-4)
    assert slam.lost == 0


def test_camera_goes_on_as_before_in_a_frame_that_matches_nothing():
    slam, steps = run(30, blind=[10])
    assert slam.lost == 1
    np.testing.assert_allclose(steps[-1].odometry.T_odom_camera, true_pose(29), atol=1e-6)


def test_nothing_is_published_where_it_is_lost():
    _, steps = run(30, blind=range(10, 14))
    assert [i for i, step in enumerate(steps) if step.odometry is None] == [10, 11, 12, 13]


def test_wrong_motion_does_not_refuse_all_that_matches_later():
    slam, steps = run(30, wrong_m={9: 0.09, 10: 0.27}, keyframe_m=1.0)
    assert 0 < slam.lost < 5
    assert all(step.odometry is not None for step in steps[-10:])


def test_match_far_from_the_expected_motion_is_refused():
    slam, _ = run(5, bias=0.2)
    assert slam.lost > 0


def test_loop_is_closed_with_stamps_and_drift_goes():
    slam, steps = run(LAP + 5, bias=0.004)
    closures = [edge for step in steps for edge in step.closures]
    assert closures
    assert all(edge.kind == EdgeKind.EXTERNAL for edge in closures)
    first = closures[0]
    T_true = inverse(true_pose(first.from_stamp_ns - 1)) @ true_pose(first.to_stamp_ns - 1)
    np.testing.assert_allclose(first.T_from_to, T_true, atol=1e-6)
    drift = [log(inverse(true_pose(LAP + 4)) @ T) for T in
             (steps[-1].odometry.T_odom_camera, slam.trajectory().T_frame_camera[-1])]  # fmt: skip
    assert np.linalg.norm(drift[1]) < 0.2 * np.linalg.norm(drift[0])


def test_loop_that_drift_has_hidden_is_not_tried():
    _, steps = run(LAP + 5, bias=0.004, closure_m=0.01)
    assert not any(step.closures for step in steps)


@pytest.mark.parametrize("gate", [{"closure_overlap": 0.95}, {"closure_sigma": 0.005}])
def test_poor_loop_closures_are_refused(gate):
    _, steps = run(LAP + 5, **gate)
    assert not any(step.closures for step in steps)

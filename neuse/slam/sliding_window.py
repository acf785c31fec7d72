"""The last keyframes under their mutual edges (NeuSE IV-C)."""

from collections.abc import Sequence

import gtsam

from neuse.geometry import Array, renormalized
from neuse.records import Edge
from neuse.slam.factors import edge_factor, huber, origin_factor, pose_key, solver_errors
from neuse.slam.smoother import SolverParams


class SlidingWindow:
    """The last K keyframes under their mutual edges: Levenberg-Marquardt with marginalisation (NeuSE IV-C).

    It lives in its own frame, `window`, that starts as the map and is never corrected by loop closures; only
    relative poses of keyframes inside the window mean anything.
    """

    def __init__(self, size: int, params: SolverParams | None = None) -> None:
        self.params, self.size = params or SolverParams(), size
        solver = gtsam.LevenbergMarquardtParams()
        solver.setMaxIterations(self.params.window_iterations)
        self._smoother = gtsam.BatchFixedLagSmoother(float(size - 1), solver)
        self._poses: dict[int, Array] = {}

    def add(self, keyframe_id: int, T_window_camera: Array, edges: Sequence[Edge]) -> None:
        """A new keyframe with its start value and its edges into the window; ids count up by one.

        Raises:
            SolverError: an edge leads to no keyframe of the window.
        """
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        key = pose_key(keyframe_id)
        values.insert(key, gtsam.Pose3(renormalized(T_window_camera)))
        if not self._poses:
            factors.add(origin_factor(keyframe_id, T_window_camera))
        for edge in edges:
            factors.add(edge_factor(edge, huber(self.params.huber_sigmas)))
        with solver_errors():
            self._smoother.update(factors, values, {key: float(keyframe_id)})
        self._read()

    def has(self, keyframe_id: int) -> bool:
        """Whether a keyframe is inside the window."""
        return keyframe_id in self._poses

    def pose(self, keyframe_id: int) -> Array:
        """T_window_camera of a keyframe inside the window."""
        return self._poses[keyframe_id]

    def _read(self) -> None:
        estimate = self._smoother.calculateEstimate()
        self._poses = {
            int(gtsam.Symbol(key).index()): estimate.atPose3(key).matrix()
            for key in estimate.keys()  # noqa: SIM118
        }

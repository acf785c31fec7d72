"""Errors of a trajectory against ground truth: ATE and RPE as evo computes them."""

from dataclasses import dataclass

import numpy as np
from evo import EvoException
from evo.core import metrics
from evo.core.geometry import GeometryException
from evo.core.sync import SyncException, associate_trajectories
from evo.core.trajectory import PoseTrajectory3D
from numpy.typing import NDArray

from neuse.errors import DegenerateGeometryError
from neuse.evaluation.trajectory import MAX_STAMP_DIFFERENCE_S, Trajectory
from neuse.geometry import Array, make_transform


@dataclass(frozen=True)
class TrajectoryErrors:
    """Errors of one trajectory over the stamps that both sides have, after SE(3) alignment without scale.

    T_world_map: the alignment.    ate_m: (n,) position errors at stamps_ns (n,).    rpe_*: translation parts.
    rpe_per_m_rmse_m: RPE over 1 m of the true path, None when the path is shorter.
    """

    T_world_map: Array
    stamps_ns: NDArray[np.int64]
    ate_m: Array
    rpe_trans_rmse_m: float | None
    rpe_per_m_rmse_m: float | None

    @property
    def ate_rmse_m(self) -> float:
        """Root mean square of the position errors."""
        return float(np.sqrt(np.mean(self.ate_m**2)))


def trajectory_errors(estimate: Trajectory, truth: Trajectory) -> TrajectoryErrors:
    """ATE (aligned by Umeyama without scale) and RPE of an estimate.

    Raises:
        DegenerateGeometryError: fewer than three common stamps, or all positions on one line.
    """
    true_path, path = _associated(estimate, truth)
    try:
        R, t, _ = path.align(true_path)
    except GeometryException as error:
        raise DegenerateGeometryError(f"the path cannot be aligned with ground truth: {error}") from error
    ate = metrics.APE(metrics.PoseRelation.translation_part)
    ate.process_data((true_path, path))
    stamps_ns = np.rint(path.timestamps * 1e9).astype(np.int64) + estimate.stamps_ns[0]
    per_frame = _rpe_rmse(true_path, path, metrics.RPE(metrics.PoseRelation.translation_part, delta=1))
    per_m = metrics.RPE(
        metrics.PoseRelation.translation_part,
        delta=1.0,
        delta_unit=metrics.Unit.meters,
        rel_delta_tol=0.2,
        all_pairs=True,
        pairs_from_reference=True,
    )
    return TrajectoryErrors(
        make_transform(R, t), stamps_ns, ate.error, per_frame, _rpe_rmse(true_path, path, per_m)
    )


def _associated(estimate: Trajectory, truth: Trajectory) -> tuple[PoseTrajectory3D, PoseTrajectory3D]:
    """(truth, estimate) at their common stamps, in seconds since the estimate's first."""
    if len(estimate) < 3 or len(truth) < 3:
        raise DegenerateGeometryError(f"{len(estimate)} estimated, {len(truth)} true poses; three are needed")
    origin_ns = int(estimate.stamps_ns[0])
    try:
        pair = associate_trajectories(
            _to_evo(truth, origin_ns), _to_evo(estimate, origin_ns), max_diff=MAX_STAMP_DIFFERENCE_S
        )
    except SyncException as error:
        raise DegenerateGeometryError("no common stamps with ground truth; is it the right bag?") from error
    if pair[0].num_poses < 3:
        raise DegenerateGeometryError(f"{pair[0].num_poses} stamps in common with ground truth, not three")
    return pair


def _to_evo(trajectory: Trajectory, origin_ns: int) -> PoseTrajectory3D:
    seconds = (trajectory.stamps_ns - origin_ns) / 1e9
    return PoseTrajectory3D(poses_se3=list(trajectory.T_frame_camera), timestamps=seconds)


def _rpe_rmse(true_path: PoseTrajectory3D, path: PoseTrajectory3D, metric: metrics.RPE) -> float | None:
    """Root mean square of a relative error; None when the path has no pair that far apart."""
    try:
        metric.process_data((true_path, path))
    except EvoException:
        return None
    return float(metric.get_statistic(metrics.StatisticsType.rmse))

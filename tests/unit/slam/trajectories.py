"""Accuracy of trajectories, by evo."""

from evo.core.metrics import APE, PoseRelation, StatisticsType
from evo.core.trajectory import PosePath3D


def ate_rmse_m(trajectory, steps):
    """RMSE of the positions after rigid alignment, metres."""
    estimate = PosePath3D(poses_se3=[T for _, T in trajectory])
    truth = PosePath3D(poses_se3=[step.T_world_camera for step in steps])
    estimate.align(truth)
    ape = APE(PoseRelation.translation_part)
    ape.process_data((truth, estimate))
    return ape.get_statistic(StatisticsType.rmse)

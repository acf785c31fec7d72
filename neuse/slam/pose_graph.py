"""All keyframes and landmarks, solved incrementally by iSAM2 (NeuSE IV-C)."""

from collections.abc import Iterable
from dataclasses import dataclass

import gtsam
import numpy as np

from neuse.errors import SolverError
from neuse.geometry import Array, renormalized
from neuse.params import CheckedParams, param
from neuse.records import Edge
from neuse.slam.factors import (
    BIAS,
    LOOSE_POINT,
    POINT,
    POSE,
    VELOCITY,
    bias_factor,
    bias_key,
    edge_factor,
    hold_factor,
    known_point_factor,
    origin_factor,
    pose_key,
    sighting_factor,
    smooth_motion_factor,
    solver_errors,
    velocity_key,
)

LOOSE_FACTOR = 10.0  # loose points may move so much further before they are relinearised
NEVER = 1e9  # threshold of what enters linearly and need not be relinearised
FAST, SAFE = "CHOLESKY", "QR"  # factorisations; the second can do where the first finds sigmas too far apart


@dataclass(frozen=True)
class SolverParams(CheckedParams):
    """How the graph is solved."""

    cauchy_sigmas: float = param(3.0, "scale of the Cauchy kernel on sightings, sigmas", 0.1, 100.0)
    huber_sigmas: float = param(3.0, "threshold of the Huber kernel on edges, sigmas", 0.1, 100.0)
    relinearize_m_rad: float = param(
        0.01, "iSAM2 relinearises what moved more than this, m or rad", 1e-6, 1.0
    )
    relinearize_every: int = param(5, "solutions between two relinearisations", 1, 1000)
    acceleration_mps2: float = param(
        0.3,
        "the camera moves smoothly: white noise of its acceleration, m/s^2/sqrt(Hz); 0: it may jerk",
        0.0,
        1e3,
    )
    window_iterations: int = param(20, "most Levenberg-Marquardt iterations in the window", 1, 100)


class PoseGraph:
    """Keyframe poses T_map_camera and landmark points under all that is known of them."""

    def __init__(self, params: SolverParams | None = None) -> None:
        self.params = params or SolverParams()
        self._isam = gtsam.ISAM2(_isam_params(self.params, FAST))
        self._new_factors = gtsam.NonlinearFactorGraph()
        self._new_values = gtsam.Values()
        self._points: dict[int, int] = {}  # gtsam's keys
        self._moving: set[int] = set()  # keyframes with a velocity
        self._poses: Array | None = None  # of the last solution, once all were asked for

    def add_origin(self, keyframe_id: int, T_map_camera: Array) -> None:
        """Fix the pose that defines the map frame."""
        self._new_factors.add(origin_factor(keyframe_id, T_map_camera))

    def move(self, T_map_graph: Array) -> None:
        """Put everything elsewhere; nothing holds it there until `add_hold` and `add_known_point` say what.

        Edges and sightings are relative, so that they stay as they are.
        """
        values = _moved(T_map_graph, self._isam.calculateEstimate())
        self._begin_anew(values, FAST, (gtsam.PriorFactorPose3, gtsam.PriorFactorPoint3))

    def add_hold(self, keyframe_id: int, T_map_camera: Array, covariance: Array) -> None:
        """A pose that is known from elsewhere."""
        self._new_factors.add(hold_factor(keyframe_id, T_map_camera, covariance))

    def add_known_point(self, point_id: int, p_map: Array, covariance: Array) -> None:
        """A landmark point whose place is known from elsewhere, metres, covariance (3, 3)."""
        if point_id not in self._points:
            self._points[point_id] = gtsam.symbol(POINT, point_id)
            self._new_values.insert(self._points[point_id], np.asarray(p_map, dtype=np.float64))
        key, cauchy_sigmas = self._points[point_id], self.params.cauchy_sigmas
        self._new_factors.add(known_point_factor(key, p_map, covariance, cauchy_sigmas))

    def add_pose(self, keyframe_id: int, T_map_camera: Array) -> None:
        """A new keyframe with its start value."""
        self._new_values.insert(pose_key(keyframe_id), gtsam.Pose3(renormalized(T_map_camera)))

    def add_edge(self, edge: Edge, robust: bool = True) -> None:
        """A relative pose between two keyframes."""
        self._new_factors.add(edge_factor(edge, self.params.huber_sigmas if robust else None))

    def add_smooth_motion(
        self, before: int, after: int, duration_s: float, T_map_before: Array, T_map_after: Array
    ) -> None:
        """Between two keyframes, given with their start values, the camera's velocity hardly changed."""
        velocity = (T_map_after[:3, 3] - T_map_before[:3, 3]) / duration_s
        for keyframe_id in {before, after} - self._moving:
            self._new_values.insert(velocity_key(keyframe_id), velocity)
        self._moving |= {before, after}
        self._new_values.insert(bias_key(after), gtsam.imuBias.ConstantBias())
        self._new_factors.add(bias_factor(after))
        self._new_factors.add(smooth_motion_factor(before, after, duration_s, self.params.acceleration_mps2))

    def add_sighting(
        self,
        keyframe_id: int,
        point_id: int,
        p_camera: Array,
        covariance: Array,
        p_map: Array,
        loose: bool = False,
    ) -> None:
        """A landmark point seen at p_camera (metres), covariance (3, 3); p_map starts a new point.

        loose: of a new point, hardly known along some direction. There it wanders with every solution, which
        is no reason to relinearise all that sees it.
        """
        if point_id not in self._points:
            self._points[point_id] = gtsam.symbol(LOOSE_POINT if loose else POINT, point_id)
            self._new_values.insert(self._points[point_id], np.asarray(p_map, dtype=np.float64))
        keys = pose_key(keyframe_id), self._points[point_id]
        self._new_factors.add(sighting_factor(*keys, p_camera, covariance, self.params.cauchy_sigmas))

    def solve(self) -> None:
        """Take in what was added and update the estimates.

        Raises:
            SolverError: the graph leaves something open; only a new graph helps.
        """
        try:
            self._update()
        except SolverError:
            self._begin_anew(self._isam.getLinearizationPoint(), SAFE)
            self._update()

    def poses(self, first: int = 0) -> Array:
        """(n, 4, 4) T_map_camera in the order of the keyframe ids, which count up from 0; from `first` on."""
        if self._poses is not None:
            return self._poses[first:]
        if first:
            return self._poses_from(first)
        with solver_errors():
            rows = gtsam.utilities.extractPose3(self._isam.calculateEstimate())  # (n, 12): R by rows, then t
        self._poses = np.tile(np.eye(4), (len(rows), 1, 1))
        self._poses[:, :3, :3], self._poses[:, :3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:]
        return self._poses

    def points(self, ids: Iterable[int] | None = None) -> dict[int, Array]:
        """{point id: (3,) position in the map} of all points, or of those ids that there are."""
        chosen = sorted(self._points) if ids is None else [i for i in ids if i in self._points]
        with solver_errors():
            return {i: self._isam.calculateEstimatePoint3(self._points[i]) for i in chosen}

    def covariance(self, keyframe_id: int) -> Array:
        """(6, 6) marginal covariance of a keyframe's pose.

        Raises:
            SolverError: no such keyframe in the solved graph.
        """
        with solver_errors():
            return self._isam.marginalCovariance(pose_key(keyframe_id))

    def _update(self) -> None:
        with solver_errors():
            self._isam.update(self._new_factors, self._new_values)
        self._poses = None
        self._new_factors, self._new_values = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def _begin_anew(self, values: gtsam.Values, factorization: str, without: tuple[type, ...] = ()) -> None:
        """The same graph with other start values waits for its solution; factors of some types are gone."""
        factors, self._new_factors = self._isam.getFactorsUnsafe(), gtsam.NonlinearFactorGraph()
        for factor in (factors.at(i) for i in range(factors.size()) if factors.exists(i)):
            if not isinstance(factor, without):
                self._new_factors.add(factor)
        self._new_values = values
        self._isam = gtsam.ISAM2(_isam_params(self.params, factorization))

    def _poses_from(self, first: int) -> Array:
        poses, key = list[Array](), pose_key(first)
        with solver_errors():
            while self._isam.valueExists(key):
                poses.append(self._isam.calculateEstimatePose3(key).matrix())
                key += 1
        return np.array(poses).reshape(-1, 4, 4)


def _moved(T_map_graph: Array, values: gtsam.Values) -> gtsam.Values:
    """A solution in another frame."""
    moved, pose_map_graph = gtsam.Values(), gtsam.Pose3(renormalized(T_map_graph))
    for key in values.keys():  # noqa: SIM118
        kind = chr(gtsam.Symbol(key).chr())
        if kind == POSE:
            moved.insert(key, pose_map_graph.compose(values.atPose3(key)))
        elif kind == VELOCITY:
            moved.insert(key, pose_map_graph.rotation().rotate(values.atVector(key)))
        elif kind == BIAS:
            moved.insert(key, values.atConstantBias(key))
        else:
            moved.insert(key, pose_map_graph.transformFrom(values.atPoint3(key)))
    return moved


def _isam_params(params: SolverParams, factorization: str) -> gtsam.ISAM2Params:
    isam_params = gtsam.ISAM2Params()
    isam_params.setRelinearizeThreshold(_thresholds(params.relinearize_m_rad))
    isam_params.relinearizeSkip = params.relinearize_every
    isam_params.setFactorization(factorization)
    return isam_params


def _thresholds(m_rad: float) -> gtsam.ISAM2ThresholdMap:
    thresholds = gtsam.ISAM2ThresholdMap()
    for letter, least in (
        (POSE, [m_rad] * 6),
        (POINT, [m_rad] * 3),
        (LOOSE_POINT, [LOOSE_FACTOR * m_rad] * 3),
        (VELOCITY, [NEVER] * 3),
        (BIAS, [NEVER] * 6),
    ):
        thresholds.insert((letter, np.array(least)))
    return thresholds

"""The optimisers: a fixed-lag smoother for the window and iSAM2 for everything (NeuSE IV-C).

The only module that knows gtsam. Vertices are keyframe poses T_map_camera and, where objects are landmarks,
points on the objects. Covariances are rotation first in the body frame, as everywhere in the library.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import gtsam
import numpy as np

from neuse.errors import SolverError
from neuse.geometry import Array, renormalized
from neuse.params import CheckedParams, param
from neuse.records import Edge

ORIGIN_SIGMA = 1e-4  # the first camera pose is the map's origin
LOOSE_FACTOR = 10.0  # loose points may move so much further before they are relinearised
POSE, POINT, LOOSE_POINT, VELOCITY, BIAS = "x", "p", "q", "v", "b"  # letters of gtsam's symbols
UNKNOWN_TURN = 10.0  # rad/sqrt(s): a smooth motion says nothing of rotations
FIXED = 1e-6  # sigma of biases that gtsam asks for and nobody has
NEVER = 1e9  # threshold of what enters linearly and need not be relinearised


@dataclass(frozen=True)
class SolverParams(CheckedParams):
    """How the graph is solved."""

    cauchy_sigmas: float = param(3.0, "scale of the Cauchy kernel on sightings, sigmas", 0.1, 100.0)
    huber_sigmas: float = param(1.345, "threshold of the Huber kernel on edges, sigmas", 0.1, 100.0)
    relinearize_m_rad: float = param(
        0.01, "iSAM2 relinearises what moved more than this, m or rad", 1e-6, 1.0
    )
    relinearize_every: int = param(5, "solutions between two relinearisations", 1, 1000)
    closure_iterations: int = param(2, "iSAM2 iterations after a loop closure", 1, 50)
    acceleration_mps2: float = param(
        0.3,
        "the camera moves smoothly: white noise of its acceleration, m/s^2/sqrt(Hz); 0: it may jerk",
        0.0,
        1e3,
    )
    window_iterations: int = param(20, "most Levenberg-Marquardt iterations in the window", 1, 100)


class PoseGraph:
    """All keyframes and landmarks, solved incrementally by iSAM2."""

    def __init__(self, params: SolverParams | None = None) -> None:
        self.params = params or SolverParams()
        self._isam = gtsam.ISAM2(_isam_params(self.params))
        self._new_factors = gtsam.NonlinearFactorGraph()
        self._new_values = gtsam.Values()
        self._points: dict[int, int] = {}  # gtsam's keys
        self._moving: set[int] = set()  # keyframes with a velocity
        self._poses: Array | None = None  # of the last solution, once all were asked for

    def add_origin(self, keyframe_id: int, T_map_camera: Array) -> None:
        """Fix the pose that defines the map frame."""
        noise = gtsam.noiseModel.Isotropic.Sigma(6, ORIGIN_SIGMA)
        self._new_factors.add(
            gtsam.PriorFactorPose3(_pose_key(keyframe_id), gtsam.Pose3(T_map_camera), noise)
        )

    def move(self, T_map_graph: Array) -> None:
        """Put everything elsewhere; nothing holds it there until `add_hold` and `add_known_point` say what.

        Edges and sightings are relative, so that they stay as they are.
        """
        factors = self._isam.getFactorsUnsafe()
        for factor in (factors.at(i) for i in range(factors.size()) if factors.exists(i)):
            if not isinstance(factor, gtsam.PriorFactorPose3 | gtsam.PriorFactorPoint3):
                self._new_factors.add(factor)
        self._new_values.insert(_moved(T_map_graph, self._isam.calculateEstimate()))
        self._isam = gtsam.ISAM2(_isam_params(self.params))

    def add_hold(self, keyframe_id: int, T_map_camera: Array, covariance: Array) -> None:
        """A pose that is known from elsewhere."""
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        self._new_factors.add(
            gtsam.PriorFactorPose3(_pose_key(keyframe_id), gtsam.Pose3(renormalized(T_map_camera)), noise)
        )

    def add_known_point(self, point_id: int, p_map: Array, covariance: Array) -> None:
        """A landmark point whose place is known from elsewhere, metres, covariance (3, 3)."""
        if point_id not in self._points:
            self._points[point_id] = gtsam.symbol(POINT, point_id)
            self._new_values.insert(self._points[point_id], np.asarray(p_map, dtype=np.float64))
        noise = _robust(gtsam.noiseModel.Gaussian.Covariance(covariance), self.params.cauchy_sigmas)
        self._new_factors.add(gtsam.PriorFactorPoint3(self._points[point_id], p_map, noise))

    def add_pose(self, keyframe_id: int, T_map_camera: Array) -> None:
        """A new keyframe with its start value."""
        self._new_values.insert(_pose_key(keyframe_id), gtsam.Pose3(renormalized(T_map_camera)))

    def add_edge(self, edge: Edge, robust: bool = True) -> None:
        """A relative pose between two keyframes."""
        self._new_factors.add(edge_factor(edge, self.params.huber_sigmas if robust else None))

    def add_smooth_motion(
        self, before: int, after: int, duration_s: float, T_map_before: Array, T_map_after: Array
    ) -> None:
        """Between two keyframes, given with their start values, the camera's velocity hardly changed.

        White noise on acceleration (Barfoot, State Estimation for Robotics, 2017, 4.3.1).
        """
        velocity = (T_map_after[:3, 3] - T_map_before[:3, 3]) / duration_s
        for keyframe_id in {before, after} - self._moving:
            self._new_values.insert(gtsam.symbol(VELOCITY, keyframe_id), velocity)
        self._moving |= {before, after}
        bias, none = gtsam.symbol(BIAS, after), gtsam.imuBias.ConstantBias()
        self._new_values.insert(bias, none)
        fixed = gtsam.noiseModel.Isotropic.Sigma(6, FIXED)
        self._new_factors.add(gtsam.PriorFactorConstantBias(bias, none, fixed))
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
        keys = _pose_key(keyframe_id), self._points[point_id]
        self._new_factors.add(sighting_factor(*keys, p_camera, covariance, self.params.cauchy_sigmas))

    def solve(self, iterations: int = 1) -> None:
        """Take in what was added and update the estimates.

        Raises:
            SolverError: the graph leaves something open; only a new graph helps.
        """
        with _solver_errors():
            self._isam.update(self._new_factors, self._new_values)
            for _ in range(iterations - 1):
                self._isam.update()
        self._poses = None
        self._new_factors, self._new_values = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def poses(self, first: int = 0) -> Array:
        """(n, 4, 4) T_map_camera in the order of the keyframe ids, which count up from 0; from `first` on."""
        if self._poses is not None:
            return self._poses[first:]
        if first:
            return self._poses_from(first)
        with _solver_errors():
            rows = gtsam.utilities.extractPose3(self._isam.calculateEstimate())  # (n, 12): R by rows, then t
        self._poses = np.tile(np.eye(4), (len(rows), 1, 1))
        self._poses[:, :3, :3], self._poses[:, :3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:]
        return self._poses

    def points(self, ids: Iterable[int] | None = None) -> dict[int, Array]:
        """{point id: (3,) position in the map} of all points, or of those ids that there are."""
        chosen = sorted(self._points) if ids is None else [i for i in ids if i in self._points]
        with _solver_errors():
            return {i: self._isam.calculateEstimatePoint3(self._points[i]) for i in chosen}

    def _poses_from(self, first: int) -> Array:
        poses, key = list[Array](), _pose_key(first)
        with _solver_errors():
            while self._isam.valueExists(key):
                poses.append(self._isam.calculateEstimatePose3(key).matrix())
                key += 1
        return np.array(poses).reshape(-1, 4, 4)

    def covariance(self, keyframe_id: int) -> Array:
        """(6, 6) marginal covariance of a keyframe's pose.

        Raises:
            SolverError: no such keyframe in the solved graph.
        """
        with _solver_errors():
            return self._isam.marginalCovariance(_pose_key(keyframe_id))


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
        key = _pose_key(keyframe_id)
        values.insert(key, gtsam.Pose3(renormalized(T_window_camera)))
        if not self._poses:
            noise = gtsam.noiseModel.Isotropic.Sigma(6, ORIGIN_SIGMA)
            factors.add(gtsam.PriorFactorPose3(key, gtsam.Pose3(T_window_camera), noise))
        for edge in edges:
            factors.add(edge_factor(edge, self.params.huber_sigmas))
        with _solver_errors():
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


@contextmanager
def _solver_errors() -> Iterator[None]:
    """What gtsam raises, as one of the library's errors."""
    try:
        yield
    except (RuntimeError, IndexError) as error:
        reason = " ".join(str(error).split())[:120]
        raise SolverError(f"the pose graph cannot be solved ({reason}); reset to begin a new map") from error


def edge_factor(edge: Edge, huber_sigmas: float | None) -> gtsam.BetweenFactorPose3:
    """p_from = T_from_to @ p_to as a factor on both poses."""
    noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(edge.covariance)
    if huber_sigmas is not None:
        noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(huber_sigmas), noise)
    return gtsam.BetweenFactorPose3(
        _pose_key(edge.from_id), _pose_key(edge.to_id), gtsam.Pose3(edge.T_from_to), noise
    )


def smooth_motion_factor(before: int, after: int, duration_s: float, acceleration: float) -> gtsam.ImuFactor:
    """Constant velocity up to white noise of the acceleration (m/s^2/sqrt(Hz)).

    That is what an IMU tells without gravity whose accelerometer reads nothing and whose gyroscope is poor.
    """
    params = gtsam.PreintegrationParams(np.zeros(3))
    params.setAccelerometerCovariance(acceleration**2 * np.eye(3))
    params.setGyroscopeCovariance(UNKNOWN_TURN**2 * np.eye(3))
    params.setIntegrationCovariance(FIXED**2 * np.eye(3))
    nothing = gtsam.PreintegratedImuMeasurements(params, gtsam.imuBias.ConstantBias())
    nothing.integrateMeasurement(np.zeros(3), np.zeros(3), duration_s)
    v_before, v_after = gtsam.symbol(VELOCITY, before), gtsam.symbol(VELOCITY, after)
    bias = gtsam.symbol(BIAS, after)
    return gtsam.ImuFactor(_pose_key(before), v_before, _pose_key(after), v_after, bias, nothing)


def sighting_factor(
    pose_key: int, point_key: int, p_camera: Array, covariance: Array, cauchy_sigmas: float
) -> gtsam.BearingRangeFactor3D:
    """A point seen at p_camera, as bearing and range with the covariance (3, 3) to first order."""
    bearing, range_m = gtsam.Unit3(p_camera), float(np.linalg.norm(p_camera))
    J = np.vstack([bearing.basis().T / range_m, bearing.point3()])  # d (bearing, range) / d p_camera
    noise = gtsam.noiseModel.Gaussian.Covariance(J @ covariance @ J.T)
    return gtsam.BearingRangeFactor3D(pose_key, point_key, bearing, range_m, _robust(noise, cauchy_sigmas))


def _robust(noise: gtsam.noiseModel.Base, cauchy_sigmas: float) -> gtsam.noiseModel.Robust:
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(cauchy_sigmas), noise)


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


def _isam_params(params: SolverParams) -> gtsam.ISAM2Params:
    isam_params = gtsam.ISAM2Params()
    isam_params.setRelinearizeThreshold(_thresholds(params.relinearize_m_rad))
    isam_params.relinearizeSkip = params.relinearize_every
    isam_params.setFactorization("QR")  # sigmas span five decades, too many for Cholesky's squares
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


def _pose_key(keyframe_id: int) -> int:
    return gtsam.symbol(POSE, keyframe_id)

"""All keyframes and landmarks, solved incrementally by iSAM2 (NeuSE IV-C)."""

from collections.abc import Iterable

import gtsam
import numpy as np

from neuse.geometry import Array, renormalized
from neuse.records import Edge
from neuse.slam.factors import (
    BIAS,
    LOOSE_POINT,
    POINT,
    POSE,
    VELOCITY,
    bias_factor,
    bias_key,
    cauchy,
    edge_factor,
    hold_factor,
    huber,
    known_point_factor,
    origin_factor,
    pose_key,
    sighting_factor,
    smooth_motion_factor,
    solver_errors,
    velocity_key,
)
from neuse.slam.smoother import FAST, Smoother, SolverParams


class PoseGraph:
    """Keyframe poses T_map_camera and landmark points under all that is known of them."""

    def __init__(self, params: SolverParams | None = None) -> None:
        self.params = params or SolverParams()
        self._smoother = Smoother(self.params)
        self._huber, self._cauchy = huber(self.params.huber_sigmas), cauchy(self.params.cauchy_sigmas)
        self._ids: list[int] = []
        self._id_array: np.ndarray | None = None
        self._points: dict[int, int] = {}  # gtsam's keys
        self._moving: set[int] = set()  # keyframes with a velocity
        self._poses: Array | None = None  # of the last solution, once all were asked for

    def add_origin(self, keyframe_id: int, T_map_camera: Array) -> None:
        """Fix the pose that defines the map frame."""
        self._smoother.add(origin_factor(keyframe_id, T_map_camera))

    def move(self, T_map_graph: Array) -> None:
        """Put everything elsewhere; nothing holds it there until `add_hold` and `add_known_point` say what.

        Edges and sightings are relative, so that they stay as they are.
        """
        values = _moved(T_map_graph, self._smoother.isam.calculateEstimate())
        self._smoother.begin_anew(values, FAST, (gtsam.PriorFactorPose3, gtsam.PriorFactorPoint3))

    def add_hold(self, keyframe_id: int, T_map_camera: Array, covariance: Array) -> None:
        """A pose that is known from elsewhere."""
        self._smoother.add(hold_factor(keyframe_id, T_map_camera, covariance))

    def add_known_point(self, point_id: int, p_map: Array, covariance: Array, loose: bool = False) -> None:
        """A landmark point whose place is known from elsewhere, metres, covariance (3, 3).

        loose: as in `add_sighting`.
        """
        self._begin_point(point_id, p_map, loose)
        self._smoother.add(known_point_factor(self._points[point_id], p_map, covariance, self._cauchy))

    def add_pose(self, keyframe_id: int, T_map_camera: Array) -> None:
        """A new keyframe with its start value; ids ascend."""
        self._ids.append(keyframe_id)
        self._id_array = None
        self._smoother.insert(pose_key(keyframe_id), gtsam.Pose3(renormalized(T_map_camera)))

    def add_edge(self, edge: Edge, robust: bool = True) -> None:
        """A relative pose between two keyframes."""
        self._smoother.add(edge_factor(edge, self._huber if robust else None))

    def add_doubtful_edge(self, edge: Edge) -> None:
        """A relative pose that may be quite another."""
        self._smoother.add(edge_factor(edge, self._cauchy))

    def add_smooth_motion(
        self, before: int, after: int, duration_s: float, T_map_before: Array, T_map_after: Array
    ) -> None:
        """Between two keyframes, given with their start values, the camera's velocity hardly changed."""
        velocity = (T_map_after[:3, 3] - T_map_before[:3, 3]) / duration_s
        for keyframe_id in {before, after} - self._moving:
            self._smoother.insert(velocity_key(keyframe_id), velocity)
        self._moving |= {before, after}
        self._smoother.insert(bias_key(after), gtsam.imuBias.ConstantBias())
        self._smoother.add(bias_factor(after))
        self._smoother.add(smooth_motion_factor(before, after, duration_s, self.params.acceleration_mps2))

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
        self._begin_point(point_id, p_map, loose)
        keys = pose_key(keyframe_id), self._points[point_id]
        self._smoother.add(sighting_factor(*keys, p_camera, covariance, self._cauchy))

    def _begin_point(self, point_id: int, p_map: Array, loose: bool) -> None:
        if point_id not in self._points:
            self._points[point_id] = gtsam.symbol(LOOSE_POINT if loose else POINT, point_id)
            self._smoother.insert(self._points[point_id], np.asarray(p_map, dtype=np.float64))

    def remove(self, keyframe_id: int) -> None:
        """A solved keyframe goes with the next solution, and with it all that was said of it."""
        self._ids.remove(keyframe_id)
        self._id_array = None
        self._smoother.remove([pose_key(keyframe_id), velocity_key(keyframe_id), bias_key(keyframe_id)])
        self._moving.discard(keyframe_id)

    def solve(self) -> None:
        """Take in what was added and update the estimates.

        Raises:
            SolverError: the graph leaves something open; only a new graph helps.
        """
        self._smoother.solve()
        self._poses = None

    @property
    def is_behind(self) -> bool:
        """Whether the last solution has left a part to the next, as after a loop closure."""
        return self._smoother.is_behind

    @property
    def ids(self) -> np.ndarray:
        """(n,) keyframe ids, ascending."""
        if self._id_array is None:
            self._id_array = np.array(self._ids, dtype=np.intp)
        return self._id_array

    def poses(self, first: int = 0) -> Array:
        """(n, 4, 4) T_map_camera in the order of `ids`, from the `first` so many on."""
        if first and self._poses is None:
            return np.array([self.pose(keyframe_id) for keyframe_id in self._ids[first:]]).reshape(-1, 4, 4)
        if self._poses is None:
            self._poses = self._all_poses()
        return self._poses[first:]

    def pose(self, keyframe_id: int) -> Array:
        """(4, 4) T_map_camera of one keyframe."""
        with solver_errors():
            return self._smoother.isam.calculateEstimatePose3(pose_key(keyframe_id)).matrix()

    def _all_poses(self) -> Array:
        with solver_errors():
            estimate = self._smoother.isam.calculateEstimate()
        rows = gtsam.utilities.extractPose3(estimate)  # (n, 12): R by rows, then t
        poses = np.tile(np.eye(4), (len(rows), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:]
        return poses

    def points(self, ids: Iterable[int] | None = None) -> dict[int, Array]:
        """{point id: (3,) position in the map} of all points, or of those ids that there are."""
        chosen = sorted(self._points) if ids is None else [i for i in ids if i in self._points]
        with solver_errors():
            return {i: self._smoother.isam.calculateEstimatePoint3(self._points[i]) for i in chosen}

    def covariance(self, keyframe_id: int) -> Array:
        """(6, 6) marginal covariance of a keyframe's pose.

        Raises:
            SolverError: no such keyframe in the solved graph.
        """
        with solver_errors():
            return self._smoother.isam.marginalCovariance(pose_key(keyframe_id))


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

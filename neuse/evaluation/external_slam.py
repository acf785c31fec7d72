"""SLAM without objects, as a partner and a rival: odometry against keyframes, loop closures, a pose graph.

What it matches is a matcher's business: scans (scan_matching.py) or features of the picture
(feature_matching.py). It knows nothing of objects and takes the world to be static.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from neuse.evaluation.trajectory import Trajectory, trajectory_of
from neuse.geometry import Array, exp, inverse, log, make_transform, renormalized, rotation_angle
from neuse.params import CheckedParams, param
from neuse.records import Edge, EdgeKind, OdometrySample, RgbdFrame
from neuse.slam.pose_graph import PoseGraph
from neuse.slam.smoother import SolverParams

ViewT = TypeVar("ViewT")
HUBER_SIGMAS = 1.345  # of its loop closures
SLOWING = 0.5  # of the camera with every frame that is lost


@dataclass(frozen=True)
class Match:
    """p_old = T_old_new @ p_new for two views.

    covariance: (6, 6) as in neuse.geometry.    overlap: share of the new view that the old one explains.
    """

    T_old_new: Array
    covariance: Array
    overlap: float


class Matcher(Protocol[ViewT]):
    """What it takes to find the motion between two frames."""

    def view(self, frame: RgbdFrame) -> ViewT:
        """What is kept of a frame."""

    def match(self, old: ViewT, new: ViewT, T_old_new: Array, slack: float) -> Match | None:
        """The motion between two views, None if it cannot be found.

        T_old_new: a guess.    slack: how many times worse it may be than between two frames.
        """


@dataclass(frozen=True)
class ExternalSlamParams(CheckedParams):
    """Keyframes, loop closures, and how far matches are trusted."""

    keyframe_m: float = param(0.15, "a keyframe after so much travel, metres", 0.01, 10.0)
    keyframe_rad: float = param(0.2, "or after such a turn, rad", 0.01, 3.15)
    min_overlap: float = param(0.6, "or where less of a frame than this is explained", 0.0, 1.0)
    closure_gap: int = param(20, "keyframes between the ends of a loop closure, at least", 2, 10_000)
    closure_m: float = param(0.5, "loop closures are tried between places this near, metres", 0.0, 100.0)
    closure_rad: float = param(0.5, "and directions this near, rad", 0.0, 3.15)
    closure_overlap: float = param(0.7, "a loop closure must explain as much of the new frame", 0.0, 1.0)
    closure_slack: float = param(16.0, "matched over so many times the distances of frames", 1.0, 1000.0)
    max_tries: int = param(2, "loop closures tried by one keyframe", 0, 100)
    closure_sigma: float = param(0.03, "and be known as well, rad and metres", 1e-4, 10.0)
    lost_sigma: float = param(0.1, "noise of a motion where nothing matched, rad and metres", 1e-6, 10.0)
    max_surprise_m: float = param(
        0.1, "a match further from what was expected of a frame is wrong", 0.0, 10.0
    )
    max_surprise_rad: float = param(0.15, "and one turned further, rad", 0.0, 3.15)


@dataclass(frozen=True)
class ExternalStep:
    """What an external SLAM publishes of a frame: its odometry, and loop closures that it has just found.

    odometry: None where it is lost.
    """

    odometry: OdometrySample | None
    closures: tuple[Edge, ...] = ()


@dataclass
class _Keyframe(Generic[ViewT]):
    stamp_ns: int
    view: ViewT
    T_odom_camera: Array


@dataclass
class _Frame:
    stamp_ns: int
    keyframe_id: int
    T_keyframe_camera: Array


@dataclass
class ExternalSlam(Generic[ViewT]):
    """Frames go in, odometry and loop closures come out; `trajectory` is its own best answer.

    lost: how many frames matched nothing, so that the camera was taken to go on as before, ever slower: a
        wrong motion would refuse all that matches later.
    """

    matcher: Matcher[ViewT]
    params: ExternalSlamParams = field(default_factory=ExternalSlamParams)
    lost: int = 0
    _keyframes: list[_Keyframe[ViewT]] = field(default_factory=list)
    _frames: list[_Frame] = field(default_factory=list)
    _motion: Array = field(default_factory=lambda: np.eye(4))
    _T_hint_camera: Array | None = None
    _graph: PoseGraph = field(default_factory=lambda: PoseGraph(SolverParams(huber_sigmas=HUBER_SIGMAS)))
    _T_map_keyframes: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))

    def step(self, frame: RgbdFrame, odometry: OdometrySample | None = None) -> ExternalStep:
        """Track one frame. Odometry, where there is some, tells the turn to look for first."""
        if odometry is not None:
            self._expect(odometry.T_odom_camera)
        view = self.matcher.view(frame)
        if not self._keyframes:
            self._graph.add_origin(0, np.eye(4))
            self._graph.add_pose(0, np.eye(4))
            return self._add_keyframe(frame.stamp_ns, view, np.eye(4))
        last = self._frames[-1]
        T_keyframe_predicted = last.T_keyframe_camera @ self._motion
        match = self.matcher.match(self._keyframes[-1].view, view, T_keyframe_predicted, 1.0)
        surprise = self.params.max_surprise_m, self.params.max_surprise_rad
        if match and _is_off(match, T_keyframe_predicted, *surprise):
            match = None
        T_keyframe_camera = T_keyframe_predicted
        if match:
            T_keyframe_camera = renormalized(match.T_old_new)
            self._motion = inverse(last.T_keyframe_camera) @ T_keyframe_camera
        else:
            self.lost += 1
            self._motion = exp(SLOWING * log(self._motion))
        if match and match.overlap >= self.params.min_overlap and not self._is_far(T_keyframe_camera):
            self._frames.append(_Frame(frame.stamp_ns, last.keyframe_id, T_keyframe_camera))
            T_odom_camera = self._keyframes[-1].T_odom_camera @ T_keyframe_camera
            return ExternalStep(OdometrySample(frame.stamp_ns, T_odom_camera))
        covariance = match.covariance if match else self.params.lost_sigma**2 * np.eye(6)
        self._add_tie(frame.stamp_ns, T_keyframe_camera, covariance)
        T_odom_camera = renormalized(self._keyframes[-1].T_odom_camera @ T_keyframe_camera)
        step = self._add_keyframe(frame.stamp_ns, view, T_odom_camera)
        return step if match else replace(step, odometry=None)

    def trajectory(self) -> Trajectory:
        """All frames after the last optimisation."""
        T_map_camera = [self._T_map_keyframes[f.keyframe_id] @ f.T_keyframe_camera for f in self._frames]
        return trajectory_of([frame.stamp_ns for frame in self._frames], T_map_camera)

    def _expect(self, T_hint_camera: Array) -> None:
        """Expect the turn that odometry has seen since the last frame, and to go on as before."""
        if self._T_hint_camera is not None:
            hinted = inverse(self._T_hint_camera) @ T_hint_camera
            self._motion = make_transform(hinted[:3, :3], self._motion[:3, 3])
        self._T_hint_camera = T_hint_camera

    def _is_far(self, T: Array) -> bool:
        far = np.linalg.norm(T[:3, 3]) >= self.params.keyframe_m
        return bool(far or rotation_angle(T[:3, :3]) >= self.params.keyframe_rad)

    def _add_tie(self, stamp_ns: int, T_keyframe_camera: Array, covariance: Array) -> None:
        """Odometry from the last keyframe to the one that is about to be added."""
        last = len(self._keyframes) - 1
        self._graph.add_pose(last + 1, self._T_map_keyframes[last] @ T_keyframe_camera)
        edge = self._edge(last, last + 1, stamp_ns, EdgeKind.ODOMETRY, T_keyframe_camera, covariance)
        self._graph.add_edge(edge, robust=False)

    def _add_keyframe(self, stamp_ns: int, view: ViewT, T_odom_camera: Array) -> ExternalStep:
        keyframe_id = len(self._keyframes)
        self._keyframes.append(_Keyframe(stamp_ns, view, T_odom_camera))
        self._frames.append(_Frame(stamp_ns, keyframe_id, np.eye(4)))
        self._solve(1)
        closures = tuple(self._closures(keyframe_id))
        for edge in closures:
            self._graph.add_edge(edge)
        if closures:
            self._solve(3)
        return ExternalStep(OdometrySample(stamp_ns, T_odom_camera), closures)

    def _solve(self, iterations: int) -> None:
        for _ in range(iterations):
            self._graph.solve()
        self._T_map_keyframes = self._graph.poses()

    def _closures(self, new: int) -> Iterator[Edge]:
        """Matches with keyframes that are near by the latest estimate and far back in time."""
        stamp_ns, view = self._keyframes[new].stamp_ns, self._keyframes[new].view
        for old, T_old_new in self._candidates(new):
            match = self.matcher.match(self._keyframes[old].view, view, T_old_new, self.params.closure_slack)
            if match and self._closes(match, T_old_new):
                yield self._edge(old, new, stamp_ns, EdgeKind.EXTERNAL, match.T_old_new, match.covariance)

    def _closes(self, match: Match, T_expected: Array) -> bool:
        sigma = float(np.sqrt(np.linalg.eigvalsh(match.covariance)[-1]))
        good = match.overlap >= self.params.closure_overlap and sigma <= self.params.closure_sigma
        return good and not _is_off(match, T_expected, self.params.closure_m, self.params.closure_rad)

    def _candidates(self, new: int) -> list[tuple[int, Array]]:
        earlier = max(new - self.params.closure_gap, 0)
        T_olds_new = inverse(self._T_map_keyframes[:earlier]) @ self._T_map_keyframes[new]
        offsets_m = np.linalg.norm(T_olds_new[:, :3, 3], axis=1)
        turns_rad = np.arccos(np.clip((np.trace(T_olds_new[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1))
        near = (offsets_m <= self.params.closure_m) & (turns_rad <= self.params.closure_rad)
        order = np.argsort(offsets_m + turns_rad, kind="stable")
        return [(int(old), T_olds_new[old]) for old in order if near[old]][: self.params.max_tries]

    def _edge(
        self, old: int, new: int, stamp_ns: int, kind: EdgeKind, T_old_new: Array, covariance: Array
    ) -> Edge:
        return Edge(old, new, self._keyframes[old].stamp_ns, stamp_ns, kind, T_old_new, covariance)


def _is_off(match: Match, T_expected: Array, max_m: float, max_rad: float) -> bool:
    """Whether a match lies further from where it was looked for than it may."""
    correction = inverse(T_expected) @ match.T_old_new
    far = np.linalg.norm(correction[:3, 3]) > max_m
    return bool(far or rotation_angle(correction[:3, :3]) > max_rad)

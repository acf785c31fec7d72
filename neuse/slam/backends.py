"""What is put into the graph: objects as landmarks, or the paper's edges between cameras (NeuSE IV-C)."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

import numpy as np

from neuse.errors import SolverError
from neuse.geometry import Array, inverse
from neuse.records import Edge, EdgeKind
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.object_frames import HIDDEN_HANDLE_RAD, LEAST_SHARE, ObjectFrames, frames_at
from neuse.slam.odometry import NANOSECONDS
from neuse.slam.pose_graph import PoseGraph, SolverParams
from neuse.slam.sliding_window import SlidingWindow
from neuse.slam.track import Track, heights_of, orthonormal_places, places_of, sigmas_of

LEVER_M = 0.3  # where a handle becomes a point: so far out that its noise is that of the direction
LOOSE_RAD = 1.0  # along directions in which a point on the lever says nothing
LEAST_HALF_HEIGHT_M = 0.01  # of ends that tell an axis
RECENT = 20  # keyframes whose poses are read after every solution
KNOWN_SIGMAS = np.array([0.05, 0.05, 0.15, 0.01, 0.01, 0.01])  # of places in a map made by others
TOP, BOTTOM, HANDLE = range(3)


class Backend(Protocol):
    """Keyframes go in, estimates of their poses and of the objects' places come out."""

    def add_keyframe(
        self, record: KeyframeRecord, T_map_camera: Array, ties: Sequence[Edge], closures: Sequence[Edge]
    ) -> None:
        """A new keyframe with its start value, its edges to the window and those that close loops."""

    def add_sightings(self, record: KeyframeRecord, tracks: Iterable[Track]) -> None:
        """The keyframe sees these tracks."""

    def add_external(self, edges: Sequence[Edge]) -> None:
        """Edges of an external SLAM."""

    def solve(self, loop_closed: bool) -> Array:
        """(n, 4, 4) T_map_camera of all keyframes after everything new is taken in.

        Unless a loop was closed, those long past may be as they were; see `latest_poses`.
        """

    def latest_poses(self) -> Array:
        """(n, 4, 4) T_map_camera of all keyframes by the last solution."""

    def covariance(self, keyframe_id: int) -> Array:
        """(6, 6) marginal covariance of a keyframe's pose."""

    def place_all(self, tracks: Iterable[Track]) -> None:
        """Update the places of tracks in the graph from the last solution."""

    def move(self, T_map_graph: Array, covariance: Array) -> None:
        """Everything belongs elsewhere, the last keyframe with this covariance (6, 6)."""

    def add_known(self, tracks: Sequence[Track]) -> None:
        """Tracks whose places are known from elsewhere."""


class _Base:
    def __init__(self, params: SolverParams) -> None:
        self.params = params
        self.graph = PoseGraph(params)
        self.poses: Array = np.zeros((0, 4, 4))

    def add_external(self, edges: Sequence[Edge]) -> None:
        for edge in edges:
            self.graph.add_edge(edge)

    def solve(self, loop_closed: bool) -> Array:
        self.graph.solve()
        self.poses = self.graph.poses()
        return self.poses

    def latest_poses(self) -> Array:
        self.poses = self.graph.poses()
        return self.poses

    def covariance(self, keyframe_id: int) -> Array:
        return self.graph.covariance(keyframe_id)

    def move(self, T_map_graph: Array, covariance: Array) -> None:
        self.poses = T_map_graph @ self.latest_poses()
        self.graph.move(T_map_graph)
        self.graph.add_hold(len(self.poses) - 1, self.poses[-1], covariance)


class LandmarkBackend(_Base):
    """Objects are points of the graph: top, bottom, and one out along the handle if it has one; one point
    alone, the centre, of those that tell no axis.

    Edges of odometry and smooth motions tie the keyframes; edges from codes are not used, since sightings
    say the same without the errors that all edges of one frame share.
    """

    def add_keyframe(
        self, record: KeyframeRecord, T_map_camera: Array, ties: Sequence[Edge], closures: Sequence[Edge]
    ) -> None:
        if record.keyframe_id == 0:
            self.graph.add_origin(0, T_map_camera)
        self.graph.add_pose(record.keyframe_id, T_map_camera)
        for edge in ties:
            if edge.kind == EdgeKind.ODOMETRY:
                self.graph.add_edge(edge)
                self._add_smooth_motion(edge, T_map_camera)

    def _add_smooth_motion(self, along: Edge, T_map_camera: Array) -> None:
        """Only where odometry goes along: where it jumps, the camera may have been carried elsewhere."""
        if self.params.acceleration_mps2 > 0.0:
            duration_s = (along.to_stamp_ns - along.from_stamp_ns) * NANOSECONDS
            ends = self.poses[along.from_id], T_map_camera
            self.graph.add_smooth_motion(along.from_id, along.to_id, duration_s, *ends)

    def add_sightings(self, record: KeyframeRecord, tracks: Iterable[Track]) -> None:
        index = {int(key): i for i, key in enumerate(record.keys)}
        for track in tracks:
            i = index[track.key]
            points, covariances = landmark_points(record.frames, i)
            center, axis, handle = track.place
            half = _half_height(track.half_height) * axis * record.frames.tell_axes[i]
            starts = center + half, center - half, center + LEVER_M * handle
            for part in range(_n_points(record.frames, i)):
                seen = points[part], covariances[part], starts[part]
                self.graph.add_sighting(record.keyframe_id, 3 * track.key + part, *seen, loose=part == HANDLE)

    def add_known(self, tracks: Sequence[Track]) -> None:
        ambiguous = np.array([track.ambiguous for track in tracks], dtype=bool)
        sigmas = sigmas_of(tracks, KNOWN_SIGMAS)
        frames = frames_at(places_of(tracks), sigmas, ambiguous, heights_of(tracks)[0])
        for i, track in enumerate(tracks):
            points, covariances = landmark_points(frames, i)
            for part in range(_n_points(frames, i)):
                self.graph.add_known_point(3 * track.key + part, points[part], covariances[part])

    def solve(self, loop_closed: bool) -> Array:
        if loop_closed:
            return super().solve(loop_closed)
        self.graph.solve()
        first = max(len(self.poses) - RECENT, 0)
        self.poses = np.concatenate([self.poses[:first], self.graph.poses(first)])
        return self.poses

    def place_all(self, tracks: Iterable[Track]) -> None:
        tracks = list(tracks)
        points = self.graph.points(3 * track.key + part for track in tracks for part in (TOP, BOTTOM, HANDLE))
        known = [track for track in tracks if 3 * track.key + TOP in points]
        if not known:
            return
        places = np.stack([_placed(track, points) for track in known])
        for track, place in zip(known, orthonormal_places(places), strict=True):
            track.anchored, track.place = True, place


class EdgeBackend(_Base):
    """The paper's way: camera poses only. A fixed-lag smoother gives keyframes a start, iSAM2 has all edges.

    Places of objects are averages of what the keyframes saw, through their latest poses (NeuSE IV-A).
    """

    def __init__(self, params: SolverParams, window: int) -> None:
        super().__init__(params)
        self.window = SlidingWindow(window, params)
        self._seen = _Sightings()

    def add_keyframe(
        self, record: KeyframeRecord, T_map_camera: Array, ties: Sequence[Edge], closures: Sequence[Edge]
    ) -> None:
        new = record.keyframe_id
        self._seen.add(record)
        if new == 0:
            self.graph.add_origin(0, T_map_camera)
            self.window.add(0, T_map_camera, [])
        else:
            T_map_camera = self.poses[-1] @ self._smoothed(new, inverse(self.poses[-1]) @ T_map_camera, ties)
        self.graph.add_pose(new, T_map_camera)
        for edge in (*ties, *closures):
            self.graph.add_edge(edge)

    def _smoothed(self, new: int, T_previous_new: Array, ties: Sequence[Edge]) -> Array:
        """T_previous_new by the window. A window that cannot be solved is begun anew with this keyframe."""
        try:
            T_window_previous = self.window.pose(new - 1)
            inside = [edge for edge in ties if self.window.has(edge.from_id)]
            self.window.add(new, T_window_previous @ T_previous_new, inside)
        except SolverError:
            self.window = SlidingWindow(self.window.size, self.params)
            self.window.add(new, np.eye(4), [])
            return T_previous_new
        return inverse(self.window.pose(new - 1)) @ self.window.pose(new)

    def add_sightings(self, record: KeyframeRecord, tracks: Iterable[Track]) -> None:
        """Nothing: the edges have said it."""

    def add_known(self, tracks: Sequence[Track]) -> None:
        """Nothing: there are no objects in the graph; the pose with which the map was joined holds it."""

    def place_all(self, tracks: Iterable[Track]) -> None:
        places = self._seen.places(self.poses)
        for track in tracks:
            if track.key in places:
                track.anchored, track.place = True, places[track.key]


class _Sightings:
    """All that keyframes have seen: keys and keyframes (n,), vectors (3, n, 3), weights (3, n)."""

    def __init__(self) -> None:
        self.keys, self.keyframes = np.zeros(0, np.intp), np.zeros(0, np.intp)
        self.vectors, self.weights = np.zeros((3, 0, 3)), np.zeros((3, 0))

    def add(self, record: KeyframeRecord) -> None:
        """What one more keyframe sees."""
        here = np.full(len(record.keys), record.keyframe_id, dtype=np.intp)
        self.keys = np.concatenate([self.keys, record.keys])
        self.keyframes = np.concatenate([self.keyframes, here])
        self.vectors = np.concatenate([self.vectors, record.frames.vectors], axis=1)
        self.weights = np.concatenate([self.weights, 1.0 / record.frames.variances], axis=1)

    def places(self, T_map_camera: Array) -> dict[int, Array]:
        """{track key: (3, 3) place}, weighted means over the keyframes' poses (n, 4, 4)."""
        T = T_map_camera[self.keyframes]
        placed = (T[None, :, :3, :3] @ self.vectors[..., None])[..., 0]
        placed[0] += T[:, :3, 3]
        known, index = np.unique(self.keys, return_inverse=True)
        sums, totals = np.zeros((3, len(known), 3)), np.zeros((3, len(known)))
        for part in range(3):
            np.add.at(sums[part], index, self.weights[part][:, None] * placed[part])
            np.add.at(totals[part], index, self.weights[part])
        means = sums / np.maximum(totals, 1e-12)[..., None]
        return dict(zip(known.tolist(), orthonormal_places(means.swapaxes(0, 1)), strict=True))


def _placed(track: Track, points: Mapping[int, Array]) -> Array:
    """(3, 3) centre, axis and handle of a track, not yet of unit length; what no point tells stays."""
    top = points[3 * track.key + TOP]
    bottom, handle = (points.get(3 * track.key + part) for part in (BOTTOM, HANDLE))
    if bottom is None:
        return np.stack([top, *track.place[1:]])
    center = (top + bottom) / 2
    return np.stack([center, top - bottom, track.place[2] if handle is None else handle - center])


def landmark_points(frames: ObjectFrames, i: int) -> tuple[Array, Array]:
    """(3, 3) top, bottom and handle point of object i, metres, with covariances (3, 3, 3).

    Along the axis each end has a variance of its own: a hidden one is hardly known. Across it both share
    those of the centre and of the tilt; as these weigh about the same half a height away, the ends err
    independently. The handle point tells the turn about the axis and is loose otherwise, so that nothing
    counts twice. Of an object that tells no axis the first is its centre, and the only one to be used.
    """
    center, axis, handle = frames.vectors[:, i]
    R = np.stack([handle, np.cross(axis, handle), axis], axis=1)
    turn_x, turn_y, turn_z, shift_x, shift_y, shift_z = frames.sigmas[i] ** 2
    half, correlation = _half_height(frames.half_heights[i]), frames.height_correlations[i]
    across = shift_x + half**2 * turn_y, shift_y + half**2 * turn_x
    ends = 2 * shift_z * np.maximum(1 + np.array([correlation, -correlation]), LEAST_SHARE)
    loose = (LOOSE_RAD * LEVER_M) ** 2
    if not frames.tell_axes[i]:
        half, across, ends = 0.0, (shift_x, shift_y), np.array([shift_z, shift_z])
    variances = np.array(
        [[*across, ends[0]], [*across, ends[1]], [loose, shift_y + turn_z * LEVER_M**2, loose]]
    )
    points = np.stack([center + half * axis, center - half * axis, center + LEVER_M * handle])
    return points, np.stack([(R * along) @ R.T for along in variances])


def _half_height(half_height: float) -> float:
    return max(float(half_height), LEAST_HALF_HEIGHT_M)


def _n_points(frames: ObjectFrames, i: int) -> int:
    """How many of its landmark points object i tells."""
    if not frames.tell_axes[i]:
        return 1
    return 2 if _handle_hidden(frames, i) else 3


def _handle_hidden(frames: ObjectFrames, i: int) -> bool:
    return bool(frames.ambiguous[i] or frames.sigmas[i, 2] > HIDDEN_HANDLE_RAD)

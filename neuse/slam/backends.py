"""What is put into the graph: objects as landmarks, or the paper's edges between cameras (NeuSE IV-C)."""

from collections.abc import Iterable, Mapping, Sequence, Set
from typing import Protocol

import numpy as np

from neuse.geometry import Array
from neuse.records import Edge, EdgeKind
from neuse.slam.chain import Chain
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.landmarks import BOTTOM, HANDLE, LEVER_M, TOP, end_height, landmark_points, n_points
from neuse.slam.object_frames import frames_at
from neuse.slam.odometry import NANOSECONDS
from neuse.slam.pose_graph import PoseGraph
from neuse.slam.smoother import SolverParams
from neuse.slam.track import Track, heights_of, orthonormal_places, places_of, sigmas_of

RECENT = 20  # keyframes whose poses are read after every solution
SAMPLES, NOTICEABLE_M = 32, 0.005  # keyframes of all times that are looked at, and what they may move, metres
N_PARTS = 3  # points of a track
KNOWN_SIGMAS = np.array([0.05, 0.05, 0.15, 0.01, 0.01, 0.01])  # of places in a map made by others


class Backend(Protocol):
    """Keyframes go in, estimates of their poses and of the objects' places come out."""

    def add_keyframe(
        self, record: KeyframeRecord, T_map_camera: Array, ties: Sequence[Edge], closures: Sequence[Edge]
    ) -> None:
        """A new keyframe with its start value, its edges to the window and those that close loops."""

    def add_sightings(self, record: KeyframeRecord, tracks: Iterable[Track]) -> None:
        """The keyframe sees these tracks."""

    def add_refined(self, edges: Sequence[Edge]) -> None:
        """Motions between neighbouring keyframes from their surfaces."""

    def add_external(self, edges: Sequence[Edge]) -> None:
        """Edges of an external SLAM."""

    def landmarks_of(self, keyframe_id: int) -> Set[int] | None:
        """The landmark points that a keyframe sees; None if it has to stay in the graph for other reasons."""

    def remove(self, keyframe_id: int, stand_in: int, T_stand_in_left: Array) -> None:
        """A keyframe that need not stay in the graph goes with the next solution."""

    @property
    def ids(self) -> np.ndarray:
        """(n,) keyframes in the graph, ascending."""

    def solve(self) -> Array:
        """(n, 4, 4) T_map_camera of the keyframes in the graph after everything new is taken in.

        Those long past may be as they were; see `has_moved` and `read_all`.
        """

    def has_moved(self) -> bool:
        """Whether keyframes long past have moved noticeably since all were read."""

    @property
    def can_judge(self) -> bool:
        """Whether the solution can tell a wrong loop closure: it is settled, and they are no part of it."""

    def latest_poses(self) -> Array:
        """(n, 4, 4) T_map_camera of the keyframes in the graph by the last solution."""

    def read_all(self) -> Array:
        """`latest_poses`, from which `has_moved` counts from now on."""

    def pose(self, keyframe_id: int) -> Array:
        """(4, 4) T_map_camera of a keyframe in the graph by the last solution."""

    def covariance(self, keyframe_id: int) -> Array:
        """(6, 6) marginal covariance of a keyframe's pose."""

    def place_all(self, tracks: Iterable[Track]) -> None:
        """Update the places of tracks in the graph from the last solution."""

    def move(self, T_map_graph: Array, covariance: Array) -> None:
        """Everything belongs elsewhere, the last keyframe with this covariance (6, 6)."""

    def add_known(self, tracks: Sequence[Track]) -> None:
        """Tracks whose places are known from elsewhere."""


class BaseBackend:
    """What both ways have in common."""

    def __init__(self, params: SolverParams) -> None:
        self.params = params
        self.graph = PoseGraph(params)
        self.poses: Array = np.zeros((0, 4, 4))

    def add_refined(self, edges: Sequence[Edge]) -> None:
        for edge in edges:
            self.graph.add_edge(edge)

    def add_external(self, edges: Sequence[Edge]) -> None:
        for edge in edges:
            self.graph.add_doubtful_edge(edge)

    @property
    def ids(self) -> np.ndarray:
        return self.graph.ids

    def latest_poses(self) -> Array:
        return self.graph.poses()

    def read_all(self) -> Array:
        self.poses = self.graph.poses()
        return self.poses

    def pose(self, keyframe_id: int) -> Array:
        return self.graph.pose(keyframe_id)

    def covariance(self, keyframe_id: int) -> Array:
        return self.graph.covariance(keyframe_id)

    def move(self, T_map_graph: Array, covariance: Array) -> None:
        self.poses = T_map_graph @ self.latest_poses()
        self.graph.move(T_map_graph)
        self.graph.add_hold(int(self.ids[-1]), self.poses[-1], covariance)


class LandmarkBackend(BaseBackend):
    """Objects are points of the graph: top, bottom, and one out along the handle if it has one; one point
    alone, the centre, of those that tell no axis.

    Edges of odometry and smooth motions tie the keyframes; edges from codes are not used, since sightings
    say the same without the errors that all edges of one frame share.
    """

    def __init__(self, params: SolverParams) -> None:
        super().__init__(params)
        self._chain = Chain()
        self._seen: dict[int, set[int]] = {}  # landmark points by keyframe
        self._bound: set[int] = {0}  # keyframes that others than landmarks and neighbours hold

    def add_keyframe(
        self, record: KeyframeRecord, T_map_camera: Array, ties: Sequence[Edge], closures: Sequence[Edge]
    ) -> None:
        if record.keyframe_id == 0:
            self.graph.add_origin(0, T_map_camera)
        self.graph.add_pose(record.keyframe_id, T_map_camera)
        self._seen[record.keyframe_id] = set()
        for edge in ties:
            if edge.kind == EdgeKind.ODOMETRY:
                self._chain.add(edge)
                self._add_motion(edge, self.poses[-1], T_map_camera)

    def _add_motion(self, along: Edge, T_map_before: Array, T_map_after: Array) -> None:
        """Odometry, and that motion is smooth only where it goes along: where it jumps, the camera may have
        been carried elsewhere.
        """
        self.graph.add_edge(along)
        if self.params.acceleration_mps2 > 0.0:
            duration_s = (along.to_stamp_ns - along.from_stamp_ns) * NANOSECONDS
            ends = along.from_id, along.to_id
            self.graph.add_smooth_motion(*ends, duration_s, T_map_before, T_map_after)

    def add_sightings(self, record: KeyframeRecord, tracks: Iterable[Track]) -> None:
        index = {int(key): i for i, key in enumerate(record.keys)}
        for track in tracks:
            i = index[track.key]
            points, covariances = landmark_points(record.frames, i)
            center, axis, handle = track.place
            half = end_height(track.half_height) * axis * record.frames.tell_axes[i]
            starts = center + half, center - half, center + LEVER_M * handle
            for part in range(n_points(record.frames, i)):
                seen = points[part], covariances[part], starts[part]
                self.graph.add_sighting(
                    record.keyframe_id, point_id(track, part), *seen, loose=part == HANDLE
                )
                self._seen[record.keyframe_id].add(point_id(track, part))

    def add_refined(self, edges: Sequence[Edge]) -> None:
        super().add_refined(edges)
        for edge in edges:
            self._chain.add(edge)

    def add_external(self, edges: Sequence[Edge]) -> None:
        super().add_external(edges)
        self._bound.update(end for edge in edges for end in (edge.from_id, edge.to_id))

    def landmarks_of(self, keyframe_id: int) -> Set[int] | None:
        return None if keyframe_id in self._bound else self._seen[keyframe_id]

    def remove(self, keyframe_id: int, stand_in: int, T_stand_in_left: Array) -> None:
        """Its sightings are forgotten; its stand-in takes over what ties it to other keyframes."""
        for edge in self._chain.hand_over(keyframe_id, stand_in, T_stand_in_left):
            self.graph.add_edge(edge)
        del self._seen[keyframe_id]
        self.poses = self.poses[self.ids[: len(self.poses)] != keyframe_id]
        self.graph.remove(keyframe_id)

    def move(self, T_map_graph: Array, covariance: Array) -> None:
        super().move(T_map_graph, covariance)
        self._bound.add(int(self.ids[-1]))

    def add_known(self, tracks: Sequence[Track]) -> None:
        ambiguous = np.array([track.ambiguous for track in tracks], dtype=bool)
        sigmas = sigmas_of(tracks, KNOWN_SIGMAS)
        frames = frames_at(places_of(tracks), sigmas, ambiguous, heights_of(tracks)[0])
        for i, track in enumerate(tracks):
            points, covariances = landmark_points(frames, i)
            for part in range(n_points(frames, i)):
                known = points[part], covariances[part]
                self.graph.add_known_point(point_id(track, part), *known, loose=part == HANDLE)

    def solve(self) -> Array:
        self.graph.solve()
        first = max(len(self.poses) - RECENT, 0)
        self.poses = np.concatenate([self.poses[:first], self.graph.poses(first)])
        return self.poses

    def has_moved(self) -> bool:
        few = samples(len(self.poses))
        now = [self.graph.pose(keyframe_id) for keyframe_id in self.ids[few].tolist()]
        return differ(self.poses[few], np.array(now))

    @property
    def can_judge(self) -> bool:
        return not self.graph.is_behind

    def place_all(self, tracks: Iterable[Track]) -> None:
        tracks = list(tracks)
        points = self.graph.points(
            point_id(track, part) for track in tracks for part in (TOP, BOTTOM, HANDLE)
        )
        known = [track for track in tracks if point_id(track, TOP) in points]
        if not known:
            return
        for track, place in zip(known, orthonormal_places(_placed(known, points)), strict=True):
            track.anchored, track.place = True, place


def point_id(track: Track, part: int) -> int:
    """Name of a landmark point of the graph: top, bottom or handle of a track."""
    return N_PARTS * track.key + part


def track_key(point: int) -> int:
    """The track whose point this is."""
    return point // N_PARTS


def _placed(tracks: Sequence[Track], points: Mapping[int, Array]) -> Array:
    """(n, 3, 3) centre, axis and handle of tracks, not yet of unit length; what no point tells stays."""
    unknown = np.full(3, np.nan)
    parts = [points.get(point_id(track, part), unknown) for track in tracks for part in (TOP, BOTTOM, HANDLE)]
    top, bottom, handle = np.array(parts).reshape(-1, 3, 3).swapaxes(0, 1)
    center = np.where(np.isnan(bottom), top, (top + bottom) / 2)
    told = np.stack([center, top - bottom, handle - center], axis=1)
    return np.where(np.isnan(told), [track.place for track in tracks], told)


def samples(n: int) -> np.ndarray:
    """A few indices below n, spread evenly."""
    return np.unique(np.linspace(0, n - 1, min(n, SAMPLES)).astype(np.intp))


def differ(before: Array, now: Array) -> bool:
    """Whether one of the poses (n, 4, 4) differs noticeably: by the place of what lies a metre ahead."""
    moved = (now - before)[:, :3, 2:].sum(axis=2)
    return bool((np.linalg.norm(moved, axis=1) > NOTICEABLE_M).any())

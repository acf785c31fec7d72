"""The paper's graph: camera poses alone, under edges between them (NeuSE IV-C)."""

from collections.abc import Iterable, Sequence, Set

import numpy as np

from neuse.errors import SolverError
from neuse.geometry import Array, inverse
from neuse.records import Edge
from neuse.slam.backends import BaseBackend, differ, samples
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.sliding_window import SlidingWindow
from neuse.slam.smoother import SolverParams
from neuse.slam.track import Track, orthonormal_places


class EdgeBackend(BaseBackend):
    """The paper's way: camera poses only. A fixed-lag smoother gives keyframes a start, iSAM2 has all edges.

    Places of objects are averages of what the keyframes saw, through their latest poses (NeuSE IV-A).
    """

    def __init__(self, params: SolverParams, window: int) -> None:
        super().__init__(params)
        self.window = SlidingWindow(window, params)
        self._seen = _Sightings()
        self._read: Array = np.zeros((0, 4, 4))  # as they were when all were read, or soon after they came

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

    def solve(self) -> Array:
        self.graph.solve()
        self.poses = self.latest_poses()
        self._read = np.concatenate([self._read, self.poses[len(self._read) :]])
        return self.poses

    def has_moved(self) -> bool:
        few = samples(len(self._read))
        return differ(self._read[few], self.poses[few])

    def read_all(self) -> Array:
        self._read = super().read_all()
        return self._read

    @property
    def can_judge(self) -> bool:
        """False: the closures are part of the solution."""
        return False

    def add_sightings(self, record: KeyframeRecord, tracks: Iterable[Track]) -> None:
        """Nothing: the edges have said it."""

    def landmarks_of(self, keyframe_id: int) -> Set[int] | None:
        """None: edges between keyframes are all there is."""
        return None

    def remove(self, keyframe_id: int, stand_in: int, T_stand_in_left: Array) -> None:
        """Nothing: all keyframes have to stay."""

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

"""Keyframes, the edges between them, and the graph that holds both (NeuSE IV-C)."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from neuse.geometry import Array, adjoint, inverse
from neuse.records import Edge, Keyframe
from neuse.slam.backends import RECENT, Backend, LandmarkBackend, track_key
from neuse.slam.edge_backend import EdgeBackend
from neuse.slam.edges import EdgeBuilder
from neuse.slam.keyframes import KeyframeLibrary, KeyframeRecord
from neuse.slam.odometry import Motion
from neuse.slam.params import SlamParams
from neuse.slam.refinement import Refiner
from neuse.slam.thinning import Thinning
from neuse.slam.track import Track

LOOSE_HOLD = np.diag([0.03**2] * 6)  # rad^2, m^2: of the pose found in a known map; its objects hold more


class NewEdges(NamedTuple):
    """What ties a new keyframe to earlier ones: edges from codes, and motions refined by surfaces."""

    short_range: list[Edge]
    closures: list[Edge]
    refined: list[Edge]


class KeyframeGraph:
    """All keyframes of a session with their latest estimates, and how they came about."""

    def __init__(self, params: SlamParams) -> None:
        keyframes, edges, refinement = params.keyframes, params.edges, params.refinement
        self.library = KeyframeLibrary(keyframes)
        self._edges, self._refiner, self._backend = EdgeBuilder(edges), Refiner(refinement), _backend(params)
        self._reach = max(edges.window, refinement.lags + 1)  # of ties to come
        self._window = edges.window
        self._first_moved = 0
        self._can_judge = False
        self._thinning = Thinning(keyframes.near_m, keyframes.views)

    @property
    def rejected_edges(self) -> int:
        """Candidate edges that the gates have refused so far."""
        return self._edges.rejected

    @property
    def size(self) -> int:
        """Keyframes in the graph."""
        return len(self._backend.ids)

    @property
    def last(self) -> KeyframeRecord | None:
        """The latest keyframe, None before the first."""
        return self.library.records[-1] if self.library.records else None

    def edges_of(
        self,
        new: KeyframeRecord,
        clouds: Mapping[int, np.ndarray],
        tracks: dict[int, Track],
        T_map_camera: Array,
    ) -> NewEdges:
        """Edges to a keyframe that is about to be added.

        Args:
            clouds: (m, 3) points of each track that it sees, camera frame.    T_map_camera: its tracked pose.
        """
        records = self.library.records
        T_olds_new = inverse(self.library.T_map_camera[-self._reach :]) @ T_map_camera
        return NewEdges(
            self._edges.short_range(new, records, tracks, T_olds_new),
            self._edges.loop_closures(new, records, tracks),
            self._refiner.edges(new, clouds, T_olds_new),
        )

    def add(
        self,
        new: KeyframeRecord,
        T_map_camera: Array,
        odometry: Sequence[Edge],
        edges: NewEdges,
        seen: Sequence[Track],
    ) -> None:
        """A keyframe with its start value, what ties it to others, and the tracks of the graph it sees."""
        self._backend.add_keyframe(new, T_map_camera, [*odometry, *edges.short_range], edges.closures)
        self._backend.add_refined(edges.refined)
        self._backend.add_sightings(new, seen)
        self.library.records.append(new)

    def add_earlier_sightings(self, entering: Sequence[Track]) -> None:
        """What the last keyframes saw of tracks that have just entered the graph."""
        for earlier in self.library.records[-self._window :]:
            self._backend.add_sightings(earlier, [track for track in entering if track.key in earlier.keys])

    def add_external(self, edges: Sequence[Edge]) -> None:
        """Edges of an external SLAM between our keyframes."""
        self._backend.add_external(edges)

    def solve(self) -> bool:
        """Take in everything new; whether all keyframes have been given new places.

        Keyframes long past stay as they were until they have moved noticeably: a loop closure moves them, and
        the solutions after it.
        """
        self.library.place(self._backend.ids, self._backend.solve())
        moved = self._backend.has_moved()
        self._can_judge = self._backend.can_judge and not moved
        if moved:
            self._read_all()
        first_moved = 0 if moved else max(len(self.library.records) - RECENT, 0)
        self._first_moved = min(self._first_moved, first_moved)
        return moved

    def borne_out(self, closures: Sequence[Edge]) -> list[Edge]:
        """Loop closures that the last solution does not contradict, as far as it can judge."""
        if not self._can_judge:
            return list(closures)
        T_from = self.library.T_map_camera[[edge.from_id for edge in closures]]
        T_to = self.library.T_map_camera[[edge.to_id for edge in closures]]
        return self._edges.borne_out(closures, inverse(T_from) @ T_to)

    def thin(self, tracks: Mapping[int, Track]) -> None:
        """The keyframe that leaves the window goes with the next solution, unless it has to stay.

        One that sees nothing stays: its place is none that others could know, and it costs next to nothing.
        """
        leaving = len(self.library.records) - 1 - self._reach
        seen = self._backend.landmarks_of(leaving) if leaving >= 0 else None
        landmarks = {point for point in seen or () if track_key(point) in tracks}  # others never come back
        if not landmarks:
            return
        positions = self.library.T_map_camera[:, :3, 3]
        stand_in = self._thinning.stand_in(leaving, landmarks, positions)
        if stand_in is None:
            self._thinning.keep(leaving, landmarks)
        else:
            self._let_go(leaving, stand_in, tracks)

    def _let_go(self, keyframe_id: int, stand_in: int, tracks: Mapping[int, Track]) -> None:
        T_stand_in_left = inverse(self._backend.pose(stand_in)) @ self._backend.pose(keyframe_id)
        for key in self.library.records[keyframe_id].keys.tolist():
            if key in tracks:
                tracks[key].leave_keyframe(keyframe_id)
        self.library.let_go(keyframe_id, stand_in, T_stand_in_left)
        self._backend.remove(keyframe_id, stand_in, T_stand_in_left)

    def place(self, tracks: Iterable[Track]) -> None:
        """Update the places of tracks of the graph from the last solution."""
        self._backend.place_all(tracks)

    def move(self, T_map_session: Array, covariance: Array) -> None:
        """The session turns out to lie elsewhere, the last keyframe with this covariance (6, 6)."""
        self._read_all()
        A = adjoint(inverse(self.library.T_map_camera[-1]))
        self._first_moved = 0
        self.library.move(T_map_session)
        self._backend.move(T_map_session, A @ covariance @ A.T + LOOSE_HOLD)

    def add_known(self, tracks: Sequence[Track]) -> None:
        """Tracks whose places are known from elsewhere."""
        self._backend.add_known(tracks)

    def relative_to_last(self, T_map_camera: Array) -> Array:
        """T_keyframe_camera of a camera pose; identity where the last keyframe is yet to be solved."""
        if len(self.library.records) > len(self.library.T_map_camera):
            return np.eye(4)
        return inverse(self.library.T_map_camera[-1]) @ T_map_camera

    def covariance(self, T_map_camera: Array) -> Array:
        """(6, 6) of the last keyframe's pose, at a camera pose that is fixed to it."""
        A = adjoint(inverse(self.relative_to_last(T_map_camera)))
        return A @ self._backend.covariance(len(self.library.records) - 1) @ A.T

    def motion(self, from_id: int, to_id: int) -> Motion:
        """Between two keyframes by the last solution; as if they erred independently, so rather doubtful."""
        T_from_to = inverse(self.library.T_map_camera[from_id]) @ self.library.T_map_camera[to_id]
        A = adjoint(inverse(T_from_to))
        before, after = (self._backend.covariance(keyframe_id) for keyframe_id in (from_id, to_id))
        return Motion(T_from_to, A @ before @ A.T + after)

    def all(self) -> tuple[Keyframe, ...]:
        """All keyframes with their latest estimates."""
        return _keyframes(self.library.records, self._latest())

    def moved(self) -> tuple[Keyframe, ...]:
        """Those that are new or may have moved since this was asked last; all of them after a closure."""
        first, self._first_moved = self._first_moved, len(self.library.records)
        return _keyframes(self.library.records[first:], self.library.T_map_camera[first:])

    def trajectory(self) -> list[tuple[int, Array]]:
        """(stamp_ns, T_map_camera) of every frame, through its keyframe's latest estimate."""
        return self.library.trajectory(self._latest())

    def _latest(self) -> Array:
        """(n, 4, 4) T_map_camera of all keyframes by the last solution; to ask changes nothing."""
        return self.library.placed(self._backend.ids, self._backend.latest_poses())

    def _read_all(self) -> None:
        ids, T_map_camera = self._backend.ids, self._backend.read_all()
        self.library.T_map_camera[:] = self.library.placed(ids, T_map_camera)


def _keyframes(records: Sequence[KeyframeRecord], T_map_camera: Array) -> tuple[Keyframe, ...]:
    pairs = zip(records, T_map_camera, strict=True)
    return tuple(Keyframe(record.keyframe_id, record.stamp_ns, T.copy()) for record, T in pairs)


def _backend(params: SlamParams) -> Backend:
    if params.mode == "edges":
        return EdgeBackend(params.solver, params.edges.window)
    return LandmarkBackend(params.solver)

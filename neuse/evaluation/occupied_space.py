"""Changes by geometry alone, as a rival: occupied space of each object against free space seen later.

In the manner of panoptic multi-TSDFs (Schmid et al. 2022): every segmented object has a submap of the space
that it occupies. One that later frames look through has gone; one that stands where earlier frames saw
nothing has come. Shapes are not compared: what has gone and what has come are taken for one object that has
moved if category and size agree, which is more than the original does. Poses are given.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.distance import cdist

from neuse.evaluation.trajectory import Trajectory
from neuse.geometry import Array, inverse, make_transform, transform_points
from neuse.params import CheckedParams, param
from neuse.records import ChangeKind, Intrinsics, ObjectChange, Observation, ObservedFrame


@dataclass(frozen=True)
class OccupiedSpaceParams(CheckedParams):
    """Resolution of submaps, and how much evidence a change needs."""

    voxel_m: float = param(0.02, "side of a submap's voxels, metres", 0.001, 1.0)
    margin_m: float = param(0.03, "a reading this far behind a voxel says that it is free", 0.001, 1.0)
    max_range_m: float = param(3.0, "readings of voxels beyond this say nothing", 0.1, 100.0)
    min_overlap: float = param(0.3, "share of a view that lies in the submap that it belongs to", 0.0, 1.0)
    min_sightings: int = param(5, "an object was seen as often", 1, 1000)
    min_readings: int = param(60, "readings that it takes to tell free from occupied", 1, 100_000)
    min_frames: int = param(5, "from so many frames", 1, 1000)
    free_share: float = param(0.7, "share of readings that say free where nothing is", 0.0, 1.0)
    visit_gap_s: float = param(3.0, "evidence older than this belongs to an earlier visit", 0.0, 1000.0)
    keyframe_gap: int = param(3, "every so many frames one is kept as evidence of free space", 1, 1000)
    max_size_difference_m: float = param(0.03, "what moved keeps its size within this", 0.0, 1.0)


@dataclass
class Submap:
    """The space that one object occupies: voxels (n, 3) in the map frame, metres.

    free, occupied, frames: readings of the present visit.    came: nothing stood there before.
    """

    category: str
    voxels: Array
    first_ns: int
    last_ns: int
    n_sightings: int = 1
    free: int = 0
    occupied: int = 0
    frames: int = 0
    evidence_ns: int = 0
    came_ns: int | None = None
    gone_ns: int | None = None

    @property
    def center(self) -> Array:
        """(3,) middle of the box."""
        return (self.voxels.min(axis=0) + self.voxels.max(axis=0)) / 2

    @property
    def size(self) -> Array:
        """(3,) sides of the box, the shortest first."""
        return np.sort(self.voxels.max(axis=0) - self.voxels.min(axis=0))


@dataclass(frozen=True)
class DepthView:
    """A depth thumbnail where it was taken."""

    stamp_ns: int
    T_camera_map: Array
    intrinsics: Intrinsics
    depth_m: np.ndarray

    def readings(self, points: Array, margin_m: float, max_range_m: float) -> tuple[int, int]:
        """(free, occupied) readings of points (n, 3), map frame; hidden ones give none."""
        seen = transform_points(self.T_camera_map, points)
        seen = seen[(seen[:, 2] > 0.1) & (seen[:, 2] < max_range_m)]
        camera, (height, width) = self.intrinsics, self.depth_m.shape
        column = (seen[:, 0] / seen[:, 2] * camera.fx + camera.cx) * width / camera.width
        row = (seen[:, 1] / seen[:, 2] * camera.fy + camera.cy) * height / camera.height
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        depth_m = self.depth_m[row[inside].astype(int), column[inside].astype(int)]
        behind_m = np.where(depth_m > 0, depth_m - seen[inside, 2], -np.inf)
        return int((behind_m > margin_m).sum()), int((np.abs(behind_m) <= margin_m).sum())


@dataclass
class OccupiedSpace:
    """Keeps submaps of objects; `changes` is what they tell in the end."""

    params: OccupiedSpaceParams = field(default_factory=OccupiedSpaceParams)
    submaps: list[Submap] = field(default_factory=list)
    _views: list[DepthView] = field(default_factory=list)
    _frame_index: int = 0

    def step(self, frame: ObservedFrame, T_map_camera: Array) -> None:
        """Take in one frame."""
        view = DepthView(frame.stamp_ns, inverse(T_map_camera), frame.intrinsics, frame.coarse_depth_m)
        for observation in frame.observations:
            self._integrate(observation, T_map_camera, frame.stamp_ns)
        for submap in self.submaps:
            if submap.gone_ns is None and submap.last_ns < frame.stamp_ns:
                self._look_through(submap, view)
        if self._frame_index % self.params.keyframe_gap == 0:
            self._views.append(view)
        self._frame_index += 1

    def changes(self) -> tuple[ObjectChange, ...]:
        """What has come, gone or moved, judged by all frames so far."""
        known = [submap for submap in self.submaps if submap.n_sightings >= self.params.min_sightings]
        gone = [submap for submap in known if submap.gone_ns is not None]
        come = [submap for submap in known if submap.came_ns is not None]
        moves = self._moves(gone, come)
        moved = {id(submap) for pair in moves for submap in pair}
        return (
            *(_change(before, after) for before, after in moves),
            *(_change(submap, None) for submap in gone if id(submap) not in moved),
            *(_change(None, submap) for submap in come if id(submap) not in moved),
        )

    def _integrate(self, observation: Observation, T_map_camera: Array, stamp_ns: int) -> None:
        """Add an observation's points to the submap that they lie in, or to a new one."""
        points = transform_points(T_map_camera, observation.cloud)
        submap = self._submap_at(observation.code.category, points[::4])
        if submap is None:
            voxels = self._voxels(points)
            self.submaps.append(Submap(observation.code.category, voxels, stamp_ns, stamp_ns))
            return
        submap.voxels = self._voxels(np.concatenate([submap.voxels, points]))
        submap.last_ns = stamp_ns
        submap.n_sightings += 1
        submap.free = submap.occupied = submap.frames = 0
        if submap.n_sightings == self.params.min_sightings and self._was_free(submap):
            submap.came_ns = stamp_ns

    def _voxels(self, points: Array) -> Array:
        """(n, 3) centres of the voxels that points lie in."""
        indices = np.unique(np.floor(points / self.params.voxel_m).astype(np.int64), axis=0)
        return np.asarray((indices + 0.5) * self.params.voxel_m, dtype=np.float64)

    def _submap_at(self, category: str, points: Array) -> Submap | None:
        """The submap of this category that most of the points lie in, None if too few do."""
        candidates = [s for s in self.submaps if s.category == category and s.gone_ns is None]
        best, most = None, self.params.min_overlap
        for submap in candidates:
            if np.linalg.norm(submap.center - points.mean(axis=0)) > 0.3:
                continue
            share = float((cdist(points, submap.voxels).min(axis=1) <= 1.5 * self.params.voxel_m).mean())
            if share >= most:
                best, most = submap, share
        return best

    def _look_through(self, submap: Submap, view: DepthView) -> None:
        """Take a frame's evidence on an object that is not detected in it."""
        params = self.params
        free, occupied = view.readings(submap.voxels, params.margin_m, params.max_range_m)
        if free + occupied == 0:
            return
        if view.stamp_ns - submap.evidence_ns > params.visit_gap_s * 1e9:
            submap.free = submap.occupied = submap.frames = 0
        submap.free, submap.occupied = submap.free + free, submap.occupied + occupied
        submap.frames, submap.evidence_ns = submap.frames + 1, view.stamp_ns
        if submap.frames >= params.min_frames and self._is_free(submap.free, submap.occupied):
            submap.gone_ns = view.stamp_ns

    def _was_free(self, submap: Submap) -> bool:
        """Whether frames of earlier visits looked through where it stands."""
        before_ns = submap.first_ns - int(self.params.visit_gap_s * 1e9)
        earlier = [view for view in self._views if view.stamp_ns < before_ns]
        readings = [v.readings(submap.voxels, self.params.margin_m, self.params.max_range_m) for v in earlier]
        free, occupied = np.sum(readings, axis=0) if readings else (0, 0)
        return self._is_free(int(free), int(occupied))

    def _is_free(self, free: int, occupied: int) -> bool:
        enough = free + occupied >= self.params.min_readings
        return enough and free >= self.params.free_share * (free + occupied)

    def _moves(self, gone: Sequence[Submap], come: Sequence[Submap]) -> list[tuple[Submap, Submap]]:
        """Pairs of one category and nearly one size, the most equal first."""
        pairs = sorted(
            (float(np.abs(before.size - after.size).max()), i, j)
            for i, before in enumerate(gone)
            for j, after in enumerate(come)
            if before.category == after.category
        )
        taken_i, taken_j, moves = set[int](), set[int](), []
        for difference_m, i, j in pairs:
            if difference_m <= self.params.max_size_difference_m and i not in taken_i and j not in taken_j:
                taken_i.add(i)
                taken_j.add(j)
                moves.append((gone[i], come[j]))
        return moves


def geometric_changes(frames: Sequence[ObservedFrame], path: Trajectory) -> tuple[ObjectChange, ...]:
    """The changes that geometry alone finds along a path; frames without a pose are left out."""
    space = OccupiedSpace()
    for frame in frames:
        T_map_camera = path.at(frame.stamp_ns)
        if T_map_camera is not None:
            space.step(frame, T_map_camera)
    return space.changes()


def _change(before: Submap | None, after: Submap | None) -> ObjectChange:
    """The change that leads from one submap to the other; None where there is nothing."""
    kind = ChangeKind.ADDED if before is None else ChangeKind.REMOVED if after is None else ChangeKind.MOVED
    stamps = [before and before.gone_ns, after and after.came_ns]
    category = before.category if before else after.category if after else ""
    return ObjectChange(max(s or 0 for s in stamps), kind, 0, category, _pose(before), _pose(after))


def _pose(submap: Submap | None) -> Array | None:
    return None if submap is None else make_transform(np.eye(3), submap.center)

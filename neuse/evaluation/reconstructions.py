"""How well single views explain what was seen: shapes decoded from one observation, beside its points."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from neuse.embedding.observe import back_project, pixels_by_label
from neuse.errors import NeuseError
from neuse.evaluation.map_scene import Reconstruct
from neuse.geometry import Array
from neuse.records import Observation, ObservedFrame, RgbdFrame

ENCLOSED_M = 0.01
MAX_RANGE_M = 6.0


@dataclass(frozen=True)
class ReconstructedObject:
    """An observation with the full shape of its code; camera frame, metres.

    mesh: the decoded shape, closed.    points: (n, 3) every depth reading under the mask.
    near: (n,) bool, which of them lie within ENCLOSED_M of the mesh's surface, inside or outside.
    """

    observation: Observation
    mesh: trimesh.Trimesh
    points: Array
    near: np.ndarray

    @property
    def enclosed_share(self) -> float:
        """Share of the observed points that the surface passes within ENCLOSED_M."""
        return float(self.near.mean())


@dataclass(frozen=True)
class ReconstructedFrame:
    """A frame with what was decoded from it alone."""

    frame: RgbdFrame
    objects: tuple[ReconstructedObject, ...]


def reconstruct_frame(
    frame: RgbdFrame, observed: ObservedFrame, reconstruct: Mapping[str, Reconstruct]
) -> ReconstructedFrame:
    """Decode every observation of a frame; one without decoder, shape or points is left out.

    reconstruct: by category, code -> mesh in the code's frame.
    """
    pixels = pixels_by_label(frame.mask)
    objects = []
    for observation in observed.observations:
        mesh = _mesh(observation, reconstruct)
        own = pixels.get(observation.label, np.empty(0, dtype=np.int64))
        points = back_project(frame.depth_m, frame.intrinsics, own, MAX_RANGE_M)
        if mesh is not None and len(points):
            near = surface_distance(mesh, points) <= ENCLOSED_M
            objects.append(ReconstructedObject(observation, mesh, points, near))
    return ReconstructedFrame(frame, tuple(objects))


def surface_distance(mesh: trimesh.Trimesh, points: Array) -> Array:
    """(n,) metres from points (n, 3) to the nearest corner or middle of a face: never too small.

    For a mesh of 2.5 mm cells it is at most that much too large.
    """
    tree = cKDTree(np.concatenate([mesh.vertices, mesh.triangles_center]))
    return tree.query(points)[0]


def telling_frames(observed: Sequence[ObservedFrame], count: int) -> list[ObservedFrame]:
    """From each of `count` equal parts of a run the frame that shows the most of objects; fewer if short."""
    parts = np.array_split(np.arange(len(observed)), min(count, len(observed)) or 1)
    best = [max((observed[i] for i in part), key=_shown_px) for part in parts if len(part)]
    return [frame for frame in best if frame.observations]


def reconstructions_dict(frames: Sequence[ReconstructedFrame]) -> dict[str, object] | None:
    """The figures for report.json; None where nothing was decoded."""
    entries = [_entry(frame.frame.stamp_ns, item) for frame in frames for item in frame.objects]
    if not entries:
        return None
    shares = [item.enclosed_share for frame in frames for item in frame.objects]
    return {
        "within_m": ENCLOSED_M,
        "enclosed_share": {"min": min(shares), "mean": float(np.mean(shares))},
        "instances": entries,
    }


def _entry(stamp_ns: int, item: ReconstructedObject) -> dict[str, object]:
    seen = item.observation
    return {
        "stamp_ns": stamp_ns,
        "label": seen.label,
        "category": seen.code.category,
        "range_m": seen.range_m,
        "points": len(item.points),
        "enclosed_share": item.enclosed_share,
    }


def _mesh(observation: Observation, reconstruct: Mapping[str, Reconstruct]) -> trimesh.Trimesh | None:
    try:
        return reconstruct[observation.code.category](observation.code)
    except (KeyError, NeuseError):
        return None


def _shown_px(frame: ObservedFrame) -> int:
    return sum(observation.mask_px for observation in frame.observations)

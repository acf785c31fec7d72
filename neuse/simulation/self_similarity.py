"""The symmetry of meshes, found by laying each surface upon itself, turned about its axes."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from neuse.geometry import Array, transform_points
from neuse.simulation.canonical import axis_frame, box_frame
from neuse.symmetry import AXIAL, BOX, HALF_TURN, NONE, QUARTER_TURN, Symmetry

N_SURFACE, N_TRIED = 30_000, 1500  # points of the surface, and of the turned surface
SAME = 0.03  # of the size: a point this near to the surface lies on it
SHARE = 0.97  # of the turned points that lie on the surface, if it is the same; the rest may be a small spout
ANY_TURN_DEG = (37.0, 71.0, 103.0, 151.0)  # none of them near a turn of few-sided prisms


def find_symmetry(meshes: Sequence[trimesh.Trimesh]) -> Symmetry:
    """What more than half of the closed meshes share, else no symmetry; small parts do not count."""
    found, count = Counter(symmetry_of_mesh(mesh) for mesh in meshes).most_common(1)[0]
    return found if 2 * count > len(meshes) else NONE


def symmetry_of_mesh(mesh: trimesh.Trimesh) -> Symmetry:
    """Of one closed mesh, in any orientation."""
    surface, _ = trimesh.sample.sample_surface(mesh, N_SURFACE, seed=0)
    upright, along_edges = (
        _Surface(frame, np.asarray(surface)) for frame in (axis_frame(mesh), box_frame(mesh))
    )
    if all(upright.is_same_after("z", angle) for angle in ANY_TURN_DEG):
        return AXIAL
    if all(along_edges.is_same_after(axis, 180.0) for axis in "xyz"):
        return BOX
    if not upright.is_same_after("z", 180.0):
        return NONE
    return QUARTER_TURN if upright.is_same_after("z", 90.0) else HALF_TURN


class _Surface:
    """Points of a surface in a frame, and where the nearest of them are."""

    def __init__(self, T_frame_mesh: Array, surface: Array) -> None:
        self.points = transform_points(T_frame_mesh, surface)
        self._tree = cKDTree(self.points)
        self._same_m = SAME * float(np.linalg.norm(np.ptp(self.points, axis=0)))

    def is_same_after(self, axis: str, angle_deg: float) -> bool:
        """Whether the surface, turned about an axis of the frame, covers itself."""
        turned = Rotation.from_euler(axis, angle_deg, degrees=True).apply(self.points[:N_TRIED])
        distances, _ = self._tree.query(turned)
        return bool(np.mean(distances < self._same_m) > SHARE)

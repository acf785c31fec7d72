"""Tables, the objects on them, and how the arrangement changes over time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from neuse.geometry import Array, make_transform, transform_points
from neuse.records import ChangeKind
from neuse.simulation.shapes import Shape

BOARD_M = 0.03
LEG_M = 0.04


@dataclass(frozen=True)
class Table:
    """A rectangular table. Its frame lies in the middle of the top: x along its length, z up.

    center: x, y in the world.    size_m: length, depth.    height_m: of the top above the floor at z = 0.
    """

    center: tuple[float, float]
    size_m: tuple[float, float] = (1.2, 0.6)
    yaw_rad: float = 0.0
    height_m: float = 0.72

    @property
    def T_world_table(self) -> Array:
        """p_world = T_world_table @ p_table."""
        R_world_table = Rotation.from_rotvec([0.0, 0.0, self.yaw_rad]).as_matrix()
        return make_transform(R_world_table, [*self.center, self.height_m])

    def mesh(self) -> trimesh.Trimesh:
        """Board and four legs in the table's frame."""
        x, y = np.array(self.size_m) / 2
        boxes = [trimesh.creation.box(bounds=[[-x, -y, -BOARD_M], [x, y, 0.0]])]
        for corner in ([x, y], [x, -y], [-x, y], [-x, -y]):
            low, high = np.sort([corner, corner - LEG_M * np.sign(corner)], axis=0)
            boxes.append(trimesh.creation.box(bounds=[[*low, -self.height_m], [*high, -BOARD_M]]))
        vertices = np.concatenate([box.vertices for box in boxes])
        faces = np.concatenate([box.faces + 8 * index for index, box in enumerate(boxes)])
        return trimesh.Trimesh(vertices, faces, process=False)

    def holds(self, points_world: Array, margin_m: float = 0.0) -> bool:
        """Whether all points (n, 2 or 3) are above the table's top, at least `margin_m` inside its edges."""
        points_xy = points_world[:, :2] - self.center
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        points_table = points_xy @ np.array([[cos, -sin], [sin, cos]])
        return bool(np.all(np.abs(points_table) <= np.array(self.size_m) / 2 - margin_m))


@dataclass(frozen=True)
class TrueObject:
    """An object of the world at its place: p_world = T_world_object @ p_object."""

    object_id: int
    shape: Shape
    T_world_object: Array

    @property
    def position(self) -> Array:
        """(3,) origin of the object, metres, world."""
        return self.T_world_object[:3, 3]


@dataclass(frozen=True)
class SceneChange:
    """A change in effect from `frame` on; `before` and `after` are None where the object is not there."""

    frame: int
    kind: ChangeKind
    before: TrueObject | None
    after: TrueObject | None

    @property
    def subject(self) -> TrueObject:
        """The object after the change, or before if it was removed."""
        subject = self.after or self.before
        assert subject is not None
        return subject


@dataclass(frozen=True)
class Timeline:
    """The objects at the start and all changes, in order of their frames."""

    initial: tuple[TrueObject, ...]
    changes: tuple[SceneChange, ...] = ()

    def objects_at(self, frame: int) -> tuple[TrueObject, ...]:
        """The objects of a frame, by id."""
        objects = {true_object.object_id: true_object for true_object in self.initial}
        for change in self.changes:
            if change.frame <= frame:
                objects.pop(change.subject.object_id, None)
                objects |= {change.after.object_id: change.after} if change.after else {}
        return tuple(objects[object_id] for object_id in sorted(objects))

    def changes_at(self, frame: int) -> tuple[SceneChange, ...]:
        """Changes that take effect at a frame."""
        return tuple(change for change in self.changes if change.frame == frame)


def footprint(shape: Shape, T_world_object: Array) -> Array:
    """(m, 2) corners, counter-clockwise, of the convex hull of an object seen from above; metres, world."""
    outline = transform_points(T_world_object, shape.mesh.vertices)[:, :2]
    return outline[ConvexHull(outline).vertices]


def gap(polygon_a: Array, polygon_b: Array) -> float:
    """Lower bound of the distance of two convex polygons (n, 2), exact unless corners are closest.

    By the separating axis theorem, the largest gap of shadows across any edge; negative if they overlap.
    """
    edges = np.concatenate([np.roll(polygon, -1, axis=0) - polygon for polygon in (polygon_a, polygon_b)])
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    a, b = polygon_a @ normals.T, polygon_b @ normals.T  # (n, edges)
    return float(np.maximum(b.min(axis=0) - a.max(axis=0), a.min(axis=0) - b.max(axis=0)).max())


def stands_free(
    shape: Shape, T_world_object: Array, others: Sequence[TrueObject], min_gap_m: float = 0.02
) -> bool:
    """Whether an object keeps its distance from all others, seen from above."""
    own = footprint(shape, T_world_object)
    reach_m = shape.mesh.scale
    return all(
        gap(own, footprint(other.shape, other.T_world_object)) >= min_gap_m
        for other in others
        if np.linalg.norm(other.position - T_world_object[:3, 3]) < reach_m + other.shape.mesh.scale
    )

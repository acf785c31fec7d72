"""The object map as coloured meshes in a frame whose z axis points up."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from neuse.embedding.code import Code
from neuse.errors import NeuseError
from neuse.evaluation.render import ColoredMesh
from neuse.geometry import Array, make_transform
from neuse.records import MapObject, ObjectStatus

Reconstruct = Callable[[Code], trimesh.Trimesh]

STATUS_COLORS = {
    ObjectStatus.UNCHANGED: (0.45, 0.58, 0.78),
    ObjectStatus.ADDED: (0.35, 0.72, 0.40),
    ObjectStatus.MOVED: (0.95, 0.62, 0.25),
    ObjectStatus.REMOVED: (0.85, 0.30, 0.28),
}
UPRIGHT_RAD = np.deg2rad(25.0)


@dataclass(frozen=True)
class MapScene:
    """Map objects with their meshes in the frame of a picture, whose z axis points up."""

    objects: tuple[MapObject, ...]
    meshes: tuple[trimesh.Trimesh, ...]

    def centers(self) -> Array:
        """(n, 3) centres of the objects' boxes, picture frame."""
        return np.array([mesh.bounds.mean(axis=0) for mesh in self.meshes]).reshape(-1, 3)

    def tops(self) -> Array:
        """(n, 3) points above the objects, picture frame."""
        centers = self.centers()
        centers[:, 2] = [mesh.bounds[1, 2] for mesh in self.meshes]
        return centers

    def subset(self, keep: Sequence[int]) -> "MapScene":
        """Some of the objects, by index."""
        objects = tuple(self.objects[i] for i in keep)
        return MapScene(objects, tuple(self.meshes[i] for i in keep))

    def colored(self) -> list[ColoredMesh]:
        """Meshes in the colours of their status."""
        pairs = zip(self.meshes, self.objects, strict=True)
        return [ColoredMesh(mesh, STATUS_COLORS[item.status]) for mesh, item in pairs]

    def plane_z(self) -> float:
        """Height of the lowest point."""
        return min((float(mesh.bounds[0, 2]) for mesh in self.meshes), default=0.0)


class SceneBuilder:
    """Builds scenes of successive maps; what was decoded once is not decoded again.

    reconstruct: by category, code -> mesh in the code's frame; an object without one is drawn as its box.
    """

    def __init__(self, reconstruct: Mapping[str, Reconstruct], T_picture_map: Array) -> None:
        self._reconstruct, self.T_picture_map = reconstruct, T_picture_map
        self._decoded: dict[bytes, trimesh.Trimesh] = {}
        self._spent_s: list[float] = []

    def scene(self, objects: Sequence[MapObject]) -> MapScene:
        """A scene of some objects."""
        return MapScene(tuple(objects), tuple(self._mesh(item) for item in objects))

    def decode_ms(self) -> float | None:
        """Mean time of decoding an object, None if none was."""
        return 1e3 * sum(self._spent_s) / len(self._spent_s) if self._spent_s else None

    def _mesh(self, item: MapObject) -> trimesh.Trimesh:
        key = item.code.z.tobytes()
        if key not in self._decoded:
            self._decoded[key] = self._decode(item).apply_transform(self.T_picture_map)
        return self._decoded[key]

    def _decode(self, item: MapObject) -> trimesh.Trimesh:
        """The full shape in the map frame; its box if there is no decoder or the code has no surface."""
        start_s = time.perf_counter()
        try:
            mesh = self._reconstruct[item.category](item.code).copy()
        except (KeyError, NeuseError):
            T_map_box = make_transform(item.T_map_object[:3, :3], item.box_center)
            return trimesh.creation.box(np.maximum(item.box_size, 1e-3), T_map_box)
        self._spent_s.append(time.perf_counter() - start_s)
        return mesh


def upward(objects: Sequence[MapObject], T_map_camera: Array) -> Array:
    """(3,) unit vector up in the map frame, which knows no gravity.

    The cameras' mean upward axis, then the mean axis of the objects that stand nearly along it.
    """
    up = _unit(-T_map_camera[:, :3, 1].mean(axis=0))
    axes = np.array([item.T_map_object[:3, 2] for item in objects]).reshape(-1, 3)
    standing = axes[axes @ up > np.cos(UPRIGHT_RAD)]
    return _unit(standing.mean(axis=0)) if len(standing) else up


def level_frame(up: Array) -> Array:
    """T_picture_map: a rotation that turns `up` to z, by the shortest way."""
    x = np.eye(3)[int(np.argmin(np.abs(up)))]
    x = _unit(x - up * (up @ x))
    return make_transform(np.stack([x, np.cross(up, x), up]), np.zeros(3))


def _unit(v: Array) -> Array:
    return v / max(float(np.linalg.norm(v)), 1e-12)

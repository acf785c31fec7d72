"""Full shapes of objects: decoded once, then carried along with the code, which moves like the object."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import manifold3d
import numpy as np
import trimesh

from neuse.embedding.code import Code
from neuse.errors import MeshError, NeuseError
from neuse.geometry import Array, inverse, make_transform, transform_points

TOLERANCE_M = 0.001

Reconstruct = Callable[[Code], trimesh.Trimesh]


@dataclass(frozen=True)
class Box:
    """A box along the axes of an object's frame: p_map = T_map_box @ p_box, |p_box| <= size / 2."""

    T_map_box: Array
    size: Array

    @property
    def center(self) -> Array:
        """(3,) map frame."""
        return self.T_map_box[:3, 3]

    @property
    def volume(self) -> float:
        """Cubic metres."""
        return float(np.prod(self.size))

    @property
    def radius(self) -> float:
        """Half the diagonal, metres."""
        return float(np.linalg.norm(self.size) / 2)

    def moved(self, T_map_map: Array) -> "Box":
        """The box after a motion of the map frame's points."""
        return Box(T_map_map @ self.T_map_box, self.size)


def bounding_box(points: Array, T_map_object: Array) -> Box:
    """Smallest box around points (n, 3), map frame, along the axes of the object's frame."""
    in_object = transform_points(inverse(T_map_object), points)
    low, high = in_object.min(axis=0), in_object.max(axis=0)
    T_object_box = make_transform(np.eye(3), (low + high) / 2)
    return Box(T_map_object @ T_object_box, high - low)


@dataclass(frozen=True)
class _Decoded:
    """What came of decoding `code`: a mesh and its box in the map frame as they were then, or an error."""

    code: Code
    shape: tuple[trimesh.Trimesh, Box] | NeuseError

    @property
    def mesh(self) -> trimesh.Trimesh:
        """Raises the error if there is none."""
        return self._found()[0]

    @property
    def box(self) -> Box:
        """Raises the error if there is none."""
        return self._found()[1]

    def _found(self) -> tuple[trimesh.Trimesh, Box]:
        if isinstance(self.shape, NeuseError):
            raise self.shape.with_traceback(None)  # else it would grow each time
        return self.shape


class MeshCache:
    """Meshes and boxes by object id; decoded anew only when the shape in the code has changed noticeably.

    A shape takes long to decode. Who has no time for it asks for `now=False`: the latest shape that has been
    decoded, at the place of the code.
    """

    def __init__(self, reconstruct: Mapping[str, Reconstruct], redecode_rms_m: float) -> None:
        self._reconstruct = reconstruct
        self._redecode_rms_m = redecode_rms_m
        self._decoded: dict[int, _Decoded] = {}

    def mesh(self, object_id: int, code: Code, now: bool = True) -> trimesh.Trimesh:
        """Full shape of the code, in the code's frame.

        Raises:
            MeshError: no decoder for the category, or not decoded yet.    NeuseError: whatever the decoder
            refuses.
        """
        decoded, T_now_then = self._placed(object_id, code, now)
        mesh = decoded.mesh.copy()
        mesh.apply_transform(T_now_then)
        return mesh

    def box(self, object_id: int, code: Code, points: Array, now: bool = True) -> Box:
        """Box of the full shape; of the observed points (n, 3) where there is none."""
        try:
            decoded, T_now_then = self._placed(object_id, code, now)
            return decoded.box.moved(T_now_then)
        except NeuseError:
            return bounding_box(points, code.T_frame_object)

    def lag_m(self, object_id: int, code: Code) -> float:
        """By how much the code has changed since it was decoded, rms; 0 if not noticeably, inf if never."""
        decoded = self._decoded.get(object_id)
        if decoded is None:
            return np.inf
        _, rms_m = align_points(decoded.code.z, code.z)
        return rms_m if rms_m > self._redecode_rms_m else 0.0

    def decode(self, object_id: int, code: Code) -> None:
        """Bring a shape up to date."""
        self._decoded[object_id] = _Decoded(code, self._shape(code))

    def forget(self, object_id: int) -> None:
        """Drop an object that left the map."""
        self._decoded.pop(object_id, None)

    def _placed(self, object_id: int, code: Code, now: bool) -> tuple[_Decoded, Array]:
        """A decoded shape, and T_now_then that carries it to where the code is now."""
        if now and self.lag_m(object_id, code) > 0.0:
            self.decode(object_id, code)
        if object_id not in self._decoded:
            raise MeshError(f"object {object_id} has not been decoded yet")
        decoded = self._decoded[object_id]
        T_now_then, _ = align_points(decoded.code.z, code.z)
        return decoded, T_now_then

    def _shape(self, code: Code) -> tuple[trimesh.Trimesh, Box] | NeuseError:
        if code.category not in self._reconstruct:
            known = ", ".join(sorted(self._reconstruct)) or "none"
            return MeshError(f"no decoder for category {code.category!r}; known: {known}")
        try:
            mesh = lighter(self._reconstruct[code.category](code))
        except NeuseError as error:
            return error
        return mesh, bounding_box(np.asarray(mesh.vertices), code.T_frame_object)


def lighter(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with its triangles merged where that moves the surface by less than TOLERANCE_M.

    A tenth of the triangles remains, for viewers to draw; a mesh that is not closed stays as it is.
    """
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
    solid = manifold3d.Manifold(manifold3d.Mesh(vertices, faces)).simplify(TOLERANCE_M)
    if solid.is_empty():
        return mesh
    light = solid.to_mesh()
    return trimesh.Trimesh(light.vert_properties[:, :3], light.tri_verts, process=False)


def align_points(source: Array, target: Array) -> tuple[Array, float]:
    """Rigid T_target_source of corresponding points (n, 3), Horn's method, and the remaining rms, metres."""
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    U, _, Vt = np.linalg.svd((target - target_mean).T @ (source - source_mean))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    T_target_source = make_transform(R, target_mean - R @ source_mean)
    residual = transform_points(T_target_source, source) - target
    return T_target_source, float(np.sqrt((residual**2).sum(axis=1).mean()))

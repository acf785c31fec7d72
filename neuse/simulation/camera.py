"""A depth camera by ray casting: z-depth, instance labels and surface normals of triangle meshes (Embree)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from neuse.errors import MeshError, ParamError
from neuse.geometry import Array, transform_points
from neuse.records import Intrinsics

Window = tuple[int, int, int, int]
NOTHING = -1
IDENTITY = np.eye(3)


class Solid(NamedTuple):
    """A mesh at its place: p_world = T_world_mesh @ p_mesh; label 0 is background."""

    mesh: trimesh.Trimesh
    T_world_mesh: Array
    label: int = 0


class RayScene:
    """Solids in an acceleration structure: build once per arrangement, render from any number of poses.

    Rendering is free of shared state, so several threads may render one scene.
    """

    def __init__(self, solids: Sequence[Solid]) -> None:
        """Raises MeshError when there is no solid, or one has no faces."""
        if not solids or any(len(solid.mesh.faces) == 0 for solid in solids):
            raise MeshError(f"a scene needs solids with faces, got {len(solids)} solids")
        self.solids = tuple(solids)
        self._labels = np.array([solid.label for solid in solids] + [0], dtype=np.int32)
        self._embree = EmbreeScene()
        # the scene does not hold references, but it reads the vertices
        self._geometries = [_embree_mesh(self._embree, solid) for solid in solids]
        self.cast(np.zeros(3), np.ones((1, 3), dtype=np.float32))  # builds the tree before threads share it

    def cast(self, origin: Array, directions: np.ndarray) -> dict[str, np.ndarray]:
        """First hit of each ray origin + tfar * direction.

        Args:
            origin: (3,) metres, world.    directions: (n, 3) float32, world, of any length.
        Returns:
            tfar (n,), geomID and primID (n,) solid and face or NOTHING, u and v (n,) barycentric coordinates,
            Ng (n, 3) normal of the face, not normalised.
        """
        origins = np.broadcast_to(np.asarray(origin, dtype=np.float32), directions.shape)
        return self._embree.run(origins, directions, output=1)

    def labels_of(self, solid_ids: np.ndarray) -> np.ndarray:
        """Instance labels of solids, by index; NOTHING gives 0."""
        return self._labels[solid_ids]


@dataclass(frozen=True)
class Rendering:
    """What a camera sees, without a sensor's faults; (h, w) of the window.

    depth_m: (h, w) float32, metres along z, 0 where nothing is hit.
    label: (h, w) int32 instance, 0 background.
    solid, face: (h, w) int32 indices into RayScene.solids and the faces of its mesh, or NOTHING.
    normal: (h, w, 3) float32 normal of the face, world frame, not normalised.
    """

    depth_m: np.ndarray
    label: np.ndarray
    solid: np.ndarray
    face: np.ndarray
    normal: np.ndarray


class DepthCamera:
    """Pinhole depth camera; pixel (u, v) looks along ((u - cx) / fx, (v - cy) / fy, 1), optical frame."""

    def __init__(self, intrinsics: Intrinsics) -> None:
        """Raises ParamError for an image without pixels or a focal length that is not positive."""
        if min(intrinsics.width, intrinsics.height, intrinsics.fx, intrinsics.fy) <= 0:
            raise ParamError(f"image size and focal lengths must be positive, got {intrinsics}")
        self.intrinsics = intrinsics
        self._x = (np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx
        self._y = (np.arange(intrinsics.height) - intrinsics.cy) / intrinsics.fy

    def render(self, scene: RayScene, T_world_camera: Array, window: Window | None = None) -> Rendering:
        """The scene from one pose.

        Args:
            T_world_camera: (4, 4), p_world = T_world_camera @ p_camera, optical frame.
            window: (u0, v0, u1, v1) half-open pixel box to render alone, or None for the whole image.
        Raises:
            ParamError: the window is empty or leaves the image.
        """
        directions = self.rays(window, T_world_camera[:3, :3])
        shape = directions.shape[:2]
        hits = scene.cast(T_world_camera[:3, 3], directions.reshape(-1, 3))
        solid = hits["geomID"].reshape(shape)
        depth_m = hits["tfar"].reshape(shape)  # rays have z = 1 in the camera frame: ray length is z-depth
        depth_m[solid == NOTHING] = 0.0
        label = scene.labels_of(solid)
        return Rendering(depth_m, label, solid, hits["primID"].reshape(shape), hits["Ng"].reshape(*shape, 3))

    def rays(self, window: Window | None = None, R_target_camera: Array = IDENTITY) -> np.ndarray:
        """(h, w, 3) float32 viewing rays of unit z-depth, optical frame or turned; a point is ray * depth_m.

        Raises:
            ParamError: the window is empty or leaves the image.
        """
        width, height = self.intrinsics.width, self.intrinsics.height
        u0, v0, u1, v1 = window or (0, 0, width, height)
        if not (0 <= u0 < u1 <= width and 0 <= v0 < v1 <= height):
            raise ParamError(f"window {window} is no box inside {width} x {height}")
        by_column, by_row = self._ray_parts(R_target_camera)
        return by_column[None, u0:u1] + by_row[v0:v1, None]

    def back_project(self, pixels: np.ndarray, depth_m: np.ndarray, T_target_camera: Array) -> np.ndarray:
        """(n, 3) float32 points, target frame, of pixels (n,), flat image indices, at depths (n,)."""
        by_column, by_row = self._ray_parts(T_target_camera[:3, :3])
        v, u = np.divmod(pixels, self.intrinsics.width)
        rays = by_column.take(u, axis=0) + by_row.take(v, axis=0)
        return rays * depth_m[:, None] + T_target_camera[:3, 3].astype(np.float32)

    def _ray_parts(self, R_target_camera: Array) -> tuple[np.ndarray, np.ndarray]:
        """(width, 3) and (height, 3) float32 whose sum is R @ (x, y, 1): spares a product per pixel."""
        by_column = self._x[:, None] * R_target_camera[:, 0]
        by_row = self._y[:, None] * R_target_camera[:, 1] + R_target_camera[:, 2]
        return by_column.astype(np.float32), by_row.astype(np.float32)

    def window_around(self, points_camera: Array, margin_px: int = 0) -> Window | None:
        """Smallest window that holds the projections of (n, 3) camera-frame points; None if out of sight.

        Points behind the camera cannot be projected; with any of them the answer is None.
        """
        if points_camera[:, 2].min() <= 0.0:
            return None
        k = self.intrinsics
        (u_min, v_min), (u_max, v_max) = self._project_bounds(points_camera)
        u0, v0 = max(int(u_min) - margin_px, 0), max(int(v_min) - margin_px, 0)
        u1, v1 = min(int(u_max) + margin_px + 2, k.width), min(int(v_max) + margin_px + 2, k.height)
        return (u0, v0, u1, v1) if u0 < u1 and v0 < v1 else None

    def silhouette_px(
        self, scene: RayScene, T_world_camera: Array, points_camera: Array, stride: int = 3
    ) -> float:
        """Pixels that the scene would cover on an image without borders.

        Args:
            points_camera: (n, 3) points that bound the scene, camera frame, all in front of the camera.
            stride: every stride-th row and column is tried.
        """
        k = self.intrinsics
        low, high = self._project_bounds(points_camera)
        x = (np.arange(np.floor(low[0]), high[0] + 1, stride) - k.cx) / k.fx
        y = (np.arange(np.floor(low[1]), high[1] + 1, stride) - k.cy) / k.fy
        rays = np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))], axis=-1).reshape(-1, 3)
        directions = (rays @ T_world_camera[:3, :3].T).astype(np.float32)
        hits = scene.cast(T_world_camera[:3, 3], directions)
        return stride**2 * float(np.sum(hits["geomID"] != NOTHING))

    def _project_bounds(self, points_camera: Array) -> tuple[Array, Array]:
        """Lowest and highest (u, v) of (n, 3) points in front of the camera; not clipped to the image."""
        k = self.intrinsics
        uv = points_camera[:, :2] / points_camera[:, 2:] * [k.fx, k.fy] + [k.cx, k.cy]
        return uv.min(axis=0), uv.max(axis=0)


def _embree_mesh(scene: EmbreeScene, solid: Solid) -> TriangleMesh:
    vertices = transform_points(solid.T_world_mesh, solid.mesh.vertices).astype(np.float32)
    return TriangleMesh(scene, vertices, np.asarray(solid.mesh.faces, dtype=np.int32))


def look_at(eye: Array, target: Array) -> Array:
    """T_world_camera (..., 4, 4) of level cameras at `eye` (..., 3) that look at `target`; world z is up."""
    z = _unit(target - eye)
    x = _unit(np.cross(z, [0.0, 0.0, 1.0]))
    T_world_camera = np.zeros((*eye.shape[:-1], 4, 4))
    T_world_camera[..., :3, :3] = np.stack([x, np.cross(z, x), z], axis=-1)
    T_world_camera[..., :3, 3] = eye
    T_world_camera[..., 3, 3] = 1.0
    return T_world_camera


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)

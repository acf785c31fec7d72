"""Pictures of meshes by ray casting: orthographic, smooth, one lamp with shadows, a plane to stand on."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import trimesh

from neuse.geometry import Array, make_transform
from neuse.simulation.camera import NOTHING, RayScene, Solid, look_at

LAMP = np.array([-0.45, -0.35, 0.82], dtype=np.float32) / np.float32(np.linalg.norm([-0.45, -0.35, 0.82]))
AMBIENT = 0.42
SHADOW = 0.55
BACKGROUND = 1.0
PLANE_COLOR = (1.0, 0.99, 0.97)
SUPERSAMPLING = 2
FAR_M = 20.0


@dataclass(frozen=True)
class ColoredMesh:
    """A mesh in the picture's frame (z up, metres) and its RGB colour in [0, 1]."""

    mesh: trimesh.Trimesh
    color: tuple[float, float, float]


class Camera(Protocol):
    """What `render` needs of a camera; directions of rays may have any length."""

    @property
    def T_world_camera(self) -> Array: ...

    @property
    def shape_px(self) -> tuple[int, int]:
        """(height, width) of the supersampled picture."""

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) float32 origins and directions, row by row, supersampled."""


@dataclass(frozen=True)
class View:
    """An orthographic camera: p_world = T_world_camera @ p_camera; it covers size_m around its axis."""

    T_world_camera: Array
    size_m: tuple[float, float]
    pixels_per_m: float

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) float32 origins and directions, row by row, supersampled."""
        width, height = self.shape_px[1], self.shape_px[0]
        x = (np.arange(width) + 0.5 - width / 2) * self.size_m[0] / width
        y = (np.arange(height) + 0.5 - height / 2) * self.size_m[1] / height
        R, t = self.T_world_camera[:3, :3], self.T_world_camera[:3, 3]
        origins = (x[:, None] * R[:, 0])[None] + (y[:, None] * R[:, 1] + t)[:, None]  # (height, width, 3)
        directions = np.broadcast_to(R[:, 2].astype(np.float32), (height * width, 3))
        return origins.astype(np.float32).reshape(-1, 3), directions

    def project(self, points: Array) -> Array:
        """(n, 2) pixels, column and row, of (n, 3) points in the finished picture."""
        in_camera = (points - self.T_world_camera[:3, 3]) @ self.T_world_camera[:3, :2]
        shape = np.array(self.shape_px[::-1]) / SUPERSAMPLING
        return (in_camera / np.array(self.size_m) + 0.5) * shape - 0.5

    @property
    def shape_px(self) -> tuple[int, int]:
        """(height, width) of the supersampled picture."""
        width, height = (max(1, round(m * self.pixels_per_m)) * SUPERSAMPLING for m in self.size_m)
        return height, width


def view_from_above(bounds: Array, margin_m: float, pixels_per_m: float) -> View:
    """Straight down on (2, 3) bounds: x to the right, y up."""
    center, size = bounds.mean(axis=0), np.ptp(bounds, axis=0)
    R_world_camera = np.diag([1.0, -1.0, -1.0])
    eye = np.array([center[0], center[1], bounds[1, 2] + FAR_M])
    size_m = (float(size[0] + 2 * margin_m), float(size[1] + 2 * margin_m))
    return View(make_transform(R_world_camera, eye), size_m, pixels_per_m)


def view_obliquely(
    points: Array, azimuth_rad: float, elevation_rad: float, margin_m: float, width_px: int
) -> View:
    """From the side and above, so that (n, 3) points fill the picture's width."""
    direction = np.array(
        [np.cos(azimuth_rad) * np.cos(elevation_rad), np.sin(azimuth_rad) * np.cos(elevation_rad), 0.0]
    )
    direction[2] = np.sin(elevation_rad)
    R_world_camera = look_at(direction, np.zeros(3))[:3, :3]
    in_view = points @ R_world_camera
    low, high = in_view.min(axis=0) - margin_m, in_view.max(axis=0) + margin_m
    eye = R_world_camera @ ((low + high) / 2) + direction * FAR_M
    size_m = (float(high[0] - low[0]), float(high[1] - low[1]))
    return View(make_transform(R_world_camera, eye), size_m, width_px / size_m[0])


def render(meshes: Sequence[ColoredMesh], view: Camera, plane_z: float | None = None) -> np.ndarray:
    """(h, w, 3) uint8 picture of meshes, on a plane at height `plane_z` if given."""
    solids = [Solid(item.mesh, np.eye(4)) for item in meshes]
    colors = [item.color for item in meshes]
    if plane_z is not None:
        solids.append(Solid(_plane(view, plane_z), np.eye(4)))
        colors.append(PLANE_COLOR)
    if not solids:
        return np.full(
            (view.shape_px[0] // SUPERSAMPLING, view.shape_px[1] // SUPERSAMPLING, 3), 255, np.uint8
        )
    origins, directions = view.rays()
    shaded = _shade(RayScene(solids), np.array(colors, dtype=np.float32), origins, directions)
    return _downsample(shaded.reshape(*view.shape_px, 3))


def _shade(scene: RayScene, colors: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n, 3) colours of rays: ambient and Lambert's law, darker where the lamp is hidden."""
    hits = scene.cast(origins, directions)
    hit = np.flatnonzero(hits["geomID"] != NOTHING)
    hits = {name: values[hit] for name, values in hits.items()}
    normals = _normals(scene, hits)
    normals *= -np.sign((normals * directions[hit]).sum(axis=1, keepdims=True))
    points = origins[hit] + directions[hit] * hits["tfar"][:, None] + normals * np.float32(1e-3)
    light = np.clip(normals @ LAMP, 0.0, 1.0) * np.where(_is_hidden(scene, points), SHADOW, 1.0)
    pixels = np.full((len(origins), 3), BACKGROUND, dtype=np.float32)
    pixels[hit] = colors[hits["geomID"]] * (AMBIENT + (1 - AMBIENT) * light)[:, None]
    return pixels


def _is_hidden(scene: RayScene, points: np.ndarray) -> np.ndarray:
    """Whether something stands between (n, 3) points and the lamp."""
    return scene.cast(points, np.broadcast_to(LAMP, points.shape))["geomID"] != NOTHING


def _normals(scene: RayScene, hits: dict[str, np.ndarray]) -> np.ndarray:
    """(n, 3) unit normals, interpolated over each face from its corners."""
    corners = np.concatenate([solid.mesh.vertex_normals[solid.mesh.faces] for solid in scene.solids])
    first_face = np.cumsum([0, *(len(solid.mesh.faces) for solid in scene.solids)])
    own = corners.astype(np.float32)[first_face[hits["geomID"]] + hits["primID"]]  # (n, 3 corners, 3)
    u, v = hits["u"][:, None], hits["v"][:, None]
    normals = (1 - u - v) * own[:, 0] + u * own[:, 1] + v * own[:, 2]
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)


def _plane(view: Camera, plane_z: float) -> trimesh.Trimesh:
    """A large quad below everything in view."""
    x, y = view.T_world_camera[:2, 3]
    far = 4 * FAR_M
    corners = [[x - far, y - far, plane_z], [x + far, y - far, plane_z]]
    corners += [[x + far, y + far, plane_z], [x - far, y + far, plane_z]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def _downsample(pixels: np.ndarray) -> np.ndarray:
    height, width, _ = pixels.shape
    blocks = pixels.reshape(height // SUPERSAMPLING, SUPERSAMPLING, width // SUPERSAMPLING, SUPERSAMPLING, 3)
    return np.rint(np.clip(blocks.mean(axis=(1, 3)), 0.0, 1.0) * 255).astype(np.uint8)

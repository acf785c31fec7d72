"""Colour pictures of renderings: Lambertian surfaces, one lamp, ambient light, and a paint for each solid."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from neuse.errors import ParamError
from neuse.geometry import Array, inverse
from neuse.simulation.camera import DepthCamera, RayScene, Rendering
from neuse.simulation.textures import Color, Texture, texture_color

# colours (n, 3) uint8 at points (n, 3) float32 of a solid's surface, in the frame of its mesh, metres
Paint = Callable[[np.ndarray], np.ndarray]

LAMP = np.array([0.35, -0.25, 0.9]) / np.linalg.norm([0.35, -0.25, 0.9])
AMBIENT = 0.45
BACKDROP = 235
TILE_PX = 512
TILE_M = 1.28


class Shader:
    """Paints what a camera sees of one scene."""

    def __init__(self, camera: DepthCamera, scene: RayScene, paints: Sequence[Paint]) -> None:
        """Raises ParamError unless there is one paint for each of scene.solids."""
        if len(paints) != len(scene.solids):
            raise ParamError(f"{len(scene.solids)} solids need as many paints, got {len(paints)}")
        self._camera, self._paints = camera, tuple(paints)
        self._T_mesh_world = inverse(np.stack([solid.T_world_mesh for solid in scene.solids]))
        lit = [_brightness(s.mesh.face_normals @ s.T_world_mesh[:3, :3].T) for s in scene.solids]
        self._first_face = np.cumsum([0, *map(len, lit)])[:-1].astype(np.int32)
        self._face_brightness = np.concatenate(lit)

    def picture(self, rendering: Rendering, T_world_camera: Array) -> np.ndarray:
        """(h, w, 3) uint8 RGB of a rendering of the whole image from T_world_camera."""
        solid, face, depth_m = (
            image.ravel() for image in (rendering.solid, rendering.face, rendering.depth_m)
        )
        color = np.full((len(solid), 3), BACKDROP, dtype=np.uint8)
        for index, pixels in _pixels_by_solid(solid):
            T_mesh_camera = self._T_mesh_world[index] @ T_world_camera
            points_mesh = self._camera.back_project(pixels, depth_m[pixels], T_mesh_camera)
            light = self._face_brightness[self._first_face[index] + face[pixels]]
            color[pixels] = (self._paints[index](points_mesh) * light[:, None]).astype(np.uint8)
        return color.reshape(*rendering.solid.shape, 3)


def textured(texture: Texture) -> Paint:
    """Paint of an object."""
    return partial(texture_color, texture)


def tiled(tile: np.ndarray) -> Paint:
    """Paint that repeats a picture, (TILE_PX, TILE_PX, 3) uint8 over TILE_M x TILE_M, in the xy plane."""
    flat_tile = tile.reshape(-1, 3)

    def paint(points: np.ndarray) -> np.ndarray:
        column, row = (points[:, :2] * np.float32(TILE_PX / TILE_M)).astype(np.int32).T & (TILE_PX - 1)
        return flat_tile.take(row * TILE_PX + column, axis=0)

    return paint


def checker(color_a: Color, color_b: Color, side_m: float = TILE_M / 4) -> Paint:
    """Squares of two colours."""
    cell = np.arange(TILE_PX) * TILE_M // (TILE_PX * side_m)
    return tiled(np.array([color_a, color_b], dtype=np.uint8)[(cell[:, None] + cell).astype(int) % 2])


def wood(color: Color, planks: int = 10, seed: int = 0) -> Paint:
    """Planks along x, each with its own tone and grain."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:TILE_PX, :TILE_PX] / TILE_PX
    plank = (y * planks).astype(int)
    waviness, tone = rng.uniform(0.0, 2 * np.pi, planks)[plank], rng.uniform(0.8, 1.0, planks)[plank]
    grain = np.sin(2 * np.pi * 40 * y + 3.0 * np.sin(2 * np.pi * x + waviness))
    return tiled(((tone * (0.94 + 0.06 * grain))[..., None] * np.array(color)).astype(np.uint8))


def _pixels_by_solid(solid: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """(solid, flat indices of its pixels) of a flat image of solids, NOTHING left out."""
    order = np.argsort(solid.astype(np.int16), kind="stable")  # a radix sort
    firsts = np.searchsorted(solid[order], np.arange(solid.max() + 2))
    for index, (first, last) in enumerate(pairwise(firsts)):
        if first < last:
            yield index, order[first:last]


def _brightness(normals_world: Array) -> np.ndarray:
    """(n,) float32 in [AMBIENT, 1] for unit normals (n, 3), by the cosine law."""
    return (AMBIENT + (1.0 - AMBIENT) * np.maximum(normals_world @ LAMP, 0.0)).astype(np.float32)

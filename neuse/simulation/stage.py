"""One arrangement of objects, made ready to be seen: what does not change between two scene changes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from neuse.geometry import Array
from neuse.simulation.camera import DepthCamera, RayScene, Solid
from neuse.simulation.scene import Table, TrueObject
from neuse.simulation.shading import Shader, checker, textured, wood

FLOOR_M = 40.0
FLOOR_PAINT = checker((143, 146, 150), (151, 154, 158))
WOODS = ((193, 154, 107), (166, 123, 80), (205, 178, 135), (140, 100, 72))
TABLE_PAINTS = tuple(wood(color, seed=seed) for seed, color in enumerate(WOODS))


@dataclass(frozen=True)
class View:
    """A picture without faults.

    depth_m: (h, w) float32, metres along z, 0 = nothing.    color: (h, w, 3) uint8 RGB.
    slot: (h, w) int32, 0 = background, i + 1 = Stage.objects[i].    visible_px: pixels by object_id, if any.
    """

    depth_m: np.ndarray
    slot: np.ndarray
    color: np.ndarray
    visible_px: dict[int, int]


class Stage:
    """A floor, tables and objects; several threads may look at one stage."""

    def __init__(self, camera: DepthCamera, tables: Sequence[Table], objects: Sequence[TrueObject]) -> None:
        self.objects = tuple(objects)
        self._camera = camera
        solids = [Solid(_floor(), np.eye(4)), *(Solid(table.mesh(), table.T_world_table) for table in tables)]
        solids += [Solid(o.shape.mesh, o.T_world_object, slot + 1) for slot, o in enumerate(objects)]
        paints = [FLOOR_PAINT, *(TABLE_PAINTS[i % len(TABLE_PAINTS)] for i in range(len(tables)))]
        paints += [textured(true_object.shape.texture) for true_object in objects]
        self._scene = RayScene(solids)
        self._shader = Shader(camera, self._scene, paints)

    def view(self, T_world_camera: Array) -> View:
        """What the camera sees from a pose."""
        rendering = self._camera.render(self._scene, T_world_camera)
        color = self._shader.picture(rendering, T_world_camera)
        pixels = np.bincount(rendering.label.ravel(), minlength=len(self.objects) + 1)[1:]
        visible_px = {o.object_id: int(px) for o, px in zip(self.objects, pixels, strict=True) if px > 0}
        return View(rendering.depth_m, rendering.label, color, visible_px)


def _floor() -> trimesh.Trimesh:
    half = FLOOR_M / 2
    corners = [[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)

"""Layouts: a shape at rest among clutter, in a room (NeuSE III-D, data generation)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from neuse.geometry import Array, make_transform, transform_points
from neuse.simulation.camera import RayScene, Solid
from neuse.simulation.shapes import Shape


@dataclass(frozen=True)
class Layout:
    """A principal shape (label 1) among clutter in a room; on a table at z = 0 of the world or in the air."""

    shape: Shape
    T_world_object: Array
    on_table: bool
    clutter_azimuths: tuple[float, ...]
    scene: RayScene
    alone: RayScene


def draw_layout(
    shape: Shape, others: Sequence[Shape], rng: np.random.Generator, clutter: tuple[int, int]
) -> Layout:
    """The shape and so many others, each upright, lying or (the shape alone, at times) in any pose."""
    T_world_object = rest(shape, rng, anyhow=0.2)
    solids = [Solid(shape.mesh, T_world_object, 1)]
    reach = reach_m(shape, T_world_object)
    azimuths = []
    for label in range(2, 2 + rng.integers(clutter[0], clutter[1] + 1)):
        other = others[int(rng.integers(len(others)))]
        T_world_other = rest(other, rng, anyhow=0.0)
        distance = reach + reach_m(other, T_world_other) + rng.uniform(0.003, 0.08)
        azimuths.append(float(rng.uniform(0, 2 * np.pi)))
        T_world_other[:2, 3] = distance * np.array([np.cos(azimuths[-1]), np.sin(azimuths[-1])])
        solids.append(Solid(other.mesh, T_world_other, label))
    on_table = bool(rng.random() < 0.6)
    scene = RayScene([*solids, *room(rng, on_table)])
    return Layout(shape, T_world_object, on_table, tuple(azimuths), scene, RayScene(solids[:1]))


def rest(shape: Shape, rng: np.random.Generator, anyhow: float) -> Array:
    """T_world_object with the axis of the object through the origin and its lowest point on z = 0."""
    choice = rng.random()
    if choice < anyhow:
        R = Rotation.random(random_state=rng)
    else:
        tilt = 90.0 if choice > 0.65 else 0.0
        R = Rotation.from_euler("zxz", [rng.uniform(0, 360), tilt, rng.uniform(0, 360)], degrees=True)
    T = make_transform(R.as_matrix(), np.zeros(3))
    T[2, 3] = -transform_points(T, shape.mesh.vertices)[:, 2].min()
    return T


def reach_m(shape: Shape, T_world_object: Array) -> float:
    """Radius about the world's z axis of a shape at its place."""
    return float(np.linalg.norm((shape.mesh.vertices @ T_world_object[:3, :3].T)[:, :2], axis=1).max())


def room(rng: np.random.Generator, on_table: bool) -> list[Solid]:
    """Floor and walls, and perhaps a table top: what flying pixels and swollen masks catch."""
    top = trimesh.creation.box([rng.uniform(0.5, 1.5), rng.uniform(0.5, 1.5), 0.03])
    walls = trimesh.creation.box([rng.uniform(3, 12), rng.uniform(3, 12), 3.0])
    walls.invert()
    shift = rng.uniform(-0.15, 0.15, 2)
    room = [Solid(walls, make_transform(np.eye(3), [0, 0, 0.75]))]
    return [*room, Solid(top, make_transform(np.eye(3), [*shift, -0.0151]))] if on_table else room

"""Worlds to run the system on: a preset and a seed give a layout, a layout gives frames with exact truth."""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from zlib import crc32

import numpy as np

from neuse.errors import MeshError, ParamError
from neuse.geometry import Array
from neuse.records import Instance, Intrinsics, ObjectChange, OdometrySample, RgbdFrame
from neuse.simulation.camera import DepthCamera
from neuse.simulation.changes import change_scene
from neuse.simulation.layout import Decorator, Sight
from neuse.simulation.mesh_files import PATTERN, mesh_paths
from neuse.simulation.meshes import load_meshes
from neuse.simulation.odometry import drifting_odometry
from neuse.simulation.population import Item, population
from neuse.simulation.presets import PRESETS, WorldPreset
from neuse.simulation.scene import SceneChange, Table, Timeline, TrueObject
from neuse.simulation.sensor import apply_faults
from neuse.simulation.shapes import Shape
from neuse.simulation.stage import Stage
from neuse.simulation.trajectory import Trajectory, Waypoint, closed_trajectory

__all__ = ["PRESETS", "SimulatedFrame", "TrueObject", "World", "make_world", "simulate"]

FIRST_STAMP_NS = 1_000_000_000
FRAME_NS = 100_000_000
WORKERS = 2
SCORES = (0.8, 1.0)
MAX_DRAWS = 4  # of a layout, before a preset is called too full


@dataclass(frozen=True)
class World:
    """A layout: everything that is decided before the first frame is rendered.

    T_odom_camera: (n, 4, 4) drifting odometry, the first is the identity.
    """

    preset: WorldPreset
    seed: int
    tables: tuple[Table, ...]
    trajectory: Trajectory
    timeline: Timeline
    T_odom_camera: Array

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.T_odom_camera)

    @property
    def intrinsics(self) -> Intrinsics:
        """The camera."""
        return self.preset.intrinsics


@dataclass(frozen=True)
class SimulatedFrame:
    """What the sensors give at one time, and the truth about it.

    T_world_camera: p_world = T_world_camera @ p_camera.    objects: all that are in the world.
    visible_px: pixels of each visible object by object_id, before faults.    traversal: 0 for the first.
    changes: those that took effect just before this frame; their T_map_... are in the world frame.
    """

    frame: RgbdFrame
    T_world_camera: Array
    odometry: OdometrySample
    objects: tuple[TrueObject, ...]
    visible_px: dict[int, int]
    changes: tuple[ObjectChange, ...]
    traversal: int


def make_world(preset: str | WorldPreset, seed: int, meshes: Path | None = None) -> World:
    """The layout that a preset and a seed determine.

    Args:
        preset: a name in PRESETS, or one's own.
        meshes: DIR/<category>/*.obj, ply, stl or glb, which replace the procedural shapes; categories that
            the preset does not have join in.
    Raises:
        ParamError: an unknown preset, one whose objects or changes find no room in any of MAX_DRAWS layouts,
            or a negative seed.
        MeshError: a mesh in the folder cannot be used.
    """
    preset = _preset(preset)
    if seed < 0:
        raise ParamError(f"seed {seed} is negative; choose 0 or more")
    own = _own_shapes(meshes, preset.categories) if meshes else {}
    preset = replace(preset, categories=tuple(own) or preset.categories)
    for attempt in range(MAX_DRAWS - 1):
        with suppress(ParamError):  # objects or changes found no room
            return _draw_world(preset, seed, attempt, own)
    return _draw_world(preset, seed, MAX_DRAWS - 1, own)


def _draw_world(preset: WorldPreset, seed: int, attempt: int, own: dict[str, list[Shape]]) -> World:
    rng = np.random.default_rng([seed, crc32(preset.name.encode()), *[attempt] * (attempt > 0)])
    tables = tuple(_jittered_table(table, preset.jitter_m, rng) for table in preset.tables)
    routes = [[_jittered_waypoint(w, preset.jitter_m, rng) for w in route] for route in preset.routes]
    trajectory = closed_trajectory(routes, preset.frames)
    decorator = Decorator(tables, Sight(trajectory, preset.intrinsics), preset.approach_m, rng)
    items = population(preset.categories, preset.objects, preset.twins, preset.lying_share, own, rng)
    initial = _initial_objects(items, preset, decorator)
    timeline = change_scene(initial, preset.changes, items, decorator)
    T_odom_camera = drifting_odometry(trajectory.T_world_camera, preset.odometry, rng)
    return World(preset, seed, tables, trajectory, timeline, T_odom_camera)


def simulate(world: World, start: int = 0, stop: int | None = None) -> Iterator[SimulatedFrame]:
    """Frames start <= index < stop, in order; the same whatever the range and the number of threads.

    Raises:
        ParamError: the range is not inside the world's.
    """
    stop = world.frames if stop is None else stop
    if not 0 <= start <= stop <= world.frames:
        raise ParamError(f"frames {start} to {stop} are not inside 0 to {world.frames}")
    return _captures(world, range(start, stop))


def _captures(world: World, indices: range) -> Iterator[SimulatedFrame]:
    camera = DepthCamera(world.intrinsics)
    stage = None
    with ThreadPoolExecutor(WORKERS) as pool:
        pending: deque[Future[SimulatedFrame]] = deque()
        for index in indices:
            if stage is None or world.timeline.changes_at(index):
                stage = Stage(camera, world.tables, world.timeline.objects_at(index))
            pending.append(pool.submit(_capture, world, stage, index))
            if len(pending) > 2 * WORKERS:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()


def _capture(world: World, stage: Stage, index: int) -> SimulatedFrame:
    """One frame; depends on nothing but its arguments."""
    rng = np.random.default_rng([world.seed, index])
    stamp_ns = FIRST_STAMP_NS + index * FRAME_NS
    T_world_camera = world.trajectory.T_world_camera[index]
    view = stage.view(T_world_camera)
    label_of_slot = rng.permutation(len(stage.objects)) + 1  # a segmenter's labels say nothing of identity
    label = np.concatenate([[0], label_of_slot])[view.slot]
    depth_m, mask = apply_faults(view.depth_m, label, world.preset.faults, rng)
    instances = _instances(mask, {int(label_of_slot[i]): o for i, o in enumerate(stage.objects)}, rng)
    return SimulatedFrame(
        frame=RgbdFrame(
            stamp_ns,
            depth_m,
            mask.astype(np.min_scalar_type(len(stage.objects))),
            instances,
            world.intrinsics,
            view.color,
        ),
        T_world_camera=T_world_camera,
        odometry=OdometrySample(stamp_ns, world.T_odom_camera[index]),
        objects=stage.objects,
        visible_px=view.visible_px,
        changes=tuple(_object_change(change, stamp_ns) for change in world.timeline.changes_at(index)),
        traversal=int(world.trajectory.traversal[index]),
    )


def _instances(
    mask: np.ndarray, objects: dict[int, TrueObject], rng: np.random.Generator
) -> tuple[Instance, ...]:
    """Entries of the labels that the segmenter's mask holds, with a detector's scores."""
    labels = [int(label) for label in np.flatnonzero(np.bincount(mask.ravel())) if label > 0]
    scores = rng.uniform(*SCORES, len(labels))
    return tuple(
        Instance(label, objects[label].shape.category, round(float(score), 3))
        for label, score in zip(labels, scores, strict=True)
    )


def _object_change(change: SceneChange, stamp_ns: int) -> ObjectChange:
    return ObjectChange(
        stamp_ns=stamp_ns,
        kind=change.kind,
        object_id=change.subject.object_id,
        category=change.subject.shape.category,
        T_map_before=change.before.T_world_object if change.before else None,
        T_map_after=change.after.T_world_object if change.after else None,
    )


def _preset(preset: str | WorldPreset) -> WorldPreset:
    if isinstance(preset, WorldPreset):
        return preset
    if preset not in PRESETS:
        raise ParamError(f"unknown preset {preset!r}; known: {', '.join(PRESETS)}")
    return PRESETS[preset]


def _own_shapes(meshes: Path, known: Sequence[str]) -> dict[str, list[Shape]]:
    """By category, the known ones first; empty where there are procedural shapes alone."""
    folders = sorted(path.name for path in meshes.iterdir() if path.is_dir()) if meshes.is_dir() else []
    found = [name for name in folders if mesh_paths(meshes / name)]
    own = {category: load_meshes(meshes, category) for category in dict.fromkeys([*known, *found])}
    if not any(own.values()):
        raise MeshError(f"no meshes below {meshes}; expected {meshes}/<category>/{PATTERN}")
    return own


def _initial_objects(
    items: Iterator[Item], preset: WorldPreset, decorator: Decorator
) -> tuple[TrueObject, ...]:
    """The first objects: each table gets one of each category in turn."""
    objects: list[TrueObject] = []
    for object_id, (shape, kind) in enumerate(islice(items, preset.objects)):
        table = decorator.tables[object_id // len(preset.categories) % len(decorator.tables)]
        objects.append(TrueObject(object_id, shape, decorator.find_place(shape, kind, [table], objects)))
    return tuple(objects)


def _jittered_table(table: Table, jitter_m: float, rng: np.random.Generator) -> Table:
    x, y = np.asarray(table.center) + rng.uniform(-jitter_m, jitter_m, 2)
    return replace(
        table, center=(float(x), float(y)), yaw_rad=table.yaw_rad + rng.uniform(-jitter_m, jitter_m)
    )


def _jittered_waypoint(waypoint: Waypoint, jitter_m: float, rng: np.random.Generator) -> Waypoint:
    moves = rng.uniform(-jitter_m, jitter_m, (2, 3))
    return Waypoint(waypoint.position + moves[0], waypoint.target + moves[1])

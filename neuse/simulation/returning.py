"""Other cameras in a world: one that comes back when things have moved or gone, one at the same time."""

from collections.abc import Sequence
from dataclasses import replace
from zlib import crc32

import numpy as np
from scipy.spatial.transform import Rotation

from neuse.errors import ParamError
from neuse.geometry import Array
from neuse.simulation.camera import DepthCamera
from neuse.simulation.changes import MIN_MOVE_M
from neuse.simulation.layout import Decorator, Sight
from neuse.simulation.odometry import drifting_odometry
from neuse.simulation.presets import Route
from neuse.simulation.scene import Timeline, TrueObject
from neuse.simulation.stage import Stage
from neuse.simulation.trajectory import Trajectory, Waypoint, closed_trajectory
from neuse.simulation.worlds import World

CHANGED_SHARE = 1 / 3
MIN_KNOWN = 3  # unchanged objects that the first frame shows
SEEN_PX, SEEN_M = 1000, 2.0  # an object that is shown
MAX_DRAWS = 50
JITTER_M = 0.15
MAX_TURN_RAD = 0.6  # by which the camera looks at things from another side than before


def come_back(
    world: World, seed: int, frames: int = 100, share: float = CHANGED_SHARE, n_known: int = MIN_KNOWN
) -> World:
    """The world as it is later, for a camera that starts at a random pose and moves on at the same pace.

    Half of the changed objects stand elsewhere, the others are gone; nothing changes while the camera is
    there. Its first frame shows at least `n_known` objects that have not changed.

    Raises:
        ParamError: there is no such start, or no room for an object that moves.
    """
    rng = np.random.default_rng([world.seed, seed, crc32(b"come back")])
    before = world.timeline.objects_at(world.frames - 1)
    changed = {before[i].object_id for i in rng.permutation(len(before))[: round(share * len(before))]}
    objects = _changed(world, before, changed, rng)
    stage = Stage(DepthCamera(world.intrinsics), world.tables, objects)
    for _ in range(MAX_DRAWS):
        trajectory = _path(world, frames, rng)
        if _n_shown(stage, trajectory.T_world_camera[0], changed) >= n_known:
            T_odom_camera = drifting_odometry(trajectory.T_world_camera, world.preset.odometry, rng)
            return replace(
                world,
                seed=1000 * (seed + 1) + world.seed,
                trajectory=trajectory,
                timeline=Timeline(objects),
                T_odom_camera=T_odom_camera,
            )
    raise ParamError(f"no start on {world.preset.name} shows {n_known} objects that stay; change fewer")


def fellow(world: World, index: int) -> World:
    """The same world at the same time for another camera (1, 2, ...) with a way and odometry of its own."""
    rng = np.random.default_rng([world.seed, index, crc32(b"fellow")])
    trajectory = _path(world, world.frames, rng)
    T_odom_camera = drifting_odometry(trajectory.T_world_camera, world.preset.odometry, rng)
    seed = world.seed + 1_000_000 * index
    return replace(world, seed=seed, trajectory=trajectory, T_odom_camera=T_odom_camera)


def _changed(
    world: World, before: Sequence[TrueObject], changed: set[int], rng: np.random.Generator
) -> tuple[TrueObject, ...]:
    """The objects after every second one of `changed` has moved and the others have been taken away."""
    sight = Sight(world.trajectory, world.intrinsics)
    decorator = Decorator(world.tables, sight, world.preset.approach_m, rng)
    after = {true_object.object_id: true_object for true_object in before}
    for i, object_id in enumerate(sorted(changed)):
        gone = after.pop(object_id)
        if i % 2:
            after[object_id] = _moved(gone, list(after.values()), decorator)
    return tuple(after[object_id] for object_id in sorted(after))


def _moved(moved: TrueObject, others: Sequence[TrueObject], decorator: Decorator) -> TrueObject:
    def suits(T_world_object: Array) -> bool:
        return bool(np.linalg.norm(T_world_object[:3, 3] - moved.position) >= MIN_MOVE_M)

    kind = "upright" if moved.T_world_object[2, 2] > 0.9 else "lying"
    T_world_object = decorator.find_place(moved.shape, kind, decorator.tables, others, suits)
    return replace(moved, T_world_object=T_world_object)


def _path(world: World, frames: int, rng: np.random.Generator) -> Trajectory:
    """A piece of one of the preset's routes, either way round, seen from other sides than before."""
    route = world.preset.routes[int(rng.integers(len(world.preset.routes)))]
    turn_rad = rng.uniform(-MAX_TURN_RAD, MAX_TURN_RAD)
    waypoints = [_jittered(waypoint, turn_rad, rng) for waypoint in route][:: rng.choice([-1, 1])]
    loop = closed_trajectory([waypoints], _frames_for(waypoints, world)).T_world_camera
    start = int(rng.integers(len(loop)))
    T_world_camera = loop[(start + np.arange(frames)) % len(loop)]
    return Trajectory(T_world_camera, np.zeros(frames, dtype=np.intp))


def _frames_for(waypoints: Route | list[Waypoint], world: World) -> int:
    """How many frames a loop takes at the pace of the world's own trajectory."""
    pace_m = world.trajectory.length_m / world.frames
    return max(2, round(closed_trajectory([waypoints], 200).length_m / pace_m))


def _jittered(waypoint: Waypoint, turn_rad: float, rng: np.random.Generator) -> Waypoint:
    turn = Rotation.from_rotvec([0.0, 0.0, turn_rad]).as_matrix()
    position = waypoint.target + turn @ (waypoint.position - waypoint.target)
    moves = rng.uniform(-JITTER_M, JITTER_M, (2, 3))
    return Waypoint(position + moves[0], waypoint.target + moves[1])


def _n_shown(stage: Stage, T_world_camera: Array, changed: set[int]) -> int:
    """How many unchanged objects a camera sees near and large."""
    visible_px = stage.view(T_world_camera).visible_px
    return sum(
        true_object.object_id not in changed
        and visible_px.get(true_object.object_id, 0) >= SEEN_PX
        and bool(np.linalg.norm(true_object.position - T_world_camera[:3, 3]) <= SEEN_M)
        for true_object in stage.objects
    )

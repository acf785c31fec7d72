"""Small worlds for the mapper's tests: cylinders on tables, analytic depth, a tracker that knows the truth.

The tracker keeps to the contract of the real one: an object is TENTATIVE or UNMATCHED twice before it is NEW,
an id never moves, and an object met at a new place becomes a new id. What fails is for the tests to choose.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from neuse import geometry
from neuse.embedding.code import Code, landmark_template
from neuse.geometry import Array, inverse, make_transform, transform_points
from neuse.mapping.mapper import ObjectMapper
from neuse.records import (
    NO_ID,
    ChangeKind,
    Intrinsics,
    Keyframe,
    MatchStatus,
    ObjectChange,
    ObjectStatus,
    Observation,
    TrackedFrame,
    TrackedObservation,
)

K = 32
CAMERA = Intrinsics(640, 480, 520.0, 520.0, 319.5, 239.5)
COARSE = (60, 80)
TABLE_HEIGHT_M = 0.7
FRAME_NS = 100_000_000
BLIND_FRAMES = 5


@dataclass(frozen=True)
class Thing:
    """A solid cylinder, z along its axis. T_world_object: its pose, origin at mid height."""

    name: str
    radius_m: float
    height_m: float
    T_world_object: Array
    category: str = "bottle"
    shape_seed: int = 0

    @property
    def ambiguous(self) -> bool:
        """Bottles have no handle."""
        return self.category == "bottle"

    @property
    def descriptor(self) -> Array:
        """(k,) unit; like 0.97 or more for one shape, under 0.6 for others."""
        raw = np.random.default_rng(self.shape_seed).normal(size=K)
        return raw / np.linalg.norm(raw)

    def at(self, x: float, y: float) -> "Thing":
        """The same thing elsewhere on the tables."""
        T = self.T_world_object.copy()
        T[:2, 3] = x, y
        return replace(self, T_world_object=T)


def standing(
    name: str, x: float, y: float, radius_m: float = 0.04, height_m: float = 0.1, seed: int | None = None,
    category: str = "bottle",
) -> Thing:  # fmt: skip
    """A thing that stands on the table; its shape is named by the seed, or by its own name."""
    seed = sum(ord(c) * 31**i for i, c in enumerate(name)) if seed is None else seed
    T = make_transform(np.eye(3), [x, y, TABLE_HEIGHT_M + height_m / 2])
    return Thing(name, radius_m, height_m, T, category, seed)


def make_code(thing: Thing, T_camera_object: Array, rng: np.random.Generator, noise_m: float = 0.004) -> Code:
    """The code of an ideal encoder, its centre and tips off by `noise_m`."""
    extents = np.diag(
        [thing.radius_m * (1.0 if thing.ambiguous else 1.6), thing.radius_m, thing.height_m / 2]
    )
    axes = T_camera_object[:3, :3] @ extents + rng.normal(scale=noise_m, size=(3, 3))
    if thing.ambiguous:
        axes[:, :2] = 0.0
    center = T_camera_object[:3, 3] + rng.normal(scale=noise_m, size=3)
    landmarks = center + landmark_template(K) @ axes.T
    z = np.concatenate([landmarks, np.broadcast_to(center, (K - K // 2, 3))])
    descriptor = thing.descriptor + rng.normal(scale=0.01, size=K)
    sigmas = np.array([0.05, 0.05, np.pi if thing.ambiguous else 0.1, 0.004, 0.004, 0.004])
    return Code(thing.category, thing.ambiguous, z, descriptor / np.linalg.norm(descriptor), sigmas)


def decode(code: Code) -> trimesh.Trimesh:
    """The box around a thing: half sides are the lengths of the code's axes (0.04 m across for bottles)."""
    half = np.maximum(np.linalg.norm(code.axes, axis=0), 0.04 if code.ambiguous else 0.001)
    return trimesh.creation.box(extents=2 * half, transform=code.T_frame_object)


RECONSTRUCT = {"bottle": decode, "mug": decode}


def ray_depths(things: Sequence[Thing], tables: Sequence[Array], T_world_camera: Array, rays: Array) -> Array:
    """(1 + t, n) depth along z at which rays (n, 3), z = 1, hit the tables and ground [0] or a thing [1:]."""
    directions = rays @ T_world_camera[:3, :3].T
    origin = T_world_camera[:3, 3]
    depths = [_planes(origin, directions, tables)]
    depths += [_cylinder(thing, origin, directions) for thing in things]
    return np.stack(depths)


def _planes(origin: Array, directions: Array, tables: Sequence[Array]) -> Array:
    """Ground at z = 0 and square tables, each (x, y, half side)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = -origin[2] / directions[:, 2]
        best = np.where(ground > 0, ground, np.inf)
        t = (TABLE_HEIGHT_M - origin[2]) / directions[:, 2]
    for x, y, half in tables:
        hit = origin[:2] + t[:, None] * directions[:, :2]
        on_top = (t > 0) & (np.abs(hit - [x, y]) <= half).all(axis=1)
        best = np.where(on_top, np.minimum(best, t), best)
    return best


def _cylinder(thing: Thing, origin: Array, directions: Array) -> Array:
    """Entry of rays into a capped cylinder: the overlap of a slab and an infinite cylinder."""
    T_object_world = inverse(thing.T_world_object)
    o, d = transform_points(T_object_world, origin), directions @ T_object_world[:3, :3].T
    a, b = (d[:, :2] ** 2).sum(axis=1), d[:, :2] @ o[:2]
    c = o[:2] @ o[:2] - thing.radius_m**2
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b**2 - a * c)
        slab = np.stack([(-thing.height_m / 2 - o[2]) / d[:, 2], (thing.height_m / 2 - o[2]) / d[:, 2]])
        enter = np.fmax((-b - root) / a, slab.min(axis=0))
        leave = np.fmin((-b + root) / a, slab.max(axis=0))
    hit = ~np.isnan(root) & (enter <= leave) & (enter > 0)
    return np.where(hit, enter, np.inf)


def look_at(eye: Sequence[float], target: Sequence[float]) -> Array:
    """T_world_camera of a level camera (x right, y down, z forward)."""
    z = np.asarray(target, dtype=float) - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return make_transform(np.stack([x, np.cross(z, x), z], axis=1), eye)


def orbit(
    x: float = 0.0, y: float = 0.0, radius_m: float = 1.1, count: int = 24, start_rad: float = 0.0,
    turn_rad: float = 2 * np.pi,
) -> list[Array]:  # fmt: skip
    """Camera poses around a table."""
    angles = start_rad + turn_rad * np.arange(count) / count
    eyes = [(x + radius_m * np.cos(a), y + radius_m * np.sin(a), TABLE_HEIGHT_M + 0.6) for a in angles]
    return [look_at(eye, (x, y, TABLE_HEIGHT_M + 0.05)) for eye in eyes]


Mishap = Callable[[int, str], bool]


@dataclass
class World:
    """Runs a mapper over camera poses. Map and world frames are equal but for the noise of the poses.

    is_missed(frame, name): the detector overlooks a thing.    is_unmatched: association overlooks it.
    drift(frame): (6,) error of the pose estimate; it changes blind.
    obeys: the tracker applies the changes it is told.
    """

    mapper: ObjectMapper
    things: list[Thing]
    tables: Sequence[Sequence[float]] = ((0.0, 0.0, 0.6),)
    seed: int = 0
    pose_noise_m: float = 0.01
    is_missed: Mishap = lambda frame, name: False
    is_unmatched: Mishap = lambda frame, name: False
    drift: Callable[[int], Array] = lambda frame: np.zeros(6)
    obeys: bool = True
    shuffles: int | None = None
    changes: list[ObjectChange] = field(default_factory=list)
    ids: dict[str, int] = field(default_factory=dict)
    frames: int = 0
    waited_ns: int = 0
    _places: dict[str, Array] = field(default_factory=dict)
    _sightings: dict[str, int] = field(default_factory=dict)
    _next_id: int = 0
    _keyframes: list[Keyframe] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._shapes: dict[int, Array] = {}

    def thing(self, name: str) -> Thing:
        """The thing of this name."""
        return next(thing for thing in self.things if thing.name == name)

    def add(self, thing: Thing) -> None:
        """Put a thing into the world."""
        self.things.append(thing)

    def remove(self, name: str) -> None:
        """Take a thing away."""
        self.things.remove(self.thing(name))

    def move(self, name: str, x: float, y: float) -> None:
        """Put a thing elsewhere."""
        self.things[self.things.index(self.thing(name))] = self.thing(name).at(x, y)

    def tour(self, poses: Iterable[Array]) -> None:
        """Let the camera see the world from these poses."""
        for T_world_camera in poses:
            self.step(T_world_camera)

    def wait(self, seconds: float) -> None:
        """Let time pass in which the camera sees nothing."""
        self.waited_ns += int(seconds * 1e9)

    def finish(self) -> list[ObjectChange]:
        """Ask for what the mapper still holds back; all changes."""
        self._take(self.mapper.finalize())
        return self.changes

    def close_loop(self, T_world_camera: Array) -> None:
        """A frame that says that the keyframes have moved, with all of them."""
        frame = replace(self.frame(T_world_camera), loop_closed=True)
        self._take(self.mapper.step(frame, self._keyframes))

    def step(self, T_world_camera: Array) -> None:
        """One frame, which is a keyframe; before it, if the pose drifts, half a second that shows nothing."""
        if self.frames and (self.drift(self.frames) != self.drift(self.frames - 1)).any():
            for i in range(BLIND_FRAMES):
                self._take(self.mapper.step(self._blind_frame(i)))
        self._take(self.mapper.step(self.frame(T_world_camera), self._keyframes[-10:]))

    def correct(self, T_map_camera: Sequence[Array]) -> None:
        """A loop closure: from the next frame on, the keyframes have these poses."""
        self._keyframes = [
            replace(keyframe, T_map_camera=T)
            for keyframe, T in zip(self._keyframes, T_map_camera, strict=True)
        ]

    def frame(self, T_world_camera: Array) -> TrackedFrame:
        """What the tracker makes of the world as seen from a pose."""
        coarse = np.min(ray_depths(self.things, self.tables, T_world_camera, _grid(*COARSE)), axis=0)
        depth = np.where(np.isfinite(coarse) & (coarse < 6.0), coarse, 0.0)
        depth = depth + 0.002 * depth**2 * self._rng.normal(size=depth.shape)
        observations = [t for thing in self.things if (t := self._track(thing, T_world_camera)) is not None]
        if self.shuffles is not None:
            np.random.default_rng((self.shuffles, self.frames)).shuffle(observations)  # type: ignore[arg-type]
        wobble = np.concatenate([self._rng.normal(scale=0.003, size=3), self._rng.normal(scale=1, size=3)])
        wobble[3:] *= self.pose_noise_m / np.sqrt(3)
        T_map_camera = T_world_camera @ geometry.exp(wobble + self.drift(self.frames))
        stamp_ns = self.waited_ns + self.frames * FRAME_NS
        self._keyframes.append(Keyframe(self.frames, stamp_ns, T_map_camera))
        self.frames += 1
        return TrackedFrame(
            stamp_ns, T_map_camera, np.eye(6) * 1e-4, tuple(observations), CAMERA,
            depth.reshape(COARSE).astype(np.float32), self.frames - 1,
        )  # fmt: skip

    def _blind_frame(self, i: int) -> TrackedFrame:
        stamp_ns = (
            self.waited_ns + self.frames * FRAME_NS - (BLIND_FRAMES - i) * FRAME_NS // (BLIND_FRAMES + 1)
        )
        T_map_camera, nothing = self._keyframes[-1].T_map_camera, np.zeros(COARSE, np.float32)
        return TrackedFrame(stamp_ns, T_map_camera, np.eye(6) * 1e-4, (), CAMERA, nothing, odometry_only=True)

    def _take(self, changes: Iterable[ObjectChange]) -> None:
        for change in changes:
            self.changes.append(change)
            if change.kind == ChangeKind.MOVED and self.obeys:
                self.ids = {n: change.object_id if i == change.merged_id else i for n, i in self.ids.items()}
                self._shapes.pop(change.merged_id, None)

    def _track(self, thing: Thing, T_world_camera: Array) -> TrackedObservation | None:
        observation = self._observe(thing, T_world_camera)
        if observation is None or self.is_missed(self.frames, thing.name):
            return None
        similar = tuple(i for i, d in self._shapes.items() if d @ thing.descriptor > 0.95)
        if self.is_unmatched(self.frames, thing.name):
            return TrackedObservation(observation, MatchStatus.UNMATCHED, NO_ID, similar)
        at_home = thing.name in self.ids and np.allclose(self._places[thing.name], thing.T_world_object)
        if at_home:
            return TrackedObservation(observation, MatchStatus.MATCHED, self.ids[thing.name], similar)
        self._sightings[thing.name] = self._sightings.get(thing.name, 0) + 1
        if self._sightings[thing.name] < 3:
            status = MatchStatus.UNMATCHED if similar else MatchStatus.TENTATIVE
            return TrackedObservation(observation, status, NO_ID, similar)
        return TrackedObservation(observation, MatchStatus.NEW, self._instantiate(thing), similar)

    def _instantiate(self, thing: Thing) -> int:
        object_id, self._next_id = self._next_id, self._next_id + 1
        self.ids[thing.name], self._places[thing.name] = object_id, thing.T_world_object
        self._shapes[object_id] = thing.descriptor
        self._sightings[thing.name] = 0
        return object_id

    def _observe(self, thing: Thing, T_world_camera: Array) -> Observation | None:
        """The thing as the camera sees it; None if less than 0.3 of the rays at it hit it first."""
        T_camera_object = inverse(T_world_camera) @ thing.T_world_object
        center = T_camera_object[:3, 3]
        size = np.hypot(thing.radius_m, thing.height_m / 2) / max(center[2], 0.1)
        around = center[:2] / center[2]
        if center[2] < 0.2 or (np.abs(around) > [0.6, 0.45]).any():
            return None
        rays = _square(18) * size + np.append(around, 1.0)
        depths = ray_depths(self.things, self.tables, T_world_camera, rays)
        first = depths.argmin(axis=0) == 1 + self.things.index(thing)
        if first.sum() < 0.3 * np.isfinite(depths[1 + self.things.index(thing)]).sum() or first.sum() < 12:
            return None
        cloud = rays[first] * depths.min(axis=0)[first, None]
        cloud += self._rng.normal(scale=0.002, size=cloud.shape)
        code = make_code(thing, T_camera_object, self._rng)
        return Observation(0, 1.0, code, cloud.astype(np.float32), cloud.mean(axis=0), 5000)


def _grid(height: int, width: int) -> Array:
    """(h * w, 3) rays, z = 1, through the samples of a coarse depth image."""
    v, u = np.mgrid[:height, :width]
    u = (u + 0.5) * CAMERA.width / width
    v = (v + 0.5) * CAMERA.height / height
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], axis=-1)
    return rays.reshape(-1, 3)


def _square(side: int) -> Array:
    """(side^2, 3) grid over [-1, 1]^2, z = 0."""
    y, x = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j]
    return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)


def lying(thing: Thing) -> Thing:
    """The thing on its side on the table."""
    T = thing.T_world_object.copy()
    T[:3, :3] = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    T[2, 3] = TABLE_HEIGHT_M + thing.radius_m
    return replace(thing, T_world_object=T)


Edit = Callable[[World], None]


def five_things() -> list[Thing]:
    """Two mugs and three bottles on the table."""
    return [
        standing("a", -0.25, -0.2),
        standing("b", 0.25, -0.2, 0.035, 0.14),
        standing("c", 0.25, 0.25, 0.05, 0.09, category="mug"),
        standing("d", -0.25, 0.2, 0.03, 0.2),
        standing("e", 0.0, 0.02, 0.045, 0.1, category="mug"),
    ]


def make_world(things: list[Thing] | None = None, mapper: ObjectMapper | None = None, **kwargs: Any) -> World:
    """The five things, or others, and a fresh mapper."""
    return World(mapper or ObjectMapper(RECONSTRUCT), five_things() if things is None else things, **kwargs)


def revisit(world: World, *edits: Edit, count: int = 16) -> list[tuple[ChangeKind, str]]:
    """Two tours around the table, with edits and time between; the changes as (kind, first true name)."""
    world.tour(orbit(count=count))
    first_ids = {object_id: name for name, object_id in world.ids.items()}
    for edit in edits:
        edit(world)
    world.wait(2.0)
    world.tour(orbit(count=count, start_rad=1.0))
    changes = world.finish()
    names = first_ids | {
        object_id: name for name, object_id in world.ids.items() if object_id not in first_ids
    }
    return sorted((change.kind, names[change.object_id]) for change in changes)


def swap(first: str, second: str) -> Edit:
    """Let two things change places."""

    def edit(world: World) -> None:
        p, q = (world.thing(name).T_world_object[:2, 3] for name in (first, second))
        world.move(first, *q)
        world.move(second, *p)

    return edit


def assert_map_is_true(world: World, tolerance_m: float = 0.02) -> None:
    """Every thing is mapped once, at its place, and nothing else is present."""
    present = [o for o in world.mapper.object_map.objects if o.status != ObjectStatus.REMOVED]
    places = np.array([thing.T_world_object[:3, 3] for thing in world.things])
    mapped = np.array([known.T_map_object[:3, 3] for known in present])
    assert len(present) == len(world.things)
    distances = np.linalg.norm(places[:, None] - mapped, axis=2)
    assert distances.min(axis=0).max() < tolerance_m
    assert distances.min(axis=1).max() < tolerance_m

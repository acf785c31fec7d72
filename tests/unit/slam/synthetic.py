"""A seeded table world without pictures: true objects, a trajectory, and codes with study-like errors.

Errors of a code are a bias that depends on the view and changes over half a metre to a metre of travel, not
white
noise: an AR(1) process over distance. A handle that points away is hidden: its direction is poor, its length
shrinks, its sigma says so. One handle in a hundred is flipped without warning.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from neuse.embedding.code import Code, landmark_template
from neuse.geometry import Array, exp, inverse, make_transform, transform_points
from neuse.records import Intrinsics, Observation, ObservedFrame, OdometrySample

K = 64
INTRINSICS = Intrinsics(640, 480, 600.0, 600.0, 320.0, 240.0)
TEMPLATE = landmark_template(K)
MEMORY_M = 0.7  # over which the errors of a code forget
RATE_HZ = 10.0


@dataclass(frozen=True)
class Thing:
    """An object of the world. `name` is unique; twins share a descriptor and extents."""

    name: int
    ambiguous: bool
    T_world_object: Array
    extents: Array
    descriptor: Array

    @property
    def category(self) -> str:
        return "bottle" if self.ambiguous else "mug"


@dataclass(frozen=True)
class Noise:
    """Standard deviations of codes at close range; `flips` is the share of handles turned round."""

    mug_rad: tuple[float, float, float] = (0.032, 0.032, 0.072)
    mug_m: float = 0.0012
    bottle_rad: float = 0.008
    bottle_m: float = 0.0013
    hidden_factor: float = 6.0
    flips: float = 0.01
    descriptor: float = 0.15
    white_share: float = 0.3
    odometry_rad: float = 0.003
    odometry_m: float = 0.05


@dataclass(frozen=True)
class Step:
    """One instant: what the tracker gets, and the truth."""

    frame: ObservedFrame
    odometry: OdometrySample
    T_world_camera: Array
    names: tuple[int, ...]


@dataclass
class World:
    """Things, and a camera path T_world_camera; `changes` are {step index: things from then on}."""

    things: list[Thing]
    path: list[Array]
    noise: Noise = field(default_factory=Noise)
    changes: dict[int, list[Thing]] = field(default_factory=dict)
    max_range_m: float = 4.3
    seed: int = 0

    def steps(self) -> Iterator[Step]:
        """Play the world."""
        rng = np.random.default_rng(self.seed)
        errors: dict[int, Array] = {}
        T_odom_camera, T_before, things = np.eye(4), self.path[0], self.things
        for index, T_world_camera in enumerate(self.path):
            things = self.changes.get(index, things)
            step = inverse(T_before) @ T_world_camera
            if index:
                sigmas = np.repeat([self.noise.odometry_rad, self.noise.odometry_m], 3)
                T_odom_camera = T_odom_camera @ step @ exp(sigmas * rng.normal(size=6))
            memory = np.exp(-np.linalg.norm(step[:3, 3]) / MEMORY_M)
            T_before = T_world_camera
            stamp_ns = int(1e9 + index * 1e9 / RATE_HZ)
            seen = [thing for thing in things if self._sees(T_world_camera, thing)]
            observations = tuple(self._observe(rng, errors, memory, T_world_camera, thing) for thing in seen)
            yield Step(
                ObservedFrame(stamp_ns, observations, INTRINSICS, np.zeros((6, 8), np.float32)),
                OdometrySample(stamp_ns, T_odom_camera),
                T_world_camera,
                tuple(thing.name for thing in seen),
            )

    def _sees(self, T_world_camera: Array, thing: Thing) -> bool:
        x, y, z = transform_points(inverse(T_world_camera), thing.T_world_object[:3, 3])
        if not 0.3 < z < self.max_range_m:
            return False
        u, v = INTRINSICS.fx * x / z + INTRINSICS.cx, INTRINSICS.fy * y / z + INTRINSICS.cy
        return bool(20 < u < INTRINSICS.width - 20 and 20 < v < INTRINSICS.height - 20)

    def _observe(
        self,
        rng: np.random.Generator,
        errors: dict[int, Array],
        memory: float,
        T_world_camera: Array,
        thing: Thing,
    ) -> Observation:
        T_camera_object = inverse(T_world_camera) @ thing.T_world_object
        fresh = rng.normal(size=6)
        bias = errors.get(thing.name, fresh)
        errors[thing.name] = memory * bias + np.sqrt(1 - memory**2) * fresh
        white = np.sqrt(self.noise.white_share)
        unit = np.sqrt(1 - white**2) * errors[thing.name] + white * rng.normal(size=6)
        sigmas, hidden = self._sigmas(thing, T_camera_object)
        xi = unit * sigmas
        if thing.ambiguous:
            xi[2] = 0.0
        elif rng.random() < self.noise.flips:
            xi = np.array([0.0, 0.0, np.pi, *xi[3:]])
        share = 0.3 if hidden else 1.0
        code = make_code(thing, T_camera_object @ exp(xi), sigmas, share, rng, self.noise.descriptor)
        center = T_camera_object[:3, 3]
        partial_center = center * (1 - 0.03 / np.linalg.norm(center)) + 0.003 * rng.normal(size=3)
        mask_px = int(0.008 * (INTRINSICS.fx / center[2]) ** 2)
        return Observation(thing.name + 1, 0.9, code, np.zeros((1, 3), np.float32), partial_center, mask_px)

    def _sigmas(self, thing: Thing, T_camera_object: Array) -> tuple[Array, bool]:
        noise, range_m = self.noise, float(np.linalg.norm(T_camera_object[:3, 3]))
        far = max(1.0, range_m / 3.0)
        if thing.ambiguous:
            return far * np.array([noise.bottle_rad] * 2 + [np.pi / far] + [noise.bottle_m] * 3), False
        handle = T_camera_object[:3, 0]
        hidden = bool(handle @ T_camera_object[:3, 3] / range_m > 0.6)
        turn = min(noise.mug_rad[2] * (noise.hidden_factor if hidden else 1.0) * far, 2.0)
        return np.array([*np.multiply(far, noise.mug_rad[:2]), turn] + [far * noise.mug_m] * 3), hidden


def make_code(
    thing: Thing,
    T_camera_object: Array,
    sigmas: Array,
    handle_share: float = 1.0,
    rng: np.random.Generator | None = None,
    descriptor_noise: float = 0.0,
) -> Code:
    """The code of a thing at a pose: z = c + E a for the landmarks, the rest arbitrary."""
    rng = rng or np.random.default_rng(0)
    E = T_camera_object[:3, :3] * thing.extents * np.array([handle_share, 1.0, 1.0])
    if thing.ambiguous:
        E = E * np.array([0.0, 0.0, 1.0])
    landmarks = T_camera_object[:3, 3] + TEMPLATE @ E.T
    descriptor = thing.descriptor + descriptor_noise * rng.normal(size=K) / np.sqrt(K)
    z = np.concatenate([landmarks, landmarks])
    return Code(thing.category, thing.ambiguous, z, descriptor / np.linalg.norm(descriptor), sigmas)


def make_thing(
    name: int,
    ambiguous: bool,
    position: Array,
    rng: np.random.Generator,
    upright: bool = True,
    alike: float = 0.0,
) -> Thing:
    """A random mug or bottle; `alike` in [0, 1] mixes its descriptor with one that all share."""
    R = exp([0, 0, rng.uniform(-np.pi, np.pi), 0, 0, 0])[:3, :3]
    if not upright and rng.random() < 0.5:
        R = R @ exp([np.pi / 2, 0, 0, 0, 0, 0])[:3, :3]
    extents = np.array([0.035, 0.035, 0.12]) if ambiguous else np.array([0.06, 0.045, 0.05])
    own = rng.normal(size=K)
    shared = np.random.default_rng(int(ambiguous)).normal(size=K)
    descriptor = (1 - alike) * own + alike * shared
    return Thing(
        name,
        ambiguous,
        make_transform(R, position),
        extents * rng.uniform(0.8, 1.2),
        descriptor / np.linalg.norm(descriptor),
    )


def look_at(eye: Array, target: Array) -> Array:
    """T_world_camera of an optical frame at `eye` that looks at `target`, world z up."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return make_transform(np.stack([right, np.cross(forward, right), forward], axis=1), eye)


def circle_path(radius_m: float, n: int, loops: int = 1, height_m: float = 1.3) -> list[Array]:
    """Round the origin, looking in, a little ahead."""
    angles = np.linspace(0, 2 * np.pi * loops, n)
    return [
        look_at(
            np.array([radius_m * np.cos(a), radius_m * np.sin(a), height_m]),
            np.array([0.7 * np.cos(a + 0.8), 0.7 * np.sin(a + 0.8), 0.75]),
        )
        for a in angles
    ]


def small_world(seed: int = 0, upright: bool = True, alike: float = 0.0) -> World:
    """Three tables, twelve objects, two loops round them; nothing is ever out of sight."""
    rng = np.random.default_rng(seed)
    tables = [np.array([0.6 * np.cos(a), 0.6 * np.sin(a), 0.75]) for a in (0.0, 2.1, 4.2)]
    things = [
        make_thing(4 * t + i, i % 2 == 1, table + _spot(i, rng), rng, upright, alike)
        for t, table in enumerate(tables)
        for i in range(4)
    ]
    return World(things, circle_path(1.6, 180, loops=2), seed=seed + 100)


def large_world(seed: int = 0, upright: bool = True, alike: float = 0.0) -> World:
    """The study's world: ten tables, 50 objects of which 5 are twins, two passes, blind frames."""
    rng = np.random.default_rng(seed)
    tables = [np.array([x, y, 0.75]) for y in (0.0, 3.2, 6.4, 9.6, 12.8) for x in (0.0, 3.4)]
    things = [
        make_thing(5 * t + i, (5 * t + i) % 2 == 1, table + _spot(i, rng), rng, upright, alike)
        for t, table in enumerate(tables)
        for i in range(5)
    ]
    for i in range(5):
        twin = things[10 * i + 3]
        things[10 * i + 7] = replace(
            things[10 * i + 7], ambiguous=twin.ambiguous, extents=twin.extents, descriptor=twin.descriptor
        )
    return World(things, _two_passes(), seed=seed + 100)


def _spot(i: int, rng: np.random.Generator) -> Array:
    angle = 2 * np.pi * i / 5 + rng.uniform(-0.3, 0.3)
    radius = rng.uniform(0.2, 0.4)
    return np.array([radius * np.cos(angle), radius * np.sin(angle), 0.06])


def _two_passes() -> list[Array]:
    """Round the outside looking in, then up and down the aisle: every table from two sides, 0.1 m a frame."""
    camera = [(-2.3, -1), (-2.3, 12), (0, 15), (3.4, 15), (5.7, 13), (5.7, 0), (3.4, -2.2), (2.3, -2.2)]
    gaze = [(0, 0.4), (0, 13), (0.5, 12.8), (3.4, 12.8), (3.4, 12), (3.4, -0.5), (3.0, 0), (0.0, 0.5)]
    camera += [(2.3, 0), (2.3, 11.5), (1.7, 15.2), (1.1, 13), (1.1, 1)]
    gaze += [(0, 1.4), (0, 12.8), (1.7, 12.8), (3.4, 11.5), (3.4, -0.2)]
    corners = np.hstack([np.array(camera, dtype=np.float64), np.array(gaze, dtype=np.float64)])
    rows = _resample(corners, 0.1)
    rows[:, 2:] = _smooth(rows[:, 2:], 11)
    return [look_at(np.array([*row[:2], 1.4]), np.array([*row[2:], 0.75])) for row in rows]


def _resample(corners: Array, spacing_m: float) -> Array:
    """The smoothed polyline at equal spacing of its first two columns."""
    pieces = [np.linspace(a, b, 200, endpoint=False) for a, b in pairwise(corners)]
    line = _smooth(np.concatenate(pieces), 61)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1))])
    wanted = np.arange(0.0, length[-1], spacing_m)
    return np.stack([np.interp(wanted, length, column) for column in line.T], axis=1)


def _smooth(rows: Array, width: int) -> Array:
    padded = np.pad(rows, ((width // 2, width // 2), (0, 0)), mode="edge")
    kernel = np.ones(width) / width
    return np.stack([np.convolve(column, kernel, mode="valid") for column in padded.T], axis=1)


def drift_between(tracks, now):
    """(m, 2) drift of the camera relative to each track over whichever other makes it least."""
    mapped = np.array([track.mapped_at for track in tracks]).reshape(-1, 2)
    since = now - np.array([track.seen_at for track in tracks]).reshape(-1, 2)
    if not tracks:
        return since
    ways = np.abs(mapped[:, None] - mapped[None]) + since[None]  # (m, via, 2)
    return ways[np.arange(len(tracks)), ways[..., 1].argmin(axis=1)]

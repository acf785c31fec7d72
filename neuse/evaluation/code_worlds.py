"""Worlds without pictures, as large as wanted: groups of objects along a circular aisle, seen as codes.

What association and optimisation need to be timed with thousands of objects and keyframes. Codes have white
noise of the size that the encoder's sigmas tell.
"""

from dataclasses import dataclass

import numpy as np

from neuse.embedding.code import Code, landmark_template
from neuse.geometry import Array, exp, inverse, make_transform, transform_points
from neuse.records import Intrinsics, Observation, ObservedFrame, OdometrySample

K = 128  # as the shipped weights
VGA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
GROUP = 5  # objects side by side on one table, all seen at once
GROUP_GAP_M = 1.0
STANDOFF_M = 0.9
SIGHT_M = 1.3
SIGMAS = np.array([0.03, 0.03, 0.06, 0.002, 0.002, 0.002])  # of a code: rad, metres
DESCRIPTOR_NOISE = 0.05
ODOMETRY_SIGMAS = np.repeat([0.001, 0.002], 3)  # of an increment: rad, metres
FRAME_NS = 33_333_333
POINTS = np.zeros((1, 3), dtype=np.float32)
NO_DEPTH = np.zeros((60, 80), dtype=np.float32)


@dataclass(frozen=True)
class CodeWorld:
    """n objects, mugs and bottles by turns, in groups on a circle of `radius_m` round the origin.

    T_world_object: (n, 4, 4).    descriptors: (n, K), unit length.    extents: (n, 3), metres.
    """

    radius_m: float
    T_world_object: Array
    descriptors: Array
    extents: Array

    def __len__(self) -> int:
        return len(self.descriptors)

    @property
    def lap_m(self) -> float:
        """Length of the camera's way round."""
        return 2 * np.pi * (self.radius_m + STANDOFF_M)

    def camera(self, way_m: float) -> Array:
        """T_world_camera after so many metres of the way round; it looks at the circle."""
        angle = way_m / (self.radius_m + STANDOFF_M)
        radial = np.array([np.cos(angle), np.sin(angle), 0.0])
        down = np.array([0.0, 0.0, -1.0])
        axes = np.stack([np.cross(down, -radial), down, -radial], axis=1)
        return make_transform(axes, (self.radius_m + STANDOFF_M) * radial)

    def true_code(self, index: int) -> Code:
        """The code of an object in the frame `world`, without noise."""
        ambiguous = index % 2 == 1
        scaled = np.diag(self.extents[index] * ([0.0, 0.0, 1.0] if ambiguous else [1.0, 1.0, 1.0]))
        landmarks = transform_points(self.T_world_object[index], landmark_template(K) @ scaled)
        sigmas = np.where([False, False, ambiguous, False, False, False], np.pi, SIGMAS)
        category = "bottle" if ambiguous else "mug"
        return Code(category, ambiguous, np.concatenate([landmarks] * 2), self.descriptors[index], sigmas)

    def observe(self, T_world_camera: Array, stamp_ns: int, rng: np.random.Generator) -> ObservedFrame:
        """The objects in sight, at most a group's number, nearest first."""
        centers = transform_points(inverse(T_world_camera), self.T_world_object[:, :3, 3])
        nearest = np.argsort(np.linalg.norm(centers, axis=1), kind="stable")[:GROUP]
        seen = [int(i) for i in nearest if np.linalg.norm(centers[i]) < SIGHT_M]
        observations = tuple(self._observation(i, inverse(T_world_camera), rng) for i in seen)
        return ObservedFrame(stamp_ns, observations, VGA, NO_DEPTH)

    def _observation(self, index: int, T_camera_world: Array, rng: np.random.Generator) -> Observation:
        code = self.true_code(index)
        T_object_world = inverse(self.T_world_object[index])
        noise = exp(SIGMAS * rng.normal(size=6) * [1, 1, not code.ambiguous, 1, 1, 1])
        T_camera_seen = T_camera_world @ self.T_world_object[index] @ noise @ T_object_world
        descriptor = code.descriptor + DESCRIPTOR_NOISE * rng.normal(size=K) / np.sqrt(K)
        z = transform_points(T_camera_seen, code.z)
        seen = Code(code.category, code.ambiguous, z, descriptor / np.linalg.norm(descriptor), code.sigmas)
        return Observation(index % GROUP + 1, 0.9, seen, POINTS, seen.center, 4000)


def make_code_world(objects: int, seed: int = 0) -> CodeWorld:
    """A world of so many objects, no two of one shape."""
    rng = np.random.default_rng(seed)
    groups = -(-objects // GROUP)
    radius_m = max(groups * GROUP_GAP_M / (2 * np.pi), 1.0)
    group, place = np.divmod(np.arange(objects), GROUP)
    angles = 2 * np.pi * group / groups + (place - GROUP / 2) * 0.15 / radius_m
    radii = radius_m + rng.uniform(-0.1, 0.1, objects)
    positions = np.stack(
        [radii * np.cos(angles), radii * np.sin(angles), rng.uniform(-0.05, 0.05, objects)], 1
    )
    turns = [exp([0, 0, yaw, 0, 0, 0])[:3, :3] for yaw in rng.uniform(-np.pi, np.pi, objects)]
    descriptors = rng.normal(size=(objects, K))
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    extents = np.where(np.arange(objects)[:, None] % 2, [0.035, 0.035, 0.12], [0.06, 0.045, 0.05])
    return CodeWorld(radius_m, make_transform(turns, positions), descriptors, extents)


def walk(
    world: CodeWorld, frames: int, spacing_m: float, seed: int = 0
) -> list[tuple[Array, OdometrySample]]:
    """A way round the world, lap after lap: T_world_camera and drifting odometry of every frame."""
    rng = np.random.default_rng(seed)
    poses = [world.camera(i * spacing_m) for i in range(frames)]
    T_odom_camera, path = np.eye(4), []
    for i, T_world_camera in enumerate(poses):
        if i:
            step = inverse(poses[i - 1]) @ T_world_camera
            T_odom_camera = T_odom_camera @ step @ exp(ODOMETRY_SIGMAS * rng.normal(size=6))
        path.append((T_world_camera, OdometrySample((i + 1) * FRAME_NS, T_odom_camera)))
    return path

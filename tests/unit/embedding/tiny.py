"""Networks small enough to run in milliseconds, and shapes, clouds and codes with known answers."""

import numpy as np
import torch
import trimesh
from scipy.spatial.transform import Rotation

from neuse.embedding.code import Code, landmark_template
from neuse.embedding.encoder import EncoderConfig
from neuse.embedding.network import Network
from neuse.geometry import Array, make_transform, transform_points
from neuse.simulation.shapes import Shape, make_shape, symmetry_of

CONFIG = EncoderConfig(n_latent=16, n_points=64, n_anchors=32, width=16, n_vectors=8, n_weights=4, n_blocks=2)
TRAIN = {
    "steps": 4,
    "shapes_per_batch": 2,
    "views_per_shape": 2,
    "n_points": 64,
    "anchors": 16,
    "anchors_last": 32,
    "width": 16,
    "queries": 16,
    "warmup": 1,
}
EXTENTS = np.array([0.07, 0.04, 0.05])


def make_network(category: str = "mug", seed: int = 0) -> Network:
    """Random weights; every layer takes part (no residual branch is left at zero)."""
    torch.manual_seed(seed)
    network = Network(category, symmetry_of(category), CONFIG)
    for block in network.decoder.blocks:
        torch.nn.init.normal_(block.outer.weight, std=0.1)
    return network.eval()


def random_transform(rng: np.random.Generator, reach_m: float = 3.0) -> Array:
    """A rotation uniform over SO(3) and a translation."""
    return make_transform(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-reach_m, reach_m, 3))


def partial_cloud(rng: np.random.Generator, n: int) -> Array:
    """(n, 3) metres: one side of a bumpy ellipsoid, noisy, a metre away."""
    directions = rng.normal(size=(n, 3))
    directions[:, 2] = -np.abs(directions[:, 2])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    bumps = 1.0 + 0.1 * np.sin(5 * directions[:, :1])
    return directions * bumps * EXTENTS + rng.normal(scale=0.001, size=(n, 3)) + [0.1, -0.2, 1.0]


def make_code(T_frame_object: Array, category: str = "mug", extents: Array = EXTENTS, k: int = 16) -> Code:
    """The code of a perfect encoder for an object at this pose."""
    seen = [0.0, 0.0, 1.0] if symmetry_of(category).ambiguous else [1.0, 1.0, 1.0]
    landmarks = landmark_template(k) * extents * seen
    free = np.random.default_rng(k).normal(scale=0.03, size=(k - k // 2, 3))
    z = transform_points(T_frame_object, np.concatenate([landmarks, free]))
    return Code(category, symmetry_of(category).ambiguous, z, np.full(k, k**-0.5), np.full(6, 0.01))


def block_mug() -> Shape:
    """A solid cylinder, 40 mm radius and 90 mm high, with a square bar as handle to x = 65 mm."""
    body = trimesh.creation.cylinder(0.04, 0.09, sections=48)
    bar = trimesh.creation.box([0.065, 0.012, 0.05], make_transform(np.eye(3), [0.0325, 0, 0]))
    return make_shape("block_mug", "mug", trimesh.boolean.union([body, bar]))


def block_bottle() -> Shape:
    """A solid cylinder, 35 mm radius, with a narrower neck: 200 mm high in all."""
    body = trimesh.creation.cylinder(0.035, 0.14, sections=48)
    body.apply_translation([0, 0, -0.03])
    neck = trimesh.creation.cylinder(0.013, 0.09, sections=48)
    neck.apply_translation([0, 0, 0.055])
    return make_shape("block_bottle", "bottle", trimesh.boolean.union([body, neck]))


def distance_to_surface(mesh: trimesh.Trimesh, points: Array) -> Array:
    """(n,) metres from each point to the nearest point of the mesh."""
    return np.abs(trimesh.proximity.closest_point_naive(mesh, points)[1])

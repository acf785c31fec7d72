"""Small worlds with known answers: a helical camera path, and map objects that decode to boxes."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from neuse.embedding.code import Code, landmark_template
from neuse.evaluation.trajectory import Trajectory
from neuse.geometry import Array, exp, make_transform
from neuse.records import MapObject, ObjectStatus

K = 16
EXTENTS = np.array([0.06, 0.05, 0.04])


@pytest.fixture
def helix() -> Trajectory:
    """60 poses of a camera that walks around the z axis, looking inwards and a little down; 0.1 s apart."""
    angles = np.linspace(0.0, 6.0, 60)
    poses = [_pose_on_helix(angle) for angle in angles]
    return Trajectory(np.arange(len(poses)) * 10**8 + 10**18 + 7, np.array(poses))


def _pose_on_helix(angle: float) -> Array:
    z = np.array([-np.cos(angle), -np.sin(angle), -0.3])
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z], axis=1)
    return make_transform(R, [2 * np.cos(angle), 2 * np.sin(angle), 1.0 + 0.02 * angle])


@pytest.fixture
def T_any() -> Array:
    """A transform far from the identity."""
    return exp([0.4, -1.1, 0.7, 2.0, -3.0, 0.5])


@pytest.fixture
def map_object() -> Callable[..., MapObject]:
    """Factory of map objects of one size, with a code that lies at their pose."""

    def make(
        object_id: int,
        T_map_object: Array,
        category: str = "mug",
        status: ObjectStatus = ObjectStatus.UNCHANGED,
    ) -> MapObject:
        z = np.zeros((K, 3))
        z[: K // 2] = landmark_template(K) * EXTENTS
        code = Code(category, False, z, np.full(K, K**-0.5), np.full(6, 0.01)).transformed(T_map_object)
        box = 2 * EXTENTS
        center = T_map_object[:3, 3]
        return MapObject(object_id, category, status, T_map_object, center, box, code, 0, 0, 5)

    return make


@pytest.fixture
def decode() -> Callable[[Code], trimesh.Trimesh]:
    """A decoder whose shapes are boxes of the codes' extents."""

    def reconstruct(code: Code) -> trimesh.Trimesh:
        return trimesh.creation.box(2 * EXTENTS, code.T_frame_object)

    return reconstruct

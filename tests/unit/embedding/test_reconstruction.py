import numpy as np
import pytest
import torch

from neuse.embedding.code import Code
from neuse.embedding.network import UNIT_M
from neuse.embedding.reconstruction import reconstruct
from neuse.errors import InputError
from neuse.geometry import inverse, transform_points

from .tiny import make_code, random_transform

RADIUS_M, HALF_HEIGHT_M, WALL_M = 0.04, 0.05, 0.003
LOGITS_PER_M = 1000.0  # a trained decoder is about as steep at the surface


class AnalyticNetwork:
    """Decodes every code to one shape, a signed distance in the object frame, wherever its landmarks lie."""

    device = torch.device("cpu")

    def __init__(self, signed_distance, threshold=0.0):
        self.signed_distance, self.occupancy_logit = signed_distance, torch.tensor(threshold)
        self.decoder, self.n_queries = self, 0

    def evaluate(self, x, z, dtype):
        self.n_queries += len(x)
        code = Code("mug", False, z.double().numpy().T * UNIT_M, np.empty(0), np.empty(0))
        points = transform_points(inverse(code.T_frame_object), x.double().numpy() * UNIT_M)
        logits = -LOGITS_PER_M * self.signed_distance(points) + float(self.occupancy_logit)
        return torch.tensor(logits, dtype=torch.float32)


def cylinder(points, radius, low, high):
    r, z = np.linalg.norm(points[:, :2], axis=1), points[:, 2]
    return np.maximum(r - radius, np.maximum(low - z, z - high))


def ball(points):
    return np.linalg.norm(points, axis=1) - RADIUS_M


def cup(points):
    outside = cylinder(points, RADIUS_M, -HALF_HEIGHT_M, HALF_HEIGHT_M)
    hollow = cylinder(points, RADIUS_M - WALL_M, -HALF_HEIGHT_M + WALL_M, 1.0)
    return np.maximum(outside, -hollow)


CUP_VOLUME = np.pi * (
    RADIUS_M**2 * 2 * HALF_HEIGHT_M - (RADIUS_M - WALL_M) ** 2 * (2 * HALF_HEIGHT_M - WALL_M)
)
BALL_VOLUME = 4 / 3 * np.pi * RADIUS_M**3


@pytest.fixture
def T_frame_object():
    return random_transform(np.random.default_rng(5))


@pytest.mark.parametrize(
    ("shape", "volume", "tolerance"),
    [(ball, BALL_VOLUME, 0.01), (cup, CUP_VOLUME, 0.05)],
    ids=["ball", "cup"],
)
@pytest.mark.parametrize("resolution_m", [0.002, 0.0025])
def test_mesh_is_closed_and_has_the_volume_of_the_shape(
    shape, volume, tolerance, resolution_m, T_frame_object
):
    mesh = reconstruct(AnalyticNetwork(shape), make_code(T_frame_object), resolution_m)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(volume, rel=tolerance)  # positive: normals point outwards


@pytest.mark.parametrize("category", ["mug", "bottle"])
def test_mesh_lies_in_the_frame_of_the_code(category, T_frame_object):
    code = make_code(T_frame_object, category)
    mesh = reconstruct(AnalyticNetwork(cup), code, 0.0025)
    vertices_object = transform_points(inverse(T_frame_object), mesh.vertices)
    assert np.abs(cup(vertices_object)).max() < 0.0015  # marching cubes round the edges


def test_thin_walls_are_kept_and_the_hollow_is_empty(T_frame_object):
    mesh = reconstruct(AnalyticNetwork(cup), make_code(T_frame_object), 0.0025)
    angle, z = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(-0.045, 0.047, 20))
    side = np.stack([np.cos(angle), np.sin(angle), z], -1).reshape(-1, 3)
    wall = side * [RADIUS_M - WALL_M / 2, RADIUS_M - WALL_M / 2, 1]
    inner = side * [RADIUS_M - 2 * WALL_M, RADIUS_M - 2 * WALL_M, 1]
    assert mesh.contains(transform_points(T_frame_object, wall)).mean() > 0.99
    assert not mesh.contains(transform_points(T_frame_object, inner)).any()


def test_threshold_of_the_network_is_the_surface(T_frame_object):
    network = AnalyticNetwork(ball, threshold=-1.5)
    mesh = reconstruct(network, make_code(T_frame_object), 0.0025)
    assert mesh.volume == pytest.approx(BALL_VOLUME, rel=0.01)


def test_only_a_part_of_the_fine_grid_is_decoded(T_frame_object):
    network = AnalyticNetwork(ball)
    reconstruct(network, make_code(T_frame_object), 0.00125)
    assert network.n_queries < (2 * RADIUS_M / 0.00125) ** 3


def test_shape_that_fills_the_searched_cube_is_closed_at_its_sides(T_frame_object):
    mesh = reconstruct(
        AnalyticNetwork(lambda points: np.full(len(points), -0.01)),
        make_code(T_frame_object),
        0.01,
    )
    assert mesh.is_watertight
    assert mesh.volume > 0


def test_code_that_decodes_to_nothing_is_refused(T_frame_object):
    network = AnalyticNetwork(lambda points: np.full(len(points), 0.01))
    with pytest.raises(InputError, match="decodes to no shape") as caught:
        reconstruct(network, make_code(T_frame_object), 0.0025)
    assert caught.value.reason == "empty_reconstruction"

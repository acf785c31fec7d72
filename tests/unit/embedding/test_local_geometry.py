import pytest
import torch
from scipy.spatial.transform import Rotation

from neuse.embedding.local_geometry import CHUNK, N_INVARIANTS, N_VECTORS, SCALES, local_geometry

N_ANCHORS = 16


@pytest.fixture
def points():
    torch.manual_seed(0)
    return torch.randn(3, 60, 3, dtype=torch.float64) * torch.tensor([0.5, 0.3, 0.1])


def test_vectors_turn_with_the_cloud_and_invariants_do_not(points):
    vectors, invariants = local_geometry(points, N_ANCHORS)
    for matrix in Rotation.random(5, random_state=1).as_matrix():
        R = torch.tensor(matrix)
        turned_vectors, turned_invariants = local_geometry(points @ R.T, N_ANCHORS)
        expected = R.float() @ vectors
        assert (turned_vectors - expected).norm() <= 1e-6 * expected.norm()
        assert (turned_invariants - invariants).norm() <= 1e-6 * invariants.norm()


def test_shapes_and_types_are_as_documented(points):
    vectors, invariants = local_geometry(points, N_ANCHORS)
    assert vectors.shape == (3, N_ANCHORS, 3, N_VECTORS)
    assert invariants.shape == (3, N_ANCHORS, N_INVARIANTS)
    assert vectors.dtype == invariants.dtype == torch.float32


def test_first_vector_is_the_anchor_itself(points):
    vectors, invariants = local_geometry(points, N_ANCHORS)
    torch.testing.assert_close(vectors[..., 0], points[:, :N_ANCHORS].float())
    torch.testing.assert_close(invariants[..., 0], points[:, :N_ANCHORS].norm(dim=-1).float())


def test_order_of_the_points_that_are_no_anchors_does_not_matter(points):
    shuffled = torch.cat([points[:, :N_ANCHORS], points[:, N_ANCHORS:].flip(1)], 1)
    for expected, found in zip(
        local_geometry(points, N_ANCHORS), local_geometry(shuffled, N_ANCHORS), strict=True
    ):
        torch.testing.assert_close(found, expected)


def test_clouds_of_a_batch_do_not_influence_each_other(points):
    many = points.repeat(CHUNK, 1, 1)  # more than a chunk
    vectors, _ = local_geometry(many, N_ANCHORS)
    torch.testing.assert_close(vectors[-1], local_geometry(points[-1:], N_ANCHORS)[0][0])


def test_covariance_in_a_plane_knows_the_normal():
    grid = torch.linspace(-1, 1, 41, dtype=torch.float64)
    plane = torch.cartesian_prod(grid, grid)
    height = torch.full_like(plane[:, :1], 0.3)  # of the plane over the centre of the cloud
    points = torch.cat([plane, height], -1)
    middle = (points - torch.tensor([0.1, -0.2, 0.3])).norm(dim=-1).argmin()
    points = torch.cat([points[middle : middle + 1], points])[None]
    vectors, _ = local_geometry(points, 1)
    x = vectors[0, 0, :, 0]
    expected = x * torch.tensor([0.5, 0.5, 0.0])  # (I - n n^T) / 2 @ x
    for i in range(len(SCALES)):
        torch.testing.assert_close(vectors[0, 0, :, 2 + 3 * i], expected, atol=5e-3, rtol=0)


def test_coinciding_points_give_finite_features():
    vectors, invariants = local_geometry(torch.zeros(1, 20, 3, dtype=torch.float64), 8)
    assert torch.isfinite(vectors).all()
    assert torch.isfinite(invariants).all()

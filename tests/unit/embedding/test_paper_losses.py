import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from torch.autograd import gradcheck
from torch.nn import functional as F

from neuse.embedding.dataset import Batch
from neuse.embedding.encoder import Encoding
from neuse.embedding.paper_losses import (
    ambiguous_loss,
    batch_hard_loss,
    chamfer_distance,
    equivalent_views,
    pairs_of_views,
    paper_losses,
    relative_pose,
    unambiguous_loss,
)
from neuse.symmetry import AXIAL, NONE

SHAPES = torch.tensor([0, 0, 1, 1])


def normal(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def rotations(n, seed=0):
    return torch.tensor(Rotation.random(n, random_state=seed).as_matrix())


def scene(ambiguous):
    """Two shapes in two views each: a batch, and the encoding of a perfect encoder."""
    R, center = rotations(4), normal(4, 3, 1, seed=1)
    extents = torch.tensor([0.0, 0.0, 0.9] if ambiguous else [0.7, 0.4, 0.5], dtype=R.dtype)
    target = torch.cat([center, R * extents], -1)
    latent, solid = normal(2, 3, 12, seed=2)[SHAPES], ring(2)[SHAPES] if ambiguous else normal(4, 9, 3)
    z, surface = R @ latent + center, solid @ R.mT + center.mT
    nothing = torch.empty(0)
    batch = Batch(nothing, target, SHAPES, nothing, nothing, surface, nothing)
    descriptor = F.normalize(normal(4, 12, seed=3), dim=-1)
    return batch, Encoding(z.requires_grad_(), nothing, descriptor.requires_grad_(), nothing)


def ring(n, points=16):
    """A solid of revolution sampled so evenly that an eighth of a turn maps it onto itself."""
    angles = torch.arange(points, dtype=torch.float64) * (2 * torch.pi / points)
    circle = torch.stack([angles.cos(), angles.sin(), torch.zeros_like(angles)], -1)
    levels = [circle * radius + torch.tensor([0.0, 0.0, z]) for radius, z in ((0.4, -0.9), (0.2, 0.9))]
    return torch.cat(levels)[None].expand(n, -1, -1)


@pytest.mark.parametrize("ambiguous", [False, True])
def test_transform_loss_of_true_transforms_is_zero(ambiguous):
    batch, encoding = scene(ambiguous)
    assert (
        abs(float(paper_losses(encoding, batch, AXIAL if ambiguous else NONE)["transform"].detach())) < 1e-12
    )


@pytest.mark.parametrize("ambiguous", [False, True])
def test_losses_train_the_latent_points(ambiguous):
    batch, encoding = scene(ambiguous)
    wrong = encoding._replace(z=(encoding.z + 0.1 * normal(4, 3, 12, seed=5)).detach().requires_grad_())
    losses = paper_losses(wrong, batch, AXIAL if ambiguous else NONE)
    (losses["transform"] + losses["shape"]).backward()
    assert losses["transform"] > 1e-4
    assert float(wrong.z.grad.norm()) > 0
    assert float(wrong.descriptor.grad.norm()) > 0


def test_pairs_are_all_of_two_views_of_a_shape():
    a, b = pairs_of_views(torch.tensor([3, 5, 3, 3]))
    assert list(zip(a.tolist(), b.tolist(), strict=True)) == [(0, 2), (0, 3), (2, 3)]


def test_relative_pose_maps_the_object_of_one_view_onto_that_of_the_other():
    batch, _ = scene(ambiguous=False)
    R, t = relative_pose(batch.target[:1], batch.target[1:2])
    torch.testing.assert_close(R @ batch.target[:1, :, 1:], batch.target[1:2, :, 1:])
    torch.testing.assert_close(R @ batch.target[:1, :, :1] + t[..., None], batch.target[1:2, :, :1])


def test_unambiguous_loss_is_that_of_the_angle_and_the_shift():
    angle, shift = 0.3, torch.tensor([[0.0, 0.2, 0.1]], dtype=torch.float64)
    R = torch.tensor(Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix())[None]
    R_true, t_true = rotations(1), normal(1, 3)
    loss = unambiguous_loss(R @ R_true, t_true + shift, R_true, t_true)
    assert float(loss) == pytest.approx(4 - 4 * np.cos(angle) + 0.05)  # |R - I|_F^2 = 4 - 4 cos


def test_chamfer_distance_agrees_with_a_search_tree():
    a, b = normal(3, 30, 3), normal(3, 20, 3, seed=1)
    for found, p, q in zip(chamfer_distance(a, b), a.numpy(), b.numpy(), strict=True):
        there, back = cKDTree(q).query(p)[0], cKDTree(p).query(q)[0]
        assert float(found) == pytest.approx((there**2).mean() + (back**2).mean())


def test_equivalent_views_turn_about_the_axis():
    batch, _ = scene(ambiguous=True)
    orbit = equivalent_views(batch.surface, batch.target, 4)
    torch.testing.assert_close(orbit[:, 0], batch.surface)
    center, axis = batch.target[0, :, 0].numpy(), F.normalize(batch.target[0, :, 3], dim=0).numpy()
    quarter = Rotation.from_rotvec(axis * np.pi / 2)
    expected = quarter.apply(batch.surface[0].numpy() - center) + center
    np.testing.assert_allclose(orbit[0, 1], expected, atol=1e-9)


def test_ambiguous_loss_does_not_see_a_turn_about_the_axis_but_a_tilt():
    surface = ring(1)
    target = torch.eye(3, 4, dtype=surface.dtype)[None].roll(1, 2)  # centre 0, axis z
    orbit, t = equivalent_views(surface, target, 8), torch.zeros(1, 3, dtype=surface.dtype)

    def loss(rotvec):
        R = torch.tensor(Rotation.from_rotvec(rotvec).as_matrix())[None]
        return float(ambiguous_loss(R, t, orbit, surface))

    assert loss([0.0, 0.0, np.pi / 4]) == pytest.approx(0.0, abs=1e-12)
    assert loss([0.3, 0.0, 0.0]) > 1e-2
    assert loss([np.pi, 0.0, 0.0]) > 1e-2  # upside down


def test_batch_hard_loss_takes_the_hardest_of_each():
    at = torch.deg2rad(torch.tensor([0.0, 20.0, 90.0, 150.0], dtype=torch.float64))
    s = torch.stack([at.cos(), at.sin()], -1)
    # farthest own, nearest other, degrees: 20, 90; 20, 70; 60, 70; 60, 130
    cos = np.cos(np.deg2rad([[20, 20, 60, 60], [90, 70, 70, 130]]))
    assert float(batch_hard_loss(s, SHAPES)) == pytest.approx((cos[1] - cos[0]).mean())


def test_gradients_agree_with_finite_differences():
    R_true, t_true, surface = rotations(2), normal(2, 3), normal(2, 5, 3, seed=4)
    orbit = normal(2, 3, 5, 3, seed=5)
    inputs = [x.requires_grad_() for x in (normal(2, 3, 3, seed=6), normal(2, 3, seed=7))]
    assert gradcheck(lambda R, t: unambiguous_loss(R, t, R_true, t_true), inputs)
    assert gradcheck(lambda R, t: ambiguous_loss(R, t, orbit, surface), inputs)
    assert gradcheck(lambda s: batch_hard_loss(F.normalize(s, dim=-1), SHAPES), normal(4, 8).requires_grad_())

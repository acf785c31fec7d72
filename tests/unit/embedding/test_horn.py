import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch.autograd import gradcheck

from neuse.embedding.horn import NearestRotation, align_latents, horn

from .tiny import make_code, random_transform


def clouds(n=6, k=20, seed=0):
    return torch.randn(n, 3, k, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_transform_of_moved_points_is_found():
    z_a, t = clouds(), clouds(k=1, seed=1)
    R = torch.tensor(Rotation.random(6, random_state=0).as_matrix())
    found_R, found_t = horn(z_a, R @ z_a + t)
    torch.testing.assert_close(found_R, R)
    torch.testing.assert_close(found_t, t[..., 0])


def test_rotation_of_noisy_points_agrees_with_scipy():
    z_a, z_b = clouds(), clouds(seed=1)  # nothing in common: the best rotation all the same
    R, _ = horn(z_a, z_b)
    for a, b, found in zip(z_a, z_b, R, strict=True):
        a, b = (z - z.mean(-1, keepdim=True) for z in (a, b))
        oracle, _ = Rotation.align_vectors(b.T.numpy(), a.T.numpy())
        np.testing.assert_allclose(found, oracle.as_matrix(), atol=1e-9)


def test_mirrored_points_give_a_rotation_and_no_reflection():
    z = clouds()
    R, _ = horn(z, -z)
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(6, dtype=R.dtype))


def test_gradients_agree_with_finite_differences():
    z_a, z_b = (clouds(3, 7, seed).requires_grad_() for seed in (0, 1))
    assert gradcheck(horn, [z_a, z_b])


@pytest.mark.parametrize("singular", [(1.0, 1.0, 1.0), (2.0, 1.0, 1.0), (2.0, 1.0, -0.5)])
def test_gradient_does_not_mind_alike_singular_values(singular):
    U, V = (torch.tensor(Rotation.random(random_state=seed).as_matrix()) for seed in (0, 1))
    M = (U @ torch.diag(torch.tensor(singular, dtype=U.dtype)) @ V)[None].requires_grad_()
    assert gradcheck(NearestRotation.apply, [M])


def test_gradient_of_points_on_a_line_is_finite():
    line = torch.tensor([[0.0], [0.0], [1.0]], dtype=torch.float64) * torch.linspace(-1, 1, 9)
    z_a, z_b = line[None].clone().requires_grad_(), line[None].roll(1, 1)
    R, t = horn(z_a, z_b)
    (R.sum() + t.sum()).backward()
    assert z_a.grad.isfinite().all()


def test_codes_are_aligned_by_all_their_latent_points():
    rng = np.random.default_rng(0)
    T_b_a = random_transform(rng)
    codes_a = [make_code(random_transform(rng), category) for category in ("mug", "bottle")]
    codes_b = [code.transformed(T_b_a) for code in codes_a]
    np.testing.assert_allclose(align_latents(codes_a, codes_b), T_b_a, atol=1e-9)

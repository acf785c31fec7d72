"""Horn's closed form between latent points with known correspondence, differentiable (NeuSE eq. 5)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from neuse.embedding.code import Code
from neuse.geometry import Array, make_transform

FLATTEST = 1e-3  # sums of singular values count as no less than this share of the largest, going back


def horn(z_a: Tensor, z_b: Tensor) -> tuple[Tensor, Tensor]:
    """R_b_a (B, 3, 3) and t_b_a (B, 3) of least |R z_a + t - z_b|^2, for z (B, 3, k)."""
    center_a, center_b = z_a.mean(-1, keepdim=True), z_b.mean(-1, keepdim=True)
    R_b_a = NearestRotation.apply((z_b - center_b) @ (z_a - center_a).mT)
    return R_b_a, (center_b - R_b_a @ center_a)[..., 0]


class NearestRotation(torch.autograd.Function):
    """R of the largest trace(R^T M), for (B, 3, 3) moments M = R P with P symmetric.

    From R^T dM - dM^T R = W P + P W with W = R^T dR, solved in the singular basis; the gradient of the
    decomposition itself would blow up wherever two singular values are alike, which does not matter to R.
    """

    @staticmethod
    def forward(ctx: Any, M: Tensor) -> Tensor:
        """(B, 3, 3) -> (B, 3, 3), determinant +1."""
        U, s, Vt = torch.linalg.svd(M)
        sign = torch.ones_like(s)
        sign[..., 2] = torch.det(U @ Vt).sign()
        U = U * sign[..., None, :]
        ctx.save_for_backward(U, s * sign, Vt)
        return U @ Vt

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        """Bounded where the points are nearly on a line and R is not determined."""
        U, s, Vt = ctx.saved_tensors
        G = U.mT @ gradient @ Vt.mT
        sums = torch.maximum(s[..., :, None] + s[..., None, :], FLATTEST * s[..., :1, None])
        return U @ ((G - G.mT) / sums.clamp(min=1e-12)) @ Vt


def align_latents(codes_a: Sequence[Code], codes_b: Sequence[Code]) -> Array:
    """T_b_a from all latent points of the same objects in two views, as the paper does it (NeuSE eq. 5)."""
    z_a, z_b = (np.concatenate([code.z for code in codes]).T for codes in (codes_a, codes_b))
    R_b_a, t_b_a = horn(torch.from_numpy(z_a)[None], torch.from_numpy(z_b)[None])
    return make_transform(R_b_a[0].numpy(), t_b_a[0].numpy())

"""The paper's losses of transforms and shapes (NeuSE III-B, C); in network units (0.1 m)."""

import torch
from torch import Tensor
from torch.nn import functional as F

from neuse.embedding.dataset import Batch
from neuse.embedding.encoder import Encoding
from neuse.embedding.horn import horn
from neuse.embedding.losses import orthonormal
from neuse.symmetry import Symmetry

ORBIT = 8  # equivalent views N; the paper has 180, and sums where we take the mean


def paper_losses(encoding: Encoding, batch: Batch, symmetry: Symmetry) -> dict[str, Tensor]:
    """L_transform of either kind over all pairs of views of a shape, and L_b_shape.

    The paper knows axial symmetry alone; any other is taken for none.
    """
    a, b = pairs_of_views(batch.shape)
    R, t = horn(encoding.z[a], encoding.z[b])
    if symmetry.ambiguous:
        orbit = equivalent_views(batch.surface[a], batch.target[a], ORBIT)  # (P, N, S, 3)
        transform = ambiguous_loss(R, t, orbit, batch.surface[b])
    else:
        transform = unambiguous_loss(R, t, *relative_pose(batch.target[a], batch.target[b]))
    return {"transform": transform, "shape": batch_hard_loss(encoding.descriptor, batch.shape)}


def pairs_of_views(shape: Tensor) -> tuple[Tensor, Tensor]:
    """Indices of all pairs of views of one shape, from (B,) shapes."""
    same = shape[:, None] == shape[None]
    a, b = torch.triu(same, 1).nonzero(as_tuple=True)
    return a, b


def relative_pose(target_a: Tensor, target_b: Tensor) -> tuple[Tensor, Tensor]:
    """True R_b_a (P, 3, 3) and t_b_a (P, 3) from centres and scaled axes (P, 3, 4) of unambiguous objects.

    The frames have the camera's axes and the partial centre as origin: in the camera's own, an error of
    rotation times the range would drown the object's translation.
    """
    R_b_a = orthonormal(target_b, False) @ orthonormal(target_a, False).mT
    return R_b_a, target_b[..., 0] - (R_b_a @ target_a[..., :1])[..., 0]


def unambiguous_loss(R: Tensor, t: Tensor, R_true: Tensor, t_true: Tensor) -> Tensor:
    """L^uab: |R R_true^T - I|_F^2 + |t - t_true|^2."""
    excess = R @ R_true.mT - torch.eye(3, dtype=R.dtype, device=R.device)
    return (excess.square().sum((-2, -1)) + (t - t_true).square().sum(-1)).mean()


def ambiguous_loss(R: Tensor, t: Tensor, orbit_a: Tensor, surface_b: Tensor) -> Tensor:
    """L^amb: Chamfer distance of equivalent views (P, N, S, 3), aligned, to the object (P, S, 3)."""
    moved = orbit_a @ R.mT[:, None] + t[:, None, None]  # (P, N, S, 3)
    return chamfer_distance(moved.flatten(0, 1), surface_b.repeat_interleave(orbit_a.shape[1], 0)).mean()


def equivalent_views(surface: Tensor, target: Tensor, n: int) -> Tensor:
    """(P, N, S, 3): the object (P, S, 3) turned about its axis in n even steps, the first of them zero."""
    center, axis = target[..., 0], F.normalize(target[..., 3], dim=-1)
    angles = torch.arange(n, dtype=surface.dtype, device=surface.device) * (2 * torch.pi / n)
    cos, sin = angles.cos()[:, None, None], angles.sin()[:, None, None]
    offset, axis = (surface - center[:, None])[:, None], axis[:, None, None]  # (P, 1, S, 3), (P, 1, 1, 3)
    along = (offset * axis).sum(-1, keepdim=True) * axis
    across = torch.linalg.cross(axis.expand_as(offset), offset)
    return center[:, None, None] + along + cos * (offset - along) + sin * across


def chamfer_distance(a: Tensor, b: Tensor) -> Tensor:
    """CD (B,): mean squared distances to the nearest point, both ways, of clouds (B, S, 3)."""
    with torch.no_grad():
        distance = torch.cdist(a, b)  # (B, S_a, S_b)
        to_b, to_a = distance.argmin(2), distance.argmin(1)
    there = (a - b.take_along_dim(to_b[..., None], 1)).square().sum(-1).mean(-1)
    back = (b - a.take_along_dim(to_a[..., None], 1)).square().sum(-1).mean(-1)
    return there + back


def batch_hard_loss(descriptor: Tensor, shape: Tensor) -> Tensor:
    """L_b_shape: least alike view of the same shape against most alike of any other; (B, k) unit, (B,)."""
    similarity = descriptor @ descriptor.T
    same = shape[:, None] == shape[None]
    hardest_positive = similarity.masked_fill(~same, torch.inf).amin(-1)
    hardest_negative = similarity.masked_fill(same, -torch.inf).amax(-1)
    return (hardest_negative - hardest_positive).mean()

"""What the cloud looks like around a point: Gaussian moments at several scales, as vectors and invariants."""

import torch
from torch import Tensor

SCALES = (0.24, 0.12, 0.06)  # standard deviations in network units (0.1 m), each half of the one before
FLOOR = 0.02  # added to the trace of a covariance, in squared scales
CHUNK = 8  # clouds at a time on a CPU: their pairwise distances fit the cache
N_VECTORS = 1 + 3 * len(SCALES)
N_INVARIANTS = 1 + 6 * len(SCALES)


@torch.no_grad()
def local_geometry(points: Tensor, n_anchors: int) -> tuple[Tensor, Tensor]:
    """Equivariant and invariant features of the first `n_anchors` points.

    For each scale, all points weighted by a Gaussian around the anchor have a mass, a mean offset m and a
    covariance C (normalised to unit trace: for a plane with normal n it is (I - n n^T) / 2, so that C x
    knows the normal).

    Args:
        points: (B, N, 3) centred clouds in network units; the features are differences of nearly
            equal moments, so that in float64 they turn with the cloud to seven digits, in float32 to four.
    Returns:
        vectors (B, M, 3, N_VECTORS): x and per scale m, C x, C C x;  invariants (B, M, N_INVARIANTS).
    """
    device = points.device.type
    with torch.autocast(device, enabled=False):
        parts = points.split(CHUNK if device == "cpu" else len(points))
        vectors, invariants = zip(*(_chunk(part, n_anchors) for part in parts), strict=True)
    return torch.cat(vectors).float(), torch.cat(invariants).float()


def _chunk(points: Tensor, n_anchors: int) -> tuple[Tensor, Tensor]:
    x = points[:, :n_anchors]  # (B, M, 3)
    weight = _squared_distances(x, points).mul_(-0.5 / SCALES[0] ** 2).exp_()  # (B, M, N)
    products = points[..., :, None] * points[..., None, :]  # (B, N, 3, 3)
    monomials = (
        torch.cat([torch.ones_like(points[..., :1]), points, products.flatten(-2)], -1) / points.shape[1]
    )
    vectors, invariants = [x], [x.norm(dim=-1, keepdim=True)]
    for scale in SCALES:
        torch.threshold_(weight, 1e-9, 0.0)  # its powers would be denormal, and slow
        moments = weight @ monomials  # (B, M, 13)
        mass = moments[..., :1].clamp(min=1e-6)
        mean = moments[..., 1:4] / mass
        C = (moments[..., 4:] / mass).unflatten(-1, (3, 3)) - mean[..., :, None] * mean[..., None, :]
        trace = C.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True).clamp(min=0.0)  # (B, M, 1)
        C = C / (trace + FLOOR * scale**2)[..., None]  # a lone point has no shape
        offset = (mean - x) / scale
        Cx = (C @ x[..., None])[..., 0]
        CCx = (C @ Cx[..., None])[..., 0]
        vectors += [offset, Cx, CCx]
        invariants += [
            mass.clamp(min=1e-4).log() / 4,
            (trace / scale**2 + 1e-6).sqrt(),
            C.square().sum((-2, -1))[..., None],
        ]
        invariants += [offset.norm(dim=-1, keepdim=True), _dot(offset, x), _dot(x, Cx)]
        weight.mul_(weight).mul_(weight)  # half the scale is the fourth power
    return torch.stack(vectors, -1), torch.cat(invariants, -1)


def _squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """(B, M, 3), (B, N, 3) -> (B, M, N)."""
    squares = a.square().sum(-1)[..., None], b.square().sum(-1)[:, None]
    return torch.baddbmm(squares[0] + squares[1], a, b.mT, alpha=-2).clamp_(min=0)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1, keepdim=True)

"""What the cloud looks like around a point: Gaussian moments at several scales, as vectors and invariants."""

import torch
from torch import Tensor

SCALES = (0.24, 0.12, 0.06)  # standard deviations in network units (0.1 m), each half of the one before
FLOOR = 0.02  # added to the trace of a covariance, in squared scales
LEAST_LOG = -40.0  # of a weight at the first scale: its 16th power, at the last, is not yet denormal and slow
CHUNK = 1  # clouds at a time on a CPU: the weights of their pairs fit the cache
N_VECTORS = 1 + 3 * len(SCALES)
N_INVARIANTS = 1 + 6 * len(SCALES)

# Components lie first in memory and points last, so that every operation runs along the points.
ROWS, COLUMNS = (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)  # of the six entries of a symmetric matrix
ENTRIES = (0, 1, 2, 1, 3, 4, 2, 4, 5)  # which of the six are its nine
DIAGONAL = (0, 3, 5)


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
    with torch.autocast(points.device.type, enabled=False):
        anchors = points[:, :n_anchors]
        return _features(anchors.permute(2, 0, 1), _moments(points, anchors))


def _moments(points: Tensor, anchors: Tensor) -> Tensor:
    """Around each anchor and at each scale the weighted means over N of 1, p and p p^T: (10, S, B, M)."""
    p, squares = points.mT, points.square().sum(-1, keepdim=True)  # (B, 3, N), (B, N, 1)
    one, M = torch.ones_like(squares), anchors.shape[1]
    monomials = torch.cat([one.mT, p, p[:, ROWS] * p[:, COLUMNS]], 1) / points.shape[1]  # (B, 10, N)
    left = torch.cat([points, squares, one], -1) / SCALES[0] ** 2  # (B, N, 5)
    right = torch.cat([anchors, -0.5 * one[:, :M], -0.5 * squares[:, :M]], -1).mT  # (B, 5, M)
    moments = points.new_empty(len(SCALES), len(points), 10, M)
    chunk = CHUNK if points.device.type == "cpu" else len(points)
    weights = points.new_empty(chunk, points.shape[1], M)
    parts = (left.split(chunk), right.split(chunk), monomials.split(chunk), moments.split(chunk, 1))
    for a, b, of_points, around_anchors in zip(*parts, strict=True):
        torch.bmm(a, b, out=weights).clamp_(LEAST_LOG, 0.0).exp_()
        for i, at_scale in enumerate(around_anchors):
            if i > 0:
                weights.square_().square_()  # half the scale is the fourth power
            torch.bmm(of_points, weights, out=at_scale)
    return moments.permute(2, 0, 1, 3)


def _features(x: Tensor, moments: Tensor) -> tuple[Tensor, Tensor]:
    """From anchors (3, B, M) and their moments (10, S, B, M), as `local_geometry` returns them."""
    mass = moments[0]  # (S, B, M), of an anchor alone 1 / N
    mean, squares = moments[1:4] / mass, moments[4:] / mass
    C = (squares - mean[ROWS,] * mean[COLUMNS,]).float()  # (6, S, B, M)
    scales = C.new_tensor(SCALES)[:, None, None]
    offset, x = (mean - x[:, None]).float() / scales, x[:, None].float()  # (3, S, B, M), (3, 1, B, M)
    trace = C[DIAGONAL,].sum(0).clamp(min=0.0)
    C = (C / (trace + FLOOR * scales**2))[ENTRIES,].unflatten(0, (3, 3))  # a lone point has no shape
    Cx = (C * x).sum(1)
    CCx = (C * Cx).sum(1)
    vectors = torch.stack([offset, Cx, CCx], 2).flatten(1, 2)  # (3, 3 S, B, M)
    invariants = [mass.float().log() / 4, (trace / scales**2 + 1e-6).sqrt(), C.square().sum((0, 1))]
    invariants += [_norm(offset), (offset * x).sum(0), (x * Cx).sum(0)]
    by_scale = torch.stack(invariants, 1).flatten(0, 1)  # (6 S, B, M)
    return (
        torch.cat([x, vectors], 1).permute(2, 3, 0, 1),  # (B, M, 3, v)
        torch.cat([_norm(x), by_scale]).permute(1, 2, 0),  # (B, M, i)
    )


def _norm(v: Tensor) -> Tensor:
    return v.square().sum(0).sqrt()

"""Figures of a network on held-out views, quick enough to follow a training run."""

import numpy as np
import torch
from torch import Tensor

from neuse.embedding.dataset import Batch, ViewSet
from neuse.embedding.encoder import Encoding
from neuse.embedding.horn import horn
from neuse.embedding.losses import frame_error, nearest_equivalent
from neuse.embedding.network import UNIT_M, Network
from neuse.symmetry import NONE

HANDLE_SEEN = 0.03  # share of the seen points that are on the handle


@torch.no_grad()
def encode_all(network: Network, views: ViewSet, n_views: int, chunk: int = 64) -> tuple[Encoding, Batch]:
    """Encodings of every (len / n_views)-th view, and the batch that they are of."""
    index = np.linspace(0, len(views) - 1, min(n_views, len(views))).astype(int)
    batch = views.batch(index, network.config.n_points, 512, np.random.default_rng(0)).to(network.device)
    parts = [network.encode(points) for points in batch.points.split(chunk)]
    return Encoding(*(torch.cat(column) for column in zip(*parts, strict=True))), batch


@torch.no_grad()
def decode_all(network: Network, encoding: Encoding, batch: Batch, chunk: int = 64) -> Tensor:
    """Occupancy logits (B, Q) of the batch's queries."""
    parts = [
        network.decode(Encoding(*(part[i : i + chunk] for part in encoding)), batch.queries[i : i + chunk])
        for i in range(0, len(batch.queries), chunk)
    ]
    return torch.cat(parts)


def validate(network: Network, views: ViewSet, n_views: int = 1024) -> dict[str, float]:
    """Medians of pose errors (deg, mm), equal error rate and occupancy IoU on held-out views.

    Poses are those of single views where the network predicts object frames, else of pairs of views.
    """
    encoding, batch = encode_all(network, views, n_views)
    predicted, is_predicted = predicted_frames(network, encoding, batch)
    target = nearest_equivalent(predicted, batch.target, network.symmetry)
    error = frame_error(predicted, target, network.ambiguous)
    angle = torch.rad2deg(error.rotation.norm(dim=-1)).cpu().numpy()
    axis = torch.rad2deg(error.rotation[:, :2].norm(dim=-1)).cpu().numpy()
    shift_mm = error.translation.norm(dim=-1).cpu().numpy() * UNIT_M * 1e3
    used = is_predicted.cpu().numpy()
    seen = used & _well_seen(views, batch.view.cpu().numpy())
    occupied = batch.occupied.cpu().numpy()
    inside = (decode_all(network, encoding, batch) > network.occupancy_logit).cpu().numpy()
    return {
        "deg_seen": _percentile(angle[seen], 50),
        "deg_seen_p90": _percentile(angle[seen], 90),
        "deg_all": _percentile(angle[used], 50),
        "axis_seen": _percentile(axis[seen], 50),
        "mm_seen": _percentile(shift_mm[seen], 50),
        "mm_all": _percentile(shift_mm[used], 50),
        "eer": equal_error_rate(encoding.descriptor.cpu().numpy(), batch.shape.cpu().numpy()),
        "iou": float((inside & occupied).sum() / (inside | occupied).sum()),
    }


def predicted_frames(network: Network, encoding: Encoding, batch: Batch) -> tuple[Tensor, Tensor]:
    """Object frames (B, 3, 4), and for which views (B,) there is one.

    The paper's codes give relative poses alone: they carry the true frame from another view of the shape.
    """
    if network.architecture == "shipped":
        return encoding.frame, torch.ones_like(batch.shape, dtype=torch.bool)
    other = next_view(batch.shape)
    R, t = horn(encoding.z[other], encoding.z)
    frame = R @ batch.target[other]
    frame[..., 0] += t
    return frame, other != torch.arange(len(other), device=other.device)


def next_view(shape: Tensor) -> Tensor:
    """(B,) the next view of the same shape, (B,), around the end; itself where it is the only one."""
    n = len(shape)
    place = torch.arange(n, device=shape.device)
    ahead = (place[None] - place[:, None] - 1) % n  # of itself n - 1
    return torch.where(shape[:, None] == shape[None], ahead, n).argmin(1)


def _well_seen(views: ViewSet, index: np.ndarray) -> np.ndarray:
    a = views.arrays
    seen = (a["visible"][index] > 0.6) & (a["noise_m"][index] < 0.004)
    return seen & (a["handle"][index] > HANDLE_SEEN) if views.symmetry is NONE else seen


def _percentile(values: np.ndarray, q: float) -> float:
    return float(np.percentile(values, q)) if len(values) else float("nan")


def equal_error_rate(descriptor: np.ndarray, shape: np.ndarray) -> float:
    """The share of like pairs refused where as many unlike ones are accepted; from (n, k) and (n,).

    NaN where there are no like or no unlike pairs.
    """
    similarity = descriptor @ descriptor.T
    upper = np.triu_indices(len(shape), 1)
    same = (shape[:, None] == shape[None])[upper]
    if same.all() or not same.any():
        return float("nan")
    order = np.argsort(-similarity[upper], kind="stable")
    accepted_true = np.cumsum(same[order]) / same.sum()
    accepted_false = np.cumsum(~same[order]) / (~same).sum()
    crossing = int(np.argmax(accepted_false >= 1 - accepted_true))
    return float(accepted_false[crossing])

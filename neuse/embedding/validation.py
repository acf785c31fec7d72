"""Figures of a network on held-out views, quick enough to follow a training run."""

import numpy as np
import torch
from torch import Tensor

from neuse.embedding.dataset import Batch, ViewSet
from neuse.embedding.encoder import Encoding
from neuse.embedding.losses import frame_error
from neuse.embedding.network import UNIT_M, Network

HANDLE_SEEN = 0.03  # share of the seen points that are on the handle


@torch.no_grad()
def encode_all(network: Network, views: ViewSet, n_views: int, chunk: int = 64) -> tuple[Encoding, Batch]:
    """Encodings of every (len / n_views)-th view, and the batch that they are of."""
    index = np.linspace(0, len(views) - 1, min(n_views, len(views))).astype(int)
    batch = views.batch(index, network.config.n_points, 512, np.random.default_rng(0))
    parts = [network.encode(batch.points[i : i + chunk]) for i in range(0, len(index), chunk)]
    return Encoding(*(torch.cat(column) for column in zip(*parts, strict=True))), batch


@torch.no_grad()
def decode_all(network: Network, encoding: Encoding, batch: Batch, chunk: int = 64) -> Tensor:
    """Occupancy logits (B, Q) of the batch's queries."""
    z = network.latent(encoding)
    center = encoding.frame[..., 0]
    x = batch.queries - center[:, None]
    z = z - center[..., None]
    return torch.cat([network.decoder(x[i : i + chunk], z[i : i + chunk]) for i in range(0, len(z), chunk)])


def validate(network: Network, views: ViewSet, n_views: int = 1024) -> dict[str, float]:
    """Medians of single-view errors (deg, mm), equal error rate and occupancy IoU on held-out views."""
    network.eval()
    encoding, batch = encode_all(network, views, n_views)
    error = frame_error(encoding.frame, batch.target, network.ambiguous)
    angle = torch.rad2deg(error.rotation.norm(dim=-1)).numpy()
    shift_mm = error.translation.norm(dim=-1).numpy() * UNIT_M * 1e3
    index = batch.view.numpy()
    seen = (views.arrays["visible"][index] > 0.6) & (views.arrays["noise_m"][index] < 0.004)
    if not network.ambiguous:
        seen &= views.arrays["handle"][index] > HANDLE_SEEN
    axis = torch.rad2deg(error.rotation[:, :2].norm(dim=-1)).numpy()
    occupied = batch.occupied.numpy()
    predicted = decode_all(network, encoding, batch).numpy() > float(network.occupancy_logit)
    network.train()
    return {
        "deg_seen": _percentile(angle[seen], 50),
        "deg_seen_p90": _percentile(angle[seen], 90),
        "deg_all": _percentile(angle, 50),
        "axis_seen": _percentile(axis[seen], 50),
        "mm_seen": _percentile(shift_mm[seen], 50),
        "mm_all": _percentile(shift_mm, 50),
        "eer": equal_error_rate(encoding.descriptor.numpy(), batch.shape.numpy()),
        "iou": float((predicted & occupied).sum() / (predicted | occupied).sum()),
    }


def _percentile(values: np.ndarray, q: float) -> float:
    return float(np.percentile(values, q)) if len(values) else float("nan")


def equal_error_rate(descriptor: np.ndarray, shape: np.ndarray) -> float:
    """The share of like pairs refused where as many unlike ones are accepted; from (n, k) and (n,)."""
    similarity = descriptor @ descriptor.T
    upper = np.triu_indices(len(shape), 1)
    same = (shape[:, None] == shape[None])[upper]
    order = np.argsort(-similarity[upper], kind="stable")
    accepted_true = np.cumsum(same[order]) / same.sum()
    accepted_false = np.cumsum(~same[order]) / (~same).sum()
    crossing = int(np.argmax(accepted_false >= 1 - accepted_true))
    return float(accepted_false[crossing])

"""After training: make the predicted uncertainties and the occupancy threshold right on held-out shapes."""

import numpy as np
import torch

from neuse.embedding.dataset import ViewSet
from neuse.embedding.losses import frame_error, nearest_equivalent
from neuse.embedding.network import Network
from neuse.embedding.validation import decode_all, encode_all


@torch.no_grad()
def calibrate(network: Network, views: ViewSet, n_views: int = 2048) -> None:
    """Set `sigma_scale` and `occupancy_logit` of the network from held-out views, in place."""
    encoding, batch = encode_all(network, views, n_views)
    if network.architecture == "shipped":  # the paper's has no uncertainties
        target = nearest_equivalent(encoding.frame, batch.target, network.symmetry)
        error = frame_error(encoding.frame, target, network.ambiguous)
        normalised = error.components * torch.exp(-encoding.log_sigmas)
        # a robust spread, blind to flipped frames: 80 % of a normal distribution lie within 1.2816 sigmas
        spread = normalised.abs().quantile(0.8, dim=0) / 1.2816
        network.sigma_scale.copy_(spread.clamp(0.3, 5.0))
    logits, occupied = decode_all(network, encoding, batch).cpu().numpy(), batch.occupied.cpu().numpy()
    thresholds = np.linspace(-2.0, 0.5, 26)
    best = np.argmax([_iou(logits > threshold, occupied) for threshold in thresholds])
    network.occupancy_logit.fill_(float(thresholds[best]))


def _iou(predicted: np.ndarray, occupied: np.ndarray) -> float:
    return float((predicted & occupied).sum() / max((predicted | occupied).sum(), 1))

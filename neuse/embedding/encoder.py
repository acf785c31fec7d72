"""The encoder: a centred partial cloud to latent points, a shape descriptor and uncertainties.

Each object keeps C_g global vector neurons G. Every block reads the points in the frame that G spans (inner
products: invariant numbers per point), thinks about them with a residual MLP and pooled concatenation, and
pools the points' vectors with the weights it arrived at into better G. All vector work is done once an
object instead of once a point, so that the net is a plain MLP in speed and exactly SO(3)-equivariant all the
same.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from neuse.embedding.code import landmark_template
from neuse.embedding.layers import VNLinear
from neuse.embedding.local_geometry import N_INVARIANTS, N_VECTORS, local_geometry

N_SIGMAS = 7
TINY = 1e-12  # a square to which the root has a slope


@dataclass(frozen=True)
class EncoderConfig:
    """Sizes of the encoder."""

    n_latent: int = 128  # k, latent points
    n_points: int = 512  # points an object is given by
    n_anchors: int = 256  # points that carry features
    width: int = 128  # scalar channels
    n_vectors: int = 48  # global vector neurons C_g
    n_weights: int = 24  # pooling weights a point has
    n_blocks: int = 6


class Encoding(NamedTuple):
    """Outputs for a batch, in network units (0.1 m), relative to the partial centre.

    z: (B, 3, k) latent points, z_0 of the paper.    frame: (B, 3, 4) centre and scaled axes [c, E_x, E_y,
    E_z] that the landmarks, the first half of z, span.    descriptor: (B, k) unit vectors.    log_sigmas:
    (B, 7) of the rotation about x, y, z, the shift along x and y, and the places of top and bottom along z.
    """

    z: Tensor
    frame: Tensor
    descriptor: Tensor
    log_sigmas: Tensor


class FrameBlock(nn.Module):
    """One round of read, think, pool."""

    def __init__(self, config: EncoderConfig) -> None:
        super().__init__()
        width, n_vectors, n_weights = config.width, config.n_vectors, config.n_weights
        self.read = VNLinear(n_vectors, N_VECTORS * width, gain=0.3)
        self.partner = VNLinear(n_vectors, n_vectors)
        self.context = nn.Linear(2 * n_vectors + width, width)
        self.norm = nn.LayerNorm(width)
        self.inner, self.outer = nn.Linear(width, width), nn.Linear(width, width)
        nn.init.normal_(self.outer.weight, std=0.3 * width**-0.5)
        self.weigh = nn.Linear(width, n_weights)
        self.cross_a, self.cross_b = VNLinear(n_vectors, n_vectors), VNLinear(n_vectors, n_vectors)
        self.update = VNLinear(n_weights * N_VECTORS + 2 * n_vectors, n_vectors)
        self.gate = nn.Linear(width, n_vectors)

    def forward(self, s: Tensor, mean: Tensor, vectors: Tensor, G: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """s (B, M, width) invariants of the points, their mean (B, width), vectors (B, M, 3 v), G (B, 3, C_g)
        -> new s, mean and G."""
        squares = G.square().sum(1)  # (B, C_g)
        scale = (squares.mean(-1) + 1e-4).sqrt()[:, None, None]  # (B, 1, 1)
        unit = G / scale
        products, lengths = (unit * self.partner(unit)).sum(1), (squares + TINY).sqrt()  # (B, C_g) each
        context = self.context(torch.cat([products, lengths, mean.float()], -1))  # (B, width)
        lens = self.read(unit).unflatten(-1, (N_VECTORS, -1)).flatten(1, 2)  # (B, 3 v, width)
        seen = torch.baddbmm(context[:, None], vectors, lens)  # (B, M, width)
        s = self.outer(F.silu(self.inner(self.norm(s)).add_(seen))).add_(s)
        mean = s.mean(1)  # (B, width)
        pooled = pool_vectors(self.weigh(F.silu(s)), vectors)  # (B, 3, n_weights v)
        cross = torch.linalg.cross(self.cross_a(unit), self.cross_b(unit), dim=1) * scale  # (B, 3, C_g)
        gate = torch.sigmoid(self.gate(mean))[:, None]  # (B, 1, C_g)
        return s, mean, G + gate * self.update(torch.cat([pooled, G, cross], -1))


def pool_vectors(weights: Tensor, vectors: Tensor) -> Tensor:
    """Weighted means over the points: weights (B, M, w), vectors (B, M, 3 v) -> (B, 3, w v)."""
    pooled = torch.bmm(weights.float().mT, vectors) / weights.shape[1]  # (B, w, 3 v)
    return pooled.unflatten(-1, (3, -1)).transpose(1, 2).flatten(2)  # (B, 3, w v)


class Encoder(nn.Module):
    """f_theta of NeuSE eq. 2 on a centred cloud (the caller adds the partial centre back)."""

    template: Tensor

    def __init__(self, config: EncoderConfig, ambiguous: bool) -> None:
        super().__init__()
        self.config, self.ambiguous = config, ambiguous
        width, n_vectors = config.width, config.n_vectors
        self.embed = nn.Linear(N_INVARIANTS, width)
        self.weigh = nn.Linear(width, config.n_weights)
        self.start = VNLinear(config.n_weights * N_VECTORS, n_vectors, gain=3.0)
        self.blocks = nn.ModuleList(FrameBlock(config) for _ in range(config.n_blocks))
        self.to_frame = VNLinear(n_vectors, 4)
        self.to_free = VNLinear(n_vectors, config.n_latent // 2)
        summary = 2 * width + n_vectors
        self.to_descriptor = _head(summary, 2 * width, config.n_latent)
        self.to_sigmas = _head(summary, width, N_SIGMAS)
        template = torch.tensor(landmark_template(config.n_latent), dtype=torch.float32)
        self.register_buffer("template", template, persistent=False)

    def forward(self, points: Tensor, n_anchors: int) -> Encoding:
        """(B, N, 3) centred clouds in network units -> Encoding."""
        return self.understand(*local_geometry(points, n_anchors))

    def understand(self, vectors: Tensor, invariants: Tensor) -> Encoding:
        """Local geometry of M points, vectors (B, M, 3, v) and invariants (B, M, i), -> Encoding."""
        vectors = vectors.flatten(2)  # (B, M, 3 v)
        s = self.embed(invariants)  # (B, M, width)
        mean = s.mean(1)  # (B, width)
        G = self.start(pool_vectors(self.weigh(F.silu(s)), vectors))  # (B, 3, C_g)
        for block in self.blocks:
            s, mean, G = block(s, mean, vectors, G)
        summary = torch.cat([mean.float(), s.amax(1).float(), G.norm(dim=1)], -1)
        frame = self.to_frame(G)  # (B, 3, 4)
        if self.ambiguous:
            frame = frame * frame.new_tensor([1.0, 0.0, 0.0, 1.0])
        descriptor = F.normalize(self.to_descriptor(summary).float(), dim=-1)
        z = torch.cat([self.landmarks(frame), self.to_free(G)], -1)  # (B, 3, k)
        return Encoding(z, frame, descriptor, self.to_sigmas(summary.detach()).float())

    def landmarks(self, frame: Tensor) -> Tensor:
        """(B, 3, k // 2) points c + E a_j."""
        with torch.autocast(frame.device.type, enabled=False):
            return frame[..., :1] + frame[..., 1:] @ self.template.T


def _head(n_in: int, n_hidden: int, n_out: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(n_in, n_hidden), nn.SiLU(), nn.Linear(n_hidden, n_out))

"""The paper's own encoder: a residual point net of vector neurons (NeuSE appendix, table Encoder).

An edge layer over nearest neighbours lifts points to channels of vectors; residual blocks see each point
beside the mean over all points; their mean over the points becomes the latent points.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from neuse.embedding.code import landmark_template
from neuse.embedding.encoder import N_SIGMAS, Encoding
from neuse.embedding.layers import VNLeakyReLU, VNLinear, VNResnetBlock


@dataclass(frozen=True)
class PaperEncoderConfig:
    """Sizes of the encoder; the defaults are the paper's."""

    n_latent: int = 512  # k, latent points
    n_points: int = 500  # points an object is given by
    n_anchors: int = 500  # points that carry features
    width: int = 128  # channels of vectors
    n_blocks: int = 5
    n_neighbors: int = 10  # of an anchor in the edge layer


class PaperEncoder(nn.Module):
    """f_theta of NeuSE eq. 4 on a centred cloud (the caller adds the partial centre back)."""

    template: Tensor

    def __init__(self, config: PaperEncoderConfig, ambiguous: bool) -> None:
        super().__init__()
        self.config, width = config, config.width
        self.edge = nn.Sequential(VNLinear(3, width, gain=10.0), VNLeakyReLU(width))
        self.lift = VNLinear(width, 2 * width)
        self.blocks = nn.ModuleList(VNResnetBlock(2 * width, width) for _ in range(config.n_blocks))
        self.to_latent = nn.Sequential(VNLeakyReLU(width), VNLinear(width, config.n_latent, gain=6.0))
        template = torch.tensor(landmark_template(config.n_latent), dtype=torch.float32)
        self.register_buffer("template", template, persistent=False)

    def forward(self, points: Tensor, n_anchors: int) -> Encoding:
        """(B, N, 3) centred clouds in network units -> Encoding, whose sigmas say nothing."""
        edges = edge_vectors(points, n_anchors, self.config.n_neighbors)  # (B, M, K, 3, 3)
        v = self.lift(self.edge(edges).mean(2))  # (B, M, 3, 2 width)
        for block in self.blocks:
            v = block(v)  # (B, M, 3, width)
            pooled = v.mean(1, keepdim=True)  # (B, 1, 3, width)
            v = torch.cat([v, pooled.expand_as(v)], -1)  # (B, M, 3, 2 width)
        z = _with_common_center(self.to_latent(pooled[:, 0]))  # (B, 3, k)
        descriptor = F.normalize(z.norm(dim=1), dim=-1)  # s_i = |z_i|
        return Encoding(z, self.frame(z), descriptor, z.new_zeros(len(z), N_SIGMAS))

    def frame(self, z: Tensor) -> Tensor:
        """(B, 3, 4) centre and axes that `Code` reads from the first half of z; they turn with z, no more."""
        center = z.mean(-1, keepdim=True)
        landmarks = z[..., : len(self.template)]
        return torch.cat([center, (landmarks - center) @ self.template * (3.0 / len(self.template))], -1)


def edge_vectors(points: Tensor, n_anchors: int, n_neighbors: int) -> Tensor:
    """Differences, the anchor itself and their cross product (DGCNN; Wang et al. 2019), float32.

    Args:
        points: (B, N, 3); neighbours of the first M = `n_anchors` are sought in the precision given, so that
            in float64 hardly any rotation exchanges them.
    Returns:
        (B, M, K, 3, 3), vectors then channels.
    """
    anchors = points[:, :n_anchors]  # (B, M, 3)
    nearest = torch.cdist(anchors, points).topk(n_neighbors, largest=False).indices  # (B, M, K)
    batch = torch.arange(len(points), device=points.device)[:, None, None]
    difference = points[batch, nearest] - anchors[:, :, None]  # (B, M, K, 3)
    anchor = anchors[:, :, None].expand_as(difference)
    cross = torch.linalg.cross(difference, anchor)
    return torch.stack([difference, anchor, cross], -1).float()  # (B, M, K, 3, 3)


def _with_common_center(z: Tensor) -> Tensor:
    """z with either half shifted to the mean of all, so that the centre can be read from the landmarks."""
    halves = z.unflatten(-1, (2, -1))  # (B, 3, 2, k / 2)
    return (halves - halves.mean(-1, keepdim=True) + z.mean(-1)[..., None, None]).flatten(-2)

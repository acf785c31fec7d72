"""The decoder: is a point inside the object? (NeuSE eq. 4, table Decoder)"""

import torch
from torch import Tensor, nn

from neuse.embedding.layers import ResnetBlockFC, VNLinear


class Decoder(nn.Module):
    """Phi(x, z): occupancy logits from inner products <x, z_j>, invariants of z and |x|^2.

    The inner products enter linearly, so (W z) x is computed instead of W (z x): the first layer costs 3 and
    not k multiplications a point and channel.
    """

    def __init__(self, n_latent: int, width: int = 128, n_blocks: int = 5) -> None:
        super().__init__()
        self.partner = VNLinear(n_latent, n_latent)
        self.of_products = nn.Linear(n_latent, width, bias=False)
        self.of_invariants = nn.Linear(n_latent, width)
        self.of_norm = nn.Linear(1, width, bias=False)
        self.blocks = nn.ModuleList(ResnetBlockFC(width) for _ in range(n_blocks))
        self.to_logit = nn.Linear(width, 1)

    def forward(self, x: Tensor, z: Tensor) -> Tensor:
        """x (B, Q, 3) query points, z (B, 3, k) latent points, both relative to the code's centre -> logits
        (B, Q)."""
        lens = self.of_products(z)  # (B, 3, width)
        invariants = (z * self.partner(z)).sum(1)  # (B, k)
        h = torch.baddbmm(self.of_invariants(invariants)[:, None], x, lens)
        h = h + self.of_norm(x.square().sum(-1, keepdim=True))  # (B, Q, width)
        for block in self.blocks:
            h = block(h)
        return self.to_logit(torch.relu(h))[..., 0]

"""The decoder: is a point inside the object? (NeuSE eq. 4, table Decoder)"""

import torch
from torch import Tensor, nn

from neuse.embedding.layers import ResnetBlockFC, VNLinear

CHUNK = 4096  # points at a time: their activations fit the cache


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

    @torch.no_grad()
    def evaluate(self, x: Tensor, z: Tensor, dtype: torch.dtype) -> Tensor:
        """`forward` of many points x (Q, 3) for one code z (3, k): logits (Q,), computed in `dtype`.

        The activations of a chunk stay in three buffers, as fresh memory costs more than the arithmetic, and
        biases of residuals are not added to h but remembered: relu(h + b) = max(h, -b) + b.
        """
        lens = torch.cat([self.of_products(z), self.of_norm.weight.T])  # (4, width)
        constant = self.of_invariants((z * self.partner(z)).sum(0))  # (width,)
        x = torch.cat([x, x.square().sum(-1, keepdim=True)], -1)  # (Q, 4)
        blocks, bias = self._remembering_biases(dtype)
        to_logit, floor = self.to_logit.weight[0].to(dtype), -bias.to(dtype)
        logits = []
        for part in x.split(CHUNK):
            h = torch.addmm(constant, part, lens).to(dtype)  # (chunk, width)
            active, inner = torch.empty_like(h), torch.empty_like(h)
            for least, W_inner, b_inner, W_outer in blocks:
                torch.maximum(h, least, out=active)
                torch.addmm(b_inner, active, W_inner, out=inner).relu_()
                h.addmm_(inner, W_outer)
            logits.append(torch.maximum(h, floor, out=active) @ to_logit)
        return torch.cat(logits).float() + self.to_logit.bias + self.to_logit.weight[0] @ bias

    def _remembering_biases(self, dtype: torch.dtype) -> tuple[list[list[Tensor]], Tensor]:
        """Each block's -b, W_inner^T, b_inner + W_inner b and W_outer^T, where h lacks b; the last b."""
        blocks, bias = [], torch.zeros_like(self.of_invariants.bias)
        for block in self.blocks:
            assert isinstance(block, ResnetBlockFC)
            weights = (-bias, block.inner.weight.T, block.inner(bias), block.outer.weight.T)
            blocks.append([weight.to(dtype) for weight in weights])
            bias = bias + block.outer.bias
        return blocks, bias

"""Vector-neuron layers (Deng et al. 2021) and the plain residual block of the decoder.

A vector feature has shape (..., 3, C): C channels of 3-vectors, channels last so that a linear map of the
channels is one matrix product. Rotating the input rotates every channel, and all layers here commute with
that.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F


class VNLinear(nn.Module):
    """Mixes channels of vectors, (..., 3, C_in) -> (..., 3, C_out); no bias, which would not rotate.

    Vectors are positions in the end, so they stay in float32 under autocast.
    """

    def __init__(self, n_in: int, n_out: int, gain: float = 1.0) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.randn(n_out, n_in) * gain * n_in**-0.5)

    def forward(self, v: Tensor) -> Tensor:
        if not torch.is_autocast_enabled(v.device.type):  # to switch it off takes longer than the product
            return F.linear(v, self.weight)  # (..., 3, C_out)
        with torch.autocast(v.device.type, enabled=False):
            return F.linear(v.float(), self.weight)  # (..., 3, C_out)


class VNLeakyReLU(nn.Module):
    """Bends each channel at the plane normal to a learned direction, (..., 3, C) -> (..., 3, C)."""

    def __init__(self, n: int, slope: float = 0.2) -> None:
        super().__init__()
        self.direction = VNLinear(n, n)
        self.slope = slope

    def forward(self, v: Tensor) -> Tensor:
        d = self.direction(v)
        along = (v * d).sum(-2, keepdim=True)  # (..., 1, C)
        beyond = torch.clamp(along, max=0.0) / (d.square().sum(-2, keepdim=True) + 1e-6)
        return v - (1.0 - self.slope) * beyond * d  # (..., 3, C)


class VNResnetBlock(nn.Module):
    """Residual block of two activated vector linears, (..., 3, C_in) -> (..., 3, C_out)."""

    def __init__(self, n_in: int, n_out: int) -> None:
        super().__init__()
        self.activate_in, self.inner = VNLeakyReLU(n_in), VNLinear(n_in, n_out)
        self.activate_out, self.outer = VNLeakyReLU(n_out), VNLinear(n_out, n_out, gain=0.3)
        self.shortcut = VNLinear(n_in, n_out)

    def forward(self, v: Tensor) -> Tensor:
        return self.shortcut(v) + self.outer(self.activate_out(self.inner(self.activate_in(v))))


class ResnetBlockFC(nn.Module):
    """Residual block of two activated linears, (..., C) -> (..., C)."""

    def __init__(self, n: int) -> None:
        super().__init__()
        self.inner, self.outer = nn.Linear(n, n), nn.Linear(n, n)
        nn.init.zeros_(self.outer.weight)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.outer(F.relu(self.inner(F.relu(x))))

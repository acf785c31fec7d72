"""The encoder as a recorded program: the same operations, without Python between them.

An encoder runs hundreds of small operations a frame; on a CPU a sixth of its time goes into calling them for
five objects, a quarter for two. TorchScript is the one recorder of torch that needs no C++ compiler where the
nodes run.
"""

import warnings

import torch
from torch import Tensor

from neuse.embedding.encoder import Encoder, Encoding
from neuse.embedding.local_geometry import local_geometry


class RecordedEncoder:
    """An encoder to be used, not trained: calls are as of the encoder, which keeps the weights."""

    def __init__(self, encoder: Encoder) -> None:
        seeded = torch.Generator().manual_seed(0)
        points = torch.rand(2, encoder.config.n_points, 3, dtype=torch.float64, generator=seeded)
        with torch.no_grad(), warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # in favour of torch.compile
            example = local_geometry(points, encoder.config.n_anchors)
            self._recorded = torch.jit.trace_module(encoder, {"understand": example}, check_trace=False)

    def __call__(self, points: Tensor, n_anchors: int) -> Encoding:
        """(B, N, 3) centred clouds in network units -> Encoding; B and N as they come."""
        geometry = local_geometry(points, n_anchors)
        with torch.jit.optimized_execution(False):  # to optimise takes seconds and gains nothing
            return Encoding(*self._recorded.understand(*geometry))

"""Losses of the shipped recipe, and errors of object frames; in network units (0.1 m)."""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from neuse.embedding.dataset import Batch
from neuse.embedding.encoder import N_SIGMAS, Encoding
from neuse.symmetry import Symmetry

SOFTNESS = 0.02  # 2 mm: below this an error counts squared, above it by its length


def nearest_equivalent(frame: Tensor, target: Tensor, symmetry: Symmetry) -> Tensor:
    """Of the frames (B, 3, 4) equivalent to the target that for which `frame_loss` is least.

    So the encoder may choose among what looks the same, and is asked no more than that it chooses.
    """
    if len(symmetry.turns) == 1:
        return target
    turns = torch.as_tensor(symmetry.turns).to(target)  # (g, 3, 3)
    axes = target[:, None, :, 1:] @ turns  # (B, g, 3, 3)
    errors = (frame[:, None, :, 1:] - axes).square().sum(2)  # (B, g, 3)
    nearest = (errors + SOFTNESS**2).sqrt().sum(-1).argmin(-1)
    return torch.cat([target[..., :1], axes[torch.arange(len(axes), device=axes.device), nearest]], -1)


def frame_loss(frame: Tensor, target: Tensor) -> Tensor:
    """Distance of centre and scaled axes from the truth, (B, 3, 4) each.

    A length and not a square, so that the many good views still count beside the few hidden handles. Where
    the handle cannot be known the best answer is the mean direction: E_x shrinks.
    """
    error = (frame - target).square().sum(1)  # (B, 4)
    return ((error + SOFTNESS**2).sqrt() - SOFTNESS).sum(-1).mean()


def occupancy_loss(logits: Tensor, occupied: Tensor) -> Tensor:
    """L_occ: cross entropy of (B, Q) logits."""
    return F.binary_cross_entropy_with_logits(logits, occupied.to(logits.dtype))


def shape_contrast_loss(descriptor: Tensor, shape: Tensor, temperature: float = 0.05) -> Tensor:
    """Supervised InfoNCE: views of one shape agree more than views of different shapes; (B, k), (B,)."""
    similarity = descriptor @ descriptor.T / temperature
    self_mask = torch.eye(len(shape), dtype=torch.bool, device=shape.device)
    log_share = similarity.masked_fill(self_mask, -torch.inf).log_softmax(-1)
    positive = (shape[:, None] == shape[None]) & ~self_mask
    return -(log_share[positive]).mean()


class FrameError(NamedTuple):
    """Error of predicted object frames in their own axes: rotation (B, 3) rad, translation (B, 3).

    half_height: (B,) error of the length of E_z. Which end of an object is hidden shows in how it goes with
    the translation along z: the end that is seen is in its place.
    """

    rotation: Tensor
    translation: Tensor
    half_height: Tensor

    @property
    def components(self) -> Tensor:
        """(B, 7) what the sigmas of an Encoding are of."""
        shift = self.translation
        ends = torch.stack([shift[:, 2] + self.half_height, shift[:, 2] - self.half_height], -1)
        return torch.cat([self.rotation, shift[:, :2], ends], -1)


def frame_error(frame: Tensor, target: Tensor, ambiguous: bool) -> FrameError:
    """How far (B, 3, 4) predicted frames are from the truth; about the axis 0 where that is ambiguous."""
    R, R_target = orthonormal(frame, ambiguous), orthonormal(target, ambiguous)
    translation = (R.mT @ (target[..., :1] - frame[..., :1]))[..., 0]
    half_height = target[..., 3].norm(dim=-1) - frame[..., 3].norm(dim=-1)
    if ambiguous:
        z = (R.mT @ R_target[..., 2:])[..., 0]  # true axis seen from the predicted frame
        tilt = torch.stack([-z[:, 1], z[:, 0], torch.zeros_like(z[:, 0])], -1)  # e_z x z
        length = tilt.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        return FrameError(tilt / length * torch.atan2(length, z[:, 2:]), translation, half_height)
    return FrameError(rotation_vector(R.mT @ R_target), translation, half_height)


def orthonormal(frame: Tensor, ambiguous: bool) -> Tensor:
    """(B, 3, 4) centre and scaled axes -> (B, 3, 3) rotations, z along E_z, x towards E_x."""
    z = F.normalize(frame[..., 3], dim=-1)
    hint = torch.eye(3).to(z)[z.abs().argmin(-1)] if ambiguous else frame[..., 1]
    x = F.normalize(hint - (hint * z).sum(-1, keepdim=True) * z, dim=-1)
    return torch.stack([x, torch.linalg.cross(z, x), z], -1)


def rotation_vector(R: Tensor) -> Tensor:
    """Axis times angle of (B, 3, 3) rotations, radians; from the longest row of 4 q q^T, q the quaternion."""
    v = torch.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], -1)
    trace = R.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True)
    outer = R + R.mT + (1 - trace[..., None]) * torch.eye(3).to(R)  # 4 q_v q_v^T
    outer = torch.cat([torch.cat([1 + trace, v], -1)[:, None], torch.cat([v[..., None], outer], -1)], 1)
    longest = outer.diagonal(dim1=-2, dim2=-1).argmax(-1)
    q = F.normalize(outer[torch.arange(len(R), device=R.device), longest], dim=-1)  # (B, 4) w, x, y, z
    w, v = q[:, :1], torch.where(q[:, :1] < 0, -q[:, 1:], q[:, 1:])
    length = v.norm(dim=-1, keepdim=True)
    return v / length.clamp(min=1e-12) * 2 * torch.atan2(length, w.abs())


def sigma_loss(log_sigmas: Tensor, error: FrameError, ambiguous: bool) -> Tensor:
    """Negative log likelihood of the (detached) errors, Student's t with 4 degrees of freedom.

    Its tails leave room for the views where the frame is flipped; a normal distribution would spend itself on
    them.
    """
    errors = error.components.detach()
    used = [i for i in range(N_SIGMAS) if i != 2 or not ambiguous]
    log_sigmas = log_sigmas.clamp(-8, 3)
    nll = log_sigmas + 2.5 * torch.log1p((errors * torch.exp(-log_sigmas)).square() / 4)
    return nll[:, used].mean()


def shipped_losses(encoding: Encoding, batch: Batch, symmetry: Symmetry) -> dict[str, Tensor]:
    """The losses of the shipped recipe that need no decoder."""
    target = nearest_equivalent(encoding.frame.detach(), batch.target, symmetry)
    error = frame_error(encoding.frame.detach(), target, symmetry.ambiguous)
    return {
        "frame": frame_loss(encoding.frame, target),
        "shape": shape_contrast_loss(encoding.descriptor, batch.shape),
        "sigma": sigma_loss(encoding.log_sigmas, error, symmetry.ambiguous),
    }

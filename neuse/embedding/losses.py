"""What the networks are trained for; all in network units (0.1 m)."""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from neuse.embedding.encoder import Encoding

SOFTNESS = 0.02  # 2 mm: below this an error counts squared, above it by its length


def frame_loss(frame: Tensor, target: Tensor) -> Tensor:
    """Distance of centre and scaled axes from the truth, (B, 3, 4) each.

    A length and not a square, so that the many good views still count beside the few hidden handles. Where
    the handle
    cannot be known the best answer is the mean direction: E_x shrinks, and weighs less in every registration.
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
    """Error of predicted object frames in their own axes: rotation (B, 3) rad, translation (B, 3)."""

    rotation: Tensor
    translation: Tensor


def frame_error(frame: Tensor, target: Tensor, ambiguous: bool) -> FrameError:
    """How far (B, 3, 4) predicted frames are from the truth; about the axis 0 where that is ambiguous."""
    R, R_target = orthonormal(frame, ambiguous), orthonormal(target, ambiguous)
    translation = (R.mT @ (target[..., :1] - frame[..., :1]))[..., 0]
    if ambiguous:
        z = (R.mT @ R_target[..., 2:])[..., 0]  # true axis seen from the predicted frame
        tilt = torch.stack([-z[:, 1], z[:, 0], torch.zeros_like(z[:, 0])], -1)  # e_z x z
        length = tilt.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        return FrameError(tilt / length * torch.atan2(length, z[:, 2:]), translation)
    return FrameError(rotation_vector(R.mT @ R_target), translation)


def orthonormal(frame: Tensor, ambiguous: bool) -> Tensor:
    """(B, 3, 4) centre and scaled axes -> (B, 3, 3) rotations, z along E_z, x towards E_x."""
    z = F.normalize(frame[..., 3], dim=-1)
    hint = torch.eye(3, dtype=z.dtype)[z.abs().argmin(-1)] if ambiguous else frame[..., 1]
    x = F.normalize(hint - (hint * z).sum(-1, keepdim=True) * z, dim=-1)
    return torch.stack([x, torch.linalg.cross(z, x), z], -1)


def rotation_vector(R: Tensor) -> Tensor:
    """Axis times angle of (B, 3, 3) rotations, radians; near pi the axis is not accurate."""
    v = torch.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], -1)
    trace = R.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True)
    length = v.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    return v / length * torch.atan2(length, trace - 1)


def sigma_loss(log_sigmas: Tensor, error: FrameError, ambiguous: bool) -> Tensor:
    """Negative log likelihood of the (detached) errors, Student's t with 4 degrees of freedom.

    Its tails leave room for the views where the frame is flipped; a normal distribution would spend itself on
    them.
    """
    errors = torch.cat([error.rotation, error.translation], -1).detach()  # (B, 6)
    used = [0, 1, 3, 4, 5] if ambiguous else [0, 1, 2, 3, 4, 5]
    log_sigmas = log_sigmas.clamp(-8, 3)
    nll = log_sigmas + 2.5 * torch.log1p((errors * torch.exp(-log_sigmas)).square() / 4)
    return nll[:, used].mean()


def paper_shape_loss(descriptor: Tensor, shape: Tensor) -> Tensor:
    """L_b_shape of the paper: batch-hard cosine triplet without margin."""
    similarity = F.normalize(descriptor, dim=-1) @ F.normalize(descriptor, dim=-1).T
    same = shape[:, None] == shape[None]
    hardest_positive = similarity.masked_fill(~same, torch.inf).amin(-1)
    hardest_negative = similarity.masked_fill(same, -torch.inf).amax(-1)
    return (hardest_negative - hardest_positive).mean()


def encoding_losses(encoding: Encoding, target: Tensor, shape: Tensor, ambiguous: bool) -> dict[str, Tensor]:
    """The losses that need no decoder."""
    error = frame_error(encoding.frame.detach(), target, ambiguous)
    return {
        "frame": frame_loss(encoding.frame, target),
        "shape": shape_contrast_loss(encoding.descriptor, shape),
        "sigma": sigma_loss(encoding.log_sigmas, error, ambiguous),
    }

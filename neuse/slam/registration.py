"""Relative pose of two views from the codes of the objects that both see (NeuSE eq. 5; Horn 1987)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuse.embedding.code import Code
from neuse.errors import DegenerateGeometryError, InputError
from neuse.geometry import Array, make_transform
from neuse.slam.object_frames import ObjectFrames, SigmaParams, reduce_codes, skews

LEVER_M = 0.05  # at which directions count as points in `residual_m`: about half an object
GRADUATION = (64.0, 16.0, 6.0, 3.0)  # Cauchy scales in sigmas: from all alike down to the robust answer
INLIER_SIGMAS = 6.0
MAX_SIGMA_RAD = 1.0  # a rotation known no better than this is not determined


@dataclass(frozen=True)
class Alignment:
    """Relative pose of two views: p_b = T_b_a @ p_a.

    covariance: (6, 6) as in neuse.geometry, of a perturbation in frame a.    residual_m: weighted rms distance of the
    aligned centres and of the points 5 cm along axes and handles.    inliers: (n,) bool, the objects that agree.
    """

    T_b_a: Array
    covariance: Array
    residual_m: float
    inliers: np.ndarray

    @property
    def n_objects(self) -> int:
        """How many objects agree."""
        return int(self.inliers.sum())

    @property
    def sigma_rotation_rad(self) -> float:
        """Standard deviation of the worst known rotation."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))

    @property
    def sigma_translation_m(self) -> float:
        """Standard deviation of the worst known translation."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[3:, 3:])[-1]))


def align(codes_a: Sequence[Code], codes_b: Sequence[Code], params: SigmaParams | None = None) -> Alignment:
    """Relative pose of two views of the same objects, jointly over all of them (NeuSE eq. 5; Horn 1987).

    Args:
        codes_a, codes_b: codes of the same n objects in the same order, metres, in frames a and b.
        params: how far the predicted sigmas, which weigh the objects, are trusted.
    Returns:
        Alignment with p_b = T_b_a @ p_a. Objects that contradict the others have lost their weight.
    Raises:
        InputError: unequal lengths, pairs of unlike category, or codes that are not finite.
        DegenerateGeometryError: no object, or all together leave a rotation free (a lone bottle; a lone mug with
            its handle hidden).
    """
    _check_pairs(codes_a, codes_b)
    return align_frames(reduce_codes(codes_a, params), reduce_codes(codes_b, params))


def align_frames(a: ObjectFrames, b: ObjectFrames) -> Alignment:
    """`align` on object frames.

    Raises:
        DegenerateGeometryError: as `align`.
    """
    if not len(a):
        raise DegenerateGeometryError("no common object to align; give at least one")
    trusted = 1.0 / (a.variances + b.variances)
    weights = trusted
    for scale in GRADUATION:
        T_b_a = _horn(a, b, weights)
        differences = _differences(T_b_a, a, b)
        square_errors = trusted * (differences**2).sum(axis=-1)  # (3, n)
        weights = trusted / (1 + square_errors / scale**2)
    inliers = (square_errors[:2] < INLIER_SIGMAS**2).all(axis=0)
    covariance = _covariance(T_b_a, a, b, weights)
    return Alignment(T_b_a, covariance, _residual_m(differences, weights, inliers), inliers)


def _check_pairs(codes_a: Sequence[Code], codes_b: Sequence[Code]) -> None:
    if len(codes_a) != len(codes_b):
        raise InputError(
            "unequal_lengths",
            f"{len(codes_a)} codes in frame a, {len(codes_b)} in frame b; pair them one to one",
        )
    for index, (a, b) in enumerate(zip(codes_a, codes_b, strict=True)):
        if a.category != b.category:
            raise InputError("mixed_categories", f"pair {index} joins a {a.category} with a {b.category}")


def _horn(a: ObjectFrames, b: ObjectFrames, weights: Array) -> Array:
    """Closed-form minimum of the weighted squared differences (Horn 1987, by Arun's SVD)."""
    share = weights[0] / weights[0].sum()
    mean_a, mean_b = share @ a.centers, share @ b.centers
    moments = (b.vectors * weights[:, :, None]).reshape(-1, 3).T @ a.vectors.reshape(-1, 3)
    U, _, Vt = np.linalg.svd(moments - weights[0].sum() * np.outer(mean_b, mean_a))
    if np.linalg.det(U @ Vt) < 0:
        U[:, 2] *= -1
    R_b_a = U @ Vt
    return make_transform(R_b_a, mean_b - R_b_a @ mean_a)


def _differences(T_b_a: Array, a: ObjectFrames, b: ObjectFrames) -> Array:
    """(3, n, 3) differences of centres, axes and handles after alignment, in frame a."""
    R_b_a, t_b_a = T_b_a[:3, :3], T_b_a[:3, 3]
    differences = a.vectors - b.vectors @ R_b_a
    differences[0] += t_b_a @ R_b_a
    return differences


def _residual_m(differences: Array, weights: Array, inliers: np.ndarray) -> float:
    levers_m = np.array([[1.0], [LEVER_M], [LEVER_M]])
    weights_m = weights / levers_m**2 * (inliers | ~inliers.any())
    square_m = (differences**2).sum(axis=-1) * levers_m**2
    return float(np.sqrt((weights_m * square_m).sum() / weights_m.sum()))


def jacobian(frames: ObjectFrames) -> Array:
    """(3, n, 3, 6) derivative of a frame's vectors by a perturbation [omega, v] of that frame."""
    J = np.zeros((*frames.vectors.shape, 6))
    J[..., :3] = -skews(frames.vectors)
    J[0, :, :, 3:] = np.eye(3)
    return J


def _covariance(T_b_a: Array, a: ObjectFrames, b: ObjectFrames, weights: Array) -> Array:
    """(6, 6) covariance of the weighted least-squares answer for the predicted sigmas (sandwich formula)."""
    J = jacobian(a)
    weighted = (weights[:, :, None, None] * J).reshape(-1, 6)
    H = weighted.T @ J.reshape(-1, 6)
    _check_determined(H)
    noise = np.concatenate([a.noise, T_b_a[:3, :3].T @ b.noise], axis=-1)  # (3, n, 3, 12)
    gains = weighted.reshape(3, len(a), 3, 6).transpose(1, 3, 0, 2).reshape(len(a), 6, 9)
    G = gains @ noise.transpose(1, 0, 2, 3).reshape(len(a), 9, 12)  # (n, 6, 12)
    H_inverse = np.linalg.inv(H)
    return H_inverse @ (G @ G.swapaxes(1, 2)).sum(axis=0) @ H_inverse


def _check_determined(H: Array) -> None:
    information = H[:3, :3] - H[:3, 3:] @ np.linalg.solve(H[3:, 3:], H[3:, :3])
    if np.linalg.eigvalsh(information)[0] < MAX_SIGMA_RAD**-2:
        raise DegenerateGeometryError(
            "the objects leave a rotation free (a lone bottle, or a lone mug whose handle is hidden); add one"
        )

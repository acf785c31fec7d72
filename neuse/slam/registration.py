"""Relative pose of two views from the codes of the objects that both see (NeuSE eq. 5; Horn 1987)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuse.embedding.code import Code
from neuse.errors import DegenerateGeometryError, InputError
from neuse.geometry import Array, make_transform
from neuse.slam.object_frames import ObjectFrames, SigmaParams, noise_of, reduce_codes, skews

HALF_SIZE_M = 0.05  # at which directions count as points in `residual_m`: about half an object
GRADUATION = (64.0, 8.0, 3.0, 3.0, 3.0)  # Cauchy scales in sigmas: from all alike down to the robust answer
INLIER_SIGMAS = 6.0
PRIOR_DOF = 6.0  # how much the predicted sigmas count beside the residuals of the very alignment
MAX_LEAN = 0.99  # to the end of an object that is better known
MAX_SIGMA_RAD = 1.0  # a rotation known no better than this is not determined


@dataclass(frozen=True)
class Alignment:
    """Relative pose of two views: p_b = T_b_a @ p_a.

    covariance: (6, 6) as in neuse.geometry, of a perturbation in frame a.    residual_m: weighted rms
    distance of the aligned centres and of the points 5 cm along axes and handles.    inliers: (n,) bool, the
    objects that agree.
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
        params: how far the predicted sigmas, which weigh the objects, are trusted; None takes them as they
            are.
    Returns:
        Alignment with p_b = T_b_a @ p_a. Objects that contradict the others have lost their weight.
    Raises:
        InputError: unequal lengths, pairs of unlike category, or codes that are not finite.
        DegenerateGeometryError: no object, or all together leave a rotation free (a lone bottle; a lone mug
            with its handle hidden).
    """
    _check_pairs(codes_a, codes_b)
    params = params or SigmaParams(scale=1.0)  # two views do not repeat each other
    return align_frames(reduce_codes(codes_a, params), reduce_codes(codes_b, params))


def align_frames(a: ObjectFrames, b: ObjectFrames) -> Alignment:
    """`align` on object frames.

    Raises:
        DegenerateGeometryError: as `align`.
    """
    if not len(a):
        raise DegenerateGeometryError("no common object to align; give at least one")
    alignment = align_each(a, [(np.arange(len(a)), b)])[0]
    if alignment is None:
        raise DegenerateGeometryError(
            "the objects leave a rotation free (a lone bottle, or a lone mug whose handle is hidden); add one"
        )
    return alignment


def align_each(a: ObjectFrames, others: Sequence[tuple[np.ndarray, ObjectFrames]]) -> list[Alignment | None]:
    """`align` of one view with several others at once, None where a rotation stays free.

    Args:
        others: for each other view b the indices (n_b,) of its objects in a, at least one, and their frames
            in b.
    """
    if not others:
        return []
    b = _stack(a, others)
    source, target = homogeneous(a.vectors), homogeneous(b.vectors)
    trusted = np.where(b.known[:, None], 1.0 / b.variances, 0.0)  # (B, 3, n)
    weights = trusted
    for scale in GRADUATION:
        T_b_a = _horn(source, target, weights)
        differences = target - source @ T_b_a[:, None].swapaxes(-1, -2)  # (B, 3, n, 4)
        squares = np.einsum("...i,...i", differences, differences)  # (B, 3, n)
        square_errors = trusted * squares
        weights = trusted / (1 + square_errors / scale**2)
    inliers = b.known & (square_errors[:, :2] < INLIER_SIGMAS**2).all(axis=1)
    residuals_m = _residuals_m(squares, weights, inliers)
    covariances = _covariances(T_b_a, a, b, weights)
    misfits = _misfits(square_errors, b.known, a.ambiguous)
    return [
        None
        if covariance is None
        else Alignment(T_b_a[i], misfits[i] * covariance, float(residuals_m[i]), inliers[i, index])
        for i, ((index, _), covariance) in enumerate(zip(others, covariances, strict=True))
    ]


@dataclass(frozen=True)
class _Views:
    """Several views b, filled up to the n objects of the view a.

    vectors: (B, 3, n, 3), centres where heights agree with those in a.    variances: (B, 3, n) of differences
    to a.    sigmas: (B, n, 6) of b, along the axis what heights leave.    axial: (B, n) share of the standard
    deviation along the axis that heights leave in a.    known: (B, n) bool.
    """

    vectors: Array
    variances: Array
    sigmas: Array
    axial: Array
    known: np.ndarray


def _stack(a: ObjectFrames, others: Sequence[tuple[np.ndarray, ObjectFrames]]) -> _Views:
    B, n = len(others), len(a)
    vectors, variances = np.zeros((B, 3, n, 3)), np.ones((B, 3, n))
    sigmas, axial, known = np.ones((B, n, 6)), np.ones((B, n)), np.zeros((B, n), dtype=bool)
    for i, (index, frames) in enumerate(others):
        shifts, gone, axial[i, index] = agreed_heights(a[index], frames)
        vectors[i, :, index], sigmas[i, index] = frames.vectors.swapaxes(0, 1), frames.sigmas
        vectors[i, 0, index] += shifts
        variances[i, :, index], known[i, index] = (a.variances[:, index] + frames.variances).T, True
        variances[i, 0, index] -= gone / 3.0
    sigmas[..., 5] *= axial
    return _Views(vectors, variances, sigmas, axial, known)


def homogeneous(vectors: Array) -> Array:
    """(..., 3, n, 4) of (..., 3, n, 3): centres are points, axes and handles are directions."""
    extended = np.zeros((*vectors.shape[:-1], 4))
    extended[..., :3] = vectors
    extended[..., 0, :, 3] = 1.0
    return extended


def agreed_heights(a: ObjectFrames, b: ObjectFrames) -> tuple[Array, Array, Array]:
    """What it says of the centres that both views see objects of the same heights.

    Where the top is hidden in one view and the bottom in the other, or either in one, the ends that both see
    tell the shift along the axis: the differences of tops and of bottoms, weighted by their variances.

    Returns:
        (n, 3) shifts of the centres in b, (n,) variance along the axes that goes, and the share of the
        standard deviation that stays.
    """
    square_a, square_b = a.sigmas[:, 5] ** 2, b.sigmas[:, 5] ** 2
    square = square_a + square_b
    lean = -(a.height_correlations * square_a + b.height_correlations * square_b) / square
    lean = np.clip(lean, -MAX_LEAN, MAX_LEAN)
    shifts = (lean * (b.half_heights - a.half_heights))[:, None] * b.axes
    return shifts, lean**2 * square, np.sqrt(1.0 - lean**2)


def _check_pairs(codes_a: Sequence[Code], codes_b: Sequence[Code]) -> None:
    if len(codes_a) != len(codes_b):
        raise InputError(
            "unequal_lengths",
            f"{len(codes_a)} codes in frame a, {len(codes_b)} in frame b; pair them one to one",
        )
    for index, (a, b) in enumerate(zip(codes_a, codes_b, strict=True)):
        if a.category != b.category:
            raise InputError("mixed_categories", f"pair {index} joins a {a.category} with a {b.category}")


def _horn(source: Array, target: Array, weights: Array) -> Array:
    """(B, 4, 4) closed-form minima of the weighted squared differences (Horn 1987, by Arun's SVD).

    source: (3, n, 4) and target: (B, 3, n, 4) homogeneous vectors.    weights: (B, 3, n).
    """
    weighted = (target * weights[..., None]).reshape(len(weights), -1, 4)
    sums = weighted.swapaxes(1, 2) @ source.reshape(-1, 4)  # (B, 4, 4)
    total = sums[:, 3:, 3]
    mean_a, mean_b = sums[:, 3, :3] / total, sums[:, :3, 3] / total
    U, _, Vt = np.linalg.svd(sums[:, :3, :3] - sums[:, :3, 3:] * mean_a[:, None])
    R_b_a = U @ Vt
    mirrored = np.linalg.det(R_b_a) < 0
    if mirrored.any():
        U[mirrored, :, 2] *= -1.0
        R_b_a = U @ Vt
    return make_transform(R_b_a, mean_b - (R_b_a @ mean_a[..., None])[..., 0])


def _residuals_m(squares: Array, weights: Array, inliers: np.ndarray) -> Array:
    counted = weights * (inliers | ~inliers.any(axis=1, keepdims=True))[:, None]
    square_levers_m = np.array([1.0, HALF_SIZE_M, HALF_SIZE_M])[:, None] ** 2
    return np.sqrt((counted * squares).sum(axis=(1, 2)) / (counted / square_levers_m).sum(axis=(1, 2)))


def _misfits(square_errors: Array, known: np.ndarray, ambiguous: np.ndarray) -> Array:
    """(B,) variance factors: square errors of the alignment over those that the sigmas predict.

    The scale of the noise of one alignment, estimated from its residuals and shrunk towards 1.
    """
    dof = known.sum(axis=1) * 5.0 + (known & ~ambiguous).sum(axis=1) - 6.0
    bounded = (square_errors / (1.0 + square_errors / INLIER_SIGMAS**2)).sum(axis=(1, 2))
    return (PRIOR_DOF + bounded) / (PRIOR_DOF + np.maximum(dof, 0.0))


def jacobian(vectors: Array) -> Array:
    """(3, n, 3, 6) derivative of centres, axes and handles by a perturbation [omega, v] of their frame."""
    J = np.zeros((*vectors.shape, 6))
    J[..., :3] = -skews(vectors)
    J[0, :, :, 3:] = np.eye(3)
    return J


def _covariances(T_b_a: Array, a: ObjectFrames, b: _Views, weights: Array) -> list[Array | None]:
    """(6, 6) covariances of weighted least squares for predicted sigmas; None where a rotation is free."""
    J, B, n = jacobian(a.vectors), len(weights), len(a)
    weighted = weights[..., None, None] * J  # (B, 3, n, 3, 6)
    H = weighted.reshape(B, -1, 6).swapaxes(1, 2) @ J.reshape(-1, 6)
    noise_b = T_b_a[:, None, None, :3, :3].swapaxes(-1, -2) @ noise_of(b.vectors, b.sigmas)
    noise_a = np.broadcast_to(a.noise, noise_b.shape).copy()
    noise_a[..., 5] *= b.axial[:, None, :, None]
    noise = np.concatenate([noise_a, noise_b], axis=-1)  # (B, 3, n, 3, 12)
    gains = weighted.transpose(0, 2, 4, 1, 3).reshape(B, n, 6, 9)
    G = gains @ noise.transpose(0, 2, 1, 3, 4).reshape(B, n, 9, 12)  # (B, n, 6, 12)
    return _sandwiches(H, (G @ G.swapaxes(-1, -2)).sum(axis=1))


def _sandwiches(H: Array, spread: Array) -> list[Array | None]:
    """H^-1 spread H^-1 of each pair of (B, 6, 6), None where a rotation is not determined."""
    information = H[:, :3, :3] - H[:, :3, 3:] @ np.linalg.solve(H[:, 3:, 3:], H[:, 3:, :3])
    told = np.linalg.eigvalsh(information)[:, 0] >= MAX_SIGMA_RAD**-2
    H_inverse = np.linalg.inv(H[told])
    covariances = iter(H_inverse @ spread[told] @ H_inverse)
    return [next(covariances) if is_told else None for is_told in told]

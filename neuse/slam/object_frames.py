"""Codes reduced to what registration needs: the pose of each object's frame and how well it is known.

The landmark channels are z_j = c + E a_j with an orthonormal template, so a least-squares alignment of all
channels (NeuSE eq. 5) sees them only through the centre c and the axes E; the rest of z is noise. Of E the
directions are kept: the lengths shrink when the encoder is unsure, which the predicted sigmas say better.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from neuse.embedding.code import Code, landmark_template
from neuse.errors import InputError
from neuse.geometry import Array
from neuse.params import CheckedParams, param

LARGEST = 1e4  # length of the numbers of a code: metres, radians, cosines
HIDDEN_HANDLE_RAD = 0.6  # a handle known no better says nothing
UNTOLD_RAD = 3.0  # an axis known no better is not told at all: that of a box, whose edges have no names
LEAST_SHARE = 0.01  # of a variance along the axis that stays, whatever the height says


@dataclass(frozen=True)
class SigmaParams(CheckedParams):
    """How far the standard deviations that the encoder predicts are trusted."""

    scale: float = param(2.0, "factor on predicted sigmas; neighbouring views share one error", 0.01, 100.0)
    rotation_floor_rad: float = param(0.002, "no rotation is believed better than this, rad", 0.0, 1.0)
    translation_floor_m: float = param(0.0003, "no centre is believed better than this, metres", 0.0, 1.0)


@dataclass(frozen=True)
class ObjectFrames:
    """Poses of n object frames seen from one frame.

    vectors: (3, n, 3) centres (metres), unit axes to the top, and unit vectors to the handle, which are
        orthogonal to the axis and arbitrary where ambiguous.
    variances: (3, n) mean variance of `vectors` along one axis: m^2, rad^2, rad^2 (infinite where ambiguous).
    sigmas: (n, 6) rotation first (rad, m), on the object's axes.    ambiguous: (n,) bool.
    half_heights: (n,) metres, as uncertain as the centres along the axes, and height_correlations: (n,) with
        those (see Code): where one end is hidden, the centre is wrong by as much as half the height.
    """

    vectors: Array
    variances: Array
    sigmas: Array
    ambiguous: np.ndarray
    half_heights: Array
    height_correlations: Array

    def __len__(self) -> int:
        return len(self.sigmas)

    def __getitem__(self, index: np.ndarray | Sequence[int]) -> "ObjectFrames":
        """The frames at `index`, an index array or a mask."""
        index = np.asarray(index, dtype=bool if np.asarray(index).dtype == bool else np.intp)
        return ObjectFrames(
            self.vectors[:, index],
            self.variances[:, index],
            self.sigmas[index],
            self.ambiguous[index],
            self.half_heights[index],
            self.height_correlations[index],
        )

    def scaled(self, factor: float) -> "ObjectFrames":
        """The same frames with sigmas times `factor`."""
        return replace(self, variances=factor**2 * self.variances, sigmas=factor * self.sigmas)

    def given_heights(self, half_heights: Array, variances: Array) -> "ObjectFrames":
        """What is known of the centres once the half heights (n,) are known, with variances (n,) m^2.

        The end that is seen stays where it is; what the height says of the other end moves the centre.
        """
        square = self.sigmas[:, 5] ** 2
        gains = self.height_correlations * square / (square + variances)  # of the conditional distribution
        vectors, sigmas = self.vectors.copy(), self.sigmas.copy()
        vectors[0] += (gains * (half_heights - self.half_heights))[:, None] * self.axes
        sigmas[:, 5] *= np.sqrt(np.maximum(1.0 - gains * self.height_correlations, LEAST_SHARE))
        correlations = np.zeros(len(self))  # all that the height can say has been said
        return _frames(vectors, sigmas, self.ambiguous, half_heights, correlations)

    @property
    def noise(self) -> Array:
        """(3, n, 3, 6) square root of the covariance of `vectors`: a column for each sigma of the object."""
        return noise_of(self.vectors, self.sigmas)

    @property
    def centers(self) -> Array:
        """(n, 3) metres."""
        return self.vectors[0]

    @property
    def axes(self) -> Array:
        """(n, 3) unit vectors to the top."""
        return self.vectors[1]

    @property
    def tell_axes(self) -> np.ndarray:
        """(n,) bool, whether anything is known but the centre."""
        return self.sigmas[:, 0] < UNTOLD_RAD


def reduce_codes(codes: Sequence[Code], params: SigmaParams | None = None) -> ObjectFrames:
    """The object frames of codes that lie in one frame.

    Raises:
        InputError: a code has non-finite numbers, sigmas that are not positive, or no correlation in [-1, 1].
    """
    params = params or SigmaParams()
    for code in codes:
        _check(code)
    ambiguous = np.array([code.ambiguous for code in codes], dtype=bool)
    centers, scaled_axes = _centers_and_axes(codes)
    half_heights = _lengths(scaled_axes[:, :, 2])
    axes = _normalized(scaled_axes[:, :, 2])
    vectors = np.array([centers, axes, _handles(scaled_axes[:, :, 0], axes, ambiguous)])
    floor = np.repeat([params.rotation_floor_rad, params.translation_floor_m], 3)
    predicted = np.array([code.sigmas for code in codes], dtype=np.float64).reshape(-1, 6)
    sigmas = np.hypot(params.scale * predicted, floor)
    correlations = np.array([code.height_correlation for code in codes], dtype=np.float64)
    return _frames(vectors, sigmas, ambiguous, half_heights, correlations)


def frames_at(vectors: Array, sigmas: Array, ambiguous: np.ndarray, half_heights: Array) -> ObjectFrames:
    """Object frames at known places: vectors (3, n, 3), sigmas (n, 6) or (6,) for all, half heights (n,)."""
    n = vectors.shape[1]
    return _frames(vectors, np.broadcast_to(sigmas, (n, 6)), ambiguous, half_heights, np.zeros(n))


def join_frames(parts: Sequence[ObjectFrames]) -> ObjectFrames:
    """All objects of several parts, in their order."""
    return ObjectFrames(
        np.concatenate([part.vectors for part in parts], axis=1),
        np.concatenate([part.variances for part in parts], axis=1),
        np.concatenate([part.sigmas for part in parts]),
        np.concatenate([part.ambiguous for part in parts]),
        np.concatenate([part.half_heights for part in parts]),
        np.concatenate([part.height_correlations for part in parts]),
    )


def is_usable(code: Code) -> bool:
    """Whether every number of the code is within reason, its sigmas are positive, the correlation is one."""
    square = sum(np.vdot(numbers, numbers) for numbers in (code.z, code.descriptor, code.sigmas))
    sound = square < LARGEST**2 and (code.sigmas > 0).all()  # NaN compares false
    return bool(sound and abs(code.height_correlation) <= 1.0)


def skews(vectors: Array) -> Array:
    """(..., 3, 3) cross-product matrices of (..., 3) vectors."""
    K = np.zeros((*vectors.shape, 3))
    K[..., 2, 1] = vectors[..., 0]
    K[..., 0, 2] = vectors[..., 1]
    K[..., 1, 0] = vectors[..., 2]
    return K - K.swapaxes(-1, -2)


def noise_of(vectors: Array, sigmas: Array) -> Array:
    """(..., 3, n, 3, 6) noise of (..., 3, n, 3) centres, axes and handles with (..., n, 6) sigmas.

    Rotations turn axes and handles, translations move centres, both on the object's axes.
    """
    axes, handles = vectors[..., 1, :, :], vectors[..., 2, :, :]
    K = skews(vectors[..., 1:, :, :])  # of axes and of handles
    R = np.stack([handles, (K[..., 0, :, :, :] @ handles[..., None])[..., 0], axes], axis=-1)
    noise = np.zeros((*vectors.shape, 6))
    noise[..., 0, :, :, 3:] = R
    noise[..., 1:, :, :, :3] = -K @ R[..., None, :, :, :]
    return noise * sigmas[..., None, :, None, :]


def _frames(
    vectors: Array, sigmas: Array, ambiguous: np.ndarray, half_heights: Array, correlations: Array
) -> ObjectFrames:
    square = sigmas**2
    handles = np.where(ambiguous, np.inf, square[:, 2])
    variances = np.stack([square[:, 3:].mean(axis=1), square[:, :2].mean(axis=1), handles])
    return ObjectFrames(vectors, variances, sigmas, ambiguous, half_heights, correlations)


def _check(code: Code) -> None:
    if not is_usable(code):
        raise InputError(
            "code_not_finite",
            f"code of a {code.category} has NaN, infinite or impossible numbers; drop this observation",
        )


def _centers_and_axes(codes: Sequence[Code]) -> tuple[Array, Array]:
    """(n, 3) centres and (n, 3, 3) scaled axes; all codes of one size at once."""
    fitted = np.zeros((len(codes), 3, 4))
    sizes = np.array([len(code.z) for code in codes])
    for k in set(sizes.tolist()):
        index = np.flatnonzero(sizes == k)
        landmarks = np.array([codes[i].landmarks for i in index.tolist()])  # (n_k, k // 2, 3)
        fitted[index] = landmarks.swapaxes(1, 2) @ _fit(k)
    return fitted[..., 0], fitted[..., 1:]


@cache
def _fit(k: int) -> Array:
    """(k // 2, 4) by which landmarks become, in the least squares, their centre and scaled axes."""
    template = landmark_template(k)
    return np.column_stack([np.ones(len(template)), 3.0 * template]) / len(template)


def _handles(raw: Array, axes: Array, ambiguous: np.ndarray) -> Array:
    """(n, 3) unit vectors orthogonal to the axes, in the half plane of `raw` unless ambiguous."""
    arbitrary = np.eye(3)[np.abs(axes).argmin(axis=1)]
    flat = _orthogonal(np.where(ambiguous[:, None], arbitrary, raw), axes)
    lost = _lengths(flat)[:, None] < 1e-9
    return _normalized(np.where(lost, _orthogonal(arbitrary, axes), flat))


def _orthogonal(vectors: Array, axes: Array) -> Array:
    return vectors - axes * (axes * vectors).sum(axis=1, keepdims=True)


def _normalized(vectors: Array) -> Array:
    return vectors / np.maximum(_lengths(vectors), 1e-12)[..., None]


def _lengths(vectors: Array) -> Array:
    return np.sqrt(np.einsum("...i,...i", vectors, vectors))

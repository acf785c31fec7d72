"""Objects as points of the graph: their ends, and one out along the handle."""

import numpy as np

from neuse.geometry import Array
from neuse.slam.object_frames import HIDDEN_HANDLE_RAD, LEAST_SHARE, ObjectFrames

LEVER_M = 0.3  # where a handle becomes a point: so far out that its noise is that of the direction
LOOSE_RAD = 1.0  # along directions in which a point on the lever says nothing
LEAST_HALF_HEIGHT_M = 0.01  # of ends that tell an axis
TOP, BOTTOM, HANDLE = range(3)


def landmark_points(frames: ObjectFrames, i: int) -> tuple[Array, Array]:
    """(3, 3) top, bottom and handle point of object i, metres, with covariances (3, 3, 3).

    Along the axis each end has a variance of its own: a hidden one is hardly known. Across it both share
    those of the centre and of the tilt; as these weigh about the same half a height away, the ends err
    independently. The handle point tells the turn about the axis and is loose otherwise, so that nothing
    counts twice. Of an object that tells no axis the first is its centre, and the only one to be used.
    """
    center, axis, handle = frames.vectors[:, i]
    R = np.stack([handle, np.cross(axis, handle), axis], axis=1)
    turn_x, turn_y, turn_z, shift_x, shift_y, shift_z = frames.sigmas[i] ** 2
    half, correlation = end_height(frames.half_heights[i]), frames.height_correlations[i]
    across = shift_x + half**2 * turn_y, shift_y + half**2 * turn_x
    ends = 2 * shift_z * np.maximum(1 + np.array([correlation, -correlation]), LEAST_SHARE)
    loose = (LOOSE_RAD * LEVER_M) ** 2
    if not frames.tell_axes[i]:
        half, across, ends = 0.0, (shift_x, shift_y), np.array([shift_z, shift_z])
    variances = np.array(
        [[*across, ends[0]], [*across, ends[1]], [loose, shift_y + turn_z * LEVER_M**2, loose]]
    )
    points = np.stack([center + half * axis, center - half * axis, center + LEVER_M * handle])
    return points, np.stack([(R * along) @ R.T for along in variances])


def end_height(half_height: float) -> float:
    """How far off its centre the ends of an object are taken to lie, metres."""
    return max(float(half_height), LEAST_HALF_HEIGHT_M)


def n_points(frames: ObjectFrames, i: int) -> int:
    """How many of its landmark points object i tells."""
    if not frames.tell_axes[i]:
        return 1
    return 2 if _handle_hidden(frames, i) else 3


def _handle_hidden(frames: ObjectFrames, i: int) -> bool:
    return bool(frames.ambiguous[i] or frames.sigmas[i, 2] > HIDDEN_HANDLE_RAD)

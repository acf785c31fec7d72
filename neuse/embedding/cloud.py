"""From the points under a mask to the cloud that is encoded."""

import numpy as np

REACH_M = 0.5  # no object of interest reaches further from its visible middle
TAIL = 2.5  # nor further than this many times the distance within which three quarters of its points lie
ENOUGH = 1024  # points tell where the middle is and how far away the others are


def core(points: np.ndarray) -> np.ndarray:
    """Which points belong to the object, and which are background that leaked through the mask's edge.

    Args:
        points: (..., n, 3) metres.
    Returns:
        (..., n) bool, True for points near the median point.
    """
    sample = points[..., :: 1 + points.shape[-2] // ENOUGH, :]
    middle = np.median(sample, axis=-2, keepdims=True)
    quartile = np.quantile(_distance(sample, middle), 0.75, axis=-1, keepdims=True)
    return _distance(points, middle) <= np.minimum(TAIL * quartile, REACH_M)


def _distance(points: np.ndarray, middle: np.ndarray) -> np.ndarray:
    offset = points - middle
    return np.sqrt(np.einsum("...i,...i->...", offset, offset))

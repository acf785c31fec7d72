"""From the points under a mask to the cloud that is encoded."""

import numpy as np

REACH_M = 0.5  # no object of interest reaches further from its visible middle
TAIL = 2.5  # nor further than this many times the distance within which three quarters of its points lie


def core(points: np.ndarray) -> np.ndarray:
    """Which points belong to the object, and which are background that leaked through the mask's edge.

    Args:
        points: (..., n, 3) metres.
    Returns:
        (..., n) bool, True for points near the median point.
    """
    distance = np.linalg.norm(points - np.median(points, axis=-2, keepdims=True), axis=-1)
    reach = TAIL * np.quantile(distance, 0.75, axis=-1, keepdims=True)
    return distance <= np.minimum(reach, REACH_M)

"""How far motions told by others are to be trusted, learned from motions that objects tell as well.

What odometry, say, and objects tell of one motion differs by the errors of both. Those of objects are known,
so that the differences tell the noise of odometry (Mehra, On the identification of variances and adaptive
Kalman filtering, 1970); old ones fade (Sage and Husa, 1969).
"""

from dataclasses import replace

import numpy as np

from neuse.geometry import Array, inverse, log
from neuse.slam.odometry import Motion

FACTORS = np.geomspace(1e-6, 1e6, 121)  # on the stated variances
PRIOR_DECADES = 0.5  # by which stated variances may be wrong, at one sigma
MEMORY = 30.0  # motions after which evidence fades
GATE_SIGMAS = 6.0  # two motions further apart contradict each other


class Trust:
    """Factors on the stated variances of rotation and of translation: 1 until something else is known.

    heard: how many motions have been compared.
    """

    def __init__(self) -> None:
        self._evidence = np.zeros((2, len(FACTORS)))  # logarithmic
        self._prior = -((np.log10(FACTORS) / PRIOR_DECADES) ** 2) / 2
        self.factors = np.ones(2)
        self.heard = 0

    def scaled(self, stated: Motion, least: float | Array = 0.0) -> Motion:
        """The motion with a covariance that fits what has been seen; no factor is below `least`."""
        scale = np.repeat(np.sqrt(np.maximum(self.factors, least)), 3)
        return replace(stated, covariance=scale[:, None] * stated.covariance * scale)

    def learn(self, stated: Motion, seen: Motion) -> None:
        """Compare a motion as stated with what objects say of it.

        A contradiction counts no more than one at the gate: a lie now and then is no noise.
        """
        self.heard += 1
        difference = log(inverse(stated.T_from_to) @ seen.T_from_to)
        for part, rows in enumerate((slice(0, 3), slice(3, 6))):
            whitening = np.linalg.inv(np.linalg.cholesky(stated.covariance[rows, rows]))
            variances, axes = np.linalg.eigh(whitening @ seen.covariance[rows, rows] @ whitening.T)
            square = (axes.T @ whitening @ difference[rows]) ** 2
            square = np.minimum(square, GATE_SIGMAS**2 * (self.factors[part] + variances))
            predicted = FACTORS[:, None] + variances  # (factors, 3), in units of what is stated
            likelihood = -(np.log(predicted) + square / predicted).sum(axis=1) / 2
            self._evidence[part] = (1.0 - 1.0 / MEMORY) * self._evidence[part] + likelihood
        self.factors = self._most_probable()

    def _most_probable(self) -> Array:
        """(2,) geometric means over the posterior."""
        logs = self._prior + self._evidence
        shares = np.exp(logs - logs.max(axis=1, keepdims=True))
        return np.exp(shares @ np.log(FACTORS) / shares.sum(axis=1))


def contradict(told: Motion, seen: Motion) -> bool:
    """Whether two motions between the same frames cannot both be right."""
    difference = log(inverse(told.T_from_to) @ seen.T_from_to)
    square = difference @ np.linalg.solve(told.covariance + seen.covariance, difference)
    return bool(square > GATE_SIGMAS**2)

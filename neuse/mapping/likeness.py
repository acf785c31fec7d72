"""Have two objects one shape? The evidence of their descriptors, which depends on how well both were seen.

The 1 - cosine of an object's descriptors from two visits is mostly 0.002 to 0.006, but above 0.1 once in ten
times where only a hidden part of it was seen; of two objects of a category it is mostly 0.3 to 0.6, but below
0.1 once in fifty times. So there is no fixed bound. Logistic regression of "same" on log(1 - cosine) and
log(noise), on averages of 3 to 16 views, 14 784 pairs of one object from different visits and 9 952 pairs of
different ones in simulated worlds with unseen shapes, gives what follows; the number of views and the heights
add nothing to it.
"""

import numpy as np

from neuse.embedding.code import Code
from neuse.slam.track import shape_noise

_STEEPNESS = 3.4  # of the log likelihood ratio over log(1 - cosine)
_EVEN = 0.8  # at 1 - cosine = 0.8 sqrt(noise), the sum of both codes' noises, both answers are as likely
_LEAST_UNLIKENESS = 1e-4  # 1 - cosine below this says no more


def likeness(code: Code, other: Code) -> float:
    """Natural logarithm of the likelihood ratio of one shape to two; above 0 one shape is likelier.

    An averaged code is as noisy as its best view. Minus infinity across categories and networks.
    """
    if code.category != other.category or len(code.descriptor) != len(other.descriptor):
        return -np.inf
    unlikeness = max(1.0 - float(code.descriptor @ other.descriptor), _LEAST_UNLIKENESS)
    even = _EVEN * np.sqrt(shape_noise(code) + shape_noise(other))
    return float(_STEEPNESS * np.log(even / unlikeness))

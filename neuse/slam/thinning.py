"""Which keyframes stay in the graph: those that see something from where it has not been seen before.

The more often a place has been seen, the less one more view of it says; after a dozen or so it need not be
kept. Thus the graph grows with the space explored and not with time. After the reduced pose graph of
Johannsson, Kaess, Fallon and Leonard, Temporally Scalable Visual SLAM using a Reduced Pose Graph, 2013: what
a keyframe that goes knew of others goes over to one nearby that stays.
"""

from collections import Counter
from collections.abc import Set

import numpy as np

from neuse.geometry import Array


class Thinning:
    """Keyframes that stay, and what they see.

    near_m: views from less than this apart are of one place.    views: enough of one landmark from there.
    """

    def __init__(self, near_m: float, views: int) -> None:
        self.near_m, self.views = near_m, views
        self._landmarks: dict[int, frozenset[int]] = {}
        self._ids = np.zeros(0, np.intp)

    def keep(self, keyframe_id: int, landmarks: Set[int]) -> None:
        """One more that stays."""
        self._landmarks[keyframe_id] = frozenset(landmarks)
        self._ids = np.append(self._ids, keyframe_id)

    def stand_in(self, keyframe_id: int, landmarks: Set[int], positions: Array) -> int | None:
        """The keyframe that stays in place of one that sees some landmarks; None if that is needed itself.

        positions: (n, 3) of all keyframes by their ids, map frame, metres.
        """
        distances_m = np.linalg.norm(positions[self._ids] - positions[keyframe_id], axis=1)
        order = np.argsort(distances_m)
        near = self._ids[order[: int((distances_m < self.near_m).sum())]].tolist()
        times_seen = Counter(seen for other in near for seen in self._landmarks[other])
        if any(times_seen[landmark] < self.views for landmark in landmarks):
            return None
        return next(other for other in near if not self._landmarks[other].isdisjoint(landmarks))

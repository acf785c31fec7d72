"""What iSAM2 relinearises, and when: a loop that moves the whole map is taken in step by step."""

from collections.abc import Mapping

import gtsam
import numpy as np

from neuse.geometry import Array

KIND_BIT = 56  # of a gtsam key: the character above, the number below


class Relinearization:
    """Chooses the vertices that the next solution relinearises: a limited number of those that moved far.

    iSAM2 would take all at once, so that a loop closed in a large map costs as much as a new graph. Here they
    come by turns in the order of their keys: neighbours share most of what has to be eliminated again.
    """

    def __init__(self, thresholds: Mapping[str, Array], every: int, most: int) -> None:
        """Thresholds by the character of the keys: a vertex has moved far when one coordinate has.

        Args:
            every: solutions between two relinearisations.    most: vertices in one.
        """
        self._thresholds, self._every, self._most = thresholds, every, most
        self._solutions = 0  # since the last relinearisation
        self._turn = 0  # key with which the next one begins
        self.is_behind = False  # whether some wait for their turn

    def next_update(self, isam: gtsam.ISAM2) -> gtsam.ISAM2UpdateParams:
        """How the next update of this graph is done."""
        update = gtsam.ISAM2UpdateParams()
        self._solutions += 1
        update.force_relinearize = self.is_behind or self._solutions >= self._every
        if update.force_relinearize:
            update.noRelinKeys = _key_list(self._take_turns(self._moved(isam)))
            self._solutions = 0
        return update

    def _take_turns(self, moved: np.ndarray) -> np.ndarray:
        """The keys that have to wait."""
        self.is_behind = len(moved) > self._most
        if not self.is_behind:
            return moved[:0]
        waiting = np.roll(moved, -np.searchsorted(moved, self._turn))[self._most :]
        self._turn = waiting[0]
        return waiting

    def _moved(self, isam: gtsam.ISAM2) -> np.ndarray:
        """(n,) keys, ascending, of all that has moved far from where it was linearised."""
        keys = np.array(isam.getLinearizationPoint().keys(), dtype=np.uint64)
        kinds, delta, moved = keys >> np.uint64(KIND_BIT), isam.getDelta(), [keys[:0]]
        for kind, least in self._thresholds.items():
            alike = keys[kinds == ord(kind)]
            steps = delta.vector(alike.tolist()).reshape(-1, len(least))
            moved.append(alike[(np.abs(steps) > least).any(axis=1)])
        return np.sort(np.concatenate(moved))


def _key_list(keys: np.ndarray) -> gtsam.KeyList:
    listed = gtsam.KeyList()
    for key in keys.tolist():
        listed.push_back(key)
    return listed

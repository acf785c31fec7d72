"""Odometry beside what objects tell of the same motions: its noise is learned, contradictions are refused.

Noise that shows while objects are in sight may be more where there are none, never less: matching of scans or
pictures fails in empty places, and they are where no object is either. There it errs in one direction for
long: k such errors add up to k^2 variances.
"""

from collections.abc import Sequence

import numpy as np

from neuse.geometry import Array
from neuse.records import Edge
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.odometry import Motion, OdometryFix, OdometryTracker
from neuse.slam.trust import Trust, contradict

LEAST_OBJECTS = 2  # that say how the camera has moved
LONG = 8  # frames of a motion in which the noise of odometry shows beside that of objects


class OdometryCheck:
    """Motions by odometry, as far as it has proved to be right."""

    def __init__(self, odometry: OdometryTracker) -> None:
        self._odometry, self._trust = odometry, Trust()
        self._since: KeyframeRecord | None = None  # from where odometry and objects are compared
        self._compared: tuple[Motion, Motion] | None = None  # the motions since then: as stated, as seen

    def motion(
        self, before: OdometryFix | None, after: OdometryFix | None, in_sight: bool = True
    ) -> Motion | None:
        """Motion between two fixes, None where odometry does not tell.    in_sight: of objects."""
        stated = self._odometry.motion(before, after)
        if before is None or after is None or stated is None or not self._odometry.params.adapt:
            return stated
        return self._trust.scaled(stated, 0.0 if in_sight else self._blind_factors(before, after))

    def _blind_factors(self, before: OdometryFix, after: OdometryFix) -> Array:
        """(2,) least factors on the stated variances where no object is in sight."""
        bias = self._odometry.params.blind_bias * np.maximum(1.0 - self._trust.factors, 0.0)
        return 1.0 + bias * (after.blindness - before.blindness) / max(1, after.index - before.index)

    def is_refuted(self, before: OdometryFix, after: OdometryFix, seen: Motion) -> bool:
        """Whether objects have seen another motion between two frames; learned from if so."""
        if not self._odometry.params.adapt:
            return False
        stated, told = self._odometry.motion(before, after), self.motion(before, after)
        if stated is None or told is None or not contradict(told, seen):
            return False
        self._trust.learn(stated, seen)
        return True

    def between(self, last: KeyframeRecord, new: KeyframeRecord, ties: Sequence[Edge]) -> Motion | None:
        """Motion between keyframes, unless objects contradict it; ties: edges from codes to the new one."""
        seen = _seen(ties, last)
        motion = self.motion(last.fix, new.fix, seen is not None)
        if last.fix and new.fix and seen and self.is_refuted(last.fix, new.fix, seen):
            self._odometry.counters["odometry_contradicted"] += 1
            self._since, self._compared = new, None
            return None
        self._compare(new, ties)
        return motion

    def _compare(self, new: KeyframeRecord, ties: Sequence[Edge]) -> None:
        """Learn from long motions, of which none overlap, so that each error counts once."""
        if self._since is not None:
            stated, seen = self._odometry.motion(self._since.fix, new.fix), _seen(ties, self._since)
            if stated is not None and seen is not None:
                self._compared = stated, seen
                if _frames(self._since, new) < LONG:
                    return
        if self._compared is not None:
            self._trust.learn(*self._compared)
        self._since, self._compared = new, None


def _frames(before: KeyframeRecord, after: KeyframeRecord) -> int:
    return after.fix.index - before.fix.index if before.fix and after.fix else 0


def _seen(ties: Sequence[Edge], since: KeyframeRecord) -> Motion | None:
    """The motion from a keyframe to the new one by objects that agree."""
    for tie in ties:
        if tie.from_id == since.keyframe_id and len(tie.object_ids) >= LEAST_OBJECTS:
            return Motion(tie.T_from_to, tie.covariance)
    return None

"""Where the camera should be before its objects are looked at, and the odometry edges between keyframes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from neuse.geometry import Array, inverse, renormalized
from neuse.records import Edge, EdgeKind, OdometrySample
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.localization import Belief, localize
from neuse.slam.odometry import NANOSECONDS, Motion, OdometryFix, OdometryParams, OdometryTracker


class Predictor:
    """Carries the last pose forward by odometry, or, without it, by the assumption of slow motion."""

    def __init__(self, params: OdometryParams, counters: Counter[str]) -> None:
        self.params = params
        self._odometry = OdometryTracker(params, counters)
        self._last_stamp_ns: int | None = None
        self._reference: tuple[OdometryFix, Belief] | None = None  # the last frame that had odometry

    def predict(
        self, last: Belief, sample: OdometrySample | None, stamp_ns: int
    ) -> tuple[OdometryFix | None, Motion, Belief]:
        """The frame's odometry fix, its motion since the last frame, and the belief that follows."""
        fix = self._odometry.accept(sample, stamp_ns)
        elapsed_ns = 0 if self._last_stamp_ns is None else stamp_ns - self._last_stamp_ns
        self._last_stamp_ns = stamp_ns
        motion = self._odometry.motion(self._reference[0], fix) if self._reference else None
        if motion is not None and self._reference is not None:
            return fix, motion, self._reference[1].moved(motion.T_from_to, motion.covariance)
        motion = self._odometry.free_motion(elapsed_ns * NANOSECONDS)
        return fix, motion, last.moved(motion.T_from_to, motion.covariance)

    def settle(self, fix: OdometryFix | None, belief: Belief) -> None:
        """Note the frame's final pose as a start for the next prediction."""
        if fix is not None:
            self._reference = (fix, belief)

    def correct(self, T_map_before: Array, T_map_after: Array) -> None:
        """The map has moved under the camera: what was at T_map_before is at T_map_after."""
        if self._reference is not None:
            fix, belief = self._reference
            moved = renormalized(T_map_after @ inverse(T_map_before) @ belief.T_map_camera)
            self._reference = (fix, replace(belief, T_map_camera=moved))

    def edge(
        self, last: KeyframeRecord | None, new: KeyframeRecord, ties: Sequence[Edge]
    ) -> tuple[list[Edge], list[Edge]]:
        """Odometry edges between two keyframes, and the weak guess where nothing else ties them.

        Where odometry is for blind pairs alone, a pair whose objects tell less than odometry is blind too;
        what they tell, such as a lone bottle its place, goes into the edge.
        """
        if last is None:
            return [], []
        motion = self._odometry.motion(last.fix, new.fix)
        if motion is not None and self.params.use == "always":
            return [_edge(last, new, motion)], []
        if motion is not None and not _tell_more(ties, motion):
            return [_edge(last, new, _sharpened(motion, last, new))], []
        if ties:
            return [], []
        return [], [
            _edge(last, new, self._odometry.free_motion((new.stamp_ns - last.stamp_ns) * NANOSECONDS))
        ]


def _sharpened(motion: Motion, last: KeyframeRecord, new: KeyframeRecord) -> Motion:
    """The motion that odometry and the objects that both keyframes see make most probable."""
    _, before, now = np.intersect1d(last.keys, new.keys, return_indices=True)
    if not len(before):
        return motion
    seen, places = new.frames[now], last.frames[before]
    seen = replace(seen, variances=seen.variances + places.variances)
    belief = localize(seen, places.vectors, Belief(motion.T_from_to, motion.covariance))
    return Motion(belief.T_map_camera, belief.covariance)


def _tell_more(ties: Sequence[Edge], motion: Motion) -> bool:
    """Whether one of the ties knows its translation better than odometry knows this motion."""
    best = min((_worst_variance(tie.covariance) for tie in ties), default=np.inf)
    return bool(best <= _worst_variance(motion.covariance))


def _worst_variance(covariance: Array) -> float:
    """Largest variance of the translation, m^2."""
    return float(np.linalg.eigvalsh(covariance[3:, 3:])[-1])


def _edge(last: KeyframeRecord, new: KeyframeRecord, motion: Motion) -> Edge:
    return Edge(
        last.keyframe_id,
        new.keyframe_id,
        last.stamp_ns,
        new.stamp_ns,
        EdgeKind.ODOMETRY,
        motion.T_from_to,
        motion.covariance,
    )

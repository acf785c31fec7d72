"""Where the camera should be before its objects are looked at, and the odometry edges between keyframes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from neuse.geometry import Array, inverse, renormalized
from neuse.records import Edge, EdgeKind, OdometrySample
from neuse.slam.hypotheses import Hypothesis
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.localization import Belief, localize
from neuse.slam.odometry import NANOSECONDS, Motion, OdometryFix, OdometryParams, OdometryTracker
from neuse.slam.odometry_check import OdometryCheck
from neuse.slam.tracker import Located

OBJECT_RANGE_M = 3.0  # at which objects are met: so far a rotation counts


class Predictor:
    """Carries the last pose forward by odometry, or, without it, by the assumption of slow motion."""

    def __init__(self, params: OdometryParams, counters: Counter[str]) -> None:
        self.params = params
        self._odometry = OdometryTracker(params, counters)
        self._check = OdometryCheck(self._odometry)
        self._last_stamp_ns: int | None = None
        self._reference: tuple[OdometryFix, Belief] | None = None  # the last frame that had odometry
        self._last = Belief(np.eye(4), np.eye(6))  # of the last frame
        self._is_steady = False  # objects were in sight, where they were expected
        self._blind_frames = 0  # since objects were in sight
        self._T_before_last: Array | None = None  # the motion that led to the last frame, if steady

    def predict(
        self, last: Belief, sample: OdometrySample | None, stamp_ns: int
    ) -> tuple[OdometryFix | None, list[Hypothesis]]:
        """The frame's odometry fix, and where the camera may be: by odometry, then by going on as before."""
        fix = self._odometry.accept(sample, stamp_ns, self._blind_frames)
        elapsed_ns = 0 if self._last_stamp_ns is None else stamp_ns - self._last_stamp_ns
        self._last_stamp_ns, self._last = stamp_ns, last
        free = self._odometry.free_motion(elapsed_ns * NANOSECONDS)
        motion = self._check.motion(self._reference[0], fix, self._is_steady) if self._reference else None
        if motion is None or self._reference is None:
            return fix, [Hypothesis.after(last, free)]
        hypotheses = [Hypothesis.after(self._reference[1], motion)]
        if self.params.adapt and self._T_before_last is not None:
            hypotheses.append(Hypothesis.after(last, Motion(self._T_before_last, free.covariance)))
        return fix, hypotheses

    def judge(self, fix: OdometryFix | None, located: Located) -> OdometryFix | None:
        """The fix, in a new segment if objects have been found elsewhere than where odometry led."""
        self._is_steady = not located.blind and not located.relocalized
        self._blind_frames = self._blind_frames + 1 if located.blind else 0
        if fix is None or self._reference is None or not located.surprised:
            return fix
        before, belief = self._reference
        seen = Motion(inverse(belief.T_map_camera) @ located.belief.T_map_camera, located.belief.covariance)
        return self._odometry.contradicted(fix) if self._check.is_refuted(before, fix, seen) else fix

    def settle(self, fix: OdometryFix | None, belief: Belief) -> None:
        """Note the frame's final pose as a start for the next prediction."""
        T_before_last = renormalized(inverse(self._last.T_map_camera) @ belief.T_map_camera)
        self._T_before_last = T_before_last if self._is_steady else None
        if fix is not None:
            self._reference = (fix, belief)

    def correct(self, T_map_before: Array, T_map_after: Array) -> None:
        """The map has moved under the camera: what was at T_map_before is at T_map_after."""
        T_after_before = T_map_after @ inverse(T_map_before)
        self._last = _moved(self._last, T_after_before)
        if self._reference is not None:
            fix, belief = self._reference
            self._reference = (fix, _moved(belief, T_after_before))

    def edge(
        self, last: KeyframeRecord | None, new: KeyframeRecord, ties: Sequence[Edge]
    ) -> tuple[list[Edge], list[Edge]]:
        """Odometry edges between two keyframes, and the weak guess where nothing else ties them.

        Where odometry is for blind pairs alone, a pair whose objects tell less than odometry is blind too;
        what they tell, such as a lone bottle its place, goes into the edge.
        """
        if last is None:
            return [], []
        motion = self._check.between(last, new, ties)
        if motion is not None and self.params.use == "always":
            return [_edge(last, new, motion)], []
        if motion is not None and not _tell_more(ties, motion):
            return [_edge(last, new, _sharpened(motion, last, new))], []
        if ties:
            return [], []
        return [], [
            _edge(last, new, self._odometry.free_motion((new.stamp_ns - last.stamp_ns) * NANOSECONDS))
        ]


def _moved(belief: Belief, T_after_before: Array) -> Belief:
    return replace(belief, T_map_camera=renormalized(T_after_before @ belief.T_map_camera))


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
    """Whether one of the ties knows better than odometry where the objects in view get by this motion."""
    best = min((_worst_variance(tie.covariance) for tie in ties), default=np.inf)
    return bool(best <= _worst_variance(motion.covariance))


def _worst_variance(covariance: Array) -> float:
    """Largest variance of the translation, and of what the rotation adds at the range of objects, m^2."""
    rotation, translation = np.linalg.eigvalsh(np.stack([covariance[:3, :3], covariance[3:, 3:]]))[:, -1]
    return float(translation + OBJECT_RANGE_M**2 * rotation)


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

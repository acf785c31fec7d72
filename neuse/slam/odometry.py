"""Odometry as a source of increments, with its faults: missing, late, repeated, jumping, backwards."""

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from neuse.geometry import Array, inverse, rotation_angle
from neuse.params import CheckedParams, param
from neuse.records import OdometrySample
from neuse.slam.checks import check_choice, is_rigid

NANOSECONDS = 1e-9


@dataclass(frozen=True)
class OdometryParams(CheckedParams):
    """How odometry is used and how far it is trusted."""

    use: str = param(
        "always", "always: an odometry edge between all keyframes; blind: only where no object ties them"
    )
    adapt: bool = param(
        True, "learn its noise beside objects and refuse what they contradict; false: as stated"
    )
    sigma_rotation_rad: float = param(0.003, "noise of an increment from frame to frame, rad", 1e-6, 1.0)
    sigma_translation_m: float = param(0.05, "noise of an increment from frame to frame, metres", 1e-6, 10.0)
    max_age_s: float = param(0.05, "a sample further than this from the frame's stamp is not used", 0.0, 10.0)
    max_speed_mps: float = param(5.0, "a faster increment is a jump", 0.01, 1000.0)
    max_rate_radps: float = param(6.0, "a faster turn is a jump", 0.01, 1000.0)
    blind_bias: float = param(
        0.3,
        "share of the noise not seen beside objects that is one error for as long as none is in sight",
        0.0,
        1.0,
    )
    free_speed_mps: float = param(0.5, "sigma of the camera's speed where there is no odometry", 0.001, 100.0)
    free_rate_radps: float = param(
        0.5, "sigma of the camera's turn rate where there is no odometry", 0.001, 100.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("use", self.use, ("always", "blind"))


@dataclass(frozen=True)
class OdometryFix:
    """An accepted sample. Fixes of one segment may be compared.

    index: counts the frames since the start.    blindness: sum of twice the frames without an object in sight
        before each of them.
    """

    T_odom_camera: Array
    segment: int
    index: int
    blindness: float


@dataclass(frozen=True)
class Motion:
    """p_from = T_from_to @ p_to, with covariance as in neuse.geometry."""

    T_from_to: Array
    covariance: Array


class OdometryTracker:
    """Accepts or refuses samples, and gives motions between accepted ones.

    counters: how often samples were refused, by reason.
    """

    def __init__(self, params: OdometryParams, counters: Counter[str]) -> None:
        self.params = params
        self.counters = counters
        self._last: OdometrySample | None = None
        self._segment = 0
        self._index = 0
        self._blindness = 0.0

    def accept(
        self, sample: OdometrySample | None, frame_stamp_ns: int, blind_frames: int = 0
    ) -> OdometryFix | None:
        """The fix for a frame, or None where there is no sample that can be used.

        blind_frames: how many frames before it have seen no object.
        """
        self._index += 1
        self._blindness += 2.0 * blind_frames
        fault = self._fault(sample, frame_stamp_ns)
        if sample is None or fault is not None:
            self.counters[fault or "odometry_missing"] += 1
            return None
        if self._is_jump(sample):
            self.counters["odometry_jump"] += 1
            self._segment += 1
        self._last = sample
        return OdometryFix(sample.T_odom_camera, self._segment, self._index, self._blindness)

    def contradicted(self, fix: OdometryFix) -> OdometryFix:
        """The fix of a frame that objects show elsewhere: it begins a segment, and that is counted."""
        self.counters["odometry_contradicted"] += 1
        self._segment += 1
        return replace(fix, segment=self._segment)

    def motion(self, before: OdometryFix | None, after: OdometryFix | None) -> Motion | None:
        """Motion between two fixes, None where odometry does not tell."""
        if before is None or after is None or before.segment != after.segment:
            return None
        T_from_to = inverse(before.T_odom_camera) @ after.T_odom_camera
        variances = np.repeat([self.params.sigma_rotation_rad**2, self.params.sigma_translation_m**2], 3)
        return Motion(T_from_to, np.diag(variances * max(1, after.index - before.index)))

    def free_motion(self, duration_s: float) -> Motion:
        """What is known of a motion without odometry: it was not fast."""
        sigmas = np.repeat([self.params.free_rate_radps, self.params.free_speed_mps], 3) * max(
            duration_s, 1e-3
        )
        return Motion(np.eye(4), np.diag(sigmas**2))

    def _fault(self, sample: OdometrySample | None, frame_stamp_ns: int) -> str | None:
        if sample is None:
            return None
        if not is_rigid(sample.T_odom_camera):
            return "odometry_not_rigid"
        if self._last is not None and sample.stamp_ns < self._last.stamp_ns:
            return "odometry_backwards"
        if abs(sample.stamp_ns - frame_stamp_ns) * NANOSECONDS > self.params.max_age_s:
            return "odometry_stale"
        if self._last is not None and sample.stamp_ns == self._last.stamp_ns:
            return "odometry_repeated"
        return None

    def _is_jump(self, sample: OdometrySample) -> bool:
        if self._last is None:
            return False
        params, step = self.params, inverse(self._last.T_odom_camera) @ sample.T_odom_camera
        duration_s = (sample.stamp_ns - self._last.stamp_ns) * NANOSECONDS
        far = np.linalg.norm(step[:3, 3]) > params.max_speed_mps * duration_s + 5 * params.sigma_translation_m
        turned = (
            rotation_angle(step[:3, :3]) > params.max_rate_radps * duration_s + 5 * params.sigma_rotation_rad
        )
        return bool(far or turned)

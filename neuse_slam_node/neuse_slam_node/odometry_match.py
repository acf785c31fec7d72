"""Which odometry sample belongs to a frame, and how long a frame waits for it; stamps are the only clock."""

from bisect import bisect_left, insort
from collections import deque
from typing import Any

from neuse.records import OdometrySample
from neuse_encoder_node.stamps import NANOSECONDS, StampOrder, Succession


class OdometryMatch:
    """Holds frames until their odometry is there, in bounded memory.

    A frame waits for the first sample that is not older than itself: only then is the nearest one known.
    It does not wait once frames are more than `wait_s` ahead of the odometry, which has stopped or was
    never there. Where one of the topics steps back by more than `restart_s` a new run begins; the other one
    may be seconds behind in the old run.
    """

    def __init__(self, wait_s: float, restart_s: float, capacity: int = 10000) -> None:
        self._wait_ns, self._capacity = int(wait_s * NANOSECONDS), capacity
        self._samples: list[OdometrySample] = []
        self._frames: deque[tuple[int, Any]] = deque()
        self._sample_order, self._frame_order = StampOrder(restart_s), StampOrder(restart_s)
        self._sample_runs = self._frame_runs = 0

    def add_sample(self, sample: OdometrySample) -> None:
        """Take in a sample, in its place by stamp; the first of a new run replaces all before."""
        if self._sample_order.follow(sample.stamp_ns) == Succession.RESTART:
            self._sample_runs += 1
            self._samples.clear()
        insort(self._samples, sample, key=_stamp_ns)
        del self._samples[: -self._capacity]

    def add_frame(self, stamp_ns: int, frame: Any) -> None:
        """Take in a frame; frames leave in the order in which they come."""
        if self._frame_order.follow(stamp_ns) == Succession.RESTART:
            self._frame_runs += 1
            if self._frame_runs > self._sample_runs:
                self._samples.clear()
        self._frames.append((stamp_ns, frame))

    def release(self, expected: bool) -> list[tuple[int, Any, OdometrySample | None]]:
        """Frames that need not wait any longer, each with its nearest sample, None if there is none at all.

        expected: somebody publishes odometry.
        """
        released = []
        while self._frames and self._is_ready(self._frames[0][0], expected):
            stamp_ns, frame = self._frames.popleft()
            released.append((stamp_ns, frame, self._nearest(stamp_ns)))
        return released

    def _is_ready(self, stamp_ns: int, expected: bool) -> bool:
        if not self._samples and not expected:
            return True
        newest_ns = self._frames[-1][0]
        latest_ns = self._samples[-1].stamp_ns if self._samples else stamp_ns
        covered = bool(self._samples) and latest_ns >= stamp_ns
        return covered or newest_ns < stamp_ns or newest_ns - latest_ns > self._wait_ns

    def _nearest(self, stamp_ns: int) -> OdometrySample | None:
        after = bisect_left(self._samples, stamp_ns, key=_stamp_ns)
        around = self._samples[max(0, after - 1) : after + 1]
        return min(around, key=lambda sample: abs(sample.stamp_ns - stamp_ns), default=None)


def _stamp_ns(sample: OdometrySample) -> int:
    return sample.stamp_ns

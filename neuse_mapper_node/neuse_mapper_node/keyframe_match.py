"""Which keyframe estimates belong to a tracked frame: two topics in the order in which they were sent."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from neuse_encoder_node.conversions import stamp_from_msg
from neuse_msgs.msg import TrackedFrame

MAX_ARRAYS = 100


@dataclass(frozen=True)
class Estimates:
    """All keyframes as records, and the stamp under which they were sent."""

    stamp_ns: int
    records: np.ndarray


class KeyframeMatch:
    """Holds frames until the keyframes that they changed are there.

    slam_node sends the keyframes of a frame that touched the pose graph under the frame's own stamp; other
    frames change none. A later array shows that the frame's own was lost.
    """

    def __init__(self) -> None:
        self._frames: deque[TrackedFrame] = deque()
        self._arrays: deque[Estimates] = deque(maxlen=MAX_ARRAYS)

    def add_frame(self, frame: TrackedFrame) -> None:
        """Take in a frame."""
        self._frames.append(frame)

    def add_keyframes(self, estimates: Estimates) -> None:
        """Take in the latest estimates; a step back in time forgets those of the earlier run."""
        if self._arrays and estimates.stamp_ns < self._arrays[-1].stamp_ns:
            self._arrays.clear()
        self._arrays.append(estimates)

    def release(self) -> list[tuple[TrackedFrame, Estimates | None]]:
        """Frames that need not wait, each with the latest array up to it, None where that has not changed."""
        released = []
        while self._frames and self._is_ready(self._frames[0]):
            frame = self._frames.popleft()
            latest = None
            while self._arrays and self._arrays[0].stamp_ns <= _stamp_ns(frame):
                latest = self._arrays.popleft()
            released.append((frame, latest))
        return released

    def _is_ready(self, frame: TrackedFrame) -> bool:
        touched = frame.keyframe_id != TrackedFrame.NO_ID or frame.loop_closed
        return not touched or any(array.stamp_ns >= _stamp_ns(frame) for array in self._arrays)


def _stamp_ns(message: TrackedFrame) -> int:
    return stamp_from_msg(message.header.stamp)

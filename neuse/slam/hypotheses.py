"""Where the camera may be before its objects are looked at, and which of these hypotheses they bear out."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from neuse.slam.association import Association
from neuse.slam.localization import Belief
from neuse.slam.odometry import Motion


class Hypothesis(NamedTuple):
    """A camera pose, and the motion since the last frame that leads there."""

    belief: Belief
    motion: Motion

    @classmethod
    def after(cls, start: Belief, motion: Motion) -> "Hypothesis":
        """Where a motion leads."""
        return cls(start.moved(motion.T_from_to, motion.covariance), motion)


def best_hypothesis(
    hypotheses: Sequence[Hypothesis],
    associate: Callable[[Hypothesis], Association],
    last_frame: int,
    expected: int,
) -> tuple[Hypothesis, Association]:
    """The first hypothesis, or one by which more of the objects of the last frame are found again.

    Others are tried where the first loses more than half of the objects, or leads elsewhere than to them.

    Args:
        last_frame: by which tracks name the last frame.    expected: how many of its objects may be in view.
    """
    best, found = hypotheses[0], associate(hypotheses[0])
    if found.T_map_camera is None and 2 * _kept(found, last_frame)[0] >= expected:
        return best, found
    for hypothesis in hypotheses[1:]:
        other = associate(hypothesis)
        if _kept(other, last_frame) > _kept(found, last_frame):
            best, found = hypothesis, other
    return best, found


def _kept(found: Association, last_frame: int) -> tuple[int, bool]:
    """How many objects of the last frame are found again, and whether where they were expected."""
    kept = sum(track is not None and track.last_frame == last_frame for track in found.tracks)
    return kept, found.T_map_camera is None

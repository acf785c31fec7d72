import numpy as np

from neuse_encoder_node.conversions import header_to_msg, stamp_from_msg
from neuse_mapper_node.keyframe_match import Estimates, KeyframeMatch
from neuse_msgs.msg import TrackedFrame
from neuse_slam_node.packed_keyframes import RECORD


def frame(stamp_ns: int, keyframe_id: int = TrackedFrame.NO_ID, loop_closed: bool = False) -> TrackedFrame:
    return TrackedFrame(
        header=header_to_msg(stamp_ns, "map"), keyframe_id=keyframe_id, loop_closed=loop_closed
    )


def keyframes(stamp_ns: int) -> Estimates:
    return Estimates(stamp_ns, np.zeros(0, RECORD))


def released(match: KeyframeMatch) -> list[tuple[int, int | None]]:
    """(frame, keyframes) stamps."""
    pairs = match.release()
    return [(stamp_from_msg(f.header.stamp), None if k is None else k.stamp_ns) for f, k in pairs]


def test_frame_that_is_no_keyframe_does_not_wait():
    match = KeyframeMatch()
    match.add_frame(frame(1))
    assert released(match) == [(1, None)]


def test_keyframe_waits_for_its_estimates_and_later_frames_wait_behind_it():
    match = KeyframeMatch()
    match.add_frame(frame(1, keyframe_id=0))
    match.add_frame(frame(2))
    match.add_frame(frame(3, loop_closed=True))
    assert released(match) == []
    match.add_keyframes(keyframes(1))
    assert released(match) == [(1, 1), (2, None)]
    match.add_keyframes(keyframes(3))
    assert released(match) == [(3, 3)]


def test_estimates_that_come_early_are_kept_for_their_frame():
    match = KeyframeMatch()
    for stamp_ns in (1, 2, 3):
        match.add_keyframes(keyframes(stamp_ns))
    for stamp_ns in (1, 2, 3):
        match.add_frame(frame(stamp_ns, keyframe_id=stamp_ns))
    assert released(match) == [(1, 1), (2, 2), (3, 3)]


def test_lost_estimates_hold_nothing_up():
    match = KeyframeMatch()
    match.add_frame(frame(1, keyframe_id=0))
    match.add_frame(frame(2, keyframe_id=1))
    match.add_keyframes(keyframes(2))
    assert released(match) == [(1, None), (2, 2)]


def test_a_new_run_goes_on_with_its_own_estimates():
    match = KeyframeMatch()
    match.add_keyframes(keyframes(1000))
    match.add_keyframes(keyframes(5))
    match.add_frame(frame(5, keyframe_id=0))
    assert released(match) == [(5, 5)]

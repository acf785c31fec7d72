import numpy as np
import pytest

from neuse.records import OdometrySample
from neuse_slam_node.odometry_match import OdometryMatch

MS = 10**6


def sample(stamp_ms: int) -> OdometrySample:
    return OdometrySample(stamp_ms * MS, np.eye(4))


def matcher() -> OdometryMatch:
    return OdometryMatch(wait_s=0.3, restart_s=1.0)


def released(match: OdometryMatch, expected: bool = True) -> list[tuple[int, int | None]]:
    """(frame, sample) stamps, milliseconds."""
    return [(stamp_ns // MS, s and s.stamp_ns // MS) for stamp_ns, _, s in match.release(expected)]


def test_frame_waits_for_the_sample_of_its_stamp():
    match = matcher()
    match.add_frame(1000 * MS, "frame")
    match.add_sample(sample(900))
    assert released(match) == []
    match.add_sample(sample(1000))
    assert released(match) == [(1000, 1000)]


def test_nearest_sample_is_chosen_whichever_side_it_lies_on():
    match = matcher()
    for stamp_ms in (960, 1010, 1090, 1100):
        match.add_sample(sample(stamp_ms))
    for stamp_ms in (1000, 1050, 1100):
        match.add_frame(stamp_ms * MS, "frame")
    assert released(match) == [(1000, 1010), (1050, 1010), (1100, 1100)]


def test_result_does_not_depend_on_which_topic_is_faster():
    first, second = matcher(), matcher()
    for stamp_ms in range(0, 1000, 100):
        first.add_frame(stamp_ms * MS, "frame")
    for stamp_ms in range(0, 1000, 50):
        first.add_sample(sample(stamp_ms))
        second.add_sample(sample(stamp_ms))
    for stamp_ms in range(0, 1000, 100):
        second.add_frame(stamp_ms * MS, "frame")
    assert released(first) == released(second)


def test_without_anyone_who_sends_odometry_no_frame_waits():
    match = matcher()
    match.add_frame(1000 * MS, "frame")
    assert released(match, expected=False) == [(1000, None)]


def test_frames_go_on_when_odometry_stops():
    match = matcher()
    match.add_sample(sample(1000))
    for stamp_ms in (1100, 1200, 1300):
        match.add_frame(stamp_ms * MS, "frame")
    assert released(match) == []
    match.add_frame(1400 * MS, "frame")
    assert [frame for frame, _ in released(match)] == [1100, 1200, 1300, 1400]


def test_frames_wait_at_the_start_only_so_long():
    match = matcher()
    match.add_frame(1000 * MS, "frame")
    assert released(match) == []
    match.add_frame(1400 * MS, "frame")
    assert [frame for frame, _ in released(match)] == [1000]


def test_frames_far_behind_the_odometry_still_get_their_own_sample():
    match = matcher()
    for stamp_ms in range(0, 30_000, 100):
        match.add_sample(sample(stamp_ms))
    for stamp_ms in (100, 200, 300):
        match.add_frame(stamp_ms * MS, "late")
        assert released(match) == [(stamp_ms, stamp_ms)]


@pytest.mark.parametrize("odometry_first", [True, False])
def test_samples_of_an_earlier_run_are_forgotten_whichever_topic_restarts_first(odometry_first: bool):
    match = matcher()
    for stamp_ms in (50_000, 50_100):
        match.add_sample(sample(stamp_ms))
    match.add_frame(50_100 * MS, "old")
    assert released(match) == [(50_100, 50_100)]
    if odometry_first:
        match.add_sample(sample(100))
        match.add_frame(100 * MS, "new")
    else:
        match.add_frame(100 * MS, "new")
        assert released(match) == []
        match.add_sample(sample(100))
    assert released(match) == [(100, 100)]


def test_frame_of_the_old_run_does_not_hold_up_the_new_one():
    match = matcher()
    match.add_sample(sample(50_000))
    match.add_frame(50_200 * MS, "old")
    match.add_frame(100 * MS, "new")
    match.add_sample(sample(100))
    assert [frame for frame, _ in released(match)] == [50_200, 100]


def test_memory_of_samples_is_bounded():
    match = OdometryMatch(wait_s=0.3, restart_s=1.0, capacity=10)
    for stamp_ms in range(100):
        match.add_sample(sample(stamp_ms))
    match.add_frame(5 * MS, "frame")
    assert released(match) == [(5, 90)]

from pathlib import Path

import numpy as np
import pytest

from neuse.errors import BagError, InputError
from neuse.geometry import exp
from neuse.records import OdometrySample, RgbdFrame
from neuse_bags import topics
from neuse_bags.conversions import camera_info_to_msg, depth_to_msg, mask_to_msg
from neuse_bags.frames import OdometryTrack, read_frames, read_odometry, with_color, write_frame
from neuse_bags.mcap_file import BagReader, BagWriter
from neuse_encoder_node.conversions import header_to_msg, instances_to_msg


def _read(path: Path) -> tuple[list[RgbdFrame], list[InputError]]:
    faults: list[InputError] = []
    with BagReader(path) as bag:
        return list(read_frames(bag, faults.append)), faults


def test_frames_are_read_back_as_written(frames_bag: Path, frames: list[RgbdFrame]) -> None:
    read, faults = _read(frames_bag)
    assert faults == []
    for back, frame in zip(read, frames, strict=True):
        np.testing.assert_array_equal(back.depth_m, frame.depth_m)
        np.testing.assert_array_equal(back.mask, frame.mask)
        assert (back.stamp_ns, back.instances, back.intrinsics) == (
            frame.stamp_ns,
            frame.instances,
            frame.intrinsics,
        )


def test_wanted_frames_alone_are_read_and_get_their_color(frames_bag: Path, frames: list[RgbdFrame]) -> None:
    wanted = frames[1::2]
    with BagReader(frames_bag) as bag:
        read = list(read_frames(bag, pytest.fail, {frame.stamp_ns for frame in wanted}))
        colored = with_color(bag, read)
    assert [frame.stamp_ns for frame in read] == [frame.stamp_ns for frame in wanted]
    for back, frame in zip(colored, wanted, strict=True):
        np.testing.assert_array_equal(back.color, frame.color)


def test_frame_without_color_leaves_the_color_topics_empty(tmp_path: Path, frames: list[RgbdFrame]) -> None:
    path = tmp_path / "gray.mcap"
    plain = frames[0]
    with BagWriter(path) as writer:
        topics.declare(writer, (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS))
        write_frame(writer, RgbdFrame(1, plain.depth_m, plain.mask, plain.instances, plain.intrinsics))
    with BagReader(path) as bag:
        assert bag.topics["/color/image"].n_messages == 0
        assert bag.topics["/depth/image"].n_messages == 1


def test_frame_with_a_part_missing_is_told_and_left_out(tmp_path: Path, frames: list[RgbdFrame]) -> None:
    path = tmp_path / "gap.mcap"
    with BagWriter(path) as writer:
        topics.declare(writer, (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS))
        lonely = depth_to_msg(frames[0].depth_m, header_to_msg(500, "camera"))
        writer.write(topics.DEPTH.name, lonely, 500)
        write_frame(writer, frames[1])
    read, faults = _read(path)
    assert [frame.stamp_ns for frame in read] == [frames[1].stamp_ns]
    assert [fault.reason for fault in faults] == ["incomplete_frame"]
    assert "/segmentation/mask" in str(faults[0])


def test_unusable_frame_is_told_and_later_frames_are_right(tmp_path: Path, frames: list[RgbdFrame]) -> None:
    path = tmp_path / "unusable.mcap"
    with BagWriter(path) as writer:
        topics.declare(writer, (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS))
        write_frame(writer, frames[0])
        header = header_to_msg(7, "camera")
        wrong = depth_to_msg(frames[1].depth_m, header)
        wrong.encoding = "bayer_rggb8"
        writer.write(topics.DEPTH.name, wrong, 7)
        writer.write(topics.DEPTH_INFO.name, camera_info_to_msg(frames[1].intrinsics, header), 7)
        writer.write(topics.MASK.name, mask_to_msg(frames[1].mask, header), 7)
        writer.write(topics.INSTANCES.name, instances_to_msg(frames[1].instances, header), 7)
        write_frame(writer, frames[2])
    read, faults = _read(path)
    assert [fault.reason for fault in faults] == ["encoding"]
    assert [frame.stamp_ns for frame in read] == [frames[0].stamp_ns, frames[2].stamp_ns]


def test_bag_without_the_needed_topics_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "odometry.mcap"
    with BagWriter(path) as writer:
        topics.declare(writer, (topics.ODOMETRY,))
    with pytest.raises(BagError, match="lacks /depth/camera_info, /depth/image"):
        _read(path)


def test_odometry_of_a_frame_is_the_nearest_sample(frames_bag: Path, frames: list[RgbdFrame]) -> None:
    with BagReader(frames_bag) as bag:
        track = read_odometry(bag, pytest.fail)
    found = track.at(frames[2].stamp_ns + 40_000_000)
    assert found is not None
    assert found.stamp_ns == frames[2].stamp_ns
    np.testing.assert_allclose(found.T_odom_camera, exp(np.full(6, 0.2)), atol=1e-12)


def test_without_odometry_there_is_no_sample() -> None:
    assert OdometryTrack([]).at(5) is None
    assert OdometryTrack([OdometrySample(9, np.eye(4))]).at(5) is not None

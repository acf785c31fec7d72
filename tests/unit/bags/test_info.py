import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from neuse.records import Instance, RgbdFrame
from neuse_bags import topics
from neuse_bags.conversions import odometry_to_msg
from neuse_bags.frames import write_frame
from neuse_bags.info import main
from neuse_bags.inspection import BagReport, inspect_bag
from neuse_bags.mcap_file import BagReader, BagWriter
from neuse_bags.qos import SENSOR

KNOWN = ("mug", "bottle")
Spoil = Callable[[RgbdFrame], RgbdFrame]


def inspect(path: Path) -> BagReport:
    with BagReader(path) as bag:
        return inspect_bag(bag, KNOWN)


def bag_of(frames: Sequence[RgbdFrame], path: Path) -> Path:
    with BagWriter(path) as writer:
        topics.declare(writer, (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS))
        for frame in frames:
            write_frame(writer, frame)
    return path


def copy(
    source: Path, path: Path, leave_out: str = "", rename: dict[str, str] | None = None, shift_ns: int = 0
) -> Path:
    """The bag without a topic, with topics renamed, or with the stamps of the mask shifted."""
    new_names = rename or {}
    with BagReader(source) as bag, BagWriter(path) as writer:
        for topic in bag.topics.values():
            if topic.name != leave_out:
                writer.add_topic(new_names.get(topic.name, topic.name), topic.type_name, [SENSOR])
        for message in bag.messages():
            decoded = message.decode()
            if message.topic == topics.MASK.name:
                decoded.header.stamp.nanosec += shift_ns
            if message.topic != leave_out:
                name = new_names.get(message.topic, message.topic)
                writer.write_raw(name, serialize_message(decoded), message.stamp_ns)
    return path


def test_sound_bag_has_topics_counts_and_categories(frames_bag: Path, capsys) -> None:
    assert main([str(frames_bag)]) == 0
    said = capsys.readouterr().out
    assert "0.4 s, 5 frames complete" in said
    assert "/depth/image" in said
    assert "5 x  10.0 Hz  reliable/volatile" in said
    assert "detections: mug 5, bottle 5" in said
    assert said.endswith("the graph can use it\n")
    assert "missing" not in said


def test_missing_topic_is_told_with_exit_code_one(frames_bag: Path, tmp_path: Path, capsys) -> None:
    path = copy(frames_bag, tmp_path / "b.mcap", leave_out="/segmentation/mask")
    assert main([str(path)]) == 1
    said = capsys.readouterr().out
    assert "missing: /segmentation/mask is missing (sensor_msgs/msg/Image: instance labels" in said
    assert said.endswith("the graph cannot use it\n")


def test_topic_of_another_name_is_proposed(frames_bag: Path, tmp_path: Path) -> None:
    renamed = {"/depth/camera_info": "/cam/depth/camera_info"}
    report = inspect(copy(frames_bag, tmp_path / "b.mcap", rename=renamed))
    assert [fault for fault in report.faults if "--remap /cam/depth/camera_info:=/depth/camera_info" in fault]


def test_bag_of_several_cameras_is_told_with_the_most_likely_names(
    frames: list[RgbdFrame], tmp_path: Path
) -> None:
    with BagWriter(tmp_path / "b.mcap") as writer:
        own = (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS)
        topics.declare(writer, tuple(topic.under(name) for name in ("/a", "/b") for topic in own))
        for frame in frames:
            write_frame(writer, frame, "/a")
            write_frame(writer, frame, "/b")
    report = inspect(tmp_path / "b.mcap")
    assert [note for note in report.notes if "/a, /b have depth/image: look at one, --namespace /a" in note]
    proposed = {fault.rpartition("--remap ")[2] for fault in report.faults}
    assert proposed == {f"/a{topic.name}:={topic.name}" for topic in topics.FRAME_TOPICS}
    assert main([str(tmp_path / "b.mcap")]) == 1
    assert main([str(tmp_path / "b.mcap"), "--namespace", "/b"]) == 0


def test_topic_of_another_type_is_told(frames_bag: Path, tmp_path: Path) -> None:
    swapped = {"/odom": "/segmentation/instances", "/segmentation/instances": "/odom"}
    faults = inspect(copy(frames_bag, tmp_path / "b.mcap", rename=swapped)).faults
    assert "/segmentation/instances has type nav_msgs/msg/Odometry; record it as neuse_msgs/" in "".join(
        faults
    )


def test_topic_without_messages_is_told(tmp_path: Path) -> None:
    assert "/depth/image has no message" in inspect(bag_of([], tmp_path / "b.mcap")).faults[0]


def test_stamps_that_never_pair_are_told_with_their_offset(frames_bag: Path, tmp_path: Path) -> None:
    report = inspect(copy(frames_bag, tmp_path / "b.mcap", shift_ns=3_000_000))
    assert report.n_frames == 0
    assert report.faults[0].startswith("0 of 5 stamps of /depth/image are on /segmentation/mask")
    assert "+3.000 ms away; give every /segmentation/mask the header.stamp" in report.faults[0]


def test_stamps_that_are_never_set_are_told(frames: list[RgbdFrame], tmp_path: Path) -> None:
    path = bag_of([replace(frame, stamp_ns=0) for frame in frames], tmp_path / "b.mcap")
    assert inspect(path).faults == ("5 images on /depth/image have 1 stamps; set each header.stamp",)


def test_few_stamps_that_do_not_pair_are_only_noted(frames: list[RgbdFrame], tmp_path: Path) -> None:
    path = bag_of(frames, tmp_path / "a.mcap")
    with BagReader(path) as bag, BagWriter(tmp_path / "b.mcap") as writer:
        topics.declare(writer, topics.FRAME_TOPICS)
        messages = [m for m in bag.messages() if m.topic in writer_topics()]
        for message in messages[:-1]:  # the last frame lacks its instances
            writer.write_raw(message.topic, message.data, message.stamp_ns)
    report = inspect(tmp_path / "b.mcap")
    assert (report.n_frames, report.faults) == (4, ())
    assert any("4 of 5 stamps" in note for note in report.notes)


def writer_topics() -> set[str]:
    return {topic.name for topic in topics.FRAME_TOPICS}


def _uncalibrated(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, intrinsics=replace(frame.intrinsics, fx=0.0, fy=0.0))


def _of_another_camera(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, intrinsics=replace(frame.intrinsics, width=64))


def _in_another_unit(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, depth_m=frame.depth_m / 100)


def _of_another_size(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, mask=np.zeros((2, 2), np.int32))


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (_uncalibrated, r"/depth/camera_info: .*calibrated\?; fill in k = \[fx"),
        (_of_another_camera, "/depth/camera_info: camera info is for 64 x 24.*; send the camera info of"),
        (_in_another_unit, "/depth/image: the unit of depth is wrong.*; send 16UC1 in millimetres"),
        (_of_another_size, "/depth/image, /segmentation/mask: .*one size"),
    ],
)
def test_frames_that_cannot_be_used_are_told(
    frames: list[RgbdFrame], tmp_path: Path, spoil: Spoil, told: str
) -> None:
    faults = inspect(bag_of([spoil(frame) for frame in frames], tmp_path / "b.mcap")).faults
    assert len(faults) == 1
    assert re.search(told, faults[0])


def _renamed(frame: RgbdFrame, *categories: str) -> RgbdFrame:
    labels = (7, 200)
    return replace(frame, instances=tuple(map(Instance, labels, categories)))


def test_categories_without_weights_are_noted_and_refused_where_no_other_is_left(
    frames: list[RgbdFrame], tmp_path: Path
) -> None:
    some = inspect(bag_of([_renamed(f, "mug", "kettle") for f in frames], tmp_path / "some.mcap"))
    none = inspect(bag_of([_renamed(f, "pan", "kettle") for f in frames], tmp_path / "none.mcap"))
    empty = inspect(bag_of([replace(f, instances=()) for f in frames], tmp_path / "empty.mcap"))
    assert "no weights for kettle; there are some for bottle, mug" in some.notes
    assert some.faults == ()
    assert none.faults == ("no weights for kettle, pan; there are some for bottle, mug",)
    assert "has no instance at all" in empty.faults[0]


def test_best_effort_inputs_and_missing_odometry_are_noted(frames_bag: Path, tmp_path: Path) -> None:
    notes = inspect(copy(frames_bag, tmp_path / "b.mcap", leave_out="/odom")).notes
    assert "no /odom: frames without known objects have no pose" in notes
    assert "/depth/image is best effort: leave input_reliable of encoder_node false" in notes


def test_file_that_is_no_bag_ends_with_exit_code_two(tmp_path: Path, capsys) -> None:
    (tmp_path / "no.mcap").write_bytes(b"no bag")
    assert main([str(tmp_path / "no.mcap")]) == 2
    assert capsys.readouterr().err.startswith("neuse_bags info: ")


def test_distortion_of_the_camera_is_told_and_does_no_harm(frames: list[RgbdFrame], tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bent.mcap") as writer:
        topics.declare(writer, topics.FRAME_TOPICS)
        bend = Bending(writer)
        for frame in frames:
            write_frame(bend, replace(frame, color=None))
    report = inspect(tmp_path / "bent.mcap")
    assert not report.faults
    assert any("has a distortion: depth and mask are taken to be rectified" in note for note in report.notes)


class Bending:
    """A writer of bags whose camera is distorted."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer = writer

    def write(self, name: str, message: object, stamp_ns: int) -> None:
        if name == topics.DEPTH_INFO.name:
            message.d = [0.1, -0.2, 0.0, 0.0, 0.0]
        self._writer.write(name, message, stamp_ns)


def _binary(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, mask=np.where(frame.mask > 0, 255, 0).astype(np.int32))


def _without_depth(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, depth_m=np.zeros_like(frame.depth_m))


def _all_over(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, mask=np.full_like(frame.mask, 7), instances=frame.instances[:1])


def _unlabelled(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, mask=np.zeros_like(frame.mask))


UNUSABLE = [
    (_binary, "10 x empty_mask .*5 x label_without_instance"),
    (_without_depth, "10 x too_few_points .*send depth where the objects are"),
    (_all_over, "5 x mask_too_large .*label the objects alone"),
    (_unlabelled, "10 x empty_mask .*give the pixels of each instance its label"),
]


@pytest.mark.parametrize(("spoil", "told"), UNUSABLE)
def test_bag_without_one_usable_instance_is_refused_with_the_reason(
    frames: list[RgbdFrame], tmp_path: Path, spoil: Spoil, told: str
) -> None:
    (fault,) = inspect(bag_of([spoil(frame) for frame in frames], tmp_path / "b.mcap")).faults
    assert re.search(f"0 instances in 5 frames can be used; refused: {told}", fault)


@pytest.mark.parametrize("spoil", [_unlabelled, _uncalibrated, _of_another_size])
def test_one_faulty_frame_is_only_noted(frames: list[RgbdFrame], tmp_path: Path, spoil: Spoil) -> None:
    report = inspect(bag_of([spoil(frames[0]), *frames[1:]], tmp_path / "b.mcap"))
    assert report.faults == ()
    assert any("can be used; refused" in note or "1 cannot be used" in note for note in report.notes)


@pytest.mark.parametrize("name", ["/odom", "/ground_truth/odometry"])
def test_poses_of_another_clock_are_told(frames: list[RgbdFrame], tmp_path: Path, name: str) -> None:
    with BagWriter(tmp_path / "b.mcap") as writer:
        topics.declare(
            writer, (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS, topics.ODOMETRY, topics.TRUE_ODOMETRY)
        )
        for frame in frames:
            write_frame(writer, frame)
        writer.write(name, odometry_to_msg(10**18, np.eye(4), "odom"), frames[0].stamp_ns)
    (fault,) = inspect(tmp_path / "b.mcap").faults
    assert fault.startswith(f"{name}: no pose is at the time of a frame: poses are at 1000000000.000")


def test_folder_that_is_no_bag_is_told_with_a_way_out(tmp_path: Path, capsys) -> None:
    assert main([str(tmp_path)]) == 2
    assert (
        "without metadata.yaml, so no rosbag2 folder; give an .mcap file, or make" in capsys.readouterr().err
    )
    (tmp_path / "a.mcap").touch()
    assert main([str(tmp_path)]) == 2
    assert f"such as {tmp_path / 'a.mcap'}, or make one: ros2 bag reindex" in capsys.readouterr().err

import os
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.well_known import Profile
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader, StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_typestore
from std_msgs.msg import String

from neuse.errors import BagError
from neuse_bags import topics
from neuse_bags.mcap_file import BagReader, BagWriter
from neuse_bags.qos import RELIABLE


def _image_pixels(message) -> np.ndarray:
    return np.frombuffer(bytes(message.data), dtype=np.uint16).reshape(message.height, message.width)


def test_header_says_ros2_and_chunks_are_compressed(frames_bag: Path) -> None:
    with frames_bag.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == Profile.ROS2
        summary = reader.get_summary()
    assert summary is not None
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    assert all("offered_qos_profiles" in channel.metadata for channel in summary.channels.values())


def test_mcap_ros2_support_reads_the_same_messages(frames_bag: Path, frames) -> None:
    with frames_bag.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        read = reader.iter_decoded_messages(topics=["/depth/image", "/segmentation/instances"])
        messages = {(channel.topic, raw.log_time): decoded for _, channel, raw, decoded in read}
    for frame in frames:
        depth = _image_pixels(messages["/depth/image", frame.stamp_ns])
        np.testing.assert_array_equal(depth, np.rint(frame.depth_m * 1e3))
        entries = messages["/segmentation/instances", frame.stamp_ns].instances
        assert [(e.label, e.category, e.score) for e in entries] == [
            (i.label, i.category, i.score) for i in frame.instances
        ]


def test_rosbags_reads_the_same_messages_by_the_embedded_definitions(frames_bag: Path, frames) -> None:
    with AnyReader([frames_bag]) as reader:
        connections = [c for c in reader.connections if c.topic == "/segmentation/instances"]
        read = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(connections)]
    assert [[e.label for e in m.instances] for m in read] == [[i.label for i in f.instances] for f in frames]


def test_reader_gives_back_what_was_written_in_order_of_stamps(frames_bag: Path, frames) -> None:
    with BagReader(frames_bag) as bag:
        stamps_ns = [message.stamp_ns for message in bag.messages()]
        depth = [message.decode() for message in bag.messages(["/depth/image"])]
        assert (bag.start_ns, bag.topics["/odom"].n_messages) == (frames[0].stamp_ns, 5)
        assert bag.topics["/odom"].qos == (RELIABLE,)
    assert stamps_ns == sorted(stamps_ns)
    np.testing.assert_array_equal(_image_pixels(depth[3]), np.rint(frames[3].depth_m * 1e3))


def test_topics_that_a_bag_lacks_are_named(frames_bag: Path) -> None:
    with BagReader(frames_bag) as bag:
        assert list(bag.messages(["/nothing"])) == []
        with pytest.raises(BagError, match=r"lacks /nothing; it has .*/depth/image"):
            bag.require(["/nothing", "/odom"])


def _write_and_stop(path: Path) -> None:
    with BagWriter(path) as writer:
        topics.declare(writer, (topics.ODOMETRY,))
        writer.write("/odom", Odometry(), 5)
        raise KeyboardInterrupt


def test_file_is_whole_when_the_writer_is_interrupted(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        _write_and_stop(tmp_path / "short.mcap")
    with Reader(tmp_path / "short.mcap") as reader:
        assert reader.message_count == 1


def test_rosbag2_folder_is_read_like_a_file(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    with FolderWriter(tmp_path / "folder", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
        writer.write(connection, 42, serialize_message(Odometry(child_frame_id="camera")))
    with BagReader(tmp_path / "folder") as bag:
        (message,) = bag.messages()
    assert (message.stamp_ns, message.decode().child_frame_id) == (42, "camera")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.mcap", b""),
        ("foreign.mcap", b"no bag" * 99),
        ("foreign.txt", b"text"),
        ("short.mcap", b"\x89MCAP0\r\n"),
    ],
)
def test_foreign_files_are_refused_with_the_path_and_a_way_out(
    tmp_path: Path, name: str, content: bytes
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(BagError, match=f"{name}.*not a ROS 2 bag"):
        BagReader(path)


def test_topic_whose_type_was_defined_otherwise_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "old.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema("neuse_msgs/msg/InstanceArray", "ros2msg", b"uint8 count")
        channel = writer.register_channel("/segmentation/instances", "cdr", schema)
        writer.add_message(channel, 1, b"\0\1\0\0\7", 1)
        writer.finish()
    with (
        BagReader(path) as bag,
        pytest.raises(BagError, match="/segmentation/instances was recorded with an"),
    ):
        list(bag.messages())


def test_message_that_ends_too_soon_is_told_by_topic_and_time(tmp_path: Path) -> None:
    path = tmp_path / "short.mcap"
    with BagWriter(path) as writer:
        topics.declare(writer, (topics.ODOMETRY,))
        writer.write_raw("/odom", serialize_message(Odometry())[:40], 7)
    with BagReader(path) as bag, pytest.raises(BagError, match=r"/odom holds a damaged nav_msgs.* at 7 ns"):
        next(bag.messages()).decode()


@pytest.mark.parametrize("lost_bytes", [1, 40, 2000])
def test_truncated_bag_is_refused(frames_bag: Path, lost_bytes: int) -> None:
    frames_bag.write_bytes(frames_bag.read_bytes()[:-lost_bytes])
    with pytest.raises(BagError, match="truncated"):
        BagReader(frames_bag)


def test_damage_inside_a_bag_is_told_while_reading(frames_bag: Path) -> None:
    content = bytearray(frames_bag.read_bytes())
    content[200:260] = bytes(60)
    frames_bag.write_bytes(content)
    with pytest.raises(BagError, match="cannot be read"), BagReader(frames_bag) as bag:
        list(bag.messages())


def test_mcap_of_another_profile_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "json.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="other")
        writer.finish()
    with pytest.raises(BagError, match="Profile is not ros2"):
        BagReader(path)


def test_messages_that_are_not_cdr_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "json.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="other")
        schema_id = writer.register_schema("a/msg/B", "ros2msg", b"")
        writer.register_channel(topic="/a", message_encoding="json", schema_id=schema_id)
        writer.finish()
    with pytest.raises(BagError, match="/a is encoded as json"):
        BagReader(path)


def test_missing_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"nothing\.mcap does not exist"):
        BagReader(tmp_path / "nothing.mcap")


def test_bag_name_without_its_ending_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"ends in \.mcap"):
        BagWriter(tmp_path / "bag")


def test_bag_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "taken.mcap").mkdir()
    with pytest.raises(BagError, match="cannot be written"):
        BagWriter(tmp_path / "taken.mcap")


def _write_texts(writer: BagWriter, mebibytes: int) -> None:
    for stamp_ns in range(mebibytes):
        writer.write("/text", String(data=os.urandom(2**19).hex()), stamp_ns)


def test_full_disk_is_told_with_the_way_to_what_was_saved(tmp_path: Path) -> None:
    full = tmp_path / "full.mcap"
    full.symlink_to("/dev/full")  # where every write finds no space
    writer = BagWriter(full)
    writer.add_topic("/text", "std_msgs/msg/String", [RELIABLE])
    with pytest.raises(BagError, match=r"full\.mcap .*No space left on device; .*`mcap recover`"):
        _write_texts(writer, mebibytes=10)
    with pytest.raises(BagError, match="No space left"):
        writer.close()
    writer.close()


@pytest.fixture
def several(tmp_path: Path) -> Path:
    """Two cameras and a map, each topic told once by its own name."""
    path = tmp_path / "several.mcap"
    with BagWriter(path) as writer:
        for stamp_ns, name in enumerate(("/a/odom", "/b/odom", "/map", "/odom")):
            writer.add_topic(name, "std_msgs/msg/String", [RELIABLE])
            writer.write(name, String(data=name), stamp_ns)
    return path


@pytest.mark.parametrize("namespace", ["/a", "a", "/a/"])
def test_topics_of_a_namespace_are_called_as_if_it_were_alone(several: Path, namespace: str) -> None:
    with BagReader(several, namespace) as bag:
        assert bag.topics.keys() == {"/odom", "/b/odom", "/map"}
        assert {name: topic.name for name, topic in bag.topics.items()} == {n: n for n in bag.topics}
        told = [(message.topic, message.decode().data) for message in bag.messages()]
        assert told == [("/odom", "/a/odom"), ("/b/odom", "/b/odom"), ("/map", "/map")]
        assert [message.decode().data for message in bag.messages(["/odom"])] == ["/a/odom"]


def test_namespace_without_topics_is_refused_with_what_there_is(several: Path) -> None:
    with pytest.raises(BagError, match="no topic in namespace /c; it has /a/odom, /b/odom"):
        BagReader(several, "/c")

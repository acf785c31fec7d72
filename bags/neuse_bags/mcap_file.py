"""Bags on disk, both ways: MCAP of profile ros2, zstd, with definitions and QoS inside."""

import struct
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.writer import CompressionType, Writer
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2 import Reader

from neuse.errors import BagError
from neuse_bags.chunks import check_chunks
from neuse_bags.definitions import is_installed_alike, message_class, message_definition
from neuse_bags.qos import qos_from_rosbags, qos_to_yaml

_CHUNK_BYTES = 4 * 1024 * 1024


@dataclass(frozen=True)
class BagTopic:
    """A topic of a bag; qos: the profiles its publishers offered, empty when the bag does not say."""

    name: str
    type_name: str
    qos: tuple[QoSProfile, ...]
    n_messages: int


@dataclass(frozen=True)
class RawMessage:
    """A message as it lies in the bag: CDR bytes, and when it was logged."""

    topic: str
    type_name: str
    stamp_ns: int
    data: bytes

    @property
    def header_stamp_ns(self) -> int:
        """Stamp of a message that begins with a std_msgs/Header, without decoding all of it."""
        little_endian = self.data[1] & 1  # of the four bytes that say how the rest is encoded
        seconds, nanoseconds = struct.unpack_from("<iI" if little_endian else ">iI", self.data, 4)
        return seconds * 10**9 + nanoseconds

    def decode(self) -> Any:
        """The message object; raises BagError if its type is not installed here, or its bytes are damaged."""
        kind = message_class(self.type_name)
        try:
            return deserialize_message(self.data, kind)
        except RuntimeError as error:  # whatever the middleware says of bytes that end too soon
            raise BagError(f"{self.topic} holds a damaged {self.type_name} at {self.stamp_ns} ns") from error


class BagWriter:
    """Writes one .mcap file; as a context manager it closes the file whole, whatever happens inside.

    Raises:
        BagError: the path does not end in .mcap or cannot be written, now or later: a disk may get full.
    """

    def __init__(self, path: Path) -> None:
        if path.suffix != ".mcap":
            raise BagError(f"{path}: the name of a bag ends in .mcap; rename it")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = path.open("wb")
        except OSError as error:
            raise BagError(f"{path} cannot be written: {error.strerror}") from error
        self.path = path
        self.counts: Counter[str] = Counter()
        self._channel_ids: dict[str, int] = {}
        self._schema_ids: dict[str, int] = {}
        self._writer = Writer(self._stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="neuse_bags")

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Flush the last chunk, write the index and close the file."""
        if self._stream.closed:
            return
        with self._writing():
            try:
                self._writer.finish()
            finally:
                self._stream.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            told = f"{self.path} cannot be written any further: {error.strerror}; make room, and save what"
            raise BagError(f"{told} was written before with `mcap recover`") from error

    def add_topic(self, name: str, type_name: str, qos: Collection[QoSProfile]) -> None:
        """Declare a topic; needed once before its first message."""
        if type_name not in self._schema_ids:
            definition = message_definition(type_name).encode()
            self._schema_ids[type_name] = self._writer.register_schema(type_name, "ros2msg", definition)
        self._channel_ids[name] = self._writer.register_channel(
            topic=name,
            message_encoding="cdr",
            schema_id=self._schema_ids[type_name],
            metadata={"offered_qos_profiles": qos_to_yaml(list(qos))},
        )

    def write_raw(self, topic: str, data: bytes, stamp_ns: int) -> None:
        """Append CDR bytes to a declared topic."""
        with self._writing():
            self._writer.add_message(self._channel_ids[topic], stamp_ns, data, stamp_ns, self.counts[topic])
        self.counts[topic] += 1

    def write(self, topic: str, message: Any, stamp_ns: int) -> None:
        """Append a message object to a declared topic."""
        self.write_raw(topic, serialize_message(message), stamp_ns)


class BagReader:
    """Reads a .mcap or .db3 file, or a rosbag2 folder; a context manager.

    namespace: of one camera among several; its topics are called as if it were alone, `/a/odom` is `/odom`.

    Raises:
        BagError: the bag is missing, truncated, damaged, not of ROS 2, or has nothing in the namespace.
    """

    def __init__(self, path: Path, namespace: str = "") -> None:
        self.path = path
        with _reading(path):
            check_chunks(path)
            self._reader = Reader(path)
            self._reader.open()
        topics = list(map(_bag_topic, self._reader.connections))
        self._names = _names_in(namespace, [topic.name for topic in topics])
        if namespace and not self._names:
            has = ", ".join(sorted(topic.name for topic in topics)) or "nothing"
            raise BagError(f"{path} has no topic in namespace {namespace}; it has {has}")
        named = ((self._names[topic.name], topic) for topic in topics if topic.name in self._names)
        self.topics = {name: replace(topic, name=name) for name, topic in named}
        self.start_ns, self.end_ns = self._reader.start_time, self._reader.end_time

    def __enter__(self) -> "BagReader":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def require(self, topics: Collection[str]) -> None:
        """Raises BagError naming the topics that the bag lacks."""
        missing = sorted(set(topics) - self.topics.keys())
        if missing:
            has = ", ".join(sorted(self.topics)) or "nothing"
            raise BagError(f"{self.path} lacks {', '.join(missing)}; it has {has}")

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Messages in the order of their log stamps, of all topics or of those given.

        Raises:
            BagError: damage, or a topic whose type was defined otherwise when it was recorded.
        """
        named = ((self._names.get(c.topic), c) for c in self._reader.connections)
        wanted = [c for name, c in named if name is not None and (topics is None or name in topics)]
        for connection in wanted:
            self._check_definition(connection)
        with _reading(self.path):
            for connection, stamp_ns, data in self._reader.messages(wanted) if wanted else ():
                yield RawMessage(self._names[connection.topic], connection.msgtype, stamp_ns, bytes(data))

    def _check_definition(self, connection: Connection) -> None:
        """Raises BagError where the installed class would misread what was recorded."""
        definition = connection.msgdef
        is_text = definition.format == MessageDefinitionFormat.MSG and definition.data
        if is_text and not is_installed_alike(connection.msgtype, definition.data):
            raise BagError(
                f"{self.path}: {connection.topic} was recorded with another definition of "
                f"{connection.msgtype} than is installed; make the bag again, or use the version it is of"
            )


def _names_in(namespace: str, topics: Collection[str]) -> dict[str, str]:
    """{topic: its name in the namespace, outside its own unless that hides it}; empty if it has none."""
    if not namespace:
        return {topic: topic for topic in topics}
    prefix = f"/{namespace.strip('/')}/"
    within = {topic: f"/{topic.removeprefix(prefix)}" for topic in topics if topic.startswith(prefix)}
    hidden = {*within, *within.values()}
    return {topic: topic for topic in topics if within and topic not in hidden} | within


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Whatever the parser says of a damaged file, as one BagError that tells the way out."""
    try:
        yield
    except FileNotFoundError as error:
        raise BagError(_not_found(path)) from error
    except BagError:
        raise
    except Exception as error:  # a damaged file can fail anywhere inside the parser
        hint = "not a ROS 2 bag, or truncated; `mcap recover` saves what is left of a truncated file"
        raise BagError(f"{path} cannot be read ({error or type(error).__name__}): {hint}") from error


def _not_found(path: Path) -> str:
    if not path.is_dir():
        return f"{path} does not exist"
    told = f"{path} is a folder without metadata.yaml, so no rosbag2 folder"
    files = sorted([*path.glob("*.mcap"), *path.glob("*.db3")])
    if files:
        return f"{told}; give a file of it, such as {files[0]}, or make one: ros2 bag reindex {path}"
    return f"{told}; give an .mcap file, or make one of pictures: neuse_bags convert {path} --out X.mcap"


def _bag_topic(connection: Connection) -> BagTopic:
    ext = connection.ext
    assert isinstance(ext, ConnectionExtRosbag2)
    if ext.serialization_format != "cdr":
        raise BagError(f"topic {connection.topic} is encoded as {ext.serialization_format}, not as cdr")
    qos = tuple(qos_from_rosbags(profile) for profile in ext.offered_qos_profiles)
    return BagTopic(connection.topic, connection.msgtype, qos, connection.msgcount)

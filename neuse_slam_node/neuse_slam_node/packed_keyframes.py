"""KeyframeArray messages as their bytes: all keyframes, for the price of a copy.

A pose graph has thousands of keyframes, and to make, send and read objects for all of them with every new one
would take longer than to track. In CDR, which DDS sends, a Keyframe is a record of fixed size without gaps.
"""

import struct
from collections.abc import Iterable

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.serialization import deserialize_message, serialize_message

from neuse.errors import InputError
from neuse.geometry import quaternion_xyzw
from neuse.records import Keyframe
from neuse_encoder_node.conversions import header_to_msg, stamp_from_msg
from neuse_encoder_node.stamps import NANOSECONDS
from neuse_msgs.msg import KeyframeArray
from neuse_slam_node.poses import transforms_from_numbers

RECORD = np.dtype(
    [
        ("keyframe_id", "<i8"),
        ("sec", "<i4"),
        ("nanosec", "<u4"),
        ("position", "<f8", 3),
        ("q_xyzw", "<f8", 4),
    ]
)
ENCAPSULATION = 4  # bytes ahead of a message, from whose end alignment counts
LITTLE_ENDIAN = 1
RENEWAL_SHARE = 0.01  # of all keyframes: to read all takes no more than to read 100 with each new one


class KeyframeTable:
    """The latest of each keyframe, as records; ids count up from 0."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all."""
        self.records = np.zeros(0, RECORD)
        self._n_renewed = 0

    @property
    def is_old(self) -> bool:
        """Whether so many keyframes have come since all were taken over that it is worth doing it again."""
        return len(self.records) - self._n_renewed > RENEWAL_SHARE * len(self.records)

    def renew(self, keyframes: Iterable[Keyframe]) -> None:
        """Take over all keyframes: those that have not moved much have moved a little."""
        self.update(keyframes)
        self._n_renewed = len(self.records)

    def update(self, keyframes: Iterable[Keyframe]) -> None:
        """Take over new and moved keyframes."""
        keyframes = list(keyframes)
        if not keyframes:
            return
        ids = np.array([keyframe.keyframe_id for keyframe in keyframes])
        missing = int(ids.max()) + 1 - len(self.records)
        if missing > 0:
            self.records = np.concatenate([self.records, np.zeros(missing, RECORD)])
        self.records[ids] = _records(keyframes, ids)


class KeyframeReader:
    """Reads of each array only the keyframes that are not as they were in the one before."""

    def __init__(self) -> None:
        self._known = np.zeros(0, RECORD)

    def changed(self, records: np.ndarray) -> tuple[Keyframe, ...]:
        """New and moved keyframes among (n,) records.

        Raises:
            InputError: `pose` or `stamp`.
        """
        n = min(len(records), len(self._known))
        is_changed = np.ones(len(records), dtype=bool)
        is_changed[:n] = (_words(records[:n]) != _words(self._known[:n])).any(axis=1)
        keyframes = keyframes_of(records[is_changed])
        self._known = records
        return keyframes

    def forget(self) -> None:
        """Read all of the next array."""
        self._known = np.zeros(0, RECORD)


def pack(records: np.ndarray, stamp_ns: int, map_frame: str) -> bytes:
    """The KeyframeArray of (n,) records, serialised."""
    head = serialize_message(KeyframeArray(header=header_to_msg(stamp_ns, map_frame)))
    if not len(records):
        return bytes(head)
    length = struct.pack("<I", len(records))
    gap = bytes(_gap(len(head)))
    return bytes(head)[: -len(length)] + length + gap + records.tobytes()


def unpack(data: bytes) -> tuple[int, np.ndarray]:
    """Stamp, nanoseconds, and (n,) records of a serialised KeyframeArray.

    Raises:
        InputError: `array_length`, the bytes are no such message, or `stamp`.
    """
    if len(data) < ENCAPSULATION or data[1] != LITTLE_ENDIAN:
        data = _in_our_order(data)
    try:
        sec, nanosec, name_length = struct.unpack_from("<iII", data, ENCAPSULATION)
        end = ENCAPSULATION + 12 + name_length
        end += -end % 4
        (n,) = struct.unpack_from("<I", data, end)
        begin = end + 4 + (_gap(end + 4) if n else 0)
        records = np.frombuffer(data, RECORD, n, begin)
    except (struct.error, ValueError) as error:
        raise InputError("array_length", f"{len(data)} bytes are no keyframes: {error}") from error
    return stamp_from_msg(Time(sec=sec, nanosec=nanosec)), records


def _in_our_order(data: bytes) -> bytes:
    try:
        return bytes(serialize_message(deserialize_message(data, KeyframeArray)))
    except RuntimeError as error:  # whatever the middleware says of bytes that end too soon
        raise InputError("array_length", f"{len(data)} bytes are no keyframes: {error}") from error


def keyframes_of(records: np.ndarray) -> tuple[Keyframe, ...]:
    """Keyframes of (n,) records.

    Raises:
        InputError: `pose` or `stamp`.
    """
    T_map_camera = transforms_from_numbers(records["position"], records["q_xyzw"])
    stamps = zip(records["sec"].tolist(), records["nanosec"].tolist(), strict=True)
    stamps_ns = [stamp_from_msg(Time(sec=sec, nanosec=nanosec)) for sec, nanosec in stamps]
    return tuple(map(Keyframe, records["keyframe_id"].tolist(), stamps_ns, T_map_camera))


def _records(keyframes: list[Keyframe], ids: np.ndarray) -> np.ndarray:
    T_map_camera = np.stack([keyframe.T_map_camera for keyframe in keyframes])
    records = np.zeros(len(keyframes), RECORD)
    records["keyframe_id"] = ids
    stamps_ns = np.array([keyframe.stamp_ns for keyframe in keyframes])
    records["sec"], records["nanosec"] = np.divmod(stamps_ns, NANOSECONDS)
    records["position"], records["q_xyzw"] = T_map_camera[:, :3, 3], quaternion_xyzw(T_map_camera)
    return records


def _words(records: np.ndarray) -> np.ndarray:
    """(n, 9) the records as integers, which compare bit by bit."""
    return records.view(np.uint64).reshape(-1, RECORD.itemsize // 8)


def _gap(end: int) -> int:
    """Bytes from a place in a serialised message to where an int64 may be."""
    return -(end - ENCAPSULATION) % 8

"""Arrays of keyframes as bytes, beside the serialisation of DDS."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message

from neuse.errors import InputError
from neuse.geometry import exp
from neuse.records import Keyframe
from neuse_msgs.msg import KeyframeArray
from neuse_slam_node.conversions import keyframes_to_msg
from neuse_slam_node.packed_keyframes import KeyframeReader, KeyframeTable, keyframes_of, pack, unpack

STAMP_NS = 5_123_456_789


def keyframes(count: int, seed: int = 0) -> list[Keyframe]:
    xis = np.random.default_rng(seed).normal(size=(count, 6))
    return [Keyframe(i, STAMP_NS + i * 10**8, exp(xi)) for i, xi in enumerate(xis)]


def table_of(made: list[Keyframe]) -> KeyframeTable:
    table = KeyframeTable()
    table.update(made)
    return table


@pytest.mark.parametrize("map_frame", ["", "m", "map", "maps", "robot_1/map"])
@pytest.mark.parametrize("count", [0, 1, 7])
def test_packed_bytes_are_those_of_the_message(count: int, map_frame: str):
    made = keyframes(count)
    packed = pack(table_of(made).records, STAMP_NS, map_frame)
    message = deserialize_message(packed, KeyframeArray)
    assert message == keyframes_to_msg(made, STAMP_NS, map_frame)
    stamp_ns, records = unpack(serialize_message(message))
    assert stamp_ns == STAMP_NS
    assert np.array_equal(records, table_of(made).records)


def test_keyframes_survive_the_way_through_the_bytes():
    made = keyframes(5)
    _, records = unpack(pack(table_of(made).records, STAMP_NS, "map"))
    for one, other in zip(keyframes_of(records), made, strict=True):
        assert (one.keyframe_id, one.stamp_ns) == (other.keyframe_id, other.stamp_ns)
        np.testing.assert_allclose(one.T_map_camera, other.T_map_camera, atol=1e-12)


def test_bytes_of_a_big_endian_machine_are_read_as_well():
    packed = serialize_message(keyframes_to_msg(keyframes(1), STAMP_NS, "map"))
    fields = [
        (4, 4),
        (8, 4),
        (12, 4),
        (20, 4),
        (28, 8),
        (36, 4),
        (40, 4),
        *((44 + 8 * i, 8) for i in range(7)),
    ]
    swapped = bytearray(packed)
    swapped[1] = 0
    for at, size in fields:
        swapped[at : at + size] = packed[at : at + size][::-1]
    stamp_ns, records = unpack(bytes(swapped))
    assert stamp_ns == STAMP_NS
    assert np.array_equal(records, unpack(packed)[1])


def test_table_takes_over_what_is_new_and_what_has_moved():
    first, moved = keyframes(6), keyframes(6, seed=1)
    table = table_of(first[:4])
    table.update([moved[3], *first[4:]])
    table.update([])
    assert np.array_equal(table.records, table_of([*first[:3], moved[3], *first[4:]]).records)
    table.clear()
    assert len(table.records) == 0


def test_table_is_old_after_every_keyframe_at_first_and_ever_more_rarely_later():
    table, renewals = KeyframeTable(), []
    for keyframe in keyframes(1000):
        table.update([keyframe])
        if table.is_old:
            table.renew([keyframe])
            renewals.append(keyframe.keyframe_id)
    assert renewals[:50] == list(range(50))
    assert max(np.diff(renewals)) == 10


def test_reader_gives_what_has_changed_and_all_again_once_it_has_forgotten():
    first, moved, reader = keyframes(6), keyframes(6, seed=1), KeyframeReader()
    assert [k.keyframe_id for k in reader.changed(table_of(first[:4]).records)] == [0, 1, 2, 3]
    second = table_of([first[0], moved[1], *first[2:]]).records
    assert [k.keyframe_id for k in reader.changed(second)] == [1, 4, 5]
    assert reader.changed(second) == ()
    assert [k.keyframe_id for k in reader.changed(second[:2])] == []
    assert [k.keyframe_id for k in reader.changed(second)] == [2, 3, 4, 5]
    reader.forget()
    assert len(reader.changed(second)) == 6


def test_keyframe_without_a_pose_or_a_time_is_refused_each_time_it_comes():
    records, reader = table_of(keyframes(3)).records, KeyframeReader()
    records["q_xyzw"][1] = 0.0
    for _ in range(2):
        with pytest.raises(InputError, match="no pose") as refused:
            reader.changed(records)
        assert refused.value.reason == "pose"
    records = table_of(keyframes(3)).records
    records["nanosec"][2] = 2**32 - 1
    with pytest.raises(InputError) as refused:
        reader.changed(records)
    assert refused.value.reason == "stamp"


def test_bytes_that_are_no_keyframes_are_refused():
    packed = pack(table_of(keyframes(3)).records, STAMP_NS, "map")
    for size in range(4, len(packed)):
        with pytest.raises(InputError) as refused:
            unpack(packed[:size])
        assert refused.value.reason == "array_length"
    wrong = packed[:8] + b"\xff" * 4 + packed[12:]
    with pytest.raises(InputError) as refused:
        unpack(wrong)
    assert refused.value.reason == "stamp"

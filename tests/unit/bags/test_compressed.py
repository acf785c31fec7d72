"""Compressed images come out as the images that they were made of."""

import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage, Image

from neuse.errors import InputError
from neuse.records import RgbdFrame
from neuse_bags.compressed import PACKED_TYPE, unpacked
from neuse_bags.convert import main
from neuse_bags.frames import read_frames, with_color
from neuse_bags.mcap_file import BagReader, BagWriter, RawMessage
from neuse_bags.qos import RELIABLE
from neuse_encoder_node.images import depth_from_msg

A, B = 100.0 * 101.0, 1.0 - 100.0 * 101.0 / 10.0  # of image_transport, quantised at 100, up to 10 m
PACKED = {
    "/cam/depth": "/depth/image",
    "/cam/mask": "/segmentation/mask",
    "/cam/color": "/color/image",
}


def png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def jpeg(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", pixels)[1].tobytes()


def depth_header(a: float = 0.0, b: float = 0.0) -> bytes:
    return struct.pack("<iff", 0, a, b)


def message(topic: str, form: str, data: bytes) -> RawMessage:
    packed = CompressedImage(format=form, data=data)
    packed.header.stamp.sec = 3
    return RawMessage(topic, PACKED_TYPE, 5, serialize_message(packed))


def image(topic: str, form: str, data: bytes) -> Image:
    return deserialize_message(unpacked(message(topic, form, data)).data, Image)


def test_depth_in_millimetres_is_as_it_was() -> None:
    depth_mm = np.random.default_rng(0).integers(0, 60000, (9, 7)).astype(np.uint16)
    found = image("/depth/image", "16UC1; compressedDepth png", depth_header() + png(depth_mm))
    assert (found.encoding, found.header.stamp.sec) == ("16UC1", 3)
    np.testing.assert_allclose(depth_from_msg(found), depth_mm * 1e-3, rtol=1e-6)


def test_depth_as_quantised_inverse_is_right_to_a_step_and_lacks_what_has_no_reading() -> None:
    depth_m = np.random.default_rng(1).uniform(0.3, 8.0, (9, 7)).astype(np.float32)
    values = (A / depth_m + B).round().astype(np.uint16)
    values[0, 0] = 0
    found = depth_from_msg(image("/depth/image", "32FC1; compressedDepth", depth_header(A, B) + png(values)))
    assert found[0, 0] == 0.0
    np.testing.assert_array_less(np.abs(found - depth_m).ravel()[1:], (depth_m**2 / A).ravel()[1:])


@pytest.mark.parametrize(("kind", "encoding"), [(np.uint8, "mono8"), (np.uint16, "16UC1")])
def test_labels_are_as_they_were(kind: type, encoding: str) -> None:
    labels = np.random.default_rng(2).integers(0, 200, (9, 7)).astype(kind)
    found = image("/segmentation/mask", "mono8; png compressed ", png(labels))
    assert found.encoding == encoding
    np.testing.assert_array_equal(np.frombuffer(found.data, kind).reshape(9, 7), labels)


def test_colour_is_told_in_red_green_blue() -> None:
    rgb = np.full((16, 16, 3), (200, 120, 40), dtype=np.uint8)
    found = image("/color/image", "rgb8; jpeg compressed bgr8", jpeg(rgb[..., ::-1]))
    assert found.encoding == "rgb8"
    np.testing.assert_allclose(np.frombuffer(found.data, np.uint8).reshape(16, 16, 3), rgb, atol=3)


GRAY = np.full((9, 7), 9, dtype=np.uint8)
BOMB = png(GRAY)[:16] + struct.pack(">II", 2**31 - 1, 2**31 - 1) + png(GRAY)[24:]


@pytest.mark.parametrize(
    ("topic", "form", "data", "told"),
    [
        ("/segmentation/mask", "mono8; jpeg compressed ", jpeg(GRAY), "JPEG changes labels and depths"),
        ("/depth/image", "16UC1; compressedDepth rvl", depth_header() + b"\x09\x00", "no PNG or JPEG"),
        ("/segmentation/mask", "rgb8; png", png(np.zeros((4, 4, 3), np.uint8)), "holds 3 channels"),
        ("/depth/image", "16UC1; compressedDepth png", depth_header() + png(GRAY)[:-20], "a part of it"),
        ("/depth/image", "16UC1; png", BOMB, "far too large"),
        ("/color/image", "rgb8; jpeg", jpeg(GRAY)[:30], "it is damaged"),
        ("/depth/image", "", b"", "no PNG or JPEG"),
    ],
)
def test_what_cannot_be_unpacked_is_told_with_its_topic_and_stamp(
    topic: str, form: str, data: bytes, told: str
) -> None:
    with pytest.raises(InputError, match=rf"{topic} at 5 ns, format .*{told}"):
        unpacked(message(topic, form, data))


def packed_bag(
    path: Path,
    frames_bag: Path,
    pack: Callable[[np.ndarray], bytes] = png,
    color: Callable[[np.ndarray], bytes] = lambda pixels: png(pixels[..., ::-1]),
) -> Path:
    """The bag with its pictures compressed and under other names; `pack` does it to the masks."""
    packers = {
        "/depth/image": ("16UC1; compressedDepth png", np.uint16, lambda p: depth_header() + png(p)),
        "/segmentation/mask": ("mono8; png compressed ", None, pack),
        "/color/image": ("rgb8; png compressed bgr8", np.uint8, color),
    }
    names = {new: old for old, new in PACKED.items()}
    with BagReader(frames_bag) as bag, BagWriter(path) as writer:
        for topic in bag.topics.values():
            kind = PACKED_TYPE if topic.name in names else topic.type_name
            writer.add_topic(names.get(topic.name, topic.name), kind, [RELIABLE])
        for raw in bag.messages():
            if raw.topic not in names:
                writer.write_raw(raw.topic, raw.data, raw.stamp_ns)
                continue
            whole: Image = raw.decode()
            form, kind, packed = packers[raw.topic]
            pixel_bytes = whole.step // whole.width
            kind = kind or {1: np.uint8, 2: np.uint16}[pixel_bytes]
            shape = (
                (whole.height, whole.width, 3) if whole.encoding == "rgb8" else (whole.height, whole.width)
            )
            data = packed(np.frombuffer(whole.data, kind).reshape(shape))
            compressed = CompressedImage(header=whole.header, format=form, data=data)
            writer.write(names[raw.topic], compressed, raw.stamp_ns)
    return path


def test_bag_of_compressed_images_converts_to_the_same_frames(
    frames: list[RgbdFrame], frames_bag: Path, tmp_path: Path
) -> None:
    source = packed_bag(tmp_path / "packed.mcap", frames_bag)
    words = [f"{old}:={new}" for old, new in PACKED.items()]
    assert main([str(source), "--out", str(tmp_path / "own.mcap"), "--remap", *words]) == 0
    with BagReader(tmp_path / "own.mcap") as bag:
        found = with_color(bag, list(read_frames(bag, pytest.fail)))
    assert len(found) == len(frames)
    for one, other in zip(found, frames, strict=True):
        np.testing.assert_array_equal(one.mask, other.mask)
        np.testing.assert_allclose(one.depth_m, other.depth_m, rtol=1e-6)
        np.testing.assert_array_equal(one.color, other.color)


def test_masks_as_jpeg_leave_no_bag(frames_bag: Path, tmp_path: Path, capsys) -> None:
    source = packed_bag(tmp_path / "packed.mcap", frames_bag, jpeg)
    words = [f"{old}:={new}" for old, new in PACKED.items()]
    assert main([str(source), "--out", str(tmp_path / "own.mcap"), "--remap", *words]) == 2
    assert "record PNG" in capsys.readouterr().err
    assert not (tmp_path / "own.mcap").exists()


def test_compressed_topics_are_offered_where_images_are_missing(
    frames_bag: Path, tmp_path: Path, capsys
) -> None:
    source = packed_bag(tmp_path / "packed.mcap", frames_bag)
    assert main([str(source), "--out", str(tmp_path / "own.mcap")]) == 2
    assert "is it /cam/" in capsys.readouterr().err


def test_damaged_colour_is_left_out_and_told(frames_bag: Path, tmp_path: Path, capsys) -> None:
    source = packed_bag(tmp_path / "packed.mcap", frames_bag, color=lambda p: b"no picture")
    words = [f"{old}:={new}" for old, new in PACKED.items()]
    assert main([str(source), "--out", str(tmp_path / "own.mcap"), "--remap", *words]) == 0
    assert "5 colour picture(s) left out" in capsys.readouterr().err
    with BagReader(tmp_path / "own.mcap") as bag:
        assert len(list(read_frames(bag, pytest.fail))) == 5

import numpy as np
import pytest
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from neuse.errors import InputError
from neuse_encoder_node.images import depth_from_msg, depth_to_msg, mask_from_msg


def image(pixels: np.ndarray, encoding: str, padding: int = 0, big_endian: bool = False) -> Image:
    stored = pixels.astype(pixels.dtype.newbyteorder(">")) if big_endian else pixels
    rows = [row.tobytes() + b"\xff" * padding for row in stored]
    return Image(
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        step=len(rows[0]),
        is_bigendian=int(big_endian),
        data=b"".join(rows),
    )


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("padding", [0, 6])
def test_depth_in_millimetres_becomes_metres_whatever_the_layout(padding: int, big_endian: bool):
    depth_mm = np.array([[0, 1, 1234], [65535, 500, 2]], dtype=np.uint16)
    depth_m = depth_from_msg(image(depth_mm, "16UC1", padding, big_endian))
    assert depth_m.dtype == np.float32
    np.testing.assert_allclose(depth_m, depth_mm / 1000.0, rtol=1e-6)


def test_depth_in_metres_has_no_reading_where_it_is_no_positive_number():
    depth_m = np.array([[1.5, np.nan, np.inf], [-np.inf, -1.0, 0.25]], dtype=np.float32)
    assert depth_from_msg(image(depth_m, "32FC1")).tolist() == [[1.5, 0.0, 0.0], [0.0, 0.0, 0.25]]


@pytest.mark.parametrize(
    ("encoding", "dtype"),
    [
        ("mono8", np.uint8),
        ("8UC1", np.uint8),
        ("16UC1", np.uint16),
        ("mono16", np.uint16),
        ("32SC1", np.int32),
    ],
)
def test_mask_keeps_its_labels(encoding: str, dtype: type):
    labels = np.array([[0, 1, 200], [7, 255, 3]], dtype=dtype)
    assert np.array_equal(mask_from_msg(image(labels, encoding)), labels)


def test_depth_image_round_trip_is_exact():
    depth_m = np.random.default_rng(0).uniform(0.1, 9.0, (4, 5)).astype(np.float32)
    assert np.array_equal(depth_from_msg(depth_to_msg(depth_m, Header())), depth_m)


@pytest.mark.parametrize(
    ("read", "encoding"), [(depth_from_msg, "rgb8"), (mask_from_msg, "32FC1"), (mask_from_msg, "")]
)
def test_unknown_encoding_is_refused_by_name(read, encoding: str):
    with pytest.raises(InputError, match=f"encoding '{encoding}'") as refused:
        read(image(np.zeros((2, 2), dtype=np.uint16), encoding))
    assert refused.value.reason == "encoding"


def test_data_that_does_not_fill_the_image_is_refused():
    message = image(np.zeros((4, 4), dtype=np.uint16), "16UC1")
    message.data = message.data[:-1]
    with pytest.raises(InputError, match="31 bytes for 4 x 4 pixels") as refused:
        depth_from_msg(message)
    assert refused.value.reason == "array_length"


@pytest.mark.parametrize("change", [{"step": 3}, {"width": 0}, {"height": 0}])
def test_impossible_sizes_are_refused(change: dict[str, int]):
    message = image(np.zeros((4, 4), dtype=np.uint16), "16UC1")
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(InputError, match="send whole images"):
        depth_from_msg(message)

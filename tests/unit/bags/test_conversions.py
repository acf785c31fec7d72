from array import array

import numpy as np
import pytest
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from neuse.evaluation.truth import TrueObject
from neuse.geometry import exp
from neuse.records import Intrinsics
from neuse_bags.conversions import (
    camera_info_to_msg,
    color_from_msg,
    depth_to_msg,
    image_to_msg,
    mask_to_msg,
    odometry_to_msg,
    true_map_to_msg,
    true_objects_from_msg,
)
from neuse_encoder_node.conversions import intrinsics_from_msg
from neuse_encoder_node.images import depth_from_msg, mask_from_msg
from neuse_slam_node.poses import transform_from_msg


def test_depth_survives_to_the_millimetre() -> None:
    depth_m = np.random.default_rng(0).uniform(0.2, 60.0, (7, 9)).astype(np.float32)
    np.testing.assert_allclose(depth_from_msg(depth_to_msg(depth_m, Header())), depth_m, atol=0.5001e-3)


def test_what_is_no_depth_becomes_no_reading() -> None:
    depth_m = np.array([[np.nan, np.inf, -np.inf, -1.0, 70.0, 0.0]], dtype=np.float32)
    np.testing.assert_array_equal(depth_from_msg(depth_to_msg(depth_m, Header())), np.zeros((1, 6)))


def test_depth_of_the_caller_is_left_as_it_is() -> None:
    depth_m = np.array([[np.nan, -1.0]], dtype=np.float32)
    depth_to_msg(depth_m, Header())
    np.testing.assert_array_equal(depth_m, [[np.nan, -1.0]])


COLORS = np.random.default_rng(1).integers(0, 255, (4, 5, 3), dtype=np.uint8)
ALPHA = np.full((4, 5, 1), 255, dtype=np.uint8)


@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("rgb8", COLORS),
        ("bgr8", COLORS[..., ::-1]),
        ("rgba8", np.concatenate([COLORS, ALPHA], axis=2)),
        ("bgra8", np.concatenate([COLORS[..., ::-1], ALPHA], axis=2)),
    ],
)
def test_color_is_read_whatever_its_order_and_padding(encoding: str, pixels: np.ndarray) -> None:
    rows = np.pad(pixels.reshape(4, -1), [(0, 0), (0, 3)])
    image = Image(height=4, width=5, encoding=encoding, step=rows.shape[1], data=array("B", rows.tobytes()))
    np.testing.assert_array_equal(color_from_msg(image), COLORS)


def test_grey_image_is_read_as_color() -> None:
    np.testing.assert_array_equal(
        color_from_msg(image_to_msg(COLORS[..., 0], "mono8", Header())), COLORS[..., [0, 0, 0]]
    )


@pytest.mark.parametrize("change", [{"encoding": "yuv422"}, {"step": 3}, {"height": 5}, {"width": 0}])
def test_color_that_cannot_be_shown_is_none(change: dict[str, object]) -> None:
    image = image_to_msg(COLORS, "rgb8", Header())
    for name, value in change.items():
        setattr(image, name, value)
    assert color_from_msg(image) is None


def test_labels_beyond_a_byte_take_two_bytes() -> None:
    for largest, encoding in ((255, "mono8"), (256, "16UC1")):
        mask = np.array([[0, 1], [2, largest]])
        message = mask_to_msg(mask, Header())
        assert message.encoding == encoding
        np.testing.assert_array_equal(mask_from_msg(message), mask)


def test_color_rows_are_stored_without_gaps() -> None:
    color = np.random.default_rng(1).integers(0, 255, (4, 10, 3), dtype=np.uint8)[:, ::2]
    message = image_to_msg(color, "rgb8", Header())
    assert (message.height, message.width, message.step) == (4, 5, 15)
    assert bytes(message.data) == color.tobytes()


def test_camera_survives() -> None:
    camera = Intrinsics(640, 480, 612.9, 613.1, 322.5, 248.1)
    assert intrinsics_from_msg(camera_info_to_msg(camera, Header())) == camera


def test_rectified_image_of_a_distorted_camera_has_its_pinhole_in_p() -> None:
    info = camera_info_to_msg(Intrinsics(640, 480, 600.0, 601.0, 320.0, 240.0), Header())
    info.p = [500.0, 0.0, 310.0, 0.0, 0.0, 501.0, 230.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    assert intrinsics_from_msg(info).fx == 600.0
    info.d = [0.1, -0.2, 0.0, 0.0, 0.0]
    assert intrinsics_from_msg(info) == Intrinsics(640, 480, 500.0, 501.0, 310.0, 230.0)
    info.p[0] = 0.0
    assert intrinsics_from_msg(info).fx == 600.0


def test_pose_and_stamp_of_odometry_survive() -> None:
    T = exp([0.3, -0.2, 1.0, 4.0, 5.0, -6.0])
    message = odometry_to_msg(3_000_000_007, T, "odom")
    assert (message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id) == (3, 7, "odom")
    np.testing.assert_allclose(transform_from_msg(message.pose.pose), T, atol=1e-12)


def test_true_objects_survive() -> None:
    item = TrueObject(4, "mug", exp([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]), np.array([0.1, 0.08, 0.12]), 17)
    (back,) = true_objects_from_msg(true_map_to_msg(5, [item]))
    assert (back.object_id, back.category, back.n_seen) == (4, "mug", 17)
    np.testing.assert_allclose(back.T_world_object, item.T_world_object, atol=1e-12)
    np.testing.assert_array_equal(back.box_size, item.box_size)

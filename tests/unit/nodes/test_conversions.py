"""Every record survives the way through its message, serialised as DDS sends it."""

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo

from neuse.errors import InputError
from neuse.geometry import make_transform, transform_points
from neuse.mapping.markers import CLEAN_SHEET, Marker, MarkerKind
from neuse.records import ChangeKind, Instance, ObjectStatus, RgbdFrame
from neuse.slam.prior_map import PriorMap
from neuse_encoder_node import conversions as encoder
from neuse_encoder_node.images import depth_to_msg
from neuse_mapper_node import conversions as mapper
from neuse_msgs.msg import PoseGraphEdge
from neuse_slam_node import conversions as slam
from neuse_slam_node import poses

from . import samples


def sent(message: Any) -> Any:
    """The message as a subscriber gets it."""
    return deserialize_message(serialize_message(message), type(message))


def assert_same(one: Any, other: Any) -> None:
    """Equal records, field by field; arrays may differ by rounding of rotations."""
    assert type(one) is type(other)
    if is_dataclass(one):
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    else:
        assert one == other


def test_observed_frame_round_trip_is_exact():
    frame = samples.observed_frame()
    back = encoder.observed_frame_from_msg(sent(encoder.observed_frame_to_msg(frame, "camera")))
    assert_same(back, frame)
    assert np.array_equal(back.observations[0].code.z, frame.observations[0].code.z)


def test_instances_round_trip():
    instances = (Instance(3, "mug", 0.5), Instance(250, "bottle", 1.0))
    message = sent(encoder.instances_to_msg(instances, encoder.header_to_msg(samples.STAMP_NS, "camera")))
    assert encoder.instances_from_msg(message) == instances
    assert encoder.stamp_from_msg(message.header.stamp) == samples.STAMP_NS


def test_tracked_frame_round_trip():
    frame = samples.tracked_frame()
    message = sent(slam.tracked_frame_to_msg(frame, "map", "camera"))
    assert_same(slam.tracked_frame_from_msg(message), frame)
    assert (message.header.frame_id, message.child_frame_id) == ("map", "camera")


def test_edges_round_trip():
    edge = samples.edge()
    message = sent(slam.edges_to_msg([edge], samples.STAMP_NS, "camera"))
    assert_same(slam.edges_from_msgs(message.edges)[0], edge)


def test_keyframes_round_trip():
    keyframes = samples.keyframes()
    message = sent(slam.keyframes_to_msg(keyframes, samples.STAMP_NS, "map"))
    assert_same(slam.keyframes_from_msg(message), keyframes)


def test_no_keyframes_are_an_empty_message():
    assert slam.keyframes_from_msg(slam.keyframes_to_msg((), 0, "map")) == ()
    assert slam.path_to_msg((), "map").poses == []


@pytest.mark.parametrize("kind", ChangeKind)
def test_change_round_trip_keeps_what_is_absent(kind: ChangeKind):
    change = samples.change(kind)
    assert_same(slam.change_from_msg(sent(slam.change_to_msg(change, "map"))), change)


def test_object_map_round_trip():
    object_map = samples.object_map()
    assert_same(mapper.object_map_from_msg(sent(mapper.object_map_to_msg(object_map, "map"))), object_map)


def test_covariance_in_a_message_is_translation_first_on_the_axes_of_the_parent_frame():
    T_map_camera = make_transform([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], np.zeros(3))
    covariance = np.diag([1.0, 2.0, 3.0, 10.0, 20.0, 30.0])  # rotation, then translation, camera axes
    message = poses.pose_with_covariance_to_msg(T_map_camera, covariance)
    np.testing.assert_allclose(np.diag(message.covariance.reshape(6, 6)), [20, 10, 30, 2, 1, 3])


def test_odometry_of_another_part_of_the_robot_gives_the_pose_of_the_camera():
    T_odom_base, T_base_camera, point = samples.transform(1), samples.transform(2), np.array([0.1, 0.2, 0.3])
    message = Odometry()
    message.pose.pose = poses.pose_to_msg(T_odom_base)
    sample = slam.odometry_from_msg(message, T_base_camera)
    expected = transform_points(T_odom_base, transform_points(T_base_camera, point))
    np.testing.assert_allclose(transform_points(sample.T_odom_camera, point), expected)


def test_estimated_odometry_and_path_carry_pose_frames_and_stamps():
    frame, keyframes = samples.tracked_frame(), samples.keyframes()
    odometry, path = slam.odometry_to_msg(frame, "map", "camera"), slam.path_to_msg(keyframes, "map")
    np.testing.assert_allclose(poses.transform_from_msg(odometry.pose.pose), frame.T_map_camera, atol=1e-12)
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "camera")
    assert [encoder.stamp_from_msg(pose.header.stamp) for pose in path.poses] == [
        keyframe.stamp_ns for keyframe in keyframes
    ]


def test_frame_is_joined_from_its_four_messages():
    header = encoder.header_to_msg(samples.STAMP_NS, "camera")
    depth_m = samples.coarse_depth()
    mask = depth_to_msg(depth_m, header)
    mask.encoding, mask.data = "32SC1", np.arange(48, dtype="<i4").tobytes()
    info = CameraInfo(width=8, height=6, k=np.array([525.0, 0, 3.5, 0, 524.0, 2.5, 0, 0, 1]))
    instances = encoder.instances_to_msg((Instance(3, "mug", 0.5),), header)
    frame = encoder.frame_from_msgs(depth_to_msg(depth_m, header), mask, instances, info)
    assert isinstance(frame, RgbdFrame)
    assert frame.stamp_ns == samples.STAMP_NS
    assert np.array_equal(frame.depth_m, depth_m)
    assert np.array_equal(frame.mask, np.arange(48).reshape(6, 8))
    assert (frame.intrinsics.fx, frame.intrinsics.fy, frame.intrinsics.cx) == (525.0, 524.0, 3.5)


@pytest.mark.parametrize(
    ("field", "length"), [("z", 25), ("z", 0), ("z", 9), ("descriptor", 7), ("descriptor", 0)]
)
def test_code_of_wrong_length_is_refused(field: str, length: int):
    message = encoder.code_to_msg(samples.code())
    setattr(message, field, [0.0] * length)
    with pytest.raises(InputError, match=f"{length} ") as refused:
        encoder.code_from_msg(message)
    assert refused.value.reason == "array_length"


def test_cloud_that_is_not_three_numbers_a_point_is_refused():
    message = encoder.observation_to_msg(samples.observation())
    message.cloud = [0.0] * 7
    with pytest.raises(InputError, match="cloud has 7 numbers"):
        encoder.observation_from_msg(message)


@pytest.mark.parametrize(
    "quaternion",
    [Quaternion(w=0.0), Quaternion(w=2.0), Quaternion(x=float("nan")), Quaternion(w=float("inf"))],
)
def test_pose_that_is_none_is_refused(quaternion: Quaternion):
    with pytest.raises(InputError, match="no pose") as refused:
        poses.transform_from_msg(Pose(orientation=quaternion))
    assert refused.value.reason == "pose"


def test_unknown_kinds_are_refused():
    with pytest.raises(InputError, match="EdgeKind has no value 9"):
        slam.edges_from_msgs([PoseGraphEdge(kind=9)])
    change = slam.change_to_msg(samples.change(ChangeKind.MOVED), "map")
    change.kind = 77
    with pytest.raises(InputError, match="ChangeKind has no value 77"):
        slam.change_from_msg(change)
    object_map = mapper.object_map_to_msg(samples.object_map(), "map")
    object_map.objects[0].status = 8
    with pytest.raises(InputError, match="status 8"):
        mapper.object_map_from_msg(object_map)


def test_mesh_marker_is_a_list_of_triangles():
    triangles = np.arange(18.0).reshape(6, 3)
    drawn = Marker("objects", 3, MarkerKind.MESH, triangles, (0.1, 0.2, 0.3, 1.0))
    (marker,) = mapper.markers_to_msg([drawn], samples.STAMP_NS, "map").markers
    assert (marker.ns, marker.id, marker.type, marker.action) == (
        "objects",
        3,
        marker.TRIANGLE_LIST,
        marker.ADD,
    )
    assert [(p.x, p.y, p.z) for p in marker.points] == [tuple(row) for row in triangles.tolist()]
    assert (marker.scale.x, marker.scale.y, marker.scale.z) == (1.0, 1.0, 1.0)


def test_label_stands_at_its_point_with_its_height():
    drawn = Marker("labels", 3, MarkerKind.TEXT, np.array([[1.0, 2.0, 3.0]]), scale_m=0.03, text="mug 3")
    (marker,) = mapper.markers_to_msg([drawn], 0, "map").markers
    assert (marker.type, marker.text, marker.scale.z) == (marker.TEXT_VIEW_FACING, "mug 3", 0.03)
    assert (marker.pose.position.x, marker.pose.position.y, marker.pose.position.z) == (1.0, 2.0, 3.0)


def test_clean_sheet_empties_a_viewer():
    (marker,) = mapper.markers_to_msg([CLEAN_SHEET], 0, "map").markers
    assert (marker.ns, marker.action) == ("", marker.DELETEALL)


def test_points_are_packed_as_viewers_read_them():
    points, colors = (
        np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
        np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    )
    cloud = mapper.points_to_msg(points, colors, samples.STAMP_NS, "map")
    unpacked = np.frombuffer(cloud.data, dtype=[("xyz", "<f4", 3), ("rgb", "<u4")])
    assert np.array_equal(unpacked["xyz"], points)
    assert unpacked["rgb"].tolist() == [0xFF0000, 0x0000FF]
    assert (cloud.width, cloud.row_step, len(cloud.data)) == (2, 32, 32)


def test_wrong_pose_anywhere_in_a_frame_refuses_the_frame():
    message = slam.tracked_frame_to_msg(replace(samples.tracked_frame()), "map", "camera")
    message.edges[0].pose.pose.orientation.w = float("nan")
    with pytest.raises(InputError, match="no pose"):
        slam.tracked_frame_from_msg(message)


@pytest.mark.parametrize(("sec", "nanosec"), [(-1, 0), (5, 10**9), (5, 2**32 - 1)])
def test_stamp_that_is_no_time_is_refused(sec: int, nanosec: int):
    with pytest.raises(InputError, match=f"stamp {sec} s {nanosec} ns is no time") as refused:
        encoder.stamp_from_msg(Time(sec=sec, nanosec=nanosec))
    assert refused.value.reason == "stamp"


def test_frame_of_more_objects_than_can_be_told_apart_in_time_is_refused():
    message = encoder.observed_frame_to_msg(samples.observed_frame(), "camera")
    message.observations = message.observations * 200
    with pytest.raises(InputError, match="400 observations"):
        encoder.observed_frame_from_msg(message)


@pytest.mark.parametrize(("name", "value"), [("fx", 0.0), ("cy", float("nan")), ("width", 0)])
def test_camera_that_is_none_is_refused(name: str, value: float):
    message = encoder.intrinsics_to_msg(samples.INTRINSICS)
    setattr(message, name, value)
    with pytest.raises(InputError, match="is no camera"):
        encoder.pinhole_from_msg(message)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e5])
@pytest.mark.parametrize("part", ["cloud", "center"])
def test_points_beyond_any_camera_are_refused(part: str, value: float):
    message = encoder.observation_to_msg(samples.observation())
    if part == "cloud":
        message.cloud[4] = value
    else:
        message.partial_center.y = value
    with pytest.raises(InputError, match="instance 7") as refused:
        encoder.observation_from_msg(message)
    assert refused.value.reason == "not_finite"


@pytest.mark.parametrize("value", [float("nan"), 1e300])
def test_code_that_is_none_is_refused_where_it_stands_for_an_object(value: float):
    frame = slam.tracked_frame_to_msg(samples.tracked_frame(), "map", "camera")
    matched, tentative = frame.observations
    tentative.observation.code.z[0] = value
    slam.tracked_frame_from_msg(frame)
    matched.observation.code.z[0] = value
    with pytest.raises(InputError, match="code of 'mug' is none"):
        slam.tracked_frame_from_msg(frame)
    object_map = mapper.object_map_to_msg(samples.object_map(), "map")
    object_map.objects[0].code.descriptor[0] = value
    with pytest.raises(InputError, match="code of 'mug' is none"):
        mapper.object_map_from_msg(object_map)


def test_prior_map_is_what_the_record_of_the_same_map_gives():
    known = samples.object_map().objects[0]
    gone = replace(known, object_id=9, status=ObjectStatus.REMOVED)
    spoiled = replace(known, object_id=5, code=replace(known.code, z=np.full_like(known.code.z, np.nan)))
    object_map = replace(samples.object_map(), objects=(known, spoiled, gone))
    found = slam.prior_map_from_msg(sent(mapper.object_map_to_msg(object_map, "map")))
    assert (found.ids, found.next_id) == ((4,), 10)
    assert_same(found.codes[4], PriorMap.of(object_map).codes[4])


@pytest.mark.parametrize("object_id", [-1, 2**63 - 1])
def test_prior_map_whose_names_leave_no_room_for_others_is_refused(object_id: int):
    message = mapper.object_map_to_msg(samples.object_map(), "map")
    message.objects[0].object_id = object_id
    with pytest.raises(InputError, match=f"no object is called {object_id}"):
        slam.prior_map_from_msg(message)


@pytest.mark.parametrize("value", [float("nan"), -1.0])
def test_box_that_is_none_is_refused(value: float):
    message = mapper.object_map_to_msg(samples.object_map(), "map")
    message.objects[0].box_size.z = value
    with pytest.raises(InputError, match="object 4 has no box"):
        mapper.object_map_from_msg(message)


@pytest.mark.parametrize("value", [float("nan"), -1.0])
def test_covariance_that_is_none_is_refused(value: float):
    message = slam.tracked_frame_to_msg(samples.tracked_frame(), "map", "camera")
    message.pose.covariance[0] = value
    with pytest.raises(InputError, match="covariance is none"):
        slam.tracked_frame_from_msg(message)


def test_pose_beyond_any_map_is_refused():
    with pytest.raises(InputError, match="no pose"):
        poses.transform_from_msg(Pose(position=Point(x=1e8)))

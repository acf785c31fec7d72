"""TF of the estimate: where the odometry's frame lies in the map (REP 105). Optional: tf2_ros is no wheel."""

from geometry_msgs.msg import Transform, TransformStamped, Vector3
from rclpy.node import Node

from neuse.geometry import Array, inverse
from neuse.records import TrackedFrame
from neuse_encoder_node.conversions import header_to_msg
from neuse_slam_node.poses import pose_to_msg

try:
    from tf2_ros import TransformBroadcaster
except ImportError:
    TransformBroadcaster = None


class MapFrameBroadcaster:
    """Broadcasts map -> odom."""

    def __init__(self, node: Node, map_frame: str) -> None:
        self._broadcaster = TransformBroadcaster(node)
        self._map_frame = map_frame

    def broadcast(self, frame: TrackedFrame, T_odom_camera: Array, odom_frame: str) -> None:
        """Say where the odometry has drifted to, as of one frame."""
        header = header_to_msg(frame.stamp_ns, self._map_frame)
        message = transform_to_msg(frame.T_map_camera @ inverse(T_odom_camera))
        self._broadcaster.sendTransform(
            TransformStamped(header=header, child_frame_id=odom_frame, transform=message)
        )


def make_broadcaster(node: Node, map_frame: str) -> MapFrameBroadcaster | None:
    """A broadcaster, or None where tf2_ros is not installed."""
    if TransformBroadcaster is None:
        node.get_logger().info("tf2_ros is not installed: no transform map -> odom")
        return None
    return MapFrameBroadcaster(node, map_frame)


def transform_to_msg(T_target_source: Array) -> Transform:
    """A rigid transform."""
    pose = pose_to_msg(T_target_source)
    position = pose.position
    return Transform(translation=Vector3(x=position.x, y=position.y, z=position.z), rotation=pose.orientation)

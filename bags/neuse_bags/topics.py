"""Every topic that this package writes: name, type, and the quality of service it is offered with."""

from dataclasses import dataclass, replace
from string import ascii_lowercase

from rclpy.qos import QoSProfile

from neuse.errors import ParamError
from neuse_bags.mcap_file import BagReader, BagWriter
from neuse_bags.qos import LATCHED, RELIABLE


@dataclass(frozen=True)
class TopicSpec:
    """A topic that this package writes; names are absolute, as bags have them."""

    name: str
    type_name: str
    qos: QoSProfile

    def under(self, namespace: str) -> "TopicSpec":
        """The same topic of one robot among several; namespace: `/a`, or nothing."""
        return replace(self, name=namespace + self.name)


DEPTH = TopicSpec("/depth/image", "sensor_msgs/msg/Image", RELIABLE)
DEPTH_INFO = TopicSpec("/depth/camera_info", "sensor_msgs/msg/CameraInfo", RELIABLE)
MASK = TopicSpec("/segmentation/mask", "sensor_msgs/msg/Image", RELIABLE)
INSTANCES = TopicSpec("/segmentation/instances", "neuse_msgs/msg/InstanceArray", RELIABLE)
COLOR = TopicSpec("/color/image", "sensor_msgs/msg/Image", RELIABLE)
COLOR_INFO = TopicSpec("/color/camera_info", "sensor_msgs/msg/CameraInfo", RELIABLE)
ODOMETRY = TopicSpec("/odom", "nav_msgs/msg/Odometry", RELIABLE)
FRAME_TOPICS = (DEPTH, DEPTH_INFO, MASK, INSTANCES)
COLOR_TOPICS = (COLOR, COLOR_INFO)

TRUE_ODOMETRY = TopicSpec("/ground_truth/odometry", "nav_msgs/msg/Odometry", RELIABLE)
TRUE_MAP = TopicSpec("/ground_truth/map", "neuse_msgs/msg/ObjectMap", LATCHED)
TRUE_CHANGES = TopicSpec("/ground_truth/changes", "neuse_msgs/msg/ObjectChange", RELIABLE)
TRUE_TRAVERSAL = TopicSpec("/ground_truth/traversal", "std_msgs/msg/UInt32", LATCHED)
TRUTH_TOPICS = (TRUE_ODOMETRY, TRUE_MAP, TRUE_CHANGES, TRUE_TRAVERSAL)

OBSERVATIONS = TopicSpec("/neuse/observations", "neuse_msgs/msg/ObjectObservationArray", RELIABLE)
EDGES = TopicSpec("/neuse/edges", "neuse_msgs/msg/PoseGraphEdgeArray", RELIABLE)
FRAMES = TopicSpec("/neuse/frames", "neuse_msgs/msg/TrackedFrame", RELIABLE)
KEYFRAMES = TopicSpec("/neuse/keyframes", "neuse_msgs/msg/KeyframeArray", LATCHED)
EST_ODOMETRY = TopicSpec("/neuse/odometry", "nav_msgs/msg/Odometry", RELIABLE)
PATH = TopicSpec("/neuse/path", "nav_msgs/msg/Path", RELIABLE)
MAP = TopicSpec("/neuse/map", "neuse_msgs/msg/ObjectMap", LATCHED)
MARKERS = TopicSpec("/neuse/markers", "visualization_msgs/msg/MarkerArray", LATCHED)
MAP_POINTS = TopicSpec("/neuse/map_points", "sensor_msgs/msg/PointCloud2", LATCHED)
PRIOR_MAP = TopicSpec("/neuse/prior_map", "neuse_msgs/msg/ObjectMap", LATCHED)
CHANGES = TopicSpec("/neuse/changes", "neuse_msgs/msg/ObjectChange", RELIABLE)
DIAGNOSTICS = TopicSpec("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", RELIABLE)
OUTPUT_TOPICS = (
    *(OBSERVATIONS, EDGES, FRAMES, KEYFRAMES, EST_ODOMETRY, PATH),
    *(MAP, MARKERS, MAP_POINTS, CHANGES, DIAGNOSTICS),
)


def namespaces(count: int) -> tuple[str, ...]:
    """Of so many cameras: none of one, `/a`, `/b` and so on of several.

    Raises:
        ParamError: no camera, or more than there are letters.
    """
    if not 1 <= count <= len(ascii_lowercase):
        raise ParamError(f"{count} cameras; choose 1 to {len(ascii_lowercase)}")
    return ("",) if count == 1 else tuple(f"/{ascii_lowercase[index]}" for index in range(count))


def namespaces_in(bag: BagReader) -> tuple[str, ...]:
    """Of the cameras in a bag."""
    return tuple(sorted(name.removesuffix(DEPTH.name) for name in bag.topics if name.endswith(DEPTH.name)))


def declare(writer: BagWriter, topics: tuple[TopicSpec, ...]) -> None:
    """Declare topics in a bag that is being written."""
    for topic in topics:
        writer.add_topic(topic.name, topic.type_name, [topic.qos])

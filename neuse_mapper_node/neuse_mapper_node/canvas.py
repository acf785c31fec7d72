"""Pictures of the map for viewers: markers and a cloud of the surfaces."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import trimesh
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from neuse.mapping.mapper import ObjectMapper
from neuse.mapping.markers import CLEAN_SHEET, map_points, scene_markers
from neuse_encoder_node.qos import latched
from neuse_mapper_node.conversions import markers_to_msg, points_to_msg

Offer = Callable[[type, str, QoSProfile], Any]  # a publisher


class Canvas:
    """Draws the shapes that have been decoded, boxes for the others."""

    def __init__(self, offer: Offer, map_frame: str) -> None:
        self._markers = offer(MarkerArray, "neuse/markers", latched())
        self._points = offer(PointCloud2, "neuse/map_points", latched())
        self._map_frame = map_frame

    @property
    def is_watched(self) -> bool:
        """Whether anybody would see a picture."""
        return any(topic.get_subscription_count() for topic in (self._markers, self._points))

    def draw(self, mapper: ObjectMapper) -> None:
        """The map as it is now."""

        @cache
        def mesh(object_id: int) -> trimesh.Trimesh:
            return mapper.mesh(object_id, now=False)

        sketch = mapper.sketch
        markers = scene_markers(sketch, mesh, mapper.changes)
        points, colors = map_points(sketch, mesh)
        self._markers.publish(markers_to_msg(markers, sketch.stamp_ns, self._map_frame))
        self._points.publish(points_to_msg(points, colors, sketch.stamp_ns, self._map_frame))

    def clear(self) -> None:
        """Empty the viewers."""
        self._markers.publish(markers_to_msg([CLEAN_SHEET], 0, self._map_frame))
        self._points.publish(points_to_msg(np.zeros((0, 3)), np.zeros((0, 3)), 0, self._map_frame))

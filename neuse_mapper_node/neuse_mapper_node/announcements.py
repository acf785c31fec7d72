"""What mapper_node tells: the map and its changes, to everybody and to the sessions that share the map."""

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.qos import QoSProfile

from neuse.records import ObjectChange
from neuse.records import ObjectMap as Map
from neuse_encoder_node.qos import latched, reliable
from neuse_mapper_node.conversions import object_map_to_msg
from neuse_msgs.msg import ObjectChange as ObjectChangeMsg
from neuse_msgs.msg import ObjectMap
from neuse_slam_node.conversions import change_to_msg


class Announcements:
    """Publishers of the map and of its changes."""

    def __init__(
        self,
        offer: Callable[[type, str, QoSProfile], Any],
        namespaces: Sequence[str],
        map_frame: str,
        depth: int,
    ) -> None:
        """namespaces: of the sessions, "robot/" each; one alone may be ""."""
        self._map_frame = map_frame
        self._map = offer(ObjectMap, "neuse/map", latched())
        own = [namespace for namespace in namespaces if namespace]
        topics = [f"{namespace}neuse/changes" for namespace in ("", *own)]
        self._changes = [offer(ObjectChangeMsg, topic, reliable(depth)) for topic in topics]
        self._priors = [offer(ObjectMap, f"{name}neuse/prior_map", latched()) for name in namespaces]
        self._known: tuple[tuple[int, int], ...] = ()

    def tell_change(self, change: ObjectChange) -> None:
        """A change, to everybody and in the namespace of each session."""
        for publisher in self._changes:
            publisher.publish(change_to_msg(change, self._map_frame))

    def tell_map(self, object_map: Map, has_strangers: bool) -> None:
        """The map; to sessions that share it, or are not in it, whenever it has got other objects."""
        message = object_map_to_msg(object_map, self._map_frame)
        self._map.publish(message)
        objects = tuple((known.object_id, known.status) for known in message.objects)
        is_shared = len(self._priors) > 1 or has_strangers
        if objects != self._known and (is_shared or not objects):
            self._known = objects
            for publisher in self._priors:
                publisher.publish(message)

"""mapper_node: tracked frames in; object map, its changes, markers and points out."""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from neuse.embedding.code import Code
from neuse.embedding.embedding import Embedding
from neuse.errors import NeuseError
from neuse.mapping.mapper import MapperParams, ObjectMapper
from neuse.mapping.markers import MarkerBoard, map_points
from neuse.mapping.reconstruction import Reconstruct
from neuse.params import param
from neuse.records import ObjectChange
from neuse_encoder_node.conversions import stamp_from_msg
from neuse_encoder_node.qos import latched, reliable
from neuse_encoder_node.run import run
from neuse_encoder_node.stage_node import StageNode, StageParams
from neuse_encoder_node.stamps import NANOSECONDS
from neuse_encoder_node.weights import MEANING, SHIPPED, load_embeddings
from neuse_mapper_node import conversions
from neuse_mapper_node.keyframe_match import KeyframeMatch
from neuse_msgs.msg import KeyframeArray, ObjectMap, TrackedFrame
from neuse_msgs.msg import ObjectChange as ObjectChangeMsg
from neuse_msgs.srv import LoadMap, SaveMap
from neuse_slam_node.conversions import change_to_msg, keyframes_from_msg, tracked_frame_from_msg

NAME = "mapper_node"


@dataclass(frozen=True)
class MapperNodeParams(StageParams):
    """Parameters of mapper_node."""

    queue_size: int = param(200, "frames that may wait for the worker; beyond it the oldest goes", 1, 100000)
    topic_depth: int = param(100, "depth of the reliable queues", 1, 10000)
    map_period_s: float = param(1.0, "the map is published at most this often, in stamps", 0.0, 3600.0)
    draw_period_s: float = param(3.0, "markers and points come at most this often, in stamps", 0.0, 3600.0)
    map_frame: str = param("map", "name of the frame of the map")
    load_path: str = param("", "map file to go on with; empty: start with nothing")
    save_path: str = param("", "map file that is written when the node ends; empty: none")
    weights: tuple[str, ...] = param(SHIPPED, MEANING)
    mapper: MapperParams = field(default_factory=MapperParams)


class MapperNode(StageNode):
    """Keeps the object map. Frames wait for the keyframe estimates that were sent with them."""

    def __init__(self) -> None:
        super().__init__(NAME, MapperNodeParams())

    def build(self, params: MapperNodeParams) -> None:
        self._params = params
        embeddings = load_embeddings(params.weights)
        decoders = {category: self._decoder(embedding) for category, embedding in embeddings.items()}
        self._mapper = ObjectMapper(decoders, params.mapper)
        if params.load_path:
            self._mapper.load(params.load_path)
        self._match = KeyframeMatch()
        self._board = MarkerBoard()
        self._is_original = not params.load_path  # nobody has told this map to be another
        self._next_map_ns = self._next_drawing_ns = 0
        self._connect(params.topic_depth)

    def _decoder(self, embedding: Embedding) -> Reconstruct:
        """A decoder whose time is kept."""

        def decode(code: Code) -> trimesh.Trimesh:
            with self.health.timed("decode"):
                return embedding.reconstruct(code)

        return decode

    def _connect(self, depth: int) -> None:
        self._map = self.offer(ObjectMap, "neuse/map", latched())
        self._markers = self.offer(MarkerArray, "neuse/markers", latched())
        self._points = self.offer(PointCloud2, "neuse/map_points", latched())
        self._changes = self.offer(ObjectChangeMsg, "neuse/changes", reliable(depth))
        self.listen(TrackedFrame, "neuse/frames", self._receive_frame, reliable(depth))
        self.listen(KeyframeArray, "neuse/keyframes", self._receive_keyframes, latched(depth))
        self.listen(ObjectMap, "neuse/recalled_map", self._receive_recalled, reliable(1))
        self.serve(SaveMap, "~/save_map", self._save_map)
        self.serve(LoadMap, "~/load_map", self._load_map)
        self.serve(Trigger, "~/reset", self._reset)

    def process(self, stamp_ns: int, item: tuple[TrackedFrame, KeyframeArray | None]) -> None:
        message, estimates = item
        frame = tracked_frame_from_msg(message)
        keyframes = () if estimates is None else keyframes_from_msg(estimates)
        with self.health.timed("map"):
            changes = self._mapper.step(frame, keyframes)
        self.health.tally("edges", len(frame.edges))
        self._publish_changes(changes)
        self._publish_due(stamp_ns)

    def forget(self) -> None:
        self._is_original = False
        self._mapper.reset()
        map_frame = self._params.map_frame
        self._next_map_ns = self._next_drawing_ns = 0
        self._publish_map()
        self._markers.publish(conversions.markers_to_msg(self._board.clear(), 0, map_frame))
        self._points.publish(conversions.points_to_msg(np.zeros((0, 3)), np.zeros((0, 3)), 0, map_frame))

    def flush(self) -> None:
        self._release()

    def finish(self) -> None:
        self._publish_changes(self._mapper.finalize())
        self._publish_map()
        self._draw()
        if self._params.save_path:
            self._mapper.save(self._params.save_path)

    def _receive_frame(self, message: TrackedFrame) -> None:
        self._match.add_frame(message)
        self._release()

    def _receive_keyframes(self, message: KeyframeArray) -> None:
        self._match.add_keyframes(message)
        self._release()

    def _receive_recalled(self, message: ObjectMap) -> None:
        """slam_node remembers what the mapper before this one knew; after a reset nobody wants it back."""
        object_map = conversions.object_map_from_msg(message)
        with self.lock:
            if self._is_original:
                self._is_original = False
                recalled = self._mapper.recall(object_map)
                self.health.tally("recalled_objects", recalled)
                self._publish_map()

    def _release(self) -> None:
        for frame, estimates in self._match.release():
            self.enqueue(stamp_from_msg(frame.header.stamp), (frame, estimates))

    def _publish_changes(self, changes: tuple[ObjectChange, ...]) -> None:
        for change in changes:
            self.health.tally(f"changes_{change.kind.name.lower()}")
            self._changes.publish(change_to_msg(change, self._params.map_frame))
        if changes:
            self._next_map_ns = self._next_drawing_ns = 0

    def _publish_due(self, stamp_ns: int) -> None:
        """The map now and then, and after a change; pictures only while no frame has to wait for them."""
        if stamp_ns >= self._next_map_ns:
            self._next_map_ns = stamp_ns + int(self._params.map_period_s * NANOSECONDS)
            self._publish_map()
        if stamp_ns >= self._next_drawing_ns and not self.is_behind:
            self._next_drawing_ns = stamp_ns + int(self._params.draw_period_s * NANOSECONDS)
            self._draw()

    def _publish_map(self) -> None:
        object_map = self._mapper.object_map
        self.health.state("objects", len(object_map.objects))
        self._map.publish(conversions.object_map_to_msg(object_map, self._params.map_frame))

    def _draw(self) -> None:
        object_map, map_frame = self._mapper.object_map, self._params.map_frame
        with self.health.timed("draw"):
            markers = self._board.draw(object_map, self._mapper.mesh, self._mapper.changes)
            points, colors = map_points(object_map, self._mapper.mesh)
        stamp_ns = object_map.stamp_ns
        self._markers.publish(conversions.markers_to_msg(markers, stamp_ns, map_frame))
        self._points.publish(conversions.points_to_msg(points, colors, stamp_ns, map_frame))

    def _save_map(self, request: SaveMap.Request, response: SaveMap.Response) -> SaveMap.Response:
        def save() -> str:
            self._mapper.save(request.path)
            return f"{len(self._mapper.object_map.objects)} objects written to {request.path}"

        return self._answer(response, save)

    def _load_map(self, request: LoadMap.Request, response: LoadMap.Response) -> LoadMap.Response:
        def load() -> str:
            self._mapper.load(request.path)
            self._is_original = False
            self._publish_map()
            self._draw()
            return f"{len(self._mapper.object_map.objects)} objects loaded from {request.path}"

        return self._answer(response, load)

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        def reset() -> str:
            self.forget()
            return "the map is empty"

        return self._answer(response, reset)

    def _answer(self, response: Any, act: Callable[[], str]) -> Any:
        """What the act says, or why it could not be done."""
        try:
            with self.lock:
                response.message = act()
            response.success = True
        except (NeuseError, OSError) as error:
            response.message = str(error)
            self.refuse("service_failed", str(error))
        return response


def main() -> None:
    """Entry point of `ros2 run neuse_mapper_node mapper_node`."""
    sys.exit(run(MapperNode))

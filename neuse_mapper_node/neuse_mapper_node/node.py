"""mapper_node: tracked frames in; object map, its changes, markers and points out."""

import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import trimesh
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_srvs.srv import Trigger

from neuse.embedding.code import Code
from neuse.embedding.embedding import Embedding, load_embeddings
from neuse.errors import MapFileError, NeuseError
from neuse.mapping.mapper import ObjectMapper
from neuse.mapping.reconstruction import Reconstruct
from neuse.mapping.sessions import Sessions
from neuse.records import ObjectChange
from neuse.records import ObjectMap as Map
from neuse_encoder_node.conversions import stamp_from_msg
from neuse_encoder_node.qos import latched, reliable
from neuse_encoder_node.run import run
from neuse_encoder_node.stage_node import StageNode
from neuse_encoder_node.stamps import NANOSECONDS, StampOrder
from neuse_mapper_node import conversions
from neuse_mapper_node.announcements import Announcements
from neuse_mapper_node.canvas import Canvas
from neuse_mapper_node.decoding import Decoding
from neuse_mapper_node.keyframe_match import Estimates, KeyframeMatch
from neuse_mapper_node.params import MapperNodeParams
from neuse_mapper_node.save_place import BEFORE_RESET, check_place
from neuse_msgs.msg import KeyframeArray, ObjectMap, TrackedFrame
from neuse_msgs.srv import LoadMap, SaveMap
from neuse_slam_node.conversions import tracked_frame_from_msg
from neuse_slam_node.packed_keyframes import KeyframeReader, unpack

NAME = "mapper_node"
SPARE_PERIOD_S = 0.2
Item = tuple[int, TrackedFrame, Estimates | None]  # of the session of this index


class MapperNode(StageNode):
    """Keeps the object map. Frames wait for the keyframe estimates that were sent with them."""

    def __init__(self) -> None:
        super().__init__(NAME, MapperNodeParams())
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(SPARE_PERIOD_S, self._use_spare_time, clock=steady)

    def build(self, params: MapperNodeParams) -> None:
        self._params = params
        if params.save_path:
            check_place(params.save_path)
        embeddings = load_embeddings(params.weights, params.device)
        decoders = {category: self._decoder(embedding) for category, embedding in embeddings.items()}
        self._mapper = ObjectMapper(decoders, params.mapper)
        named = [name.strip().rstrip("/") for name in params.sessions.split(",")]
        self._namespaces = [f"{name}/" for name in named if name] or [""]
        self._sessions = Sessions(self._mapper, len(self._namespaces))
        self._matches = [KeyframeMatch() for _ in self._namespaces]
        self._readers = [KeyframeReader() for _ in self._namespaces]
        self._orders = [StampOrder(params.restart_s) for _ in self._namespaces]
        self._is_original = True  # nobody has told this map to be another
        self._stamp_ns = self._next_map_ns = self._next_drawing_ns = 0
        self._decoding = Decoding(self._mapper, params.decode_share)
        self._connect(params.topic_depth)
        if params.load_path:
            self._load(params.load_path)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = super().on_activate(state)
        with self.lock:
            if self._mapper.places():
                self._show()
        return result

    def _decoder(self, embedding: Embedding) -> Reconstruct:
        """A decoder whose time is kept."""

        def decode(code: Code) -> trimesh.Trimesh:
            with self.health.timed("decode"):
                return embedding.reconstruct(code, self._params.resolution_m)

        return decode

    def _connect(self, depth: int) -> None:
        self._told = Announcements(self.offer, self._namespaces, self._params.map_frame, depth)
        self._canvas = Canvas(self.offer, self._params.map_frame)
        for index, namespace in enumerate(self._namespaces):
            frames = partial(self._receive_frame, index)
            keyframes = partial(self._receive_keyframes, index)
            self.listen(TrackedFrame, f"{namespace}neuse/frames", frames, reliable(depth))
            self.listen(KeyframeArray, f"{namespace}neuse/keyframes", keyframes, latched(depth), raw=True)
        self.listen(ObjectMap, "neuse/recalled_map", self._receive_recalled, reliable(1))
        self.serve(SaveMap, "~/save_map", self._save_map)
        self.serve(LoadMap, "~/load_map", self._load_map)
        self.serve(Trigger, "~/reset", self._reset)

    def order_of(self, item: Item) -> StampOrder:
        return self._orders[item[0]]

    def process(self, stamp_ns: int, item: Item) -> None:
        index, message, estimates = item
        frame = tracked_frame_from_msg(message)
        keyframes = () if estimates is None else self._readers[index].changed(estimates.records)
        steps = self._sessions.admit(frame, keyframes, index)
        with self.health.timed("map"):
            changes = [change for step in steps for change in self._mapper.step(*step)]
        self.health.tally("edges", len(frame.edges))
        if not steps:
            self.health.tally("frames_outside_the_map")
        self._publish_changes(changes)
        self._stamp_ns = stamp_ns
        self._publish_due()

    def forget(self) -> None:
        if self._params.save_path:
            self._keep(self._params.save_path + BEFORE_RESET)
        self._clear()
        self._sessions.forget()
        if self._params.load_path:
            self._load(self._params.load_path)
            self._show()

    def _load(self, path: str) -> None:
        """Go on with a saved map; sessions have to find their place in it."""
        self._mapper.load(path)
        self._let_find_their_places()

    def _let_find_their_places(self) -> None:
        """The map is not that of the sessions: their frames wait until they have joined it."""
        self._read_all()
        self._sessions.distrust()

    def _show(self) -> None:
        self._publish_map(self._mapper.sketch)
        self._draw()

    def _clear(self) -> None:
        """Empty the map and what is shown of it."""
        self._is_original = False
        self._mapper.reset()
        self._read_all()
        self._stamp_ns = self._next_map_ns = self._next_drawing_ns = 0
        self._publish_map(self._mapper.sketch)
        self._canvas.clear()

    def _read_all(self) -> None:
        """The mapper has no keyframes: it needs those as well that stay as they are."""
        for reader in self._readers:
            reader.forget()

    def flush(self) -> None:
        self._release()

    def finish(self) -> None:
        self._publish_changes(self._mapper.finalize())
        self._publish_map(self._mapper.object_map)
        self._draw()
        if self._params.save_path:
            self._keep(self._params.save_path)

    def _keep(self, path: str) -> None:
        """Write the map before it is gone; an empty one is none."""
        if not self._mapper.places():
            return
        try:
            self._mapper.save(path)
            self.get_logger().info(f"{len(self._mapper.places())} objects written to {path}")
        except MapFileError as error:
            self.refuse("map_not_saved", str(error))

    def _receive_frame(self, index: int, message: TrackedFrame) -> None:
        self._matches[index].add_frame(message)
        self._release()

    def _receive_keyframes(self, index: int, data: bytes) -> None:
        self._matches[index].add_keyframes(Estimates(*unpack(data)))
        self._release()

    def _receive_recalled(self, message: ObjectMap) -> None:
        """slam_node remembers what the mapper before this one knew; after a reset nobody wants it back."""
        object_map = conversions.object_map_from_msg(message)
        with self.lock:
            if self._is_original:
                self._is_original = False
                is_in = self._mapper.is_in(object_map)
                recalled = self._mapper.recall(object_map)
                if recalled and not is_in:
                    self._let_find_their_places()
                self.health.tally("recalled_objects", recalled)
                self._publish_map(self._mapper.sketch)

    def _release(self) -> None:
        for index, match in enumerate(self._matches):
            for frame, estimates in match.release():
                self.enqueue(stamp_from_msg(frame.header.stamp), (index, frame, estimates))

    def _publish_changes(self, changes: Sequence[ObjectChange]) -> None:
        for change in changes:
            self.health.tally(f"changes_{change.kind.name.lower()}")
            self._told.tell_change(change)
        if changes:
            self._next_map_ns = self._next_drawing_ns = 0

    def _publish_due(self) -> None:
        """The map now and then, and after a change; pictures only while no frame has to wait for them."""
        if self._stamp_ns >= self._next_map_ns:
            self._next_map_ns = self._stamp_ns + int(self._params.map_period_s * NANOSECONDS)
            if len(self._namespaces) > 1:
                self._mapper.merge_duplicates()
            self._publish_map(self._mapper.sketch)
        if not self.is_behind:
            self._draw_if_due()

    def _draw_if_due(self) -> None:
        if self._stamp_ns >= self._next_drawing_ns and self._canvas.is_watched:
            self._next_drawing_ns = self._stamp_ns + int(self._params.draw_period_s * NANOSECONDS)
            self._draw()

    def _use_spare_time(self) -> None:
        """Decode a shape now and then, and draw for a viewer who has come, while no frame has to wait."""
        if not self._active or self.is_behind:
            return
        with self.lock:
            if self._decoding.go_on():
                self._publish_map(self._mapper.sketch)
                self._next_drawing_ns = 0
            self._draw_if_due()

    def _publish_map(self, object_map: Map) -> None:
        self.health.state("objects", len(object_map.objects))
        self._told.tell_map(object_map, self._sessions.has_strangers)

    def _draw(self) -> None:
        with self.health.timed("draw"):
            self._canvas.draw(self._mapper)

    def _save_map(self, request: SaveMap.Request, response: SaveMap.Response) -> SaveMap.Response:
        def save() -> str:
            self._mapper.save(request.path)
            return f"{len(self._mapper.places())} objects written to {request.path}"

        return self._answer(response, save)

    def _load_map(self, request: LoadMap.Request, response: LoadMap.Response) -> LoadMap.Response:
        def load() -> str:
            self._load(request.path)
            self._is_original = False
            self._show()
            return f"{len(self._mapper.places())} objects loaded from {request.path}"

        return self._answer(response, load)

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        def reset() -> str:
            self._clear()
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

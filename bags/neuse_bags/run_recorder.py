"""Records what the in-process pipeline puts out, on the topics and at the times that the nodes would."""

from collections import defaultdict

from neuse.mapping.markers import map_points, scene_markers
from neuse.pipeline import Pipeline, PipelineResult
from neuse.records import NO_ID, ObjectChange
from neuse_bags import topics
from neuse_bags.conversions import CAMERA_FRAME
from neuse_bags.mcap_file import BagWriter
from neuse_encoder_node.conversions import header_to_msg, observed_frame_to_msg
from neuse_encoder_node.health import Health
from neuse_mapper_node.conversions import markers_to_msg, object_map_to_msg, points_to_msg
from neuse_slam_node import conversions as slam

MAP_FRAME = "map"
MAP_PERIOD_NS = 10**9
DRAW_PERIOD_NS = 3 * 10**9


class RunRecorder:
    """Writes the results of each step, and the state of the pipeline now and then, to a bag."""

    def __init__(self, writer: BagWriter, pipeline: Pipeline) -> None:
        topics.declare(writer, topics.OUTPUT_TOPICS)
        self._writer, self._pipeline = writer, pipeline
        self._health = Health()
        self._stamp_ns = self._next_map_ns = self._next_draw_ns = 0

    def add(self, result: PipelineResult) -> None:
        """Everything that one step puts out."""
        self._stamp_ns = result.tracked.stamp_ns
        self._write(topics.OBSERVATIONS, observed_frame_to_msg(result.observed, CAMERA_FRAME))
        self._add_tracked(result)
        self.add_changes(result.changes)
        self._add_map(at_once=bool(result.changes))
        self._health.tally("frames")
        self._add_times(result)

    def add_changes(self, changes: tuple[ObjectChange, ...]) -> None:
        """Changes that the mapper reports."""
        for change in changes:
            self._write(topics.CHANGES, slam.change_to_msg(change, MAP_FRAME))

    def finish(self) -> None:
        """The final state, once all frames are in."""
        self._add_map(at_once=True)
        self._add_path()
        header = header_to_msg(self._stamp_ns, "")
        self._write(topics.DIAGNOSTICS, self._health.report("pipeline", header))

    def _write(self, topic: topics.TopicSpec, message: object) -> None:
        self._writer.write(topic.name, message, self._stamp_ns)

    def _add_tracked(self, result: PipelineResult) -> None:
        frame = result.tracked
        if frame.edges:
            self._write(topics.EDGES, slam.edges_to_msg(frame.edges, frame.stamp_ns, CAMERA_FRAME))
        if frame.keyframe_id != NO_ID or frame.loop_closed:
            keyframes = self._pipeline.slam.keyframes
            self._write(topics.KEYFRAMES, slam.keyframes_to_msg(keyframes, frame.stamp_ns, MAP_FRAME))
        self._write(topics.FRAMES, slam.tracked_frame_to_msg(frame, MAP_FRAME, CAMERA_FRAME))
        self._write(topics.EST_ODOMETRY, slam.odometry_to_msg(frame, MAP_FRAME, CAMERA_FRAME))

    def _add_path(self) -> None:
        self._write(topics.PATH, slam.path_to_msg(self._pipeline.slam.keyframes, MAP_FRAME))

    def _add_map(self, at_once: bool) -> None:
        if at_once or self._stamp_ns >= self._next_map_ns:
            self._next_map_ns = self._stamp_ns + MAP_PERIOD_NS
            self._write(topics.MAP, object_map_to_msg(self._pipeline.mapper.object_map, MAP_FRAME))
            self._add_path()
        if at_once or self._stamp_ns >= self._next_draw_ns:
            self._next_draw_ns = self._stamp_ns + DRAW_PERIOD_NS
            self._draw()

    def _draw(self) -> None:
        mapper = self._pipeline.mapper
        markers = scene_markers(mapper.object_map, mapper.mesh, mapper.changes)
        self._write(topics.MARKERS, markers_to_msg(markers, self._stamp_ns, MAP_FRAME))
        points, colors = map_points(mapper.object_map, mapper.mesh)
        self._write(topics.MAP_POINTS, points_to_msg(points, colors, self._stamp_ns, MAP_FRAME))

    def _add_times(self, result: PipelineResult) -> None:
        """Stages run once a frame, except the encoding of an object."""
        runs = defaultdict(lambda: 1, encode_per_object=max(len(result.observed.observations), 1))
        for stage, milliseconds in result.stage_ms.items():
            self._health.add_time(stage, milliseconds / 1e3 * runs[stage], runs[stage])

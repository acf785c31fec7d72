"""What one run delivered, by the nodes or by the in-process pipeline."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from neuse.evaluation.trajectory import FramePose, Trajectory, smoothed_trajectory, trajectory_of
from neuse.records import Edge, EdgeKind, Keyframe, ObjectChange, ObjectMap

FRONT_END_STAGES = ("encode", "associate", "edge")
SYSTEM_STAGES = ("encode", "slam", "map")
REPORTED_STAGES = ("encode_per_object", "associate", "edge", "optimise", "decode")


@dataclass(frozen=True)
class Estimate:
    """A run's output, in the frame `map`.

    frames: poses as published at the time.    keyframes: as optimised last.    maps: in order of stamps.
    stage_ms: mean milliseconds a frame by stage, as the run measured them; encode_per_object and decode: an
        object. `slam` holds `associate`, `edge` and `optimise`.    categories: by object id.
    """

    frames: tuple[FramePose, ...] = ()
    keyframes: tuple[Keyframe, ...] = ()
    edges: tuple[Edge, ...] = ()
    rejected_edges: int = 0
    changes: tuple[ObjectChange, ...] = ()
    maps: tuple[ObjectMap, ...] = ()
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    categories: Mapping[int, str] = field(default_factory=dict)

    def online_trajectory(self) -> Trajectory:
        """Poses as published at the time."""
        return trajectory_of([f.stamp_ns for f in self.frames], [f.T_map_camera for f in self.frames])

    def trajectory(self) -> Trajectory:
        """Final poses of all frames, after the last optimisation."""
        return smoothed_trajectory(self.frames, self.keyframes)

    def final_map(self) -> ObjectMap:
        """The map at the end."""
        return self.maps[-1] if self.maps else ObjectMap(0)

    def blind_pairs(self) -> int:
        """How many pairs of consecutive frames only odometry joins."""
        return sum(frame.blind for frame in self.frames[1:])

    def edge_count(self, kind: EdgeKind) -> int:
        """How many edges of a kind the run delivered."""
        return sum(edge.kind == kind for edge in self.edges)

    def front_end_fps(self) -> float | None:
        """Frames a second that encoding, association and edges allow; None if not measured."""
        return self._fps(FRONT_END_STAGES)

    def system_fps(self) -> float | None:
        """Frames a second that encoding, localising and mapping allow in turn; None if not measured."""
        return self._fps(SYSTEM_STAGES)

    def _fps(self, stages: tuple[str, ...]) -> float | None:
        if not all(stage in self.stage_ms for stage in stages):
            return None
        return 1e3 / max(sum(self.stage_ms[stage] for stage in stages), 1e-6)

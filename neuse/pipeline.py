"""The whole system in one process, one step a frame: no ROS, no threads, repeatable to the last digit."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from neuse.embedding.embedding import Embedding
from neuse.embedding.observe import Observer, ObserverParams
from neuse.mapping.mapper import MapperParams, ObjectMapper
from neuse.records import ObjectChange, ObservedFrame, OdometrySample, RgbdFrame, TrackedFrame
from neuse.slam.feedback import DELAY_S, ChangeFeedback
from neuse.slam.joining import Joiner, JoiningParams
from neuse.slam.params import SlamParams
from neuse.slam.prior_map import PriorMap
from neuse.slam.slam import ObjectSlam


@dataclass(frozen=True)
class PipelineParams:
    """Parameters of the three stages."""

    encoder: ObserverParams = field(default_factory=ObserverParams)
    slam: SlamParams = field(default_factory=SlamParams)
    mapper: MapperParams = field(default_factory=MapperParams)
    joining: JoiningParams = field(default_factory=JoiningParams)
    feedback_delay_s: float = DELAY_S


@dataclass(frozen=True)
class PipelineResult:
    """What one frame led to. mapped: frames that entered the map: this one, or none and later many while the
    session joins a saved map.
    """

    observed: ObservedFrame
    tracked: TrackedFrame
    changes: tuple[ObjectChange, ...]
    stage_ms: dict[str, float]
    mapped: tuple[TrackedFrame, ...] = ()


class Pipeline:
    """Segmented RGB-D frames in, keyframes, edges and a change-aware object map out (NeuSE figure 2)."""

    def __init__(
        self, params: PipelineParams | None = None, embeddings: Mapping[str, Embedding] | None = None
    ) -> None:
        """`embeddings` by category; None loads all that are shipped."""
        self.params = params or PipelineParams()
        self.observer = Observer(self.params.encoder, embeddings)
        self.slam = ObjectSlam(self.params.slam)
        decoders = {name: embedding.reconstruct for name, embedding in self.observer.embeddings.items()}
        self.mapper = ObjectMapper(decoders, self.params.mapper)
        self.joiner = Joiner(self.slam, self.params.joining)
        self._feedback = ChangeFeedback(self.params.feedback_delay_s)

    def load_map(self, path: str | Path) -> None:
        """Begin anew in a saved map: frames enter it once the camera has been found there.

        Raises:
            MapFileError: missing, damaged, or of another version; everything goes on as it was.
        """
        self.mapper.load(path)
        self._feedback.clear()
        self.joiner.offer(PriorMap.of(self.mapper.object_map))

    def step(self, frame: RgbdFrame, odometry: OdometrySample | None = None) -> PipelineResult:
        """Encode, localise, map."""
        started = time.perf_counter()
        observed = self.observer.observe(frame)
        encode_ms = 1e3 * (time.perf_counter() - started)
        result = self.track(observed, odometry)
        per_object_ms = encode_ms / max(len(observed.observations), 1)
        stage_ms = {"encode": encode_ms, "encode_per_object": per_object_ms, **result.stage_ms}
        return replace(result, stage_ms=stage_ms)

    def track(self, observed: ObservedFrame, odometry: OdometrySample | None = None) -> PipelineResult:
        """Localise and map an encoded frame; changes reach the tracker as late as between processes."""
        started = time.perf_counter()
        for change in self._feedback.due(observed.stamp_ns):
            self.slam.apply_change(change)
        tracked = self.slam.step(observed, odometry)
        localised = time.perf_counter()
        mapped_frames = self.joiner.follow(tracked)
        changes = self._map(mapped_frames)
        for change in changes:
            self._feedback.add(change)
        mapped = time.perf_counter()
        stage_ms = {
            "slam": 1e3 * (localised - started),
            **self.slam.stopwatch.stage_ms,
            "map": 1e3 * (mapped - localised),
        }
        return PipelineResult(observed, tracked, changes, stage_ms, tuple(mapped_frames))

    def _map(self, frames: Sequence[TrackedFrame]) -> tuple[ObjectChange, ...]:
        """Take frames into the map, none or many while the session joins a saved one; what has changed."""
        keyframes = self.slam.moved_keyframes() if frames else ()
        return tuple(change for frame in frames for change in self.mapper.step(frame, keyframes))

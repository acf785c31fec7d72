"""SLAM and mapping over an encoded world: what the in-process pipeline makes of what the front end saw."""

from collections import defaultdict

import numpy as np

from neuse.evaluation.encoded_world import EncodedWorld
from neuse.evaluation.estimate import Estimate
from neuse.evaluation.trajectory import FramePose
from neuse.pipeline import Pipeline, PipelineParams
from neuse.records import NO_ID, Edge


def run_encoded(world: EncodedWorld, params: PipelineParams | None = None) -> Estimate:
    """The same steps as `neuse_bags run`, from where the codes are known."""
    pipeline = Pipeline(params)
    frames, edges, rejected = list[FramePose](), list[Edge](), 0
    times_ms, categories = defaultdict[str, list[float]](list), dict[int, str]()
    for observed, odometry in zip(world.frames, world.odometry, strict=True):
        result = pipeline.track(observed, odometry)
        tracked = result.tracked
        frames.append(FramePose.of(tracked))
        edges += tracked.edges
        rejected += tracked.rejected_edges
        categories |= {
            item.object_id: item.observation.code.category
            for item in tracked.observations
            if item.object_id != NO_ID
        }
        for stage, milliseconds in result.stage_ms.items():
            times_ms[stage].append(milliseconds)
    pipeline.mapper.finalize()
    return Estimate(
        frames=tuple(frames),
        keyframes=pipeline.slam.keyframes,
        edges=tuple(edges),
        rejected_edges=rejected,
        changes=pipeline.mapper.changes,
        maps=(pipeline.mapper.object_map,),
        stage_ms={stage: float(np.mean(values)) for stage, values in times_ms.items()},
        categories=categories,
    )

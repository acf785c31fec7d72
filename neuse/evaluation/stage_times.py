"""Times of the stages: encoder, alignment and decoder by themselves, and all of a run on simulated frames."""

import resource
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from neuse.embedding.code import Code
from neuse.embedding.embedding import load_embedding, shipped_categories
from neuse.embedding.reconstruction import decode
from neuse.evaluation.code_worlds import make_code_world
from neuse.evaluation.estimate import FRONT_END_STAGES
from neuse.evaluation.timing import WARM_UP, Times, timed, timed_runs
from neuse.geometry import Array, inverse
from neuse.mapping.map_file import load_map
from neuse.mapping.mapper import ObjectMapper
from neuse.pipeline import Pipeline, PipelineResult
from neuse.simulation.worlds import SimulatedFrame, World, make_world, simulate
from neuse.slam.edges import EdgeParams
from neuse.slam.object_frames import reduce_codes
from neuse.slam.registration import align, align_each

CHUNK = 20
BATCH, CLOUD_POINTS = 5, 500  # the paper's frame: five objects of 500 points
DECODED_POINTS = 20_000
RUNS = 40


def encoder_times(runs: int = RUNS) -> Times:
    """An object's share of encoding a frame's five objects; categories by turns."""
    embeddings = [load_embedding(category) for category in shipped_categories()]
    clouds = list(_clouds(BATCH))
    times = [timed_runs(partial(embedding.encode, clouds), runs).per(BATCH) for embedding in embeddings]
    return Times(sum((t.wall_ms for t in times), ()), sum((t.cpu_ms for t in times), ()))


def alignment_times(runs: int = 10 * RUNS) -> Times:
    """Relative pose of two views with five objects each, from their codes."""
    codes_a, codes_b = (_codes(way_m) for way_m in (0.0, 0.2))
    return timed_runs(lambda: align(codes_a, codes_b), runs)


def window_alignment_times(runs: int = RUNS) -> Times:
    """A view's share of aligning a new keyframe with all others of the window, as for its edges."""
    new, *olds = (reduce_codes(_codes(0.02 * index)) for index in range(EdgeParams().window))
    views = [(np.arange(BATCH), old) for old in olds]
    return timed_runs(lambda: align_each(new, views), runs).per(len(views))


def decoding_times(runs: int = RUNS) -> Times:
    """Occupancy of one code at 20 000 points."""
    rng, embedding = np.random.default_rng(0), load_embedding(shipped_categories()[0])
    code = embedding.encode(list(_clouds(1)))[0]
    points = rng.uniform(-0.1, 0.1, (DECODED_POINTS, 3))
    return timed_runs(lambda: decode(embedding.network, code, points), runs)


def _codes(way_m: float) -> list[Code]:
    """Codes of five objects, seen after so much of the camera's way."""
    world = make_code_world(BATCH)
    T_camera_world = inverse(world.camera(way_m))
    return [world.true_code(index).transformed(T_camera_world) for index in range(BATCH)]


def _clouds(count: int) -> Array:
    """(count, CLOUD_POINTS, 3) points a metre away."""
    return np.random.default_rng(0).normal([0.0, 0.0, 1.0], 0.04, (count, CLOUD_POINTS, 3))


@dataclass(frozen=True)
class Run:
    """A run of the whole pipeline over simulated frames.

    system: everything of a frame.    front_end_ms: of encoding, association and edges, a frame.
    stage_ms: by stage, of the frames that had it.    map_bytes: of the saved map and of its objects alone, an
    object.    peak_memory_mb: of this process so far.
    """

    system: Times
    front_end_ms: tuple[float, ...]
    stage_ms: dict[str, tuple[float, ...]]
    objects_per_frame: float
    map_bytes: tuple[float, float]
    peak_memory_mb: float

    @property
    def front_end_fps(self) -> float:
        """Frames a second, by the median."""
        return 1e3 / float(np.median(self.front_end_ms))

    @property
    def system_fps(self) -> float:
        """Frames a second, by the median."""
        return 1e3 / float(np.median(self.system.wall_ms))


def pipeline_run(preset: str, frames: int) -> Run:
    """The in-process pipeline on the first frames of a world, after a few that do not count."""
    pipeline, results, times = Pipeline(), list[PipelineResult](), list[tuple[float, float]]()
    for simulated in _rendered(make_world(preset, seed=0), frames):
        wall_cpu = timed(lambda s=simulated: results.append(pipeline.step(s.frame, s.odometry)))  # type: ignore
        times.append(wall_cpu)
    stage_ms = [result.stage_ms for result in results[WARM_UP:]]
    return Run(
        system=Times.of(times[WARM_UP:]),
        front_end_ms=tuple(sum(ms.get(stage, 0.0) for stage in FRONT_END_STAGES) for ms in stage_ms),
        stage_ms={
            stage: tuple(ms[stage] for ms in stage_ms if stage in ms)
            for stage in dict.fromkeys(chain(*stage_ms))
        },
        objects_per_frame=float(np.mean([len(r.observed.observations) for r in results[WARM_UP:]])),
        map_bytes=_map_bytes(pipeline.mapper),
        peak_memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    )


def _rendered(world: World, frames: int) -> Iterator[SimulatedFrame]:
    """Frames, rendered by chunks before the first of a chunk is given, so that nothing else runs."""
    stop = min(frames, world.frames)
    for start in range(0, stop, CHUNK):
        yield from list(simulate(world, start, min(start + CHUNK, stop)))


def _map_bytes(mapper: ObjectMapper) -> tuple[float, float]:
    """Bytes an object of the map file with its evidence of free space, and of its views alone."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "map.npz"
        mapper.save(path)
        stored, size = load_map(path), path.stat().st_size
    count = max(len(stored.objects), 1)
    views = [view for item in stored.objects for view in item.views.values()]
    own = sum(v.points.nbytes + v.code.z.nbytes + v.code.descriptor.nbytes for v in views)
    return size / count, own / count

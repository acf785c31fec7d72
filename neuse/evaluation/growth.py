"""How the times of a frame grow: association with the objects known, optimisation with the keyframes.

Worlds of codes are enough for it; see code_worlds.py.
"""

import time
from dataclasses import dataclass
from functools import partial

import numpy as np

from neuse.evaluation.code_worlds import CodeWorld, make_code_world, walk
from neuse.evaluation.timing import WARM_UP, Times, TwoClocks, timed
from neuse.geometry import Array, inverse
from neuse.records import ObservedFrame
from neuse.slam.hypotheses import Hypothesis
from neuse.slam.library import ids_by_likeness
from neuse.slam.localization import Belief
from neuse.slam.object_frames import reduce_codes
from neuse.slam.odometry import Motion
from neuse.slam.params import SlamParams
from neuse.slam.slam import ObjectSlam
from neuse.slam.track import LastSighting, Track
from neuse.slam.tracker import ObjectTracker

FRAME_SIGMAS = np.repeat([0.003, 0.01], 3)  # of the motion between two frames: rad, metres
DRIFT_AN_OBJECT = np.array([1e-7, 4e-6])  # that the drift clock runs from one object to the next, rad^2, m^2
FRAME_SPACING_M = 0.05  # every frame is a keyframe
LAP_OBJECTS = 250  # of the world in which keyframes grow: 50 m a lap, so that every lap closes loops
ASSOCIATION_FRAMES = 60


def association_times(objects: int, frames: int = ASSOCIATION_FRAMES) -> Times:
    """Association of a frame of five objects (poses, matches, similar ones) with so many objects known."""
    world = make_code_world(objects)
    tracker, rng = surveyed(world), np.random.default_rng(1)
    path = walk(world, frames + WARM_UP, FRAME_SPACING_M)
    motions = [inverse(a[0]) @ b[0] for a, b in zip(path[:1] + path[:-1], path, strict=True)]
    views = [world.observe(T, sample.stamp_ns, rng) for T, sample in path]
    times = [timed(partial(associate_frame, tracker, o, T)) for o, T in zip(views, motions, strict=True)]
    return Times.of(times[WARM_UP:])


def surveyed(world: CodeWorld) -> ObjectTracker:
    """A tracker at the start of the walk that has gone round once: it knows every object."""
    slam = SlamParams()
    tracker = ObjectTracker(slam.association, slam.instantiation, slam.use_ambiguous)
    for index in range(len(world)):
        code = world.true_code(index)
        frames = reduce_codes([code], slam.sigmas)
        last = LastSighting(frames, code.center, np.eye(4))
        drift = (index - len(world)) * DRIFT_AN_OBJECT  # the clock reads 0 now
        track = tracker.library.add(code, frames.vectors[:, 0], last, drift, 0)
        track.last_frame = track.last_sure = -10_000
        track.n_sightings = track.n_eligible = 10
        track.anchored = track.in_graph = True
        tracker.library.confirm(track)
    tracker.belief = Belief(world.camera(0.0), 1e-6 * np.eye(6))
    return tracker


def associate_frame(
    tracker: ObjectTracker, observed: ObservedFrame, T_before_now: Array
) -> tuple[Track | None, ...]:
    """What association does in a frame; the track of each observation."""
    observations = observed.observations
    codes = tuple(observation.code for observation in observations)
    centers = np.array([observation.partial_center for observation in observations])
    view = tracker.view(codes, reduce_codes(codes), centers)
    motion = Motion(T_before_now, np.diag(FRAME_SIGMAS**2))
    located = tracker.locate(view, [Hypothesis.after(tracker.belief, motion)])
    tracks, fresh = tracker.update(view, observations, located)
    ids_by_likeness(codes, [*view.alike, *fresh], tracker.association.delta_shape)
    return tracks


@dataclass(frozen=True)
class Optimisation:
    """Times of the solver at every keyframe of one long run, and in how many of them loops were closed.

    error_m: of the last position, a sign that the run was sound.    in_graph: keyframes at the end, when
        others had left the graph.
    """

    times: Times
    loop_closures: int
    error_m: float
    in_graph: int

    def at(self, keyframes: int) -> dict[str, float] | None:
        """Summary of the last tenth of the first so many keyframes, with the worst of all that came before.

        None if the run did not get so far.
        """
        if keyframes > len(self.times.wall_ms):
            return None
        first, until = keyframes - keyframes // 10, keyframes
        times = Times(self.times.wall_ms[first:until], self.times.cpu_ms[first:until]).summary()
        worst = {"worst_ms": max(self.times.wall_ms[:until]), "cpu_worst_ms": max(self.times.cpu_ms[:until])}
        return times | worst


def optimisation_times(keyframes: int, budget_s: float, lap_objects: int = LAP_OBJECTS) -> Optimisation:
    """A camera goes round and round; every frame is a keyframe and every lap closes loops.

    budget_s: the run stops after so long, however far it came.
    """
    world, slam, rng = make_code_world(lap_objects), ObjectSlam(), np.random.default_rng(2)
    times, closures, started = list[tuple[float, float]](), 0, time.monotonic()
    for T_world_camera, sample in walk(world, keyframes, FRAME_SPACING_M):
        slam.stopwatch = clocks = TwoClocks()
        tracked = slam.step(world.observe(T_world_camera, sample.stamp_ns, rng), sample)
        times.append((clocks.stage_ms.get("optimise", 0.0), clocks.cpu_ms.get("optimise", 0.0)))
        closures += tracked.loop_closed
        error = inverse(world.camera(0.0)) @ T_world_camera @ inverse(tracked.T_map_camera)
        if time.monotonic() - started > budget_s:
            break
    return Optimisation(Times.of(times), closures, float(np.linalg.norm(error[:3, 3])), slam.graph_size)

"""What is timed is the real thing: objects are matched, poses are right, loops close."""

import numpy as np

from neuse.evaluation.code_worlds import make_code_world
from neuse.evaluation.growth import (
    ASSOCIATION_FRAMES,
    Optimisation,
    associate_frame,
    association_times,
    optimisation_times,
    surveyed,
)
from neuse.evaluation.timing import Times


def test_surveyed_tracker_matches_every_object_with_its_own_track():
    world = make_code_world(200)
    tracker, rng = surveyed(world), np.random.default_rng(0)
    observed = world.observe(world.camera(0.0), 1, rng)
    tracks = associate_frame(tracker, observed, np.eye(4))
    for observation, track in zip(observed.observations, tracks, strict=True):
        assert observation.code.descriptor @ world.descriptors[track.key] > 0.99
    assert len(tracker.library.tracks) == len(world)


def test_association_is_timed_on_every_frame():
    times = association_times(10)
    assert len(times.wall_ms) == ASSOCIATION_FRAMES
    assert min(times.wall_ms) > 0


def test_run_whose_time_is_up_stops():
    run = optimisation_times(1000, budget_s=0.0)
    assert len(run.times.wall_ms) == 1
    assert run.at(1000) is None


def test_run_follows_the_camera():
    run = optimisation_times(20, budget_s=60.0)
    assert len(run.times.wall_ms) == 20
    assert run.error_m < 0.05
    assert run.in_graph == 20
    assert min(run.times.wall_ms) > 0  # every frame was a keyframe


def test_summary_is_of_the_last_tenth():
    ramp = tuple(float(i) for i in range(100))
    run = Optimisation(Times(ramp, ramp), 0, 0.0, 100)
    assert run.at(50)["mean_ms"] == 47.0
    assert run.at(100)["worst_ms"] == 99.0


def test_worst_is_that_of_all_keyframes():
    times = (7.0, *(1.0 for _ in range(99)))
    at = Optimisation(Times(times, times), 0, 0.0, 100).at(100)
    assert (at["mean_ms"], at["worst_ms"], at["cpu_worst_ms"]) == (1.0, 7.0, 7.0)

"""Sessions that come to a map that they did not make, in a small world of codes."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.geometry import inverse, rotation_angle
from neuse.records import NO_ID, MatchStatus, ObjectStatus
from neuse.slam.joining import Joiner, JoiningParams, moved
from neuse.slam.params import SlamParams
from neuse.slam.prior_map import PriorMap
from neuse.slam.slam import ObjectSlam

from .known_maps import ELSEWHERE, map_of
from .synthetic import World, small_world


def walk(world, start, count, seed=9):
    """Another camera in the world, from somewhere on its path."""
    return World(world.things, world.path[start : start + count], seed=seed)


def play(joiner, slam, steps, with_odometry=False):
    """[(step, frames that came out)]"""
    return [
        (step, joiner.follow(slam.step(step.frame, step.odometry if with_odometry else None)))
        for step in steps
    ]


def error(T_map_world, step, T_map_camera):
    """(m, deg) of a pose in the map."""
    off = inverse(T_map_world @ step.T_world_camera) @ T_map_camera
    return np.linalg.norm(off[:3, 3]), np.rad2deg(rotation_angle(off[:3, :3]))


@pytest.fixture(scope="module", params=["landmarks", "edges"])
def joined(request):
    """A session without odometry that has met a map of the same world in another frame."""
    world = small_world(3)
    slam = ObjectSlam(SlamParams(mode=request.param))
    joiner = Joiner(slam)
    joiner.offer(PriorMap.of(map_of(world.things, ELSEWHERE)))
    return world, slam, joiner, play(joiner, slam, walk(world, 20, 30).steps())


def test_frames_come_out_once_the_place_is_certain_and_none_is_lost(joined):
    *_, played = joined
    counts = [len(out) for _, out in played]
    first = next(i for i, count in enumerate(counts) if count)
    assert 2 <= first <= 8
    assert counts[first] == first + 1
    assert set(counts[first + 1 :]) == {1}
    stamps = [frame.stamp_ns for _, out in played for frame in out]
    assert stamps == [step.frame.stamp_ns for step, _ in played]
    assert next(out for _, out in played if out)[-1].loop_closed


def test_all_poses_are_in_the_map(joined):
    *_, played = joined
    out = [frame for _, frames in played for frame in frames]
    for (step, _), frame in zip(played, out, strict=True):
        far_m, turned_deg = error(ELSEWHERE, step, frame.T_map_camera)
        assert far_m < 0.05
        assert turned_deg < 2.0


def test_objects_have_the_ids_of_the_map_from_the_first_frame_on(joined):
    *_, played = joined
    out = [frame for _, frames in played for frame in frames]
    for (step, _), frame in zip(played, out, strict=True):
        for name, tracked in zip(step.names, frame.observations, strict=True):
            if tracked.object_id != NO_ID:
                assert tracked.object_id == 20 + name
            assert tracked.object_id not in tracked.similar_ids
    matched = [t for frame in out[10:] for t in frame.observations if t.status == MatchStatus.MATCHED]
    assert len(matched) > 0.8 * sum(len(frame.observations) for frame in out[10:])


def test_keyframes_are_in_the_map_too(joined):
    _, slam, _, played = joined
    steps = {step.frame.stamp_ns: step for step, _ in played}
    for keyframe in slam.keyframes:
        assert error(ELSEWHERE, steps[keyframe.stamp_ns], keyframe.T_map_camera)[0] < 0.05


def test_session_that_has_joined_goes_on_when_the_map_is_told_again_and_learns_what_is_new():
    world = small_world(3)
    known, last = replace_things(world, world.things[:-1]), world.things[-1]
    slam = ObjectSlam()
    joiner = Joiner(slam)
    joiner.offer(PriorMap.of(map_of(known.things)))
    play(joiner, slam, walk(world, 20, 12).steps())
    assert not joiner.is_waiting
    assert joiner.offer(PriorMap.of(map_of(world.things))) is False
    assert not joiner.is_waiting
    place = last.T_world_object[:3, 3]
    assert sum(np.linalg.norm(center - place) < 0.05 for center in slam.places().values()) == 1


def test_nothing_waits_where_there_is_no_map():
    world, slam = small_world(3), ObjectSlam()
    played = play(Joiner(slam), slam, walk(world, 0, 6).steps())
    assert [len(out) for _, out in played] == [1] * 6


def test_session_may_wait_for_a_map_to_come():
    world, slam = small_world(3), ObjectSlam()
    joiner = Joiner(slam, JoiningParams(wait_for_map=True, session=1, sessions=2))
    steps = list(walk(world, 20, 16).steps())
    assert not any(out for _, out in play(joiner, slam, steps[:6]))
    joiner.offer(PriorMap.of(map_of(world.things)))
    out = [frame for _, frames in play(joiner, slam, steps[6:]) for frame in frames]
    assert len(out) == 16


def test_session_that_waited_for_a_map_calls_nothing_by_a_name_of_the_map():
    """It has counted its objects from 0, as the map has; one of them is new to the map."""
    world, slam = small_world(3), ObjectSlam()
    joiner = Joiner(slam, JoiningParams(wait_for_map=True))
    steps = list(walk(world, 20, 30).steps())
    play(joiner, slam, steps[:6])
    first = min(steps[0].names)
    known = map_of([thing for thing in world.things if thing.name != first], ELSEWHERE, first_id=0)
    prior = PriorMap.of(known)
    joiner.offer(prior)
    out = [frame for _, frames in play(joiner, slam, steps[6:]) for frame in frames]
    assert len(out) == len(steps)
    places = slam.places()
    for object_id, center in prior.places.items():
        np.testing.assert_allclose(places[object_id], center, atol=0.05)
    for step, frame in zip(steps, out, strict=True):
        for name, tracked in zip(step.names, frame.observations, strict=True):
            if tracked.object_id != NO_ID:
                assert tracked.object_id == name or (name == first and tracked.object_id >= prior.next_id)


def test_session_in_another_world_never_joins():
    slam = ObjectSlam()
    joiner = Joiner(slam)
    joiner.offer(PriorMap.of(map_of(small_world(5, alike=0.9).things)))
    played = play(joiner, slam, walk(small_world(3, alike=0.9), 0, 120).steps(), with_odometry=True)
    assert joiner.is_waiting
    assert not any(out for _, out in played)
    assert joiner.n_held == 120


def test_held_frames_are_bounded():
    slam = ObjectSlam()
    joiner = Joiner(slam, JoiningParams(wait_for_map=True, max_held_frames=4))
    steps = list(walk(small_world(3), 0, 8).steps())
    play(joiner, slam, steps)
    stamps_ns = [step.frame.stamp_ns for step in steps]
    assert [frame.stamp_ns for frame in joiner._held] == [stamps_ns[0], *stamps_ns[-3:]]


def test_running_session_begins_anew_in_a_map_that_is_not_its_own():
    world, slam = small_world(3), ObjectSlam()
    joiner = Joiner(slam)
    steps = list(walk(world, 20, 24).steps())
    play(joiner, slam, steps[:8])
    assert joiner.offer(PriorMap.of(map_of(world.things, ELSEWHERE, first_id=0))) is True
    out = [frames for _, frames in play(joiner, slam, steps[8:]) if frames]
    assert out[0][0].keyframe_id == 0
    assert out[0][0].stamp_ns == steps[8].frame.stamp_ns


def test_map_that_is_gone_is_waited_for_no_longer():
    world, slam = small_world(3), ObjectSlam()
    joiner = Joiner(slam)
    joiner.offer(PriorMap.of(map_of(small_world(5).things)))
    steps = list(walk(world, 20, 10).steps())
    play(joiner, slam, steps[:5])
    assert joiner.offer(PriorMap({}, 0)) is True
    assert [len(out) for _, out in play(joiner, slam, steps[5:])] == [1] * 5


@pytest.mark.parametrize(("session", "expected"), [(0, [26, 28]), (1, [25, 27])])
def test_sessions_that_share_a_map_never_give_one_name_twice(session, expected):
    slam = ObjectSlam()
    joiner = Joiner(slam, JoiningParams(session=session, sessions=2))
    things = small_world(3).things[:5]
    joiner.offer(PriorMap.of(map_of(things)))
    ids = slam._tracker.library._ids
    assert [next(ids), next(ids)] == expected


def test_removed_objects_are_no_part_of_the_map_to_be_joined_but_keep_their_names():
    prior = PriorMap.of(map_of(small_world(3).things, status=ObjectStatus.REMOVED))
    assert len(prior) == 0
    assert prior.next_id == 20 + 12


def test_edges_of_held_frames_name_the_objects_of_the_map(joined):
    *_, played = joined
    out = [frame for _, frames in played for frame in frames]
    named = {i for frame in out for edge in frame.edges for i in edge.object_ids}
    assert named
    assert named <= {NO_ID, *range(20, 32)}


def test_moving_a_frame_keeps_its_covariance(joined):
    frame = joined[3][-1][1][0]
    again = moved(frame, ELSEWHERE, {})
    np.testing.assert_array_equal(again.T_map_camera, ELSEWHERE)
    np.testing.assert_array_equal(again.covariance, frame.covariance)


def replace_things(world, things):
    return replace(world, things=things)

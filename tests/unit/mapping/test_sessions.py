"""Sessions that share a map: who founds it, who joins it, and who stays outside."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.geometry import exp, inverse, make_transform
from neuse.mapping.mapper import ObjectMapper
from neuse.mapping.sessions import STRIDE, Sessions
from neuse.records import NO_ID, Keyframe, MatchStatus, TrackedObservation

from .synthetic import RECONSTRUCT, make_world, orbit

ELSEWHERE = make_transform(exp([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])[:3, :3], [2.0, 1.0, 0.0])


def frames_of(count=8, start_rad=0.0, first_stamp_ns=0, ids=None, T_map_world=None):
    """What a tracker makes of the table; `ids` maps the ids that it gives to those of the map."""
    world = make_world(mapper=ObjectMapper(RECONSTRUCT), seed=int(100 * start_rad))
    frames = []
    for T_world_camera in orbit(count=count, start_rad=start_rad):
        frame = world.frame(T_world_camera)
        observations = tuple(
            replace(t, object_id=(ids or {}).get(t.object_id, t.object_id)) for t in frame.observations
        )
        T = frame.T_map_camera if T_map_world is None else T_map_world @ frame.T_map_camera
        stamp_ns = first_stamp_ns + frame.stamp_ns
        frames.append(replace(frame, observations=observations, T_map_camera=T, stamp_ns=stamp_ns))
    return frames


def take(mapper, sessions, frames, index=0):
    """How many steps each frame leads to."""
    counts = []
    for frame in frames:
        keyframes = [Keyframe(frame.keyframe_id, frame.stamp_ns, frame.T_map_camera)]
        steps = sessions.admit(frame, keyframes, index)
        for step in steps:
            mapper.step(*step)
        counts.append(len(steps))
    return counts


@pytest.fixture
def founded():
    """A mapper, its sessions of two robots, and the ids of the objects that the first has mapped."""
    mapper = ObjectMapper(RECONSTRUCT)
    sessions = Sessions(mapper, 2)
    assert take(mapper, sessions, frames_of()) == [1] * 8
    return mapper, sessions, sorted(mapper.places())


def same_ids(mapper, T_map_world=None):
    """{id of a fresh tracker: id of the map} by where the objects stand."""
    other = ObjectMapper(RECONSTRUCT)
    for frame in frames_of(start_rad=1.0):
        other.step(frame)
    places = mapper.places()
    return {
        i: min(places, key=lambda j: np.linalg.norm(places[j] - center))
        for i, center in other.places().items()
    }


def test_first_session_founds_the_map(founded):
    mapper, _, ids = founded
    assert len(ids) == 5
    assert all(known.n_observations >= 5 for known in mapper.object_map.objects)


def test_second_session_enters_with_all_its_frames_when_its_objects_are_in_place(founded):
    mapper, sessions, ids = founded
    counts = take(mapper, sessions, frames_of(start_rad=1.0, ids=same_ids(mapper)), index=1)
    first = next(i for i, count in enumerate(counts) if count)
    assert counts[first] == first + 1
    assert sum(counts) == 8
    assert sorted(mapper.places()) == ids
    assert not sessions.has_strangers


def test_session_whose_objects_are_not_where_the_map_has_them_stays_outside(founded):
    mapper, sessions, ids = founded
    before = mapper.places()
    counts = take(mapper, sessions, frames_of(start_rad=1.0, T_map_world=ELSEWHERE), index=1)
    assert sum(counts) == 0
    assert sessions.has_strangers
    assert sorted(mapper.places()) == ids
    for object_id, center in mapper.places().items():
        np.testing.assert_allclose(center, before[object_id], atol=1e-9)


def test_session_of_unknown_names_waits_until_it_names_what_the_map_knows(founded):
    mapper, sessions, _ = founded
    strangers = {i: 100 + i for i in range(10)}
    assert sum(take(mapper, sessions, frames_of(start_rad=1.0, ids=strangers), index=1)) == 0
    assert sessions.has_strangers


def test_keyframes_of_sessions_are_kept_apart(founded):
    mapper, sessions, _ = founded
    (frame, *_) = frames_of(count=4, start_rad=1.0, ids=same_ids(mapper))
    sessions.admit(frame, (), 1)
    known = tuple(
        TrackedObservation(_seen_at(frame, center, seen.observation), MatchStatus.MATCHED, object_id)
        for seen, (object_id, center) in zip(
            frame.observations, list(mapper.places().items())[:3], strict=False
        )
    )
    sessions.admit(replace(frame, keyframe_id=NO_ID, observations=known[:2]), (), 1)
    assert sessions.has_strangers  # two may stand there by chance
    later = replace(frame, keyframe_id=1, observations=known)
    steps = sessions.admit(later, [Keyframe(1, 5, np.eye(4))], 1)
    assert [step[0].keyframe_id for step in steps] == [STRIDE, NO_ID, STRIDE + 1]
    assert [k.keyframe_id for k in steps[-1][1]] == [STRIDE + 1]
    between = replace(later, keyframe_id=NO_ID)
    assert sessions.admit(between, (), 1)[0][0].keyframe_id == NO_ID


def _seen_at(frame, center, observation):
    """The observation, moved to a place of the map."""
    T = np.eye(4)
    T[:3, 3] = inverse(frame.T_map_camera)[:3, :3] @ center + inverse(frame.T_map_camera)[:3, 3]
    T[:3, 3] -= observation.code.center
    return replace(observation, code=observation.code.transformed(T))


def test_session_that_was_started_again_comes_back_under_keyframes_of_its_own():
    mapper = ObjectMapper(RECONSTRUCT)
    sessions = Sessions(mapper)
    take(mapper, sessions, frames_of())
    ids, before = same_ids(mapper), sorted(mapper.places())
    counts = take(mapper, sessions, frames_of(start_rad=1.0, first_stamp_ns=10**10, ids=ids))
    assert counts[0] == 0
    assert sum(counts) == 8
    assert sorted(mapper.places()) == before


def test_loaded_map_is_entered_by_no_session_that_is_not_in_it(tmp_path):
    mapper = ObjectMapper(RECONSTRUCT)
    sessions = Sessions(mapper)
    frames = frames_of()
    take(mapper, sessions, frames)
    mapper.save(tmp_path / "map")
    mapper.load(tmp_path / "map")
    sessions.distrust()
    outside = [replace(f, T_map_camera=ELSEWHERE @ f.T_map_camera, keyframe_id=9) for f in frames[4:]]
    assert sum(take(mapper, sessions, outside)) == 0
    assert sum(take(mapper, sessions, [replace(f, keyframe_id=9 + i) for i, f in enumerate(frames[4:])])) == 4


def test_forgetting_lets_the_next_session_found_the_map(founded):
    mapper, sessions, _ = founded
    mapper.reset()
    sessions.forget()
    assert take(mapper, sessions, frames_of(start_rad=1.0), index=1) == [1] * 8

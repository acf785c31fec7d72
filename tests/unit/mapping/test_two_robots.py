"""Two cameras in one world at the same time: two sessions that share a map and exchange nothing but codes."""

from dataclasses import replace

import numpy as np
import pytest
from slam.synthetic import World, small_world

from neuse.geometry import inverse
from neuse.mapping.mapper import ObjectMapper
from neuse.mapping.sessions import Sessions
from neuse.records import NO_ID
from neuse.slam.joining import Joiner, JoiningParams
from neuse.slam.prior_map import PriorMap
from neuse.slam.slam import ObjectSlam

N_FRAMES = 70


@pytest.fixture(scope="module")
def shared():
    """Both cameras go round, the second from the other side; the map is told whenever it has got objects."""
    world = small_world(4)
    mapper, told = ObjectMapper({}), 0
    sessions = Sessions(mapper, 2)
    slams = [ObjectSlam(), ObjectSlam()]
    joiners = [
        Joiner(slam, JoiningParams(session=i, sessions=2, wait_for_map=i == 1))
        for i, slam in enumerate(slams)
    ]
    walks = [
        World(world.things, world.path[start : start + N_FRAMES], seed=start).steps() for start in (0, 50)
    ]
    names: list[dict[int, set[int]]] = [{}, {}]
    counts = [0, 0]
    for steps in zip(*walks, strict=True):
        for i, step in enumerate(steps):
            frames = joiners[i].follow(slams[i].step(_with_surfaces(step.frame), step.odometry))
            keyframes = slams[i].moved_keyframes() if frames else ()
            for frame in frames:
                counts[i] += 1
                for admitted in sessions.admit(frame, keyframes, i):
                    mapper.step(*admitted)
            if frames:
                _note(names[i], step.names, frames[-1])
        mapper.merge_duplicates()
        if len(mapper.places()) > told:
            told = len(mapper.places())
            for joiner in joiners:
                joiner.offer(PriorMap.of(mapper.object_map))
    return world, mapper, names, counts, slams, steps


def _with_surfaces(frame):
    """The frame with points on its objects, as the mapper needs them."""
    observations = (replace(o, cloud=o.code.landmarks.astype(np.float32)) for o in frame.observations)
    return replace(frame, observations=tuple(observations))


def _note(names, seen, frame):
    for name, tracked in zip(seen, frame.observations, strict=True):
        if tracked.object_id != NO_ID:
            names.setdefault(name, set()).add(tracked.object_id)


def test_both_sessions_get_into_the_map_with_all_their_frames(shared):
    assert shared[3] == [N_FRAMES, N_FRAMES]


def lasting(mapper, ids):
    """The ids of the map behind those that a session has used."""
    return {mapper._library.resolve(object_id) for object_id in ids}


def test_every_object_is_mapped_once(shared):
    _, mapper, (first, second), *_ = shared
    assert len(first.keys() | second.keys()) >= 11
    assert len(mapper.places()) == len(first.keys() | second.keys())


def test_shared_objects_have_one_name(shared):
    _, mapper, (first, second), *_ = shared
    both = first.keys() & second.keys()
    assert len(both) >= 6
    assert all(len(lasting(mapper, first[name] | second[name])) == 1 for name in both)


def test_second_camera_stands_where_it_is_in_the_frame_of_the_first(shared):
    *_, slams, steps = shared
    T_a_map, T_b_map = (
        step.T_world_camera @ inverse(slam.trajectory()[-1][1])
        for slam, step in zip(slams, steps, strict=True)
    )
    assert np.linalg.norm((inverse(T_a_map) @ T_b_map)[:3, 3]) < 0.05

"""A session's place in a map, from made-up layouts: the right one, and none where there is a doubt."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from neuse.geometry import Array, exp, inverse, make_transform, rotation_angle
from neuse.slam.object_frames import reduce_codes
from neuse.slam.prior_map import PriorMap
from neuse.slam.relocalization import RelocalizationParams, find_place, same_arrangement
from neuse.slam.relocalizer import Relocalizer
from neuse.slam.track import LastSighting, Track

from .known_maps import ELSEWHERE, FIRST_ID, SIGMAS, map_of
from .synthetic import Thing, make_code, make_thing, small_world

PARAMS = RelocalizationParams()
T_SESSION_WORLD = make_transform(exp([0.3, -0.2, 1.0, 0.0, 0.0, 0.0])[:3, :3], [0.5, 2.0, -1.0])
T_MAP_SESSION = ELSEWHERE @ inverse(T_SESSION_WORLD)


def tracks_of(things: Sequence[Thing], noise_m: float = 0.0, seed: int = 0) -> list[Track]:
    """The things as a session has met them, in its own frame."""
    rng = np.random.default_rng(seed)
    return [track_of(key, thing, noise_m * rng.normal(size=3)) for key, thing in enumerate(things)]


def track_of(key: int, thing: Thing, error_m: Array, sigmas: Array = SIGMAS) -> Track:
    T = T_SESSION_WORLD @ thing.T_world_object
    T[:3, 3] += error_m
    code = make_code(thing, T, np.where(thing.ambiguous & (np.arange(6) == 2), np.pi, sigmas))
    frames = reduce_codes([code])
    return Track(
        set(), key, thing.category, thing.ambiguous, code.descriptor, frames.vectors[:, 0], np.zeros(2),
        np.zeros(2), LastSighting(frames, code.center, np.eye(4)), last_frame=0, n_sightings=9,
        confirmed=True, place_weights=1.0 / frames.variances[:, 0], half_height=code.half_height,
        height_weight=1e6,
    )  # fmt: skip


def prior_of(things: Sequence[Thing]) -> PriorMap:
    return PriorMap.of(map_of(things, ELSEWHERE))


def moved(thing: Thing, offset_m: Sequence[float]) -> Thing:
    return replace(thing, T_world_object=make_transform(np.eye(3), offset_m) @ thing.T_world_object)


def names(things: Sequence[Thing]) -> dict[int, int]:
    """What the matches of tracks of these things should be."""
    return {key: FIRST_ID + thing.name for key, thing in enumerate(things)}


def assert_right(place):
    off = inverse(T_MAP_SESSION) @ place.T_map_session
    eye = T_SESSION_WORLD[:3, 3]
    assert np.linalg.norm((off @ [*eye, 1.0])[:3] - eye) < 0.03
    assert rotation_angle(off[:3, :3]) < np.deg2rad(3.0)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("count", [3, 5, 12])
def test_place_is_found_wherever_three_different_objects_are_in_sight(seed, count):
    world = small_world(seed)
    seen = [world.things[i] for i in np.random.default_rng(seed).permutation(12)[:count]]
    place = find_place(tracks_of(seen, 0.003, seed), prior_of(world.things), PARAMS)
    assert place.matches == names(seen)
    assert place.false_alarms <= PARAMS.max_false_alarms
    assert_right(place)
    assert np.linalg.eigvalsh(place.covariance).min() > 0


@pytest.mark.parametrize("seed", range(6))
def test_third_of_the_objects_may_have_moved(seed):
    known, rng = small_world(seed).things, np.random.default_rng(seed)
    changed = set(rng.permutation(12)[:4].tolist())
    seen = [moved(thing, rng.uniform(0.2, 0.6, 3)) if thing.name in changed else thing for thing in known]
    place = find_place(tracks_of(seen, 0.003, seed), prior_of(known), PARAMS)
    assert_right(place)
    assert place.matches == {k: i for k, i in names(seen).items() if k not in changed}


@pytest.mark.parametrize("seed", range(6))
def test_other_world_of_like_objects_is_no_place(seed):
    here, there = small_world(seed, alike=0.9), small_world(seed + 50, alike=0.9)
    assert find_place(tracks_of(here.things), prior_of(there.things), PARAMS) is None


def square(side_m: float = 0.5) -> list[Thing]:
    """The same bottle at four corners."""
    bottle = make_thing(0, True, np.zeros(3), np.random.default_rng(3))
    corners = [(0.0, 0.0), (side_m, 0.0), (side_m, side_m), (0.0, side_m)]
    return [replace(moved(bottle, [*corner, 0.0]), name=name) for name, corner in enumerate(corners)]


def test_layout_that_looks_the_same_from_four_sides_is_no_place():
    things = square()
    assert find_place(tracks_of(things), prior_of(things), PARAMS) is None


def test_same_layout_is_a_place_once_other_objects_tell_its_sides():
    rng = np.random.default_rng(5)
    mugs = (4, np.array([0.7, 0.1, 0.0])), (5, np.array([0.2, 0.9, 0.0]))
    others = [make_thing(name, False, position, rng) for name, position in mugs]
    things = [*square(), *others]
    place = find_place(tracks_of(things), prior_of(things), PARAMS)
    assert place.matches == names(things)
    assert_right(place)


def test_two_objects_are_no_place():
    things = small_world(1).things
    assert find_place(tracks_of(things[:2]), prior_of(things), PARAMS) is None
    assert find_place(tracks_of(things[:5]), prior_of(things[:2]), PARAMS) is None


def test_as_many_objects_out_of_place_as_in_place_are_a_doubt():
    known = small_world(1).things
    offsets_m = np.random.default_rng(1).uniform(0.05, 0.15, (6, 3))
    moved_away = [moved(thing, offset_m) for thing, offset_m in zip(known[6:], offsets_m, strict=True)]
    tracks = tracks_of([*known[:6], *moved_away])
    assert find_place(tracks, prior_of(known), PARAMS) is None
    tracks[-1].confirmed = False  # it may be nothing
    assert_right(find_place(tracks, prior_of(known), PARAMS))


def test_objects_that_only_one_of_map_and_session_has_met_are_no_doubt():
    things = small_world(1).things
    for seen, known in [(things, things[:4]), (things[:4], things)]:
        place = find_place(tracks_of(seen, 0.001), prior_of(known), PARAMS)
        assert_right(place)
        assert place.matches == names(things[:4])


def test_layout_that_agrees_closely_is_hardly_chance():
    things = small_world(2).things[:4]

    def alarms(noise_m: float) -> float:
        return find_place(tracks_of(things, noise_m, seed=1), prior_of(things), PARAMS).false_alarms

    assert alarms(0.0) == alarms(0.0005) < alarms(0.004) < alarms(0.008)


def test_what_chance_may_do_grows_with_the_number_of_like_objects():
    def alarms(n_alike: int) -> float:
        things = small_world(2).things
        like = things[n_alike].descriptor
        things = [replace(t, descriptor=like) if t.name < n_alike else t for t in things]
        return find_place(tracks_of(things[-4:]), prior_of(things), PARAMS).false_alarms

    assert alarms(0) <= alarms(4) < alarms(8)


def test_place_that_chance_would_give_too_often_is_none():
    things = small_world(2).things
    place = find_place(tracks_of(things[:4]), prior_of(things), PARAMS)
    strict = replace(PARAMS, max_false_alarms=place.false_alarms / 2)
    assert find_place(tracks_of(things[:4]), prior_of(things), strict) is None


def arrangement_of(things: Sequence[Thing], T: Array, turn_rad: float, sigma_rad: float) -> np.ndarray:
    """Whether two mugs lie alike when the first has been turned about its axis in one of the two views."""
    sigmas = SIGMAS.copy()
    sigmas[2] = sigma_rad
    turn = exp([0.0, 0.0, turn_rad, 0.0, 0.0, 0.0])
    here = reduce_codes([make_code(thing, T @ thing.T_world_object, sigmas) for thing in things])
    first, second = (thing.T_world_object for thing in things)
    poses = zip(things, (first @ turn, second), strict=True)
    return same_arrangement(here, reduce_codes([make_code(*pose, sigmas) for pose in poses]), PARAMS)


@pytest.mark.parametrize(
    ("turn_rad", "sigma_rad", "alike"), [(0.0, 0.05, True), (1.5, 0.05, False), (1.5, 0.9, True)]
)
def test_bearing_from_a_handle_tells_layouts_apart_if_the_handle_is_known(turn_rad, sigma_rad, alike):
    rng = np.random.default_rng(0)
    mugs = [make_thing(i, False, np.array([0.5 * i, 0.1, 0.0]), rng) for i in range(2)]
    agree = arrangement_of(mugs, exp([0.4, 0.1, 2.0, 1.0, 2.0, 3.0]), turn_rad, sigma_rad)
    assert agree[0, 1] == agree[1, 0] == alike


def test_place_is_believed_when_it_is_found_often_enough_in_a_row():
    things, relocalizer = small_world(1).things, Relocalizer()
    prior, tracks = prior_of(things), tracks_of(things[:5])
    looks = [tracks, tracks, [], tracks, tracks, tracks]
    found = [relocalizer.look(look, prior, np.eye(4)) is not None for look in looks]
    assert found == [False, False, False, False, False, True]
    relocalizer.forget()
    assert relocalizer.look(tracks, prior, np.eye(4)) is None


def test_places_that_differ_do_not_confirm_each_other():
    things, relocalizer = small_world(1).things, Relocalizer(replace(PARAMS, confirmations=2))
    elsewhere = PriorMap.of(map_of(things, exp([0.0, 0.0, 0.0, 0.2, 0.0, 0.0]) @ ELSEWHERE))
    tracks = tracks_of(things[:5])
    for prior in (prior_of(things), elsewhere, prior_of(things)):
        assert relocalizer.look(tracks, prior, np.eye(4)) is None
    assert relocalizer.look(tracks, prior_of(things), np.eye(4)) is not None


def test_place_is_not_believed_where_the_camera_is_too_far_off_to_be_told():
    things, relocalizer = small_world(1).things, Relocalizer(replace(PARAMS, confirmations=1))
    prior, tracks = prior_of(things), tracks_of(things[:5])
    far_off = make_transform(np.eye(3), [0.0, 0.0, 30.0])
    assert relocalizer.look(tracks, prior, far_off) is None
    assert relocalizer.look(tracks, prior, far_off) is None
    assert relocalizer.look(tracks, prior, np.eye(4)) is not None

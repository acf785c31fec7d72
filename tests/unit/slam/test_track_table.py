"""The table answers for all tracks at once what each would say itself, whatever has changed since."""

import numpy as np
import pytest

from neuse.slam.library import ObjectLibrary, similarity
from neuse.slam.track import places_of

from .synthetic import drift_between, make_thing
from .test_association import scene_of, view_of


@pytest.fixture
def library() -> ObjectLibrary:
    rng = np.random.default_rng(0)
    spots = rng.uniform([-2, -2, 0.5], [2, 2, 3], (40, 3))
    scene = scene_of([make_thing(i, i % 2 == 1, spot, rng, alike=0.7) for i, spot in enumerate(spots)])
    for track, (mapped, seen) in zip(scene.tracks, np.sort(rng.random((40, 2)), axis=1), strict=True):
        track.mapped_at, track.seen_at = np.full(2, mapped), np.full(2, seen)
        track.last_frame = int(100 * seen)
    return scene.library


def keys(tracks) -> list[int]:
    return [track.key for track in tracks]


def near(library, point, radius_m) -> list[int]:
    return keys(library.table.at(library.table.near(point, radius_m)))


def expected_near(library, point, radius_m) -> list[int]:
    tracks = library.active()
    offsets_m = np.linalg.norm(places_of(tracks)[0] - point, axis=1)
    return [track.key for track, offset_m in zip(tracks, offsets_m, strict=True) if offset_m <= radius_m]


def test_near_tracks_are_the_active_ones_within_the_radius(library):
    point = np.array([0.3, 0.1, 1.5])
    library.tracks[near(library, point, 1.5)[0]].retired = True
    assert near(library, point, 1.5) == expected_near(library, point, 1.5)
    assert 0 < len(near(library, point, 1.5)) < 39


def test_rows_follow_what_is_set_dropped_and_added(library):
    point, track = np.array([9.0, 9.0, 9.0]), library.tracks[30]
    track.place = np.stack([point, track.place[1], track.place[2]])
    library.drop([library.tracks[3], library.tracks[7]])
    assert near(library, point, 0.1) == [30]
    code = view_of([make_thing(99, False, point, np.random.default_rng(1))]).codes[0]
    library.add(code, track.place, track.last, np.zeros(2), 0)
    assert near(library, point, 0.1) == [30, 40]
    assert near(library, np.zeros(3), 99.0) == keys(library.tracks.values())


def test_drifts_are_those_between_the_active_tracks(library):
    library.tracks[5].retired = True
    active, now = library.active(), np.array([1.2, 1.3])
    some = active[::3]
    np.testing.assert_allclose(library.table.drifts(some, now), drift_between(active, now)[::3])
    active[0].seen_at = now
    np.testing.assert_allclose(library.table.drifts(some, now), drift_between(active, now)[::3])


def test_drifts_by_way_of_some_are_those_between_these(library):
    over, now = np.arange(40) % 3 == 0, np.array([1.2, 1.3])
    among = library.table.all_drifts(now, over)[over]
    np.testing.assert_allclose(among, drift_between(library.table.at(over), now))


@pytest.mark.parametrize("delta_shape", [-1.0, 0.5, 0.9, 0.99])
def test_no_alike_track_is_missed(library, delta_shape):
    codes = view_of(
        [make_thing(i, True, np.ones(3), np.random.default_rng(i), alike=0.7) for i in (1, 77)]
    ).codes
    shapes = similarity(codes, list(library.tracks.values()))
    alike = (shapes >= delta_shape).any(axis=0)
    assert (library.table.may_be_alike([code.descriptor for code in codes], delta_shape) | ~alike).all()


def test_unlike_tracks_are_left_out_early(library):
    codes = view_of([make_thing(77, True, np.ones(3), np.random.default_rng(5))]).codes
    assert not library.table.may_be_alike([code.descriptor for code in codes], 0.95).any()


def test_most_alike_objects_are_as_many_as_asked_for(library):
    track = library.tracks[1]
    codes = view_of([make_thing(5, True, np.ones(3), np.random.default_rng(5), alike=0.7)]).codes
    shapes = similarity(codes, list(library.tracks.values()))[0]
    best = sorted(np.argsort(-shapes)[:4].tolist())
    assert keys(library.table.at(library.most_alike(codes, library.alike(codes, -0.5), -0.5, 4))) == best
    track.confirmed = False
    assert not library.most_alike(codes, library.alike(codes, -0.5), -0.5, 40)[1]


def test_tracks_around_are_those_in_reach(library):
    points = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 1.0]])
    around = library.table.at(library.around(points, 0.5))
    for track in library.active():
        reachable = np.linalg.norm(track.place[0] - points.mean(axis=0)) <= 0.75
        assert (track in around) == reachable

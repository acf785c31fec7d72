"""Tracks, their similarity and the drift clock."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.slam.drift import Ways
from neuse.slam.library import ObjectLibrary, alike_in_place, rather_rivals, similarity, unlikeness
from neuse.slam.object_frames import frames_at
from neuse.slam.track import orthonormal_places, places_of, shape_noise

from .synthetic import drift_between, make_thing
from .test_association import scene_of, view_of


@pytest.fixture
def scene():
    rng = np.random.default_rng(0)
    return scene_of([make_thing(i, i % 2 == 1, np.array([0.2 * i, 0.0, 1.0]), rng) for i in range(3)])


def see_again(track, scene, place=None):
    view = view_of([scene.things[track.key]])
    track.see(view.codes[0], track.place if place is None else place, track.last, np.ones(2), frame_index=7)


def test_similarity_is_the_cosine_within_a_category_and_minus_one_across(scene):
    codes = view_of(scene.things).codes
    S = similarity(codes, scene.tracks)
    assert S[0, 1] == -1.0
    assert S[0, 0] == pytest.approx(1.0)
    assert S[0, 2] == pytest.approx(scene.things[0].descriptor @ scene.things[2].descriptor)
    assert similarity(codes, []).shape == (3, 0)


def test_descriptors_of_another_network_are_not_alike(scene):
    codes = view_of(scene.things).codes[:2]
    shorter = [replace(code, z=code.z[:8], descriptor=code.descriptor[:8]) for code in codes]
    np.testing.assert_array_equal(similarity(codes, shorter), -1.0)
    np.testing.assert_array_equal(similarity(codes, [*shorter, *codes])[:, 2:], similarity(codes, codes))


def test_ids_are_never_reused():
    scene = scene_of([make_thing(0, False, np.array([0, 0, 1.0]), np.random.default_rng(0))])
    library, old = scene.library, scene.tracks[0]
    library.drop([old])
    new = library.add(view_of(scene.things).codes[0], old.place, old.last, np.zeros(2), 1)
    library.confirm(new)
    assert (new.key, new.object_id) == (1, 1)


def test_tentative_tracks_have_no_object_and_confirmed_ones_do(scene):
    library = ObjectLibrary()
    track = library.add(
        view_of(scene.things).codes[0], scene.tracks[0].place, scene.tracks[0].last, np.zeros(2), 0
    )
    assert not track.confirmed
    library.confirm(track)
    assert track.confirmed
    assert library.named(track.object_id) == [track]


def test_confirmed_track_keeps_the_name_that_it_had(scene):
    library = ObjectLibrary()
    code, last = view_of(scene.things).codes[0], scene.tracks[0].last
    first, second = (library.add(code, scene.tracks[0].place, last, np.zeros(2), 0) for _ in range(2))
    library.name(second)
    library.name(first)
    library.confirm(second)
    assert (first.object_id, second.object_id) == (1, 0)
    assert (first.confirmed, second.confirmed) == (False, True)


def test_retired_tracks_are_known_but_not_active(scene):
    scene.tracks[1].retired = True
    assert [track.key for track in scene.library.active()] == [0, 2]
    assert len(scene.library.named(1)) == 1


def test_place_is_averaged_until_the_graph_knows_better(scene):
    track = scene.tracks[0]
    further = track.place + np.array([[0.1, 0, 0], [0, 0, 0], [0, 0, 0]])
    see_again(track, scene, further)
    assert track.place[0, 0] == pytest.approx(0.05, abs=0.002)
    track.anchored = True
    see_again(track, scene, further)
    assert track.place[0, 0] == pytest.approx(0.05, abs=0.002)
    assert track.last_frame == 7


def test_poor_sighting_hardly_moves_a_well_known_place(scene):
    track = scene.tracks[0]
    before = track.half_height
    poor = replace(
        track.last,
        frames=frames_at(track.last.frames.vectors, np.full(6, 0.3), np.array([False]), np.array([0.3])),
    )
    code = view_of(scene.things).codes[0]
    track.see(code, track.place + np.array([[0.1, 0, 0], [0, 0, 0], [0, 0, 0]]), poor, np.ones(2), 1)
    assert 0.0 < track.place[0, 0] < 0.001
    assert track.half_height == pytest.approx(before, abs=0.001)


@pytest.mark.parametrize(("sigma_m", "noise"), [(1e-6, 0.004), (0.006, 0.044), (0.1, 0.05)])
def test_descriptors_of_ill_known_objects_are_noisy(scene, sigma_m, noise):
    code = replace(view_of(scene.things).codes[0], sigmas=np.full(6, sigma_m))
    assert shape_noise(code) == pytest.approx(noise)


def test_unlikeness_counts_the_noise_of_both_and_tells_categories_apart(scene):
    codes = view_of(scene.things).codes
    S, U = similarity(codes, scene.tracks), unlikeness(codes, scene.tracks)
    expected = (1.0 - S[0, 0]) / (shape_noise(codes[0]) + scene.tracks[0].shape_noise)
    assert U[0, 0] == pytest.approx(expected)
    assert np.isinf(U[S == -1.0]).all()


def test_what_was_seen_a_moment_ago_may_look_more_unlike(scene):
    codes = view_of(scene.things).codes[:1]
    limit = unlikeness(codes, scene.tracks)[0, 2]
    for last_sure, alike in ((100, True), (60, False)):
        scene.tracks[2].last_sure = last_sure
        assert alike_in_place(codes, [None], scene.tracks, limit / 2, frame_index=101)[0, 2] == alike


def test_poor_view_that_looks_far_more_like_its_rival_is_not_what_stood_there_long_ago(scene):
    own, rival = scene.tracks[0], scene.tracks[2]
    own.object_id, rival.object_id = 4, 7
    code = view_of(scene.things).codes[0]
    seen = replace(code, descriptor=rival.descriptor, sigmas=np.full(6, 0.05))

    def is_alike(rivals):
        return alike_in_place([seen], rivals, [own], max_unlikeness=100.0, frame_index=100)[0, 0]

    assert 1.0 - own.descriptor @ rival.descriptor > 0.1
    assert is_alike([None])
    assert not is_alike([rival])
    own.last_sure = 90
    assert is_alike([rival])
    own.last_sure, rival.object_id = 0, 4
    assert is_alike([rival])


def test_view_that_looks_like_both_is_no_rival(scene):
    own, rival = scene.tracks[0], scene.tracks[2]
    own.object_id, rival.object_id = 4, 7
    between = own.descriptor + rival.descriptor
    seen = replace(view_of(scene.things).codes[0], descriptor=between / np.linalg.norm(between))
    assert not rather_rivals([seen], [rival], [own])[0, 0]


def test_rivals_are_the_most_alike_of_the_map_that_were_not_seen_a_moment_ago(scene):
    codes, library, known = view_of(scene.things).codes, ObjectLibrary(), scene.tracks[0]
    tracks = [library.add(code, known.place, known.last, np.zeros(2), 0) for code in codes]

    def rivals():
        return library.rivals(codes, library.alike(codes, 0.95), 0.95, 100)

    assert rivals() == (None,) * len(codes)
    for track in tracks:
        library.confirm(track)
    assert rivals() == tuple(tracks)
    tracks[1].last_sure = 90
    assert rivals()[1] is not tracks[1]
    tracks[2].retired = True
    assert rivals()[2] is tracks[2]


def test_descriptor_of_a_poor_first_view_stays_of_unit_length_and_learns(scene):
    poor = replace(view_of(scene.things).codes[0], sigmas=np.full(6, 0.05))
    known = scene.tracks[0]
    track = ObjectLibrary().add(poor, known.place, known.last, np.zeros(2), 0)
    clear = view_of([make_thing(9, False, np.zeros(3), np.random.default_rng(5))]).codes[0]
    likeness = []
    for frame_index in range(1, 50):
        track.see(clear, track.place, track.last, np.ones(2), frame_index)
        likeness.append(track.descriptor @ clear.descriptor)
    assert np.linalg.norm(track.descriptor) == pytest.approx(1.0)
    assert (np.diff(likeness) > 0.0).all()
    assert likeness[-1] > 0.95


def test_poor_views_of_another_object_hardly_change_what_a_track_looks_like(scene):
    track, codes = scene.tracks[0], view_of(scene.things).codes
    own = replace(codes[0], sigmas=np.full(6, 0.001))
    other = replace(own, descriptor=codes[2].descriptor)
    poor = replace(other, sigmas=np.full(6, 0.05))
    for frame_index in range(20):
        track.see(own, track.place, track.last, np.zeros(2), frame_index)
    for frame_index in range(20, 60):
        track.see(poor, track.place, track.last, np.zeros(2), frame_index)
    assert track.descriptor @ own.descriptor > 0.95
    assert track.last_sure == 19


def test_object_never_seen_clearly_is_sure_only_while_it_looks_alike(scene):
    codes = [replace(code, sigmas=np.full(6, 0.05)) for code in view_of(scene.things).codes]
    library, known = ObjectLibrary(), scene.tracks[0]
    track = library.add(codes[0], known.place, known.last, np.zeros(2), 3)
    for frame_index in range(4, 30):
        track.see(codes[0], known.place, known.last, np.zeros(2), frame_index)
    track.see(codes[2], known.place, known.last, np.zeros(2), 30)
    assert (track.last_sure, track.seen_clearly) == (29, False)


def test_periods_of_sight_end_after_a_gap(scene):
    track = scene.tracks[0]
    for keyframe in (3, 4, 10, 14, 25):
        track.enter_keyframe(keyframe, gap=10, spacing=5)
    assert track.periods == [[3, 10], [25]]


def test_keyframes_that_left_the_graph_end_no_period_and_count_in_none(scene):
    track = scene.tracks[0]
    for keyframe in (3, 5, 10, 25, 26):
        track.enter_keyframe(keyframe, gap=10, spacing=5)
    for keyframe in (3, 25, 26):
        track.leave_keyframe(keyframe)
    assert track.periods == [[5, 10], []]
    assert track.last_noted == 25
    track.enter_keyframe(40, gap=10, spacing=5)
    assert track.periods == [[5, 10], [40]]


def drifts(mapped_at, seen_at, now):
    """By ways of which any may be used; one reading for rotation and translation."""
    mapped, seen = (np.repeat(np.array(readings)[:, None], 2, axis=1) for readings in (mapped_at, seen_at))
    return Ways(mapped, seen, np.ones(len(mapped), dtype=bool)).drifts(mapped, np.full(2, now))


def test_drift_counts_from_the_last_sight():
    np.testing.assert_allclose(drifts([0.0, 0.0, 0.0], [0.1, 0.1, 0.1], 0.4), np.full((3, 2), 0.3))


def test_object_mapped_with_one_just_seen_is_known_as_well():
    """Seeing table one again tells where table two is, since both were mapped at nearly the same drift."""
    drift = drifts(mapped_at=[0.0, 0.1, 5.0], seen_at=[9.0, 0.1, 5.0], now=9.2)
    np.testing.assert_allclose(drift[:, 1], [0.2, 0.3, 4.2])


def test_way_with_the_least_drift_is_found_among_many(scene):
    rng = np.random.default_rng(4)
    clock = np.sort(rng.random((60, 2)), axis=0)
    mapped, seen = clock[rng.integers(0, 40, 40)], clock[rng.integers(40, 60, 40)]
    tracks = [replace(scene.tracks[0], mapped_at=m, seen_at=s) for m, s in zip(mapped, seen, strict=True)]
    ways = Ways(mapped, seen, np.ones(40, dtype=bool))
    np.testing.assert_allclose(ways.drifts(mapped, clock[-1]), drift_between(tracks, clock[-1]))


def test_there_is_no_way_over_no_track():
    none = np.zeros((0, 2))
    assert np.isinf(Ways(none, none, np.zeros(0, dtype=bool)).drifts(np.zeros((3, 2)), np.zeros(2))).all()
    assert Ways(none, none, np.zeros(0, dtype=bool)).drifts(none, np.zeros(2)).shape == (0, 2)


def test_no_tracks_have_no_places():
    assert places_of([]).shape == (3, 0, 3)


def test_places_stack_centres_axes_and_handles(scene):
    np.testing.assert_array_equal(places_of(scene.tracks)[0, 1], scene.tracks[1].place[0])


@pytest.mark.parametrize("handle", [[0.3, 0.1, 0.9], [0.0, 0.0, 2.0], [0.0, 0.0, 0.0]])
def test_place_is_made_orthonormal(handle):
    _, axis, right = orthonormal_places(np.array([[[1.0, 2, 3], [0, 0, 5], handle]]))[0]
    np.testing.assert_allclose([axis @ axis, right @ right, axis @ right], [1, 1, 0], atol=1e-12)


def test_tracks_of_the_graph_come_by_turns_and_some_always(scene):
    for track in scene.tracks:
        track.in_graph = True
    chosen = [[track.key for track in scene.library.by_turns([2, 99], 1)] for _ in range(4)]
    assert chosen == [[0, 2], [1, 2], [2], [0, 2]]
    scene.tracks[2].retired = True
    assert [track.key for track in scene.library.by_turns([2], 10)] == [0, 1]


def test_only_clear_views_of_the_same_shape_make_sure_that_an_object_is_still_the_same(scene):
    track, codes = scene.tracks[0], view_of(scene.things).codes
    own = replace(codes[0], sigmas=np.full(6, 0.001))
    other = replace(own, descriptor=codes[2].descriptor)
    poor = replace(own, sigmas=np.full(6, 0.05))
    for frame_index, code, last_sure in ((5, own, 5), (6, poor, 5), (7, other, 5), (8, own, 8)):
        track.see(code, track.place, track.last, np.zeros(2), frame_index)
        assert track.last_sure == last_sure
        track.descriptor = own.descriptor


def test_object_never_seen_clearly_may_look_unlike_as_long_as_it_is_seen(scene):
    poor = replace(view_of(scene.things).codes[0], sigmas=np.full(6, 0.05))
    library = ObjectLibrary()
    known = scene.tracks[0]
    track = library.add(poor, known.place, known.last, np.zeros(2), 3)
    track.see(poor, known.place, known.last, np.zeros(2), 9)
    assert (track.last_sure, track.seen_clearly) == (9, False)

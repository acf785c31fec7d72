"""Joint association: place tells twins apart, layout relocalises, contradictions lose."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from neuse.errors import ParamError
from neuse.geometry import Array, exp, inverse, log, transform_points
from neuse.slam.association import AssociationParams, associate
from neuse.slam.layout import View
from neuse.slam.library import ObjectLibrary
from neuse.slam.localization import Belief, to_map
from neuse.slam.object_frames import reduce_codes
from neuse.slam.track import LastSighting, Track

from .synthetic import Thing, drift_between, make_code, make_thing

SIGMAS = np.array([0.03, 0.03, 0.1, 0.003, 0.003, 0.003])
EXACT = Belief(np.eye(4), 1e-6 * np.eye(6))
SPOTS = np.array([[-0.3, 0.1, 1.2], [0.25, -0.05, 1.3], [0.0, 0.2, 1.7], [0.3, 0.25, 1.5], [-0.1, -0.2, 1.4]])


@dataclass
class Scene:
    """Objects known at their places in the map (which is the first camera's frame)."""

    things: list[Thing]
    library: ObjectLibrary

    @property
    def tracks(self) -> list[Track]:
        return self.library.active()

    def names(self, matched) -> list[int | None]:
        """Which thing each matched track is; the library was filled in their order."""
        return [None if track is None else track.key for track in matched]


def view_of(things, T_map_camera: Array | None = None) -> View:
    T_camera_map = np.eye(4) if T_map_camera is None else inverse(T_map_camera)
    codes = tuple(make_code(thing, T_camera_map @ thing.T_world_object, SIGMAS) for thing in things)
    centers = np.array([code.center for code in codes]).reshape(-1, 3)
    return View(codes, reduce_codes(codes), centers, (), (None,) * len(codes))


def scene_of(things) -> Scene:
    view, library = view_of(things), ObjectLibrary()
    placed = to_map(np.eye(4), view.frames.vectors)
    for i, code in enumerate(view.codes):
        last = LastSighting(view.frames[[i]], view.partial_centers[i], np.eye(4))
        library.confirm(library.add(code, placed[:, i], last, np.zeros(2), 0))
    return Scene(things, library)


@pytest.fixture
def scene() -> Scene:
    rng = np.random.default_rng(0)
    return scene_of([make_thing(i, i % 2 == 1, spot, rng) for i, spot in enumerate(SPOTS)])


def associated(scene, view, prediction=EXACT, drift_m=0.01, params=None):
    drift = drift_between(scene.tracks, np.array([1e-5, drift_m**2]))
    return associate(view, scene.tracks, drift, prediction, params or AssociationParams(), 0)


def moved(thing, shift) -> Thing:
    return replace(thing, T_world_object=exp([0, 0, 0, *shift]) @ thing.T_world_object)


def test_everything_in_its_place_matches(scene):
    found = associated(scene, view_of(scene.things[::-1]))
    assert scene.names(found.tracks) == [4, 3, 2, 1, 0]
    assert found.T_map_camera is None


def test_twins_are_told_apart_by_place(scene):
    things = scene.things
    twins = [replace(thing, descriptor=things[0].descriptor, ambiguous=False) for thing in things]
    scene = scene_of(twins)
    shifted = Belief(exp([0, 0, 0, 0.05, -0.04, 0.03]), EXACT.covariance)
    found = associated(scene, view_of(twins[::-1]), shifted, drift_m=0.05)
    assert scene.names(found.tracks) == [4, 3, 2, 1, 0]


def test_object_that_moved_beyond_the_gate_stays_free(scene):
    things = [moved(scene.things[0], [0.12, 0, 0]), *scene.things[1:]]
    assert scene.names(associated(scene, view_of(things)).tracks) == [None, 1, 2, 3, 4]


def test_object_that_moved_within_a_wide_gate_is_outvoted(scene):
    things = [moved(scene.things[0], [0.12, 0, 0]), *scene.things[1:]]
    assert scene.names(associated(scene, view_of(things), drift_m=0.1).tracks) == [None, 1, 2, 3, 4]


def test_unlike_object_in_the_place_of_another_stays_free(scene):
    stranger = replace(scene.things[0], descriptor=-scene.things[0].descriptor)
    assert scene.names(associated(scene, view_of([stranger, *scene.things[1:]])).tracks)[0] is None


def test_other_category_never_matches(scene):
    bottle = replace(scene.things[0], ambiguous=True)
    assert associated(scene, view_of([bottle])).tracks == (None,)


def test_lone_object_in_a_narrow_gate_matches(scene):
    assert scene.names(associated(scene, view_of(scene.things[2:3])).tracks) == [2]


def test_lone_object_in_a_wide_gate_stays_free(scene):
    assert associated(scene, view_of(scene.things[2:3]), drift_m=0.15).tracks == (None,)


def test_lone_object_with_two_possible_places_stays_free(scene):
    twin = moved(scene.things[0], [0.06, 0, 0])
    scene = scene_of([scene.things[0], twin])
    view = view_of([moved(scene.things[0], [0.03, 0, 0])])
    assert associated(scene, view, drift_m=0.03).tracks == (None,)


def test_pair_matches_in_a_gate_too_wide_for_one(scene):
    found = associated(scene, view_of(scene.things[1:3]), drift_m=0.15)
    assert scene.names(found.tracks) == [1, 2]


def test_three_that_agree_match_beyond_the_gate_of_a_lone_object(scene):
    T_map_camera = exp([0, 0, 0, 0.22, 0, 0])  # five sigmas from the prediction
    view = view_of(scene.things, T_map_camera)
    assert scene.names(associated(scene, view, drift_m=0.04).tracks) == [0, 1, 2, 3, 4]
    assert associated(scene, view_of(scene.things[:1], T_map_camera), drift_m=0.04).tracks == (None,)


def test_two_far_from_their_places_do_not_outvote_one_that_is_near(scene):
    seen, copies = scene.things[:2], [moved(thing, [0.2, 0, 0]) for thing in scene.things[:2]]
    known = scene_of([*copies, seen[1]])
    assert known.names(associated(known, view_of(seen), drift_m=0.04).tracks) == [None, 2]


def test_layout_alone_relocalises_a_lost_camera(scene):
    T_map_camera = exp([0.1, 0.1, 0.2, 0.8, -0.5, 0.3])
    found = associated(scene, view_of(scene.things, T_map_camera), drift_m=0.01)
    assert scene.names(found.tracks) == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(log(inverse(found.T_map_camera) @ T_map_camera), 0.0, atol=1e-6)


def test_lost_camera_that_sees_two_objects_stays_lost(scene):
    view = view_of(scene.things[:2], exp([0.1, 0.1, 0.2, 0.8, -0.5, 0.3]))
    assert associated(scene, view).tracks == (None, None)


def test_correction_that_drift_cannot_explain_is_refused(scene):
    view = view_of(scene.things[:4], exp([0, 0, 0, 8.0, 0, 0]))
    assert set(associated(scene, view).tracks) == {None}
    assert set(associated(scene, view, drift_m=4.0).tracks) != {None}


def test_correction_that_five_objects_agree_on_needs_no_explanation(scene):
    found = associated(scene, view_of(scene.things, exp([0, 0, 0, 8.0, 0, 0])))
    assert scene.names(found.tracks) == [0, 1, 2, 3, 4]


def test_known_layout_is_found_although_its_objects_pass_as_new_ones(scene):
    """Drift had them followed as tentative objects since they came into view, too far to be matched."""
    T_map_camera = exp([0, 0, 0, 0.6, 0, 0])
    view = view_of(scene.things, T_map_camera)
    for i, code in enumerate(view.codes):
        last = LastSighting(view.frames[[i]], view.partial_centers[i], np.eye(4))
        scene.library.add(code, view.frames.vectors[:, i], last, np.zeros(2), 0)
    found = associated(scene, view, drift_m=0.01)
    assert scene.names(found.tracks) == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(log(inverse(found.T_map_camera) @ T_map_camera), 0.0, atol=1e-6)


def test_two_tables_with_one_layout_do_not_relocalise(scene):
    copies = [
        replace(thing, name=thing.name + 10, T_world_object=exp([0, 0, 0, 5.0, 0, 0]) @ thing.T_world_object)
        for thing in scene.things
    ]
    scene = scene_of([*scene.things, *copies])
    view = view_of(scene.things[:5], exp([0, 0, 0, 2.5, 0, 0]))
    assert set(associated(scene, view, drift_m=1.0).tracks) == {None}


def test_tentative_objects_do_not_relocalise(scene):
    for track in scene.tracks:
        track.confirmed = False
    view = view_of(scene.things, exp([0.1, 0.1, 0.2, 0.8, -0.5, 0.3]))
    assert set(associated(scene, view).tracks) == {None}


def test_empty_view_and_empty_library_give_nothing(scene):
    assert associated(scene, view_of([])).tracks == ()
    assert associated(scene_of([]), view_of(scene.things)).tracks == (None,) * 5


def test_unknown_method_is_refused():
    with pytest.raises(ParamError, match="method"):
        AssociationParams(method="guess")


def test_places_are_compared_in_the_predicted_camera_frame(scene):
    T_map_camera = exp([0.3, -0.2, 0.1, 0.4, 0.2, -0.3])
    view = view_of(scene.things, T_map_camera)
    found = associated(scene, view, Belief(T_map_camera, EXACT.covariance))
    assert scene.names(found.tracks) == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(transform_points(T_map_camera, view.frames.centers[0]), SPOTS[0], atol=1e-9)


def test_part_of_the_map_that_has_drifted_is_matched_apart(scene):
    """Two objects are seen 9 cm from their places relative to the three others."""
    seen = [*scene.things[:3], *(moved(thing, [0.09, 0, 0]) for thing in scene.things[3:])]
    found = associated(scene, view_of(seen), drift_m=0.03)
    assert scene.names(found.tracks) == [0, 1, 2, None, None]
    assert scene.names(found.apart) == [None, None, None, 3, 4]


def test_lone_object_off_its_place_is_not_matched_apart(scene):
    seen = [*scene.things[:4], moved(scene.things[4], [0.09, 0, 0])]
    assert set(associated(scene, view_of(seen), drift_m=0.03).apart) == {None}

"""Presence of known objects, judged by the whole mapper; then the counts alone."""

import numpy as np
import pytest

from neuse.geometry import make_transform
from neuse.mapping.change_detection import ChangeParams
from neuse.mapping.free_space import FreeSpaceParams, Sight
from neuse.mapping.keyframe_memory import KeyframeMemory
from neuse.mapping.mapper import MapperParams, ObjectMapper
from neuse.mapping.object_library import ObjectLibrary
from neuse.mapping.object_record import ObjectRecord
from neuse.mapping.presence import Presence
from neuse.mapping.views import View
from neuse.records import ChangeKind, ObjectStatus, TrackedFrame

from .synthetic import (
    CAMERA,
    COARSE,
    RECONSTRUCT,
    assert_map_is_true,
    five_things,
    lying,
    make_code,
    make_world,
    orbit,
    revisit,
    standing,
)

ADDED, REMOVED, MOVED = ChangeKind.ADDED, ChangeKind.REMOVED, ChangeKind.MOVED


@pytest.mark.parametrize("seed", range(3))
def test_missed_masks_change_nothing(seed):
    missing = np.random.default_rng(seed).random((100, 128)) < 0.4
    world = make_world(seed=seed, is_missed=lambda frame, name: missing[frame, ord(name[0])])
    assert revisit(world) == []
    assert_map_is_true(world)


def test_object_that_is_never_detected_again_is_not_removed():
    world = make_world(is_missed=lambda frame, name: name == "a" and frame >= 16)
    assert revisit(world) == []
    assert_map_is_true(world)


def test_object_that_an_addition_hides_is_not_removed():
    world = make_world()
    world.tour(orbit(count=16))
    world.add(standing("tall", -0.1, -0.42, 0.11, 0.3))
    world.tour(orbit(count=16, start_rad=-2.2, turn_rad=1.2))
    assert [(c.kind, c.object_id) for c in world.finish()] == [(ADDED, world.ids["tall"])]


def test_removal_is_found_in_spite_of_drift():
    off = np.array([0.0, 0.0, 0.03, 0.08, 0.03, 0.06])
    world = make_world(drift=lambda frame: off if frame >= 16 else np.zeros(6))
    assert revisit(world, lambda w: w.remove("a")) == [(REMOVED, "a")]


def test_lying_object_that_is_taken_away_is_removed():
    things = [lying(thing) if thing.name == "a" else thing for thing in five_things()]
    assert revisit(make_world(things), lambda w: w.remove("a")) == [(REMOVED, "a")]


def test_removed_object_that_the_tracker_matches_again_is_added():
    world = make_world(mapper=ObjectMapper(RECONSTRUCT, MapperParams(changes=ChangeParams(hold_s=0.0))))
    world.tour(orbit(count=16))
    a, known = world.thing("a"), (world.ids["a"], world._places["a"])
    world.remove("a")
    world.tour(orbit(count=16))
    world.add(a)
    world.ids["a"], world._places["a"] = known
    world.tour(orbit(count=16))
    assert [(c.kind, c.object_id) for c in world.finish()] == [(REMOVED, known[0]), (ADDED, known[0])]
    assert_map_is_true(world)


PARTLY = 0.3


class Eyes:
    """Evidence that is told what it sees: free share, or None."""

    def __init__(self):
        self.free = 1.0

    def sight(self, points, keyframe, known_by, excluded_id, carried):
        return None if self.free is None else Sight(self.free, self.taken, 0.0, FreeSpaceParams())

    @property
    def taken(self):
        """Of a place partly free the rest is hidden."""
        return 0.0 if self.free == PARTLY else 1.0 - self.free


@pytest.fixture
def watched():
    """Presence of one object, id 5, two metres before the camera; keyframe, memory, library, evidence."""
    memory, library, eyes = KeyframeMemory(10), ObjectLibrary(), Eyes()
    frame = TrackedFrame(0, np.eye(4), np.eye(6), (), CAMERA, np.ones(COARSE, np.float32), 0)
    memory.update(frame, (), 1)
    thing = standing("thing", 0.0, 0.0)
    record = ObjectRecord(5, "bottle", dict(memory.poses), 0, 0, 0, 0)
    T_map_object = make_transform(np.eye(3), [0.0, 0.0, 2.0])
    record.add_view(0, View(make_code(thing, T_map_object, np.random.default_rng(0)), np.zeros((1, 3))), 10)
    library.records[5] = record
    return Presence(eyes, enough=3), memory, library, eyes


def watch(watched, free, count=1, seen_ids=()):
    presence, memory, library, eyes = watched
    eyes.free = free
    for _ in range(count):
        presence.update(memory.seen[0], memory, library, set(seen_ids))
    return presence.is_gone(5)


def test_object_is_gone_after_enough_empty_sights(watched):
    assert not watch(watched, 1.0, count=2)
    assert watch(watched, 1.0)


def test_match_clears_what_spoke_against_an_object(watched):
    assert watch(watched, 1.0, count=9)
    assert not watch(watched, 1.0, seen_ids=[5])
    assert not watch(watched, 1.0, count=2)


def test_taken_place_takes_back_one_empty_sight(watched):
    watch(watched, 1.0, count=2)
    watch(watched, 0.0)
    assert not watch(watched, 1.0)
    assert watch(watched, 1.0)


@pytest.mark.parametrize("free", [None, 0.4])
def test_unclear_sights_say_nothing(watched, free):
    watch(watched, 1.0, count=2)
    assert not watch(watched, free, count=20)
    assert watch(watched, 1.0)


def test_place_partly_seen_through_counts_half(watched):
    assert not watch(watched, PARTLY, count=5)
    assert watch(watched, PARTLY)


def test_displaced_object_is_gone_until_it_is_matched(watched):
    watched[0].displace(5, 6)
    assert watch(watched, 0.0, count=20)
    assert not watch(watched, 0.0, seen_ids=[5])


def test_what_is_only_displaced_is_disputed_while_the_other_waits(watched):
    presence = watched[0]
    presence.displace(5, 6)
    assert presence.disputed({6, 7}) == {5}
    assert presence.disputed({7}) == set()
    watch(watched, 1.0, count=3)
    assert presence.disputed({6}) == set()


def test_claim_on_a_place_ends_with_a_sight_of_its_owner(watched):
    presence = watched[0]
    presence.displace(5, 6)
    watch(watched, 0.0, seen_ids=[5])
    assert presence.disputed({6}) == set()


def test_place_out_of_view_is_not_judged(watched):
    watched[1].poses[0] = make_transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 0.0])
    assert not watch(watched, 1.0, count=20)


def test_removed_object_has_returned_after_as_many_matches(watched):
    presence, _, library, _ = watched
    library.records[5].status = ObjectStatus.REMOVED
    watch(watched, 1.0, count=2, seen_ids=[5])
    assert not presence.has_returned(5)
    watch(watched, 1.0, seen_ids=[5])
    assert presence.has_returned(5)
    presence.forget(5)
    assert not presence.has_returned(5)

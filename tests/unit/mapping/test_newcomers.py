"""Newcomers, judged by the whole mapper: duplicates, discoveries and changes."""

from dataclasses import dataclass, fields

import numpy as np
import pytest

from neuse.geometry import Array
from neuse.mapping.change_detection import ChangeDetector, Decision
from neuse.mapping.judge import Judge, Origin, Verdict
from neuse.records import ChangeKind

from .synthetic import (
    Edit,
    Thing,
    World,
    assert_map_is_true,
    five_things,
    make_world,
    orbit,
    revisit,
    standing,
    swap,
)

ADDED, REMOVED, MOVED = ChangeKind.ADDED, ChangeKind.REMOVED, ChangeKind.MOVED


@dataclass(frozen=True)
class Lookalike(Thing):
    """A thing whose descriptor is somewhat like that of the seed `like`, as in poor views of one thing.

    share: how much of it is that descriptor.
    """

    like: int = 0
    share: float = 0.55

    @property
    def descriptor(self) -> Array:
        """(k,) unit."""
        own, other = super().descriptor, np.random.default_rng(self.like).normal(size=32)
        other /= np.linalg.norm(other)
        aside = own - (own @ other) * other
        return self.share * other + np.sqrt(1.0 - self.share**2) * aside / np.linalg.norm(aside)


def lookalike(thing: Thing, like: int, seed: int, share: float = 0.55) -> Lookalike:
    """The thing with such a descriptor."""
    known = {entry.name: getattr(thing, entry.name) for entry in fields(Thing)} | {"shape_seed": seed}
    return Lookalike(**known, like=like, share=share)


def look_away(world: World) -> None:
    """Long enough for an exchange."""
    world.tour(orbit(x=60.0, count=20))


def test_object_that_only_association_misses_is_seen_by_the_object_graph():
    world = make_world(is_unmatched=lambda frame, name: name == "c" and frame >= 16)
    assert revisit(world) == []
    mug = next(o for o in world.mapper.object_map.objects if o.object_id == world.ids["c"])
    assert mug.last_seen_ns > 2_500_000_000


def test_object_first_seen_late_because_it_was_hidden_is_a_discovery():
    tall = standing("tall", -0.05, -0.38, 0.11, 0.3)
    world = make_world([*five_things()[1:], tall, standing("behind", -0.05, -0.15, height_m=0.08)])
    world.tour(orbit(count=8, start_rad=-1.8, turn_rad=0.4))
    assert "behind" not in world.ids
    world.tour(orbit(count=16, start_rad=0.5, turn_rad=2.5))
    assert "behind" in world.ids
    assert world.finish() == []


def test_drift_before_a_loop_closure_changes_nothing():
    """The second visit starts 20 cm off and is put right after six frames."""
    off = np.array([0.0, 0.0, 0.03, 0.15, 0.05, 0.12])
    world = make_world(drift=lambda frame: off if 16 <= frame < 22 else np.zeros(6))
    world.tour(orbit(count=16))
    true = orbit(count=16, start_rad=1.0)
    world.tour(true[:6])
    world.correct([*[k.T_map_camera for k in world._keyframes[:16]], *true[:6]])
    world.tour(true[6:])
    assert world.finish() == []
    assert_map_is_true(world)


def test_objects_met_again_under_new_ids_after_a_drift_are_not_changes():
    """Association fails until the loop closes; the doubles then coincide with the objects and are merged."""
    off = np.array([0.0, 0.0, 0.03, 0.25, 0.1, 0.2])
    world = make_world(drift=lambda frame: off if 16 <= frame < 24 else np.zeros(6))
    world.tour(orbit(count=16))
    old_ids, world.ids = dict(world.ids), {}
    true = orbit(count=24, start_rad=1.0)
    world.tour(true[:8])
    world.correct([*[k.T_map_camera for k in world._keyframes[:16]], *true[:8]])
    assert world.changes == []
    world.ids |= {name: old_ids[name] for name in "abd"}
    world.tour(true[8:])
    assert world.finish() == []


def test_twin_that_stays_is_not_taken_for_the_one_that_moved():
    twins = [standing(n, x, y, seed=7) for n, x, y in (("p", -0.25, 0.0), ("q", 0.3, 0.0))]
    world = make_world([*five_things()[:4], *twins])
    assert revisit(world, lambda w: w.move("p", 0.0, -0.3)) == [(MOVED, "p")]
    assert_map_is_true(world)


@pytest.mark.parametrize(("table_m", "gone"), [(2.5, ["f", "g"]), (6.0, [])])
def test_object_put_on_a_table_where_nothing_has_stayed_has_moved(table_m, gone):
    """Whether the place was free before, and what has gone, objects of the next table can tell, unless it is
    far; that the object is missed elsewhere tells that it has moved.
    """
    far = [standing("f", table_m - 0.2, -0.2), standing("g", table_m + 0.2, 0.2, category="mug")]
    world = make_world(
        [*five_things(), *far],
        tables=((0.0, 0.0, 0.6), (table_m, 0.0, 0.6)),
        drift=lambda frame: np.full(6, 1e-6 * (frame >= 32)),  # nothing is in sight in between
    )
    world.tour([*orbit(count=16), *orbit(x=table_m, count=16)])
    world.remove("f")
    world.remove("g")
    world.move("a", table_m, 0.0)
    known_ids = dict(world.ids)
    world.tour([*orbit(count=16), *orbit(x=table_m, count=16)])
    world.finish()
    changes = {(change.kind, change.object_id): change for change in world.mapper.changes}
    moved = changes.pop((MOVED, known_ids["a"]))
    np.testing.assert_allclose(moved.T_map_after[:2, 3], [table_m, 0.0], atol=0.03)
    assert changes.keys() == {(REMOVED, known_ids[name]) for name in gone}


def test_object_in_whose_place_another_turns_out_to_stand_is_gone():
    """Nothing is left on the far table by which its places could be seen empty."""
    far = [standing("f", 5.8, -0.2), standing("g", 6.2, 0.2, category="mug")]
    world = make_world(
        [*five_things(), *far],
        tables=((0.0, 0.0, 0.6), (6.0, 0.0, 0.6)),
        drift=lambda frame: np.full(6, 1e-6 * (frame >= 32)),
    )
    world.tour([*orbit(count=16), *orbit(x=6.0, count=16)])
    world.remove("f")
    world.remove("g")
    world.move("a", 5.8, -0.2)
    known_ids = dict(world.ids)
    world.wait(2.0)
    world.tour([*orbit(count=16), *orbit(x=6.0, count=16)])
    world.finish()
    changes = {(change.kind, change.object_id) for change in world.mapper.changes}
    assert changes == {(MOVED, known_ids["a"]), (REMOVED, known_ids["f"])}


def test_twin_of_an_object_gone_that_stands_where_nothing_was_known_is_a_discovery():
    world = make_world(tables=((0.0, 0.0, 0.6), (3.0, 0.0, 0.6)))
    world.tour(orbit(count=16))
    twin = standing("f", 3.0, 0.0, seed=world.thing("a").shape_seed)
    world.remove("a")
    world.tour(orbit(count=16))
    world.add(twin)
    world.tour(orbit(x=3.0, count=16))
    world.finish()
    assert [change.kind for change in world.mapper.changes] == [REMOVED]


def test_second_id_for_an_object_still_seen_is_the_same_object():
    """Association alternates between two ids for one mug, which looks different under each."""
    world = make_world()
    world.tour(orbit(count=12))
    first_id, place = world.ids["c"], world._places["c"]
    for T in orbit(count=24, start_rad=0.5):
        world.ids["c"] = first_id if world.frames % 2 else 77
        world._places["c"] = place
        world.step(T)
    world.ids["c"] = first_id
    assert world.finish() == []
    assert_map_is_true(world)


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_doubles_that_a_loop_closure_brings_together_are_one(share):
    """The second visit starts 20 cm off under new ids, is settled as such, and then put right.

    However unlike themselves things looked then: they are seen again as they were.
    """
    off = np.array([0.0, 0.0, 0.03, 0.15, 0.05, 0.12])
    world = make_world(drift=lambda frame: off if 16 <= frame < 32 else np.zeros(6))
    world.tour(orbit(count=16))
    old_ids, old_things, world.ids = world.ids, world.things, {}
    world.things = [lookalike(thing, thing.shape_seed, seed=1, share=share) for thing in old_things]
    true = orbit(count=16, start_rad=1.0)
    world.tour(true)
    assert len(world.mapper.object_map.objects) > len(world.things)
    world.correct([*[k.T_map_camera for k in world._keyframes[:16]], *true])
    world.ids, world.things = old_ids, old_things
    world.step(true[0])
    assert world.finish() == []
    assert len(world.mapper.object_map.objects) == len(world.things)


def test_double_that_was_called_added_has_never_come():
    """Off its place it looks like a newcomer, until the loop closure shows what it is."""
    off = np.array([0.0, 0.0, 0.0, 0.15, 0.0, 0.0])
    world = make_world(drift=lambda frame: off if 16 <= frame < 32 else np.zeros(6))
    world.tour(orbit(count=16))
    old_ids, world.ids = world.ids, {}
    true = orbit(count=16, start_rad=1.0)
    world.tour(true)
    doubles = set(world.ids.values())
    for double in doubles & {known.object_id for known in world.mapper.object_map.objects}:
        world.mapper._change(double, ADDED)
    assert world.mapper.changes
    world.correct([*[k.T_map_camera for k in world._keyframes[:16]], *true])
    world.ids = old_ids
    world.close_loop(true[0])
    assert world.mapper.changes == ()


def disguise(name: str, share: float = 0.55) -> Edit:
    """Let association fail for the thing's descriptor, which no other thing has."""

    def edit(world: World) -> None:
        thing = world.thing(name)
        world.things[world.things.index(thing)] = lookalike(thing, thing.shape_seed, seed=1, share=share)
        del world.ids[name]

    return edit


def test_thing_that_looks_otherwise_on_the_second_visit_is_no_exchange():
    """Depth shows no change."""
    world = make_world()
    assert revisit(world, look_away, disguise("a")) == []
    assert_map_is_true(world)


def test_that_a_place_was_free_before_a_thing_came_does_not_tell_that_it_went():
    world = make_world()
    world.tour(orbit(count=16))
    world.add(standing("f", 0.0, -0.35))
    look_away(world)
    assert revisit(world, look_away, disguise("f")) == [(ADDED, "f")]
    assert_map_is_true(world)


def test_what_has_just_come_may_be_exchanged_at_once():
    world = make_world()
    world.tour(orbit(count=16))
    world.add(standing("f", 0.0, -0.35))
    world.tour(orbit(count=16, start_rad=1.0))
    first_id = world.ids["f"]
    world.remove("f")
    world.add(standing("g", 0.0, -0.35, height_m=0.25, seed=9))
    look_away(world)
    world.tour(orbit(count=16))
    world.finish()
    changes = [(change.kind, change.object_id) for change in world.mapper.changes]
    assert sorted(changes) == sorted([(ADDED, first_id), (REMOVED, first_id), (ADDED, world.ids["g"])])


@pytest.mark.parametrize("off_m", [0.0, 0.03])
def test_what_was_taken_for_another_for_a_moment_is_still_itself(off_m):
    """Six poor views look like another thing; then it is matched again, and the other is no more than it."""
    world = make_world()
    world.tour(orbit(count=16))
    first_id, thing = world.ids["a"], world.thing("a")
    world.wait(2.0)
    x, y = thing.T_world_object[:2, 3]
    world.remove("a")
    world.add(standing("other", x + off_m, y, seed=9))
    world.tour(orbit(count=6))
    world.remove("other")
    world.add(thing)
    world.ids["a"] = first_id
    world.tour(orbit(count=40))
    assert world.finish() == []


@pytest.mark.parametrize("off_m", [0.03, 0.04, 0.05])
def test_what_stands_where_an_object_is_still_seen_has_not_come(off_m):
    """Both cannot be: it is that object, badly seen."""
    world = make_world()
    world.tour(orbit(count=16))
    x, y = world.thing("a").T_world_object[:2, 3]
    world.wait(3.0)
    world.add(standing("ghost", x + off_m, y, seed=9))
    world.tour(orbit(count=40))
    assert "ghost" in world.ids
    assert world.finish() == []


def test_likeness_to_an_object_elsewhere_alone_does_not_tell_an_exchange():
    """On the second visit one looks somewhat like itself and just like another, out of sight; depth shows no
    change.
    """
    a = five_things()[0]
    far = lookalike(standing("z", 6.0, 0.0), like=a.shape_seed, seed=1, share=0.7)
    world = make_world([*five_things(), far], tables=((0.0, 0.0, 0.6), (6.0, 0.0, 0.6)))
    world.tour([*orbit(count=16), *orbit(x=6.0, count=16)])
    look_away(world)
    disguise("a", share=0.7)(world)
    world.tour(orbit(count=16))
    assert world.finish() == []


def test_what_has_come_lately_hardly_goes_again():
    """However unlike itself it looks then, as long as depth shows no change."""
    world = make_world()
    world.tour(orbit(count=16))
    world.add(standing("f", 0.0, -0.35))
    look_away(world)
    world.tour(orbit(count=16))
    assert revisit(world, look_away, disguise("f", share=0.1)) == [(ADDED, "f")]
    assert_map_is_true(world)


def test_things_of_one_size_that_look_somewhat_alike_and_trade_places_have_moved():
    p, q = standing("p", -0.25, 0.0), standing("q", 0.3, 0.0)
    world = make_world([*five_things()[:4], p, lookalike(q, like=p.shape_seed, seed=1)])
    assert revisit(world, look_away, swap("p", "q")) == [(MOVED, "p"), (MOVED, "q")]
    assert_map_is_true(world)


@pytest.mark.parametrize("off_m", [0.0, 0.12])
def test_trade_of_places_is_seen_through_drift(off_m):
    """The second visit starts 12 cm off, so that in the map what collides is far apart."""
    off = np.array([0.0, 0.0, 0.0, off_m, 0.0, 0.0])
    world = make_world(drift=lambda frame: off * (frame >= 16))
    assert revisit(world, swap("a", "b")) == [(MOVED, "a"), (MOVED, "b")]


def test_what_turns_out_to_be_there_after_all_is_not_removed(monkeypatch):
    """A newcomer is found to be it as the removal is due, and so has displaced nothing else either."""
    world = make_world()
    world.tour(orbit(count=16))
    known_id, newcomer_id = world.ids["a"], world.ids["b"]
    for displaced_id in (known_id, world.ids["c"]):
        world.mapper._presence.displace(displaced_id, newcomer_id)
    due = Decision((), added=(newcomer_id,), removed=(known_id, world.ids["c"]))
    monkeypatch.setattr(ChangeDetector, "decide", lambda *_: due)
    monkeypatch.setattr(Judge, "judge", lambda *_: Verdict(Origin.DUPLICATE, duplicate_of=known_id))
    world.is_missed = lambda *_: True
    world.step(orbit(count=16)[0])
    assert world.changes == []
    assert newcomer_id not in {known.object_id for known in world.mapper.object_map.objects}

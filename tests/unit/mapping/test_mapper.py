import time
from dataclasses import replace

import numpy as np
import pytest

from neuse import geometry
from neuse.errors import InputError, MapFileError, MeshError, ParamError
from neuse.mapping.change_detection import ChangeParams
from neuse.mapping.mapper import MapperParams, ObjectMapper
from neuse.params import build, fields, flatten
from neuse.records import NO_ID, ChangeKind, ObjectStatus

from .synthetic import (
    RECONSTRUCT,
    assert_map_is_true,
    five_things,
    make_world,
    orbit,
    revisit,
    standing,
    swap,
)

ADDED, REMOVED, MOVED = ChangeKind.ADDED, ChangeKind.REMOVED, ChangeKind.MOVED


SCENARIOS = {
    "nothing": ([], []),
    "removed": ([lambda w: w.remove("a")], [(REMOVED, "a")]),
    "added": ([lambda w: w.add(standing("f", 0.0, -0.3))], [(ADDED, "f")]),
    "moved": ([lambda w: w.move("a", 0.0, -0.3)], [(MOVED, "a")]),
    "moved by 5 cm": ([lambda w: w.move("a", -0.2, -0.2)], [(MOVED, "a")]),
    "bottles swapped": ([swap("a", "b")], [(MOVED, "a"), (MOVED, "b")]),
    "mugs swapped": ([swap("c", "e")], [(MOVED, "c"), (MOVED, "e")]),
    "mug and bottle swapped": ([swap("d", "e")], [(MOVED, "d"), (MOVED, "e")]),
    "replaced by a new one": (
        [lambda w: w.remove("a"), lambda w: w.add(standing("f", -0.25, -0.2, 0.045, 0.12))],
        [(ADDED, "f"), (REMOVED, "a")],
    ),
    "moved into the place of a removed one": (
        [lambda w: w.remove("a"), lambda w: w.move("b", -0.25, -0.2)],
        [(REMOVED, "a"), (MOVED, "b")],
    ),
    "three at once": (
        [
            lambda w: w.remove("a"),
            lambda w: w.add(standing("f", 0.0, -0.3)),
            lambda w: w.move("b", 0.05, 0.35),
        ],
        [(ADDED, "f"), (REMOVED, "a"), (MOVED, "b")],
    ),
}


@pytest.mark.parametrize(("edits", "expected"), SCENARIOS.values(), ids=SCENARIOS)
def test_changes_between_two_visits_are_found_and_none_else(edits, expected):
    world = make_world()
    assert revisit(world, *edits) == expected
    assert_map_is_true(world)


def test_object_moved_to_another_table_waits_for_its_old_place():
    tables = ((0.0, 0.0, 0.6), (3.0, 0.0, 0.6))
    there = [
        standing(n, 3.0 + x, y, 0.04, 0.12) for n, x, y in (("u", -0.2, 0.2), ("v", 0.2, 0.2), ("w", 0, -0.2))
    ]
    world = make_world([*five_things(), *there], tables=tables)
    world.tour([*orbit(count=12), *orbit(x=3.0, count=12)])
    first_id = world.ids["a"]
    world.move("a", 3.0, 0.1)
    world.tour(orbit(x=3.0, count=12))
    assert world.changes == []
    world.tour(orbit(count=12))
    assert [(c.kind, c.object_id) for c in world.changes] == [(MOVED, first_id)]
    assert world.finish() == world.changes
    assert_map_is_true(world)


def test_removed_object_put_back_is_added():
    world = make_world(mapper=ObjectMapper(RECONSTRUCT, MapperParams(changes=ChangeParams(hold_s=0.0))))
    a = world.thing("a")
    world.tour(orbit(count=16))
    world.remove("a")
    world.tour(orbit(count=16))
    world.add(a)
    world.tour(orbit(count=16))
    assert [c.kind for c in world.finish()] == [REMOVED, ADDED]
    assert_map_is_true(world)


def test_tracker_may_go_on_with_the_new_id_of_a_moved_object():
    world = make_world(obeys=False)
    world.tour(orbit(count=16))
    first_id = world.ids["a"]
    world.move("a", 0.0, -0.3)
    world.tour(orbit(count=24, start_rad=1.0))
    assert world.ids["a"] != first_id
    assert [(c.kind, c.object_id) for c in world.finish()] == [(MOVED, first_id)]
    assert_map_is_true(world)


@pytest.mark.parametrize("shuffles", [1, 2])
def test_map_does_not_depend_on_the_order_of_observations_in_a_frame(shuffles):
    maps = []
    for order in (None, shuffles):
        world = make_world(shuffles=order)
        revisit(world, lambda w: w.move("a", 0.0, -0.3), count=12)
        maps.append(world.mapper.object_map)
    for one, other in zip(maps[0].objects, maps[1].objects, strict=True):
        assert (one.object_id, one.status, one.n_observations) == (
            other.object_id,
            other.status,
            other.n_observations,
        )
        np.testing.assert_array_equal(one.code.z, other.code.z)


def test_mapper_that_starts_anew_goes_on_with_what_the_one_before_knew():
    params = MapperParams(changes=ChangeParams(hold_s=0.0))
    world = make_world(mapper=ObjectMapper(RECONSTRUCT, params))
    world.tour(orbit(count=12))
    world.remove("a")
    world.tour(orbit(count=16))
    before, changes = world.mapper.object_map, list(world.changes)
    assert REMOVED in {change.kind for change in changes}
    world.mapper = ObjectMapper(RECONSTRUCT, params)
    world.tour(orbit(count=16)[:3])
    seen = {known.object_id for known in world.mapper.object_map.objects}
    assert world.mapper.recall(before) == len({known.object_id for known in before.objects} - seen) > 0
    after = {known.object_id: known for known in world.mapper.object_map.objects}
    for known in before.objects:
        found = after[known.object_id]
        assert (found.first_seen_ns, found.status) == (known.first_seen_ns, known.status)
        assert found.n_observations >= known.n_observations
        np.testing.assert_allclose(found.box_center, known.box_center, atol=0.02)
    world.tour(orbit(count=16))
    assert world.finish() == changes
    assert_map_is_true(world)


def test_mapper_loaded_with_an_earlier_map_goes_on_with_what_the_one_before_knew(tmp_path):
    params = MapperParams(changes=ChangeParams(hold_s=0.0))
    world = make_world(mapper=ObjectMapper(RECONSTRUCT, params))
    world.tour(orbit(count=12))
    world.mapper.save(tmp_path / "room.map")
    world.remove("a")
    world.tour(orbit(count=16))
    before = world.mapper.object_map
    world.mapper = ObjectMapper(RECONSTRUCT, params)
    world.mapper.load(tmp_path / "room.map")
    stale = {known.object_id: known.status for known in world.mapper.object_map.objects}
    assert world.mapper.recall(before) == len(before.objects) - len(stale)
    after = {known.object_id: known for known in world.mapper.object_map.objects}
    assert ObjectStatus.REMOVED in {known.status for known in before.objects} - set(stale.values())
    for known in before.objects:
        found = after[known.object_id]
        assert (found.status, found.n_observations) == (known.status, known.n_observations)
        np.testing.assert_allclose(found.box_center, known.box_center, atol=0.02)
    world.tour(orbit(count=16))
    world.finish()
    assert_map_is_true(world)


def test_moved_object_that_a_loaded_mapper_has_seen_is_recalled_where_it_stands(tmp_path):
    """The tracker goes on to call it by its name, and the loaded map has it where it stood."""
    world = make_world()
    world.tour(orbit(count=12))
    world.mapper.save(tmp_path / "room.map")
    world.move("a", 0.0, -0.3)
    world.wait(2.0)
    world.tour(orbit(count=16))
    world.finish()
    before = world.mapper.object_map
    world.mapper = ObjectMapper(RECONSTRUCT)
    world.mapper.load(tmp_path / "room.map")
    world.tour(orbit(count=16)[:6])
    assert world.mapper.recall(before) == 0
    assert_map_is_true(world)
    after = {known.object_id: known for known in world.mapper.object_map.objects}
    for known in before.objects:
        found = after[known.object_id]
        assert (found.first_seen_ns, found.status) == (known.first_seen_ns, known.status)
        assert known.n_observations <= found.n_observations <= known.n_observations + 6
    world.tour(orbit(count=16))
    assert len(world.finish()) == 1
    assert_map_is_true(world)


def test_loaded_mapper_recalls_no_later_map_of_others(tmp_path):
    world, other = make_world(), make_world()
    world.tour(orbit(count=4))
    world.mapper.save(tmp_path / "room.map")
    other.tour(orbit(count=12))
    strangers = [
        replace(known, first_seen_ns=known.first_seen_ns + 1) for known in other.mapper.object_map.objects
    ]
    mapper = ObjectMapper(RECONSTRUCT)
    mapper.load(tmp_path / "room.map")
    assert mapper.recall(replace(other.mapper.object_map, objects=tuple(strangers))) == 0


def test_map_that_is_later_than_this_session_is_not_recalled():
    world = make_world()
    world.tour(orbit(count=4))
    mapper = ObjectMapper(RECONSTRUCT)
    assert mapper.recall(world.mapper.object_map) == 0
    assert mapper.object_map.objects == ()


def test_map_of_another_session_takes_the_place_of_what_was_seen_elsewhere():
    """A session that was started again, and has not found its place yet, calls objects by any names."""
    world, stranger = make_world(), make_world()
    world.tour(orbit(count=12))
    before = world.mapper.object_map
    T = geometry.exp([0.0, 0.0, 1.0, 2.0, 0.0, 0.0])
    for thing in list(stranger.things):
        stranger.move(thing.name, 0.3 * float(T[0, 3]) - thing.T_world_object[0, 3], 0.0)
    stranger.tour(orbit(count=12))
    stranger.wait(60.0)
    assert not stranger.mapper.is_in(before)
    assert stranger.mapper.recall(before) == len(before.objects)
    found = {known.object_id: known for known in stranger.mapper.object_map.objects}
    assert found.keys() == {known.object_id for known in before.objects}
    for known in before.objects:
        np.testing.assert_allclose(found[known.object_id].box_center, known.box_center, atol=0.02)


def test_recalled_map_can_be_saved(tmp_path):
    world = make_world()
    world.tour(orbit(count=12))
    before = world.mapper.object_map
    world.remove("a")
    world.mapper = ObjectMapper(RECONSTRUCT)
    world.tour(orbit(count=16)[:3])
    assert world.mapper.recall(before) > 0
    world.mapper.save(tmp_path / "room.map")
    loaded = ObjectMapper(RECONSTRUCT)
    loaded.load(tmp_path / "room.map")
    places = loaded.places()
    assert places.keys() == {known.object_id for known in before.objects}
    for object_id, center in world.mapper.places().items():
        np.testing.assert_allclose(places[object_id], center, atol=1e-3)


def test_map_that_began_without_a_keyframe_can_be_saved(tmp_path):
    world = make_world()
    frames = [world.frame(T_world_camera) for T_world_camera in orbit(count=12)]
    mapper = ObjectMapper(RECONSTRUCT)
    mapper.step(replace(frames[-1], keyframe_id=NO_ID))
    assert mapper.places()
    mapper.save(tmp_path / "room.map")
    loaded = ObjectMapper(RECONSTRUCT)
    loaded.load(tmp_path / "room.map")
    assert loaded.places().keys() == mapper.places().keys()


def test_loop_closure_moves_the_objects_with_their_keyframes():
    world = make_world()
    world.tour(orbit(count=12))
    before = {o.object_id: o.box_center for o in world.mapper.object_map.objects}
    T = geometry.exp([0.0, 0.0, 0.2, 0.5, -0.3, 0.1])
    world.correct([T @ keyframe.T_map_camera for keyframe in world._keyframes])
    frame = world.frame(orbit()[0])
    world.mapper.step(frame, world._keyframes[:-1])
    for known in world.mapper.object_map.objects:
        expected = geometry.transform_points(T, before[known.object_id])
        np.testing.assert_allclose(known.box_center, expected, atol=0.05)


def test_map_lists_pose_box_and_times():
    world = make_world()
    world.tour(orbit(count=12))
    objects = world.mapper.object_map.objects
    assert [known.object_id for known in objects] == sorted(world.ids.values())
    for name, object_id in world.ids.items():
        known, thing = objects[object_id], world.thing(name)
        assert known.category == thing.category
        np.testing.assert_allclose(known.box_center, thing.T_world_object[:3, 3], atol=0.02)
        assert known.box_size[2] == pytest.approx(thing.height_m, abs=0.015)
        assert 0 <= known.first_seen_ns < known.last_seen_ns <= 1_100_000_000
        assert known.n_observations >= 8
        assert world.mapper.mesh(object_id).contains([known.box_center]).all()


def test_unknown_object_has_no_mesh():
    with pytest.raises(InputError, match="42"):
        ObjectMapper(RECONSTRUCT).mesh(42)


def test_category_without_decoder_is_mapped_but_has_no_mesh():
    world = make_world(mapper=ObjectMapper({"bottle": RECONSTRUCT["bottle"]}))
    world.tour(orbit(count=8))
    mug_id = world.ids["c"]
    assert mug_id in {known.object_id for known in world.mapper.object_map.objects}
    with pytest.raises(MeshError, match="mug"):
        world.mapper.mesh(mug_id)


def test_reset_forgets_everything():
    world = make_world()
    world.tour(orbit(count=8))
    world.mapper.reset()
    assert world.mapper.object_map.objects == ()
    assert world.mapper.changes == ()


def test_removed_object_stays_removed_over_a_reload(tmp_path):
    world = make_world()
    revisit(world, lambda w: w.remove("a"))
    world.mapper.save(tmp_path / "map.npz")
    mapper = ObjectMapper(RECONSTRUCT)
    mapper.load(tmp_path / "map.npz")
    assert mapper.finalize() == ()
    statuses = [known.status for known in mapper.object_map.objects]
    assert statuses == [known.status for known in world.mapper.object_map.objects]
    assert ObjectStatus.REMOVED in statuses


def test_broken_file_leaves_the_map_as_it_is(tmp_path):
    world = make_world()
    world.tour(orbit(count=8))
    (tmp_path / "map.npz").write_bytes(b"broken")
    with pytest.raises(MapFileError):
        world.mapper.load(tmp_path / "map.npz")
    assert len(world.mapper.object_map.objects) == 5


def test_changes_after_a_reload_are_found(tmp_path):
    """Saved after the first visit; a new session with keyframes and a clock of its own finds what changed."""
    first = make_world()
    first.tour(orbit(count=16))
    first.mapper.save(tmp_path / "map.npz")
    mapper = ObjectMapper(RECONSTRUCT)
    mapper.load(tmp_path / "map.npz")
    for one, other in zip(first.mapper.object_map.objects, mapper.object_map.objects, strict=True):
        assert (one.object_id, one.category, one.first_seen_ns) == (
            other.object_id,
            other.category,
            other.first_seen_ns,
        )
        np.testing.assert_allclose(one.code.z, other.code.z, atol=1e-9)
    second = make_world(mapper=mapper, seed=1)
    second.ids, second._places, second._shapes = dict(first.ids), dict(first._places), dict(first._shapes)
    second._next_id = 100
    second.remove("a")
    second.add(standing("f", 0.0, -0.3))
    second.tour(orbit(count=16, start_rad=0.3))
    expected = [(ADDED, second.ids["f"]), (REMOVED, first.ids["a"])]
    assert sorted((c.kind, c.object_id) for c in second.finish()) == expected


def test_step_takes_few_milliseconds():
    world = make_world()
    frames = [world.frame(T) for T in orbit()]
    took_s = []
    for i, frame in enumerate(frames):
        start_s = time.process_time()
        world.mapper.step(frame, world._keyframes[max(0, i - 9) : i + 1])
        took_s.append(time.process_time() - start_s)
    assert np.median(took_s) < 0.02


def test_parameters_have_meanings_ranges_and_dotted_names():
    params = MapperParams()
    assert build(params, flatten(params)) == params
    assert all(field.metadata.get("description") for field in fields(params).values())
    assert flatten(params)["layout.delta_e_m"] == 0.03
    with pytest.raises(ParamError, match="delta_e_m"):
        build(params, {"layout.delta_e_m": -1.0})

"""A world as it is when somebody comes back to it."""

import numpy as np
import pytest

from neuse.errors import ParamError
from neuse.simulation.changes import MIN_MOVE_M
from neuse.simulation.returning import MIN_KNOWN, SEEN_M, SEEN_PX, come_back, fellow
from neuse.simulation.worlds import World, make_world, simulate

FRAMES = 12


@pytest.fixture(scope="module")
def before() -> World:
    return make_world("tabletop", 101)


@pytest.fixture(scope="module", params=range(2))
def after(request: pytest.FixtureRequest, before: World) -> World:
    return come_back(before, request.param, FRAMES)


def fates(before: World, after: World) -> dict[str, list[int]]:
    """Names of what stayed, moved, went and came between the two sessions."""
    old = {o.object_id: o for o in before.timeline.objects_at(before.frames - 1)}
    new = {o.object_id: o for o in after.timeline.initial}
    stayed = [i for i in old.keys() & new.keys() if new[i] is old[i]]
    return {
        "stayed": stayed,
        "moved": sorted(old.keys() & new.keys() - stayed),
        "gone": sorted(old.keys() - new.keys()),
        "new": sorted(new.keys() - old.keys()),
    }


def test_third_of_the_objects_has_changed_half_of_them_by_going(before: World, after: World):
    found = fates(before, after)
    assert (len(found["moved"]), len(found["gone"]), found["new"]) == (2, 2, [])
    assert len(found["stayed"]) == 8


def test_what_has_moved_stands_free_and_well_away_in_the_same_shape(before: World, after: World):
    old = {o.object_id: o for o in before.timeline.objects_at(before.frames - 1)}
    for thing in (o for o in after.timeline.initial if o.object_id in fates(before, after)["moved"]):
        assert thing.shape is old[thing.object_id].shape
        assert np.linalg.norm(thing.position - old[thing.object_id].position) >= MIN_MOVE_M
        others = [o.position for o in after.timeline.initial if o is not thing]
        assert np.linalg.norm(np.array(others) - thing.position, axis=1).min() > 0.05


def test_first_frame_shows_three_objects_that_have_stayed(before: World, after: World):
    first = next(simulate(after, 0, 1))
    near = {
        o.object_id
        for o in first.objects
        if np.linalg.norm(o.position - first.T_world_camera[:3, 3]) <= SEEN_M
        and first.visible_px.get(o.object_id, 0) >= SEEN_PX
    }
    assert len(near & set(fates(before, after)["stayed"])) >= MIN_KNOWN


def test_nothing_changes_while_the_camera_is_there(after: World):
    assert after.frames == len(after.trajectory.T_world_camera) == FRAMES
    assert not any(after.timeline.changes_at(index) for index in range(FRAMES))


def test_camera_keeps_the_pace_of_the_world_and_begins_its_odometry_anew(before: World, after: World):
    step_m = before.trajectory.length_m / before.frames
    assert 0.3 * step_m < after.trajectory.length_m / (FRAMES - 1) < 3.0 * step_m
    np.testing.assert_allclose(after.T_odom_camera[0], np.eye(4), atol=1e-12)


def test_same_seed_gives_the_same_return_and_another_seed_another_one(before: World):
    first, again, other = (come_back(before, seed, 3) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.trajectory.T_world_camera, again.trajectory.T_world_camera)
    assert fates(before, first) == fates(before, again)
    assert not np.allclose(first.trajectory.T_world_camera, other.trajectory.T_world_camera)
    assert first.seed != before.seed


def test_world_in_which_nothing_has_changed_is_the_same(before: World):
    same = come_back(before, 0, 3, share=0.0)
    assert same.timeline.initial == before.timeline.objects_at(before.frames - 1)


def test_start_that_cannot_be_is_refused(before: World, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("neuse.simulation.returning.MAX_DRAWS", 2)
    with pytest.raises(ParamError, match=r"no start on tabletop shows 99 objects .* change fewer"):
        come_back(before, 0, 3, n_known=99)


def test_fellow_is_in_the_same_world_at_the_same_time_on_a_way_of_its_own(before: World):
    first, again, second = fellow(before, 1), fellow(before, 1), fellow(before, 2)
    assert first.timeline is before.timeline
    assert first.frames == before.frames
    np.testing.assert_array_equal(first.T_odom_camera, again.T_odom_camera)
    ways = [world.trajectory.T_world_camera for world in (before, first, second)]
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert np.linalg.norm(ways[one][:, :3, 3] - ways[other][:, :3, 3], axis=1).min() > 1e-3
    assert len({world.seed for world in (before, first, second)}) == 3

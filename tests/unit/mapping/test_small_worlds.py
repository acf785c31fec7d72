"""Tracker and mapper together on one small table, from codes and depth alone: every kind of change."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest

from neuse.geometry import Array, exp, transform_points
from neuse.mapping.mapper import ObjectMapper
from neuse.records import ChangeKind, ObjectStatus, ObservedFrame, OdometrySample
from neuse.slam.slam import ObjectSlam

from .synthetic import (
    CAMERA,
    COARSE,
    FRAME_NS,
    RECONSTRUCT,
    World,
    five_things,
    orbit,
    standing,
    swap,
)

ADDED, REMOVED, MOVED = ChangeKind.ADDED, ChangeKind.REMOVED, ChangeKind.MOVED
A, B = (-0.25, -0.2), (0.25, -0.2)
FREE = (0.0, -0.35)


@dataclass
class TrackedWorld(World):
    """A world in which the real tracker finds poses and ids; the map frame is the first camera's."""

    slam: ObjectSlam = field(default_factory=ObjectSlam)
    T_world_map: Array | None = None

    def step(self, T_world_camera: Array) -> None:
        if self.T_world_map is None:
            self.T_world_map = T_world_camera
        observations = [o for thing in self.things if (o := self._observe(thing, T_world_camera)) is not None]
        stamp_ns = self.frames * FRAME_NS
        depth = self.frame(T_world_camera).coarse_depth_m
        observed = ObservedFrame(stamp_ns, tuple(observations), CAMERA, depth.reshape(COARSE))
        noise = self._rng.normal(scale=[0.001] * 3 + [0.005] * 3)
        tracked = self.slam.step(observed, OdometrySample(stamp_ns, T_world_camera @ exp(noise)))
        for change in self.mapper.step(tracked, self.slam.keyframes):
            self.slam.apply_change(change)

    def places(self) -> list[tuple[ChangeKind, tuple[float, float] | None, tuple[float, float] | None]]:
        """All changes as (kind, x and y before, x and y after) in the world, to 5 cm."""
        self.mapper.finalize()
        return sorted(
            (change.kind, self._spot(change.T_map_before), self._spot(change.T_map_after))
            for change in self.mapper.changes
        )

    def _spot(self, T_map_object: Array | None) -> tuple[float, float] | None:
        if T_map_object is None:
            return None
        assert self.T_world_map is not None
        x, y, _ = transform_points(self.T_world_map, T_map_object[:3, 3])
        return round(float(x) * 20) / 20, round(float(y) * 20) / 20


def table(things: Sequence | None = None) -> TrackedWorld:
    return TrackedWorld(ObjectMapper(RECONSTRUCT), list(things) if things else five_things())


def visit(world: TrackedWorld) -> None:
    """Once around the table, back to where the camera was: odometry must not jump."""
    world.tour(orbit(count=32))


def assert_mapped_once(world: TrackedWorld) -> None:
    """Every thing is in the map once, at its place."""
    assert world.T_world_map is not None
    present = [o for o in world.mapper.object_map.objects if o.status != ObjectStatus.REMOVED]
    mapped = [transform_points(world.T_world_map, o.T_map_object[:3, 3]) for o in present]
    places = np.array([thing.T_world_object[:3, 3] for thing in world.things])
    offsets_m = np.linalg.norm(places[:, None] - np.array(mapped)[None], axis=-1)
    assert len(present) == len(world.things)
    assert offsets_m.min(axis=1).max() < 0.02


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        (lambda w: None, []),
        (lambda w: w.remove("a"), [(REMOVED, A, None)]),
        (lambda w: w.move("a", *FREE), [(MOVED, A, FREE)]),
        (lambda w: w.add(standing("f", *FREE, 0.03, 0.12)), [(ADDED, None, FREE)]),
        (swap("a", "b"), [(MOVED, A, B), (MOVED, B, A)]),
    ],
    ids=["nothing", "removed", "moved", "added", "swapped"],
)
def test_change_between_two_visits_is_found_and_none_else(edit, expected):
    world = table()
    visit(world)
    edit(world)
    visit(world)
    assert world.places() == expected
    assert_mapped_once(world)


def test_twins_that_trade_places_change_nothing():
    twins = [standing("p", *A, seed=7), standing("q", *B, seed=7)]
    world = table([*five_things()[2:], *twins])
    visit(world)
    swap("p", "q")(world)
    visit(world)
    assert world.places() == []


def test_object_that_goes_and_comes_back_elsewhere_has_moved():
    world = table()
    a = world.thing("a")
    visit(world)
    world.remove("a")
    visit(world)
    assert [change.kind for change in world.mapper.changes] == [REMOVED]
    world.add(a.at(*FREE))
    visit(world)
    assert world.places() == [(MOVED, A, FREE)]


def test_object_that_is_only_hidden_is_not_removed():
    world = table()
    visit(world)
    world.tour(orbit(count=16, turn_rad=-2.2))
    world.add(standing("tall", -0.1, -0.42, 0.11, 0.3))
    world.tour(orbit(count=24, start_rad=-2.2, turn_rad=1.2))
    assert [change.kind for change in world.mapper.changes if change.kind != ADDED] == []
    assert [kind for kind, _, _ in world.places()] == [ADDED]


def test_removal_shows_within_seconds_of_being_seen():
    world = table()
    visit(world)
    world.remove("a")
    removed_at, reported_after = world.frames, None
    for pose in orbit(count=32):
        world.step(pose)
        if reported_after is None and world.mapper.changes:
            reported_after = world.frames - removed_at
    (change,) = world.mapper.changes
    assert change.kind == REMOVED
    assert reported_after is not None
    assert reported_after <= 24  # frames of 32

"""Coming back to a saved map: from a small world of codes, and what is made of the figures."""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np
import pytest
from slam.synthetic import Step, Thing, World, small_world

from neuse.evaluation import relocalization as module
from neuse.evaluation.encoded_world import EncodedWorld
from neuse.evaluation.relocalization import Later, Return, later_frames, map_and_save, run_return, summary
from neuse.evaluation.trajectory import trajectory_of
from neuse.evaluation.truth import Truth
from neuse.geometry import Array, make_transform
from neuse.records import ChangeKind, ObjectChange, ObservedFrame

CATEGORY = "vase"  # of no shipped decoder


def frame_of(step: Step) -> ObservedFrame:
    """What a camera saw: the landmarks of the codes stand for the surfaces, and behind all is a far wall."""
    seen = (replace(o, code=replace(o.code, category=CATEGORY)) for o in step.frame.observations)
    observations = tuple(replace(o, cloud=o.code.landmarks.astype(np.float32)) for o in seen)
    return replace(step.frame, observations=observations, coarse_depth_m=np.full((48, 64), 6.0, np.float32))


def encoded(world: World) -> EncodedWorld:
    steps = list(world.steps())
    trajectory = trajectory_of([s.frame.stamp_ns for s in steps], [s.T_world_camera for s in steps])
    frames, odometry = tuple(map(frame_of, steps)), tuple(s.odometry for s in steps)
    return EncodedWorld("small", 3, frames, odometry, Truth(trajectory))


def later(things: Sequence[Thing], path: list[Array], changes: tuple[ObjectChange, ...] = ()) -> Later:
    """Another day, without a word of how the camera has come there."""
    steps = list(World(list(things), path, seed=77).steps())
    shift_ns = 10**12
    frames = tuple(replace(frame_of(s), stamp_ns=s.frame.stamp_ns + shift_ns) for s in steps)
    odometry = tuple(replace(s.odometry, stamp_ns=s.odometry.stamp_ns + shift_ns) for s in steps)
    return Later(frames, odometry, np.stack([s.T_world_camera for s in steps]), changes)


@pytest.fixture(scope="module")
def world() -> World:
    whole = small_world(3)
    return replace(whole, path=whole.path[:95])


@pytest.fixture(scope="module")
def saved(world, tmp_path_factory):
    """The file of the first session, and T_world_map."""
    path = tmp_path_factory.mktemp("maps") / "small.map"
    return path, map_and_save(encoded(world), path)


def test_return_finds_the_camera_soon_and_right(world, saved):
    found = run_return("small", *saved, later(world.things, world.path[30:50]))
    assert found.is_good
    assert not found.is_wrong
    assert 0.2 <= found.after_s <= 1.0
    assert found.median_m < 0.05
    assert (found.found, found.false) == (0, 0)


def test_return_finds_what_has_moved(world, saved):
    thing = world.things[5]
    there = make_transform(np.eye(3), [0.25, -0.3, 0.0]) @ thing.T_world_object
    things = [replace(t, T_world_object=there) if t is thing else t for t in world.things]
    change = ObjectChange(0, ChangeKind.MOVED, thing.name, CATEGORY, thing.T_world_object, there)
    found = run_return("small", *saved, later(things, world.path, (change,)))
    assert found.is_good
    assert (found.found, found.false) == (1, 0)


def test_return_to_another_place_finds_nothing(world, saved):
    elsewhere = small_world(9)
    assert run_return("small", *saved, later(elsewhere.things, elsewhere.path[:15])) == Return("small", None)


def test_later_frames_are_those_of_the_changed_world_and_are_made_once(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "FRAMES", 2)
    world = EncodedWorld("tabletop", 101, (), (), Truth(trajectory_of([1], [np.eye(4)])))
    first = later_frames(world, tmp_path)
    assert len(first.frames) == len(first.odometry) == len(first.T_world_camera) == 2
    kinds = [change.kind for change in first.changes]
    assert (kinds.count(ChangeKind.MOVED), kinds.count(ChangeKind.REMOVED), len(kinds)) == (2, 2, 4)
    assert all(
        (change.T_map_after is None) == (change.kind == ChangeKind.REMOVED) for change in first.changes
    )
    monkeypatch.setattr(module, "Observer", None)
    again = later_frames(world, tmp_path)
    np.testing.assert_array_equal(again.T_world_camera, first.T_world_camera)
    assert again.frames[0].stamp_ns == first.frames[0].stamp_ns


@pytest.mark.parametrize(
    ("error_m", "error_deg", "is_good", "is_wrong"),
    [
        (0.01, 0.5, True, False),
        (0.06, 0.5, False, False),
        (0.01, 2.5, False, False),
        (0.11, 0.5, False, True),
        (0.01, 11.0, False, True),
        (None, None, False, False),
    ],
)
def test_good_and_wrong_are_as_the_bars_say(error_m, error_deg, is_good, is_wrong):
    start = Return("a", 0.5, error_m, error_deg)
    assert (start.is_good, start.is_wrong) == (is_good, is_wrong)


STARTS = [
    Return("a", 0.4, 0.01, 0.5, 0.01, 0.4, found=3, false=0),
    Return("b", 0.8, 0.03, 1.0, 0.02, 0.9, found=2, false=1),
    Return("c", 0.6, 0.50, 9.0, 0.50, 9.0, found=0, false=4),
    Return("d", None),
]


def test_summary_counts_what_was_found_and_gives_middle_and_worst():
    expected = ("2 of 4", "1", "0.6 (0.8)", "0.030 (0.500)", "1.00 (9.00)", "5 / 5")
    assert summary(STARTS) == expected
    assert summary(STARTS[-1:]) == ("0 of 1", "0", "-", "-", "-", "-")


def test_command_writes_every_start_and_a_picture(tmp_path, monkeypatch, capsys):
    starts = iter(STARTS[:2])
    monkeypatch.setattr(module, "encoded_world", lambda preset, seed, folder: (preset, seed))
    monkeypatch.setattr(module, "return_figures", lambda world, folder: asdict(next(starts)))
    command = ["relocalization", "--out", str(tmp_path), "--seeds", "2", "--presets", "tabletop"]
    monkeypatch.setattr(sys, "argv", command)
    module.main()
    assert json.loads((tmp_path / "relocalization.json").read_text())["starts"][1]["error_m"] == 0.03
    assert (tmp_path / "relocalization.png").read_bytes().startswith(b"\x89PNG")
    assert capsys.readouterr().out.splitlines()[-1].startswith("2 of 2 | 0 | ")

"""Worlds are simulated and encoded once; what they were made with decides whether the cache is good."""

import numpy as np
import pytest

from neuse.evaluation import encoded_world as module
from neuse.evaluation.encoded_world import encoded_world, fingerprint
from neuse.evaluation.run import run_encoded
from neuse.records import NO_ID

FRAMES = 5


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("worlds")


@pytest.fixture(scope="module")
def world(folder):
    return encoded_world("tabletop", 3, folder, FRAMES)


def test_world_has_what_the_front_end_saw_beside_its_truth(world):
    assert (world.name, len(world.frames), len(world.odometry)) == ("tabletop-3", FRAMES, FRAMES)
    np.testing.assert_array_equal(world.truth.trajectory.stamps_ns, [f.stamp_ns for f in world.frames])
    assert all(frame.observations for frame in world.frames)


def test_world_is_encoded_only_once(world, folder, monkeypatch):
    monkeypatch.setattr(module, "encode_world", None)
    again = encoded_world("tabletop", 3, folder, FRAMES)
    np.testing.assert_array_equal(
        again.frames[-1].observations[0].code.z, world.frames[-1].observations[0].code.z
    )


def test_fingerprint_follows_the_files(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "PACKAGE", tmp_path)
    (tmp_path / "slam").mkdir()
    (tmp_path / "slam" / "a.py").write_text("a = 1")
    before = fingerprint(["slam"])
    (tmp_path / "slam" / "notes.txt").write_text("no matter")
    assert fingerprint(["slam"]) == before
    (tmp_path / "slam" / "a.py").write_text("a = 2")
    assert fingerprint(["slam"]) != before


def test_run_delivers_every_frame_with_covariance_and_names_categories(world):
    estimate = run_encoded(world)
    assert [frame.stamp_ns for frame in estimate.frames] == [frame.stamp_ns for frame in world.frames]
    assert all(frame.covariance is not None for frame in estimate.frames)
    assert set(estimate.categories.values()) <= {"mug", "bottle"}
    assert NO_ID not in estimate.categories
    assert {item.object_id for item in estimate.final_map().objects} <= set(estimate.categories)

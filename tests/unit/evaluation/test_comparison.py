"""Comparisons with others, on a short world and with canned figures."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.embedding.observe import Observer
from neuse.evaluation.comparison import (
    beside_external_slam,
    beside_geometry,
    external_figures,
    geometric_figures,
    odometry_path,
    run_joined,
)
from neuse.evaluation.encoded_world import encode_world
from neuse.evaluation.external_runs import ExternalRun
from neuse.geometry import inverse
from neuse.records import Edge, EdgeKind

FRAMES = 6
NAMES = {
    "odometry",
    *(f"{name}{what}" for name in ("scans", "features") for what in ("", ", odometry", ", joined")),
}


@pytest.fixture(scope="module")
def world():
    return encode_world("tabletop", 103, Observer(), FRAMES)


class Canned:
    def over_seeds(self, variant, preset, seeds):
        return [{"ate_rmse_m": 0.1 * (i + 1), "changes": {"tp": 3, "fp": 0, "fn": 1}} for i in range(seeds)]

    def others_over_seeds(self, name, preset, seeds):
        figures = dict.fromkeys(NAMES, 0.2) if name == "external" else {"tp": 1, "fp": 2, "fn": 3}
        return [figures] * seeds


def test_every_way_to_localise_has_a_figure(world, tmp_path):
    figures = external_figures(world, tmp_path)
    assert set(figures) == NAMES
    assert all(0 <= value < 0.1 for value in figures.values())


def test_joined_run_takes_odometry_and_closures_of_the_external(world):
    truth = world.truth.trajectory
    stamps, T = truth.stamps_ns.tolist(), truth.T_frame_camera
    closure = Edge(0, 1, stamps[0], stamps[-1], EdgeKind.EXTERNAL, inverse(T[0]) @ T[-1], 1e-6 * np.eye(6))
    external = ExternalRun(world.odometry, ((),) * (FRAMES - 1) + ((closure,),), truth, 0)
    joined = run_joined(world, external)
    end = joined.trajectory().T_frame_camera
    moved = inverse(end[0]) @ end[-1]
    np.testing.assert_allclose(moved[:3, 3], (inverse(T[0]) @ T[-1])[:3, 3], atol=0.01)
    blind = replace(closure, T_from_to=closure.T_from_to @ np.diag([1.0, 1.0, -1.0, 1.0]))
    ignored = run_joined(world, replace(external, closures=((),) * (FRAMES - 1) + ((blind,),)))
    assert len(ignored.frames) == FRAMES  # what is no pose is not taken


def test_dead_reckoning_is_the_odometry(world):
    path = odometry_path(world.odometry)
    np.testing.assert_array_equal(path.T_frame_camera[-1], world.odometry[-1].T_odom_camera)


def test_geometry_finds_no_changes_where_none_are(world, tmp_path):
    assert geometric_figures(world, tmp_path) == {"tp": 0, "fp": 0, "fn": 0}


def test_tables_have_medians_and_sums():
    row = beside_external_slam(Canned(), 3).rows[0]
    assert row[1:8] == ("0.200", "0.200", "0.200", *["0.200"] * 4)
    assert beside_geometry(Canned(), 3).rows[0][1:3] == ("9 / 0 / 3", "3 / 6 / 9")

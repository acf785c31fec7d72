"""Results are computed once and kept as files."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.evaluation import results as module
from neuse.evaluation.encoded_world import EncodedWorld
from neuse.evaluation.estimate import Estimate
from neuse.evaluation.results import Results, figures, is_wrong
from neuse.evaluation.trajectory import FramePose
from neuse.evaluation.truth import Truth
from neuse.geometry import exp, inverse
from neuse.records import Edge, EdgeKind


@pytest.fixture
def estimate(helix):
    """A run without error, that had one wrong and one right loop closure."""
    frames = [
        FramePose(s, T, covariance=1e-6 * np.eye(6))
        for s, T in zip(helix.stamps_ns.tolist(), helix.T_frame_camera, strict=True)
    ]
    right = edge(helix)
    wrong = replace(right, T_from_to=right.T_from_to @ exp([0, 0, 0, 0.2, 0, 0]))
    return Estimate(tuple(frames), edges=(right, wrong), categories={0: "mug"})


def edge(helix):
    T = inverse(helix.T_frame_camera[0]) @ helix.T_frame_camera[50]
    ends = int(helix.stamps_ns[0]), int(helix.stamps_ns[50])
    return Edge(0, 50, *ends, EdgeKind.LOOP_CLOSURE, T, 1e-4 * np.eye(6), (0,))


@pytest.mark.parametrize(
    ("xi", "wrong"),
    [([0, 0, 0, 0.09, 0, 0], False), ([0, 0, 0, 0.11, 0, 0], True), ([0.18, 0, 0, 0, 0, 0], True)],
)
def test_closures_are_wrong_beyond_ten_centimetres_or_degrees(helix, xi, wrong):
    right = edge(helix)
    assert is_wrong(replace(right, T_from_to=right.T_from_to @ exp(xi)), helix) is wrong


def test_figures_count_wrong_closures_and_judge_trust(helix, estimate):
    result = figures(EncodedWorld("helix", 0, (), (), Truth(helix)), estimate)
    assert result["wrong_closures"] == 1
    assert result["trust"]["poses"]["mean"] == pytest.approx(0.0, abs=1e-6)
    assert result["trust"]["loop_closure/mug"]["n"] == 2


def test_results_are_computed_once(helix, estimate, tmp_path, monkeypatch):
    world, runs = EncodedWorld("helix", 0, (), (), Truth(helix)), []
    monkeypatch.setattr(module, "encoded_world", lambda *args: world)
    monkeypatch.setattr(module, "run_encoded", lambda *args: runs.append(args) or estimate)
    first = Results(tmp_path).get("full", "helix", 0)
    assert Results(tmp_path).get("full", "helix", 0) == first
    assert [r["wrong_closures"] for r in Results(tmp_path).over_seeds("full", "helix", 1)] == [1]
    assert len(runs) == 1


def test_seeds_begin_at_the_first_one_asked_for(helix, estimate, tmp_path, monkeypatch):
    seeds = []
    monkeypatch.setattr(
        module,
        "encoded_world",
        lambda preset, seed, *_: seeds.append(seed) or EncodedWorld(preset, seed, (), (), Truth(helix)),
    )
    monkeypatch.setattr(module, "run_encoded", lambda *_: estimate)
    Results(tmp_path, first_seed=100).over_seeds("full", "helix", 2)
    assert seeds == [100, 101]

"""A whole run's outputs; slow things (figures) are made once and looked at from many sides."""

import csv
import json
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from neuse.evaluation.estimate import Estimate
from neuse.evaluation.outputs import EDGE_COLUMNS, write_outputs
from neuse.evaluation.reconstructions import ReconstructedFrame, ReconstructedObject
from neuse.evaluation.report import summary_text
from neuse.evaluation.trajectory import FramePose, Trajectory, trajectory_of
from neuse.evaluation.truth import TrueMap, TrueObject, Truth
from neuse.geometry import exp, inverse, make_transform
from neuse.records import (
    ChangeKind,
    Edge,
    EdgeKind,
    Intrinsics,
    Keyframe,
    ObjectChange,
    ObjectMap,
    ObjectStatus,
    Observation,
    RgbdFrame,
)

FIXED_KEYS = {
    "frames": None,
    "ate_rmse_m": None,
    "rpe_trans_rmse_m": None,
    "ate_rmse_m_per_traversal": None,
    "changes": {"tp", "fp", "fn"},
    "objects": {"true", "mapped"},
    "edges": {"short_range", "loop_closure", "rejected"},
    "nees": {"mean", "dof"},
    "fps": {"front_end", "system"},
    "stage_ms": {"encode_per_object", "associate", "edge", "optimise", "decode"},
}
FILES = {
    "report.json",
    "report.html",
    "trajectory.tum",
    "edges.csv",
    "trajectory.png",
    "map.png",
    "changes.json",
}


@dataclass
class Run:
    """A made-up run: a mug stays, another one is added half way, a bottle is never found."""

    estimate: Estimate
    truth: Truth


@pytest.fixture
def run(helix: Trajectory, map_object) -> Run:
    T_map_world = inverse(helix.T_frame_camera[0])
    here, there = (make_transform(np.eye(3), [x, 0.0, 0.8]) for x in (0.0, 0.3))
    stamps_ns, middle_ns = helix.stamps_ns.tolist(), int(helix.stamps_ns[30])
    poses = T_map_world @ helix.T_frame_camera
    frames = tuple(
        FramePose(s, T, i, blind=i == 9) for i, (s, T) in enumerate(zip(stamps_ns, poses, strict=True))
    )
    keyframes = tuple(Keyframe(f.keyframe_id, f.stamp_ns, f.T_map_camera) for f in frames)
    step = inverse(poses[4]) @ poses[5] @ exp(np.full(6, 0.01))
    edge = Edge(4, 5, stamps_ns[4], stamps_ns[5], EdgeKind.SHORT_RANGE, step, np.eye(6) * 1e-4, (1, 2), 0.004)
    first = map_object(1, T_map_world @ here)
    second = map_object(2, T_map_world @ there, status=ObjectStatus.ADDED)
    added = ObjectChange(middle_ns, ChangeKind.ADDED, 2, "mug", None, T_map_world @ there)
    estimate = Estimate(
        frames,
        keyframes,
        (edge,),
        3,
        (added,),
        (ObjectMap(stamps_ns[20], (first,)), ObjectMap(middle_ns, (first, second))),
    )
    size = np.full(3, 0.1)
    objects = tuple(
        TrueObject(i, c, T, size, 9)
        for i, c, T in ((5, "mug", here), (6, "mug", there), (7, "bottle", there))
    )
    removed = ObjectChange(middle_ns, ChangeKind.REMOVED, 8, "mug", here, None)
    true_added = replace(added, object_id=6, stamp_ns=middle_ns - 1, T_map_after=there)
    truth = Truth(helix, (TrueMap(middle_ns, objects),), (true_added, removed), (stamps_ns[0], middle_ns))
    return Run(estimate, truth)


@pytest.fixture
def written(run: Run, decode, tmp_path: Path) -> tuple[Path, dict[str, Any]]:
    report = write_outputs(tmp_path / "out", "made-up <run>", run.estimate, run.truth, {"mug": decode})
    return tmp_path / "out", report


def test_all_promised_files_with_all_promised_figures_are_written(written) -> None:
    folder, report = written
    assert {path.name for path in folder.iterdir()} >= FILES
    assert json.loads((folder / "report.json").read_text()) == json.loads(json.dumps(report))
    for key, inner in FIXED_KEYS.items():
        assert key in report
        assert inner is None or inner <= report[key].keys()
    _check_figures(report)
    _check_edges(folder / "edges.csv")
    _check_changes(json.loads((folder / "changes.json").read_text()))
    _check_page(folder / "report.html")
    _check_pictures(folder)


def _check_figures(report: dict[str, Any]) -> None:
    assert report["frames"] == 60
    assert report["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert len(report["ate_rmse_m_per_traversal"]) == 2
    assert report["changes"] == {"tp": 1, "fp": 0, "fn": 1, "detected": 1}
    assert (report["objects"]["true"], report["objects"]["mapped"], report["objects"]["missed"]) == (
        3,
        2,
        (7,),
    )
    assert report["edges"] == {
        "odometry": 0,
        "short_range": 1,
        "loop_closure": 0,
        "external": 0,
        "rejected": 3,
    }
    assert report["nees"]["mean"] == pytest.approx(6.0, rel=1e-6)
    assert report["blind_pairs"] == 1


def _check_edges(path: Path) -> None:
    (row,) = csv.DictReader(path.open())
    assert tuple(row) == EDGE_COLUMNS
    assert (row["kind"], row["object_ids"], float(row["nees"])) == (
        "short_range",
        "1 2",
        pytest.approx(6.0, rel=1e-3),
    )


def _check_changes(changes: dict[str, Any]) -> None:
    (detected,), (missed,) = changes["detected"], changes["missed"]
    assert (detected["kind"], detected["object_id"], detected["correct"]) == ("added", 2, True)
    assert (missed["kind"], missed["object_id"], missed["after"]) == ("removed", 8, None)


def _check_page(path: Path) -> None:
    class Sources(HTMLParser):
        found: list[str] = []  # noqa: RUF012

        def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
            self.found += [value or "" for name, value in attributes if name in ("src", "href")]

    page = path.read_text()
    Sources().feed(page)
    assert len(Sources.found) == 3
    assert all(source.startswith("data:image/png;base64,") for source in Sources.found)
    assert "made-up &lt;run&gt;" in page


def _check_pictures(folder: Path) -> None:
    for name in ("trajectory.png", "map.png"):
        picture = cv2.imread(str(folder / name))
        assert picture is not None
        assert picture.std() > 5


def test_without_ground_truth_what_needs_it_is_null(run: Run, decode, tmp_path: Path) -> None:
    report = write_outputs(tmp_path, "run", run.estimate, None, {"mug": decode})
    assert {key for key, value in report.items() if value is None} >= {"ate_rmse_m", "rpe_trans_rmse_m"}
    assert report["changes"] == {"tp": None, "fp": None, "fn": None, "detected": 1}
    assert report["objects"] == {"true": None, "mapped": 2}
    assert report["nees"] == {"mean": None, "dof": None}
    assert "changes TP / FP / FN" in summary_text(report)
    assert {path.name for path in tmp_path.iterdir()} >= FILES


def test_ground_truth_of_another_bag_is_told_and_treated_as_none(run: Run, tmp_path: Path, caplog) -> None:
    other = Truth(Trajectory(run.truth.trajectory.stamps_ns + 10**13, run.truth.trajectory.T_frame_camera))
    estimate = replace(run.estimate, maps=(), changes=())
    assert write_outputs(tmp_path, "run", estimate, other, {})["ate_rmse_m"] is None
    assert "is it the right bag" in caplog.text


def test_run_that_saw_nothing_still_has_a_report(helix: Trajectory, tmp_path: Path) -> None:
    report = write_outputs(tmp_path, "run", Estimate(), Truth(helix), {})
    assert (report["frames"], report["ate_rmse_m"]) == (0, None)
    assert len(trajectory_of([], [])) == 0


def test_views_give_a_picture_a_table_and_shares(run: Run, decode, tmp_path: Path) -> None:
    pixels = np.full((48, 64), 0.9, dtype=np.float32)
    camera = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    frame = RgbdFrame(2 * 10**9, pixels, (pixels > 0).astype(np.int32), (), camera)
    code = run.estimate.final_map().objects[0].code
    shape = trimesh.creation.box([0.1] * 3, make_transform(np.eye(3), [0.0, 0.0, 0.95]))
    item = ReconstructedObject(
        Observation(1, 1.0, code, np.zeros((0, 3)), np.zeros(3), 9), shape, shape.vertices, np.arange(8) < 6
    )
    views = [ReconstructedFrame(frame, (item,))]
    report = write_outputs(tmp_path, "run", run.estimate, None, {"mug": decode}, views)
    assert report["reconstructions"]["enclosed_share"] == {"min": 0.75, "mean": 0.75}
    assert "75.0% (least 75.0%, 1 observations)" in summary_text(report)
    assert "<td>2.0 s</td><td>1: mug</td>" in (tmp_path / "report.html").read_text()
    assert cv2.imread(str(tmp_path / "reconstructions.png")).std() > 5


def test_without_views_there_are_no_reconstructions_in_the_report(written) -> None:
    folder, report = written
    assert report["reconstructions"] is None
    assert not (folder / "reconstructions.png").exists()

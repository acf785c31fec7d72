"""Everything that a finished run leaves in its folder: report, trajectory, edges, changes and pictures."""

import csv
import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neuse.errors import DegenerateGeometryError
from neuse.evaluation import plots
from neuse.evaluation.estimate import Estimate
from neuse.evaluation.evaluation import Evaluation, evaluate
from neuse.evaluation.map_scene import Reconstruct, SceneBuilder, level_frame, upward
from neuse.evaluation.nees import edge_nees
from neuse.evaluation.reconstruction_plots import reconstruction_figure
from neuse.evaluation.reconstructions import ReconstructedFrame, reconstructions_dict
from neuse.evaluation.report import html_page, report_dict, write_json
from neuse.evaluation.trajectory import Trajectory, tum_lines
from neuse.evaluation.truth import Truth
from neuse.geometry import Array, quaternion_xyzw, transform_points
from neuse.records import Edge, ObjectChange, ObjectMap

EDGE_COLUMNS = (
    *("from_id", "to_id", "from_stamp_ns", "to_stamp_ns", "kind"),
    *("x", "y", "z", "qx", "qy", "qz", "qw", "sigma_rotation_rad", "sigma_translation_m"),
    *("residual_m", "object_ids", "nees"),
)

_log = logging.getLogger(__name__)


def write_outputs(
    folder: Path,
    title: str,
    estimate: Estimate,
    truth: Truth | None,
    reconstruct: Mapping[str, Reconstruct],
    views: Sequence[ReconstructedFrame] = (),
) -> dict[str, Any]:
    """Evaluate a run; write report.json, report.html, trajectory.tum, edges.csv, changes.json and pictures.

    truth: None where it is not known; the figures that need it are null.    reconstruct: see SceneBuilder.
    views: frames with what was decoded from each alone.
    Returns:
        The content of report.json.
    """
    folder.mkdir(parents=True, exist_ok=True)
    evaluation = _evaluation(estimate, truth)
    builder = SceneBuilder(reconstruct, _picture_frame(estimate, evaluation))
    pictures = list(_pictures(folder, estimate, truth, evaluation, builder))
    if views:
        data = _saved(folder / "reconstructions.png", plots.png(reconstruction_figure(views)))
        pictures.append(("Observed objects and their reconstructions", data))
    report = report_dict(estimate, evaluation) | {"reconstructions": reconstructions_dict(views)}
    report["stage_ms"]["decode"] = estimate.stage_ms.get("decode", builder.decode_ms())
    write_json(folder / "report.json", report)
    write_json(folder / "changes.json", changes_dict(estimate, truth, evaluation))
    (folder / "trajectory.tum").write_text("\n".join([*tum_lines(estimate.trajectory()), ""]))
    _write_edges(folder / "edges.csv", estimate.edges, truth)
    (folder / "report.html").write_text(html_page(title, report, pictures))
    return report


def _evaluation(estimate: Estimate, truth: Truth | None) -> Evaluation | None:
    if truth is None:
        return None
    try:
        return evaluate(estimate, truth)
    except DegenerateGeometryError as error:
        _log.warning("no comparison with ground truth: %s", error)
        return None


def changes_dict(estimate: Estimate, truth: Truth | None, evaluation: Evaluation | None) -> dict[str, Any]:
    """Detected changes, each marked right or wrong where ground truth is known, and the true ones missed."""
    right = {i for i, _ in evaluation.changes.matches} if evaluation else set()
    detected = [_change_dict(change) for change in estimate.changes]
    if truth is None or evaluation is None:
        return {"detected": detected, "missed": None}
    for index, entry in enumerate(detected):
        entry["correct"] = index in right
    return {
        "detected": detected,
        "missed": [_change_dict(truth.changes[j]) for j in evaluation.changes.missed],
    }


def _change_dict(change: ObjectChange) -> dict[str, Any]:
    places = {"before": change.T_map_before, "after": change.T_map_after}
    return {
        "stamp_ns": change.stamp_ns,
        "kind": change.kind.name.lower(),
        "object_id": change.object_id,
        "category": change.category,
        **{name: None if T is None else _pose_values(T) for name, T in places.items()},
    }


def _pose_values(T: Array) -> list[float]:
    """x, y, z, qx, qy, qz, qw."""
    return np.concatenate([T[:3, 3], quaternion_xyzw(T)]).tolist()


def _write_edges(path: Path, edges: Sequence[Edge], truth: Truth | None) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(EDGE_COLUMNS)
        writer.writerows(_edge_row(edge, truth) for edge in edges)


def _edge_row(edge: Edge, truth: Truth | None) -> list[Any]:
    variances = np.diag(edge.covariance)
    sigmas = [np.sqrt(variances[:3].sum()), np.sqrt(variances[3:].sum())]
    nees = edge_nees(edge, truth.trajectory) if truth else None
    return [
        *(edge.from_id, edge.to_id, edge.from_stamp_ns, edge.to_stamp_ns, edge.kind.name.lower()),
        *(f"{value:.9g}" for value in [*_pose_values(edge.T_from_to), *sigmas, edge.residual_m]),
        " ".join(map(str, edge.object_ids)),
        "" if nees is None else f"{nees:.4g}",
    ]


def _pictures(
    folder: Path,
    estimate: Estimate,
    truth: Truth | None,
    evaluation: Evaluation | None,
    builder: SceneBuilder,
) -> Iterator[tuple[str, bytes]]:
    """(caption, PNG) for the report; the first two also as trajectory.png and map.png."""
    path = estimate.trajectory()
    if not len(path):
        return
    seen = path.transformed(builder.T_picture_map)
    yield "Camera path", _saved(folder / "trajectory.png", _trajectory_png(seen, truth, evaluation))
    if not estimate.maps:
        return
    final = builder.scene(estimate.final_map().objects)
    yield "Object map", _saved(folder / "map.png", plots.png(plots.map_figure(final, seen)))
    for change in estimate.changes:
        yield _change_caption(change), _change_png(change, estimate.maps, builder)


def _saved(path: Path, data: bytes) -> bytes:
    path.write_bytes(data)
    return data


def _picture_frame(estimate: Estimate, evaluation: Evaluation | None) -> Array:
    """Frame with z up: the world where ground truth is known, else levelled by the cameras and objects."""
    if evaluation:
        return evaluation.T_world_map
    path = estimate.trajectory()
    return level_frame(upward(estimate.final_map().objects, path.T_frame_camera)) if len(path) else np.eye(4)


def _trajectory_png(seen: Trajectory, truth: Truth | None, evaluation: Evaluation | None) -> bytes:
    if truth is None or evaluation is None:
        return plots.png(plots.trajectory_figure(seen, None, None))
    common = np.isin(seen.stamps_ns, evaluation.trajectory.stamps_ns)
    path = Trajectory(seen.stamps_ns[common], seen.T_frame_camera[common])
    return plots.png(plots.trajectory_figure(path, truth.trajectory, evaluation.trajectory.ate_m))


def _change_caption(change: ObjectChange) -> str:
    return f"{change.category} {change.object_id} {change.kind.name.lower()} at {change.stamp_ns / 1e9:.1f} s"


def _change_png(change: ObjectChange, maps: Sequence[ObjectMap], builder: SceneBuilder) -> bytes:
    """The map just before and just after the change was found."""
    earlier = [m for m in maps if m.stamp_ns < change.stamp_ns]
    later = [m for m in maps if m.stamp_ns >= change.stamp_ns]
    before = builder.scene((earlier[-1] if earlier else maps[0]).objects)
    after = builder.scene((later[0] if later else maps[-1]).objects)
    ends = [T for T in (change.T_map_before, change.T_map_after) if T is not None]
    places = [transform_points(builder.T_picture_map, T[:3, 3]) for T in ends]
    return plots.png(plots.change_figure(before, after, places, _change_caption(change)))

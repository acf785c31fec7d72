"""The report of one run: figures as JSON, tables and pictures as one HTML file."""

import base64
import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from neuse.evaluation.estimate import REPORTED_STAGES, Estimate
from neuse.evaluation.evaluation import Evaluation
from neuse.records import EdgeKind, MapObject, ObjectStatus

STYLE = """body { font: 15px/1.5 system-ui, sans-serif; color: #222 }
body { max-width: 68em; margin: 2em auto; padding: 0 1em }
table { border-collapse: collapse; margin: 1em 0; display: block; overflow-x: auto }
td, th { border: 1px solid #ccc; padding: .25em .7em } th { background: #f3f3f3; text-align: left }
img { max-width: 100% } h2 { margin-top: 1.6em } pre { overflow-x: auto } code { overflow-wrap: anywhere }
.bar { background: #738fc7; height: .9em; min-width: 1px } .bars { width: 12em }"""
PAGE = """<!DOCTYPE html>
<html lang='en'><head><meta charset='utf-8'>
<meta name='viewport' content='width=device-width, initial-scale=1'>
<title>{title}</title><style>{style}</style></head>
<body>
<h1>{title}</h1>
{body}
</body></html>
"""
RECONSTRUCTION_TEXT = (
    "Each shape is decoded from the code of this one view. Dots are the depth readings under its mask: black "
    "within 1 cm of the surface, red further away. A high share says that the surface passes by what was "
    "seen; whether the other side is right, and the object the right way up, only the pictures tell."
)


def report_dict(estimate: Estimate, evaluation: Evaluation | None) -> dict[str, Any]:
    """All figures of a run; what needs ground truth is None without it."""
    return {
        "frames": len(estimate.frames),
        "path_length_m": estimate.trajectory().length_m,
        "blind_pairs": estimate.blind_pairs(),
        **_trajectory_part(evaluation),
        "changes": _changes_part(estimate, evaluation),
        "objects": _objects_part(estimate, evaluation),
        "edges": _edges_part(estimate),
        "nees": _nees_part(evaluation),
        "fps": {"front_end": estimate.front_end_fps(), "system": estimate.system_fps()},
        "stage_ms": {stage: estimate.stage_ms.get(stage) for stage in REPORTED_STAGES}
        | dict(estimate.stage_ms),
    }


def _trajectory_part(evaluation: Evaluation | None) -> dict[str, Any]:
    """ATE of final and online poses, RPE a frame and over 1 m, ATE of every traversal aligned by itself."""
    errors = evaluation.trajectory if evaluation else None
    return {
        "ate_rmse_m": errors.ate_rmse_m if errors else None,
        "ate_online_rmse_m": evaluation.online.ate_rmse_m if evaluation else None,
        "rpe_trans_rmse_m": errors.rpe_trans_rmse_m if errors else None,
        "rpe_trans_per_m_rmse_m": errors.rpe_per_m_rmse_m if errors else None,
        "ate_rmse_m_per_traversal": [part and part.ate_rmse_m for part in evaluation.traversals]
        if evaluation
        else None,
    }


def _changes_part(estimate: Estimate, evaluation: Evaluation | None) -> dict[str, Any]:
    score = evaluation.changes if evaluation else None
    counts = {name: getattr(score, name) if score else None for name in ("tp", "fp", "fn")}
    return counts | {"detected": len(estimate.changes)}


def _objects_part(estimate: Estimate, evaluation: Evaluation | None) -> dict[str, Any]:
    """Objects clearly seen where they stand at the end, and how many of them are mapped."""
    if evaluation is None:
        return {"true": None, "mapped": len(present_objects(estimate))}
    return asdict(evaluation.objects)


def present_objects(estimate: Estimate) -> list[MapObject]:
    """The objects of the final map that are there."""
    return [item for item in estimate.final_map().objects if item.status != ObjectStatus.REMOVED]


def _edges_part(estimate: Estimate) -> dict[str, int]:
    counts = {kind.name.lower(): estimate.edge_count(kind) for kind in EdgeKind}
    return counts | {"rejected": estimate.rejected_edges}


def _nees_part(evaluation: Evaluation | None) -> dict[str, Any]:
    """NEES over short-range and loop-closure edges, and by kind."""
    if evaluation is None:
        return {"mean": None, "dof": None}
    parts = {name: asdict(nees) if nees else None for name, nees in evaluation.nees.items()}
    overall = parts.pop("all") or {"mean": None, "dof": None}
    return overall | {"by_kind": parts}


def write_json(path: Path, report: Mapping[str, Any]) -> None:
    """Write figures as JSON."""
    path.write_text(json.dumps(report, indent=2) + "\n")


def summary_rows(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The figures that matter most, as (name, value) for people."""
    traversals = report["ate_rmse_m_per_traversal"] or []
    changes, objects, edges = report["changes"], report["objects"], report["edges"]
    shapes = report.get("reconstructions")
    return [
        ("frames", f"{report['frames']} ({report['blind_pairs']} pairs joined by odometry alone)"),
        ("path", _quantity(report["path_length_m"], "m", 1)),
        ("ATE RMSE, final poses", _quantity(report["ate_rmse_m"], "m")),
        ("ATE RMSE, poses as published", _quantity(report["ate_online_rmse_m"], "m")),
        ("ATE RMSE by traversal", ", ".join(_quantity(value, "m") for value in traversals) or "-"),
        ("RPE translation, a frame", _quantity(report["rpe_trans_rmse_m"], "m")),
        ("RPE translation, over 1 m", _quantity(report["rpe_trans_per_m_rmse_m"], "m")),
        (
            "changes TP / FP / FN",
            f"{_count(changes['tp'])} / {_count(changes['fp'])} / {_count(changes['fn'])}",
        ),
        ("objects mapped / true", f"{objects['mapped']} / {_count(objects['true'])}"),
        ("edges short range / loop / refused", _edge_counts(edges)),
        ("points within 1 cm of their reconstruction", _shares(shapes)),
        ("edge NEES mean (6 is honest)", _quantity(report["nees"]["mean"], "", 2)),
        (
            "front end / system",
            " / ".join(_quantity(report["fps"][k], "fps", 1) for k in ("front_end", "system")),
        ),
    ]


def _edge_counts(edges: Mapping[str, int]) -> str:
    return f"{edges['short_range']} / {edges['loop_closure']} / {edges['rejected']}"


def _shares(shapes: Mapping[str, Any] | None) -> str:
    if shapes is None:
        return "-"
    share = shapes["enclosed_share"]
    return f"{share['mean']:.1%} (least {share['min']:.1%}, {len(shapes['instances'])} observations)"


def summary_text(report: Mapping[str, Any]) -> str:
    """The summary as an aligned table for a terminal."""
    rows = summary_rows(report)
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in rows)


def page(title: str, body: str) -> str:
    """A page that needs no other file and fits a phone.

    body: HTML.
    """
    return PAGE.format(title=html.escape(title), style=STYLE, body=body)


def html_page(title: str, report: Mapping[str, Any], pictures: Sequence[tuple[str, bytes]]) -> str:
    """The report of a run as a page.

    pictures: (caption, PNG) in order.
    """
    parts = [_table(summary_rows(report))]
    parts += [f"<h2>{html.escape(caption)}</h2>\n{_image(data)}" for caption, data in pictures]
    parts += [_reconstruction_part(report.get("reconstructions"))]
    parts += ["<h2>Mean time of each stage</h2>", _stage_table(report["stage_ms"])]
    figures = html.escape(json.dumps(report, indent=2))
    parts += [f"<details><summary>All figures</summary><pre>{figures}</pre></details>"]
    return page(title, "\n".join(part for part in parts if part))


def _reconstruction_part(shapes: Mapping[str, Any] | None) -> str:
    """How much of what was seen each reconstruction explains, and what that does not say."""
    if shapes is None:
        return ""
    header = ("seen at", "object", "distance", "depth readings", "within 1 cm of the surface")
    rows = [
        (
            f"{item['stamp_ns'] / 1e9:.1f} s",
            f"{item['label']}: {item['category']}",
            _quantity(item["range_m"], "m", 2),
            str(item["points"]),
            f"{item['enclosed_share']:.1%}",
        )
        for item in shapes["instances"]
    ]
    lines = "".join(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    heads = "".join(f"<th>{name}</th>" for name in header)
    return f"<p>{RECONSTRUCTION_TEXT}</p>\n<table><tr>{heads}</tr>{lines}</table>"


def _table(rows: Sequence[tuple[str, str]]) -> str:
    cells = (f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in rows)
    return f"<table>{''.join(cells)}</table>"


def _stage_table(stage_ms: Mapping[str, float | None]) -> str:
    """Milliseconds by stage, the longest time with the longest bar."""
    longest_ms = max((ms for ms in stage_ms.values() if ms), default=1.0)
    bar = "<div class='bar' style='width: {:.0f}%'></div>"
    rows = (
        f"<tr><th>{html.escape(name)}</th><td>{_quantity(ms, 'ms', 2)}</td>"
        f"<td class='bars'>{bar.format(100.0 * (ms or 0.0) / longest_ms)}</td></tr>"
        for name, ms in stage_ms.items()
    )
    return f"<table>{''.join(rows)}</table>"


def _image(data: bytes) -> str:
    return f"<img alt='' src='data:image/png;base64,{base64.b64encode(data).decode()}'>"


def _quantity(value: float | None, unit: str, digits: int = 4) -> str:
    return "-" if value is None else f"{value:.{digits}f} {unit}".strip()


def _count(value: int | None) -> str:
    return "-" if value is None else str(value)

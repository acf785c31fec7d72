"""The figures of an embedding as one table, beside the bars it is held to."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

USUAL, FAR = "1.5 mm", "far"  # conditions
CATEGORIES = ("mug", "bottle")  # of which there are joint figures


@dataclass(frozen=True)
class Row:
    """A figure: where `evaluate` puts it, and what it should be.

    path: keys of embedding.json; "*" stands for the condition.    category: "" if of several.
    """

    title: str
    path: tuple[str, ...]
    bar: float
    category: str = ""
    at_least: bool = False


def _pose_rows(title: str, row: str, bars: tuple[float, float], category: str = "") -> list[Row]:
    """Rotation (deg) and translation (mm) of a row of pairs."""
    return [
        Row(f"{title}: rotation, deg", ("*", row, "rotation_deg"), bars[0], category),
        Row(f"{title}: translation, mm", ("*", row, "translation_mm"), bars[1], category),
    ]


ROWS = (
    *_pose_rows("mug, handle seen, 0-30 deg apart", "mug, handle seen, 0-30", (2.5, 1.5), "mug"),
    *_pose_rows("the same, 60-180 deg apart", "mug, handle seen, 60-180", (5.0, 3.0), "mug"),
    *_pose_rows("bottle, axis", "bottle", (0.8, 2.5), "bottle"),
    *_pose_rows("mug + bottle", "mug + bottle", (1.0, 2.5)),
    *_pose_rows("2 mugs + 2 bottles", "2 mugs + 2 bottles", (0.5, 2.0)),
    Row("2.6-3.3 m: mug handle direction, deg", (FAR, "frame, mug", "handle_deg"), 8.0, "mug"),
    Row("2.6-3.3 m: mug centre, mm", (FAR, "frame, mug", "centre_mm"), 5.0, "mug"),
    Row("2.6-3.3 m: bottle axis, deg", (FAR, "frame, bottle", "axis_deg"), 2.0, "bottle"),
    Row("2.6-3.3 m: bottle centre, mm", (FAR, "frame, bottle", "centre_mm"), 5.0, "bottle"),
    Row("flips over 45 deg, mug", ("*", "flips, mug", "rate"), 0.003, "mug"),
    Row("the same, handle seen", ("*", "flips, mug with handle seen", "rate"), 0.003, "mug"),
    Row("flips over 45 deg, bottle", ("*", "flips, bottle", "rate"), 0.003, "bottle"),
    Row("descriptor, mug: equal error rate", ("*", "descriptor, mug", "eer"), 0.04, "mug"),
    Row("descriptor, bottle: equal error rate", ("*", "descriptor, bottle", "eer"), 0.04, "bottle"),
    Row("mug: 1-of-8 retrieval", ("*", "descriptor, mug", "retrieval"), 0.95, "mug", True),
    Row("bottle: 1-of-8 retrieval", ("*", "descriptor, bottle", "retrieval"), 0.95, "bottle", True),
    Row("bottle: IoU", ("bottle shape", "iou"), 0.90, "bottle", True),
    Row("mug: surface distance, mm", ("mug shape", "surface_mm"), 3.0, "mug"),
    Row("encoder, ms an object", ("speed", "encode_ms_per_object"), 6.0),
    Row("decoder, ms for 20 000 points", ("speed", "decode_20k_ms"), 30.0),
)
NEES_GROUPS = ("mug", "mug + bottle", "2 mugs + 2 bottles")
NEES_RANGE = (0.7, 1.5)


def rows_of(categories: Collection[str]) -> list[Row]:
    """The rows that are of these categories: ROWS of mugs and bottles, the same few of any others.

    Speed is that of the network, which is the same for all.
    """
    told = [row for row in ROWS if row.category in categories]
    if told:
        return [row for row in ROWS if row.category in ("", *categories)]
    return [row for category in categories for row in _rows_of_other(category)]


def _rows_of_other(category: str) -> list[Row]:
    frame, shape = f"frame, {category}", f"descriptor, {category}"
    return [
        Row(f"{category}: axis in single views, deg", ("*", frame, "axis_deg"), 2.0, category),
        Row(f"{category}: centre in single views, mm", ("*", frame, "centre_mm"), 5.0, category),
        Row(f"2.6-3.3 m: {category} axis, deg", (FAR, frame, "axis_deg"), 2.0, category),
        Row(f"2.6-3.3 m: {category} centre, mm", (FAR, frame, "centre_mm"), 5.0, category),
        Row(f"descriptor, {category}: equal error rate", ("*", shape, "eer"), 0.04, category),
        Row(f"{category}: 1-of-8 retrieval", ("*", shape, "retrieval"), 0.95, category, True),
        Row(f"{category}: IoU", (f"{category} shape", "iou"), 0.90, category, True),
        Row(f"{category}: surface distance, mm", (f"{category} shape", "surface_mm"), 3.0, category),
    ]


def markdown_table(columns: Mapping[str, tuple[Mapping[str, Any], str]], rows: Sequence[Row] = ROWS) -> str:
    """Medians (90th percentiles) as a Markdown table; bold where the bar is met.

    Args:
        columns: by heading the figures of `evaluate` and the condition of the column; figures of no
            condition stand in columns of the usual one.
    """
    lines = [["", "bar", *columns]]
    for row in rows:
        cells = [
            _cell(lookup(figures, row.path, condition), row) if "*" in row.path or condition == USUAL else ""
            for figures, condition in columns.values()
        ]
        lines.append([row.title, f"{row.bar:g}", *cells])
    return _markdown(lines)


def nees_table(figures: Mapping[str, Any], condition: str = USUAL) -> str:
    """Mean NEES per degree of freedom by view change (less is more overlap) and visibility."""
    groups = {group: figures[condition][f"nees, {group}"] for group in NEES_GROUPS}
    low, high = NEES_RANGE
    lines = [[f"NEES per degree of freedom ({low} to {high})", *groups]]
    for name in next(iter(groups.values())):
        figures_of = [bins[name] for bins in groups.values()]
        lines.append([name, *(f"{f['mean']:.2f}, n {f['n']}" if f["n"] else "-" for f in figures_of)])
    return _markdown(lines)


def lookup(figures: Mapping[str, Any], path: tuple[str, ...], condition: str) -> Any:
    """A figure by its path, None where there is none."""
    found: Any = figures
    for key in path:
        found = found.get(condition if key == "*" else key) if found is not None else None
    return found


def _cell(figure: Any, row: Row) -> str:
    median = figure["median"] if isinstance(figure, Mapping) else figure
    if median is None or math.isnan(median):
        return "-"
    met = median >= row.bar if row.at_least else median <= row.bar
    text = f"**{median:.3g}**" if met else f"{median:.3g}"
    return f"{text} ({figure['p90']:.3g}), n {figure['n']}" if isinstance(figure, Mapping) else text


def _markdown(lines: Sequence[Sequence[str]]) -> str:
    """The first line is the head; columns padded, so that the source reads as a table too."""
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    rule = [["-" * width for width in widths]]
    padded = [[cell.ljust(width) for cell, width in zip(line, widths, strict=True)] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in (padded[:1] + rule + padded[1:]))

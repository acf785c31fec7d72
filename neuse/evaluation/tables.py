"""The paper's tables on simulated worlds: our figures beside the paper's, as Markdown and as one HTML page.

    python -m neuse.evaluation.tables --out DIR [--docs FILE] [--seeds N] [--first-seed N] [--tables NAME,...]

Worlds are simulated and encoded once into DIR/worlds, runs once into DIR/results; both go by what they were
made with, so that a stopped command goes on where it was, and a changed program starts anew.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from neuse.evaluation.bench import beside_paper
from neuse.evaluation.cells import (
    change_cells,
    change_counts,
    counts_cell,
    nees_cells,
    object_cell,
    wrong_cell,
)
from neuse.evaluation.comparison import beside_external_slam, beside_geometry, coming_back
from neuse.evaluation.results import Result, Results
from neuse.evaluation.table import Table, command, write_page

SYNTHETIC = ("synthetic-planar", "synthetic-nonplanar")
REAL = ("four-round", "triple-infinity")
PRESETS = ("tabletop", *SYNTHETIC, *REAL)


@dataclass(frozen=True)
class Row:
    """One line of the localisation table: a name, how to read the figure, and what the paper has.

    paper: of the planar and of the non-planar world, mugs alone and all objects.
    """

    name: str
    value: Callable[[Result], float | None]
    paper: tuple[str, str] = ("-", "-")
    digits: int = 3
    tells_worst: bool = False


def localisation(results: Results, seeds: int) -> Table:
    """Table I: errors by traversal, mugs alone against all objects, in both modes; medians over the seeds."""
    first, second = ("0.072 / 0.043", "0.058 / 0.045"), ("0.096 / 0.071", "0.077 / 0.033")
    full, rpe = ("0.116 / 0.065", "0.091 / 0.053"), ("0.026 / 0.017", "0.024 / 0.016")
    rows = (
        Row("ATE, 1st traversal (m)", lambda r: r["ate_rmse_m_per_traversal"][0], first),
        Row("ATE, 2nd traversal (m)", lambda r: r["ate_rmse_m_per_traversal"][1], second),
        Row("ATE, full (m)", lambda r: r["ate_rmse_m"], full, tells_worst=True),
        Row("RPE, a frame (m)", lambda r: r["rpe_trans_rmse_m"], rpe),
        Row("RPE, over 1 m (m)", lambda r: r["rpe_trans_per_m_rmse_m"]),
        Row("blind pairs (%)", lambda r: _share_of_pairs(r, r["blind_pairs"]), digits=1),
        Row("pairs with odometry (%)", lambda r: _share_of_pairs(r, r["edges"]["odometry"]), digits=1),
    )
    lines = []
    for i, preset in enumerate(SYNTHETIC):
        runs = [results.over_seeds(v, preset, seeds) for v in ("paper-mugs", "paper", "full-mugs", "full")]
        lines += [(f"{preset}: {row.name}", *(_median(row, r) for r in runs), row.paper[i]) for row in rows]
    columns = ("", "paper mode, mugs", "paper mode, all", "full mode, mugs", "full mode, all")
    return Table(
        "Localisation on synthetic worlds (Table I)",
        f"Median over {seeds} seeds, in brackets the worst. Blind pairs: without a known object in sight. "
        "Paper mode takes odometry also where the objects that a pair shares tell less.",
        (*columns, "paper, mugs / all"),
        tuple(lines),
        command("localisation", seeds),
    )


def worlds(results: Results, seeds: int) -> Table:
    """The system as it is shipped on every kind of world: medians over the seeds, and the worst."""
    rows = []
    for preset in PRESETS:
        runs = results.over_seeds("full", preset, seeds)
        ate_m, rpe_m = ([run[key] for run in runs] for key in ("ate_rmse_m", "rpe_trans_rmse_m"))
        rows.append((preset, *(f"{median(values):.4f} ({max(values):.4f})" for values in (ate_m, rpe_m))))
    return Table(
        "All worlds",
        f"Full mode, all objects; median (worst) of {seeds} seeds.",
        ("", "ATE (m)", "RPE, a frame (m)"),
        tuple(rows),
        command("worlds", seeds),
    )


def changes(results: Results, seeds: int) -> Table:
    """Table IV: changes found, false and missed over all seeds, with Wilson intervals; objects mapped."""
    paper = {"synthetic-planar": "9 / 0 / 0", "four-round": "9 / 0 / 0", "triple-infinity": "7 / 1 / 0"}
    lines, total = [], np.zeros(3, dtype=int)
    for preset in PRESETS:
        runs = results.over_seeds("full", preset, seeds)
        counts = change_counts([run["changes"] for run in runs])
        total += counts
        lines.append((preset, *change_cells(counts), object_cell(runs), paper.get(preset, "-")))
    lines.append(("all", *change_cells(total), "", ""))
    return Table(
        "Change detection (Table IV)",
        f"Sums over {seeds} seeds; precision and recall with Wilson's 95 % intervals; objects mapped / to be "
        "mapped, mapped twice, and ghosts.",
        ("", "TP / FP / FN", "precision", "recall", "objects", "paper TP / FP / FN"),
        tuple(lines),
        command("changes", seeds),
    )


def trust(results: Results, seeds: int) -> Table:
    """NEES per degree of freedom by type of edge and kind of objects, and of poses; wrong loop closures."""
    runs = [r for preset in (*SYNTHETIC, *REAL) for r in results.over_seeds("full", preset, seeds)]
    names = sorted({name for run in runs for name in run["trust"]})
    lines = [(name, *nees_cells([run["trust"].get(name) for run in runs])) for name in names]
    ungated = [r for preset in (*SYNTHETIC, *REAL) for r in results.over_seeds("full-ungated", preset, seeds)]
    paper = [r for preset in SYNTHETIC for r in results.over_seeds("paper", preset, seeds)]
    told = {
        "loop closures off by over 0.10 m or 10 degrees, told": runs,
        "the same before the gates": ungated,
        "the same in the graph of paper mode, where kernels must bear them": paper,
    }
    lines += [(f"{name}: {wrong_cell(closures)}", "", "", "") for name, closures in told.items()]
    return Table(
        "Trust: are the covariances honest?",
        "Normalised estimation error squared per degree of freedom; 1 is honest, below is cautious. "
        "Poses: as published with every frame.",
        ("", "mean", "median", "n"),
        tuple(lines),
        command("trust", seeds),
    )


def ablations(results: Results, seeds: int) -> Table:
    """ATE and changes without one part at a time."""
    variants = {
        "full mode": "full",
        "odometry only when blind": "full-odometry-when-blind",
        "without refinement by surfaces, codes alone": "full-no-refinement",
        "without smooth motion": "full-no-smooth-motion",
        "without change feedback": "full-no-feedback",
        "without ambiguous objects": "full-mugs",
        "paper mode": "paper",
        "paper mode, without joint alignment of ambiguous objects": "paper-mugs",
        "paper mode, without loop closures": "paper-no-loops",
        "paper mode, the paper's association": "paper-nearest",
        "the same, without spatial proximity": "paper-no-proximity",
    }
    lines = []
    for name, variant in variants.items():
        cells = []
        for preset in (SYNTHETIC[0], REAL[1]):
            runs = results.over_seeds(variant, preset, seeds)
            cells += [
                _median(Row("", lambda r: r["ate_rmse_m"]), runs),
                counts_cell([run["changes"] for run in runs]),
            ]
        lines.append((name, *cells))
    return Table(
        "Ablations",
        f"Median ATE (m) and changes TP / FP / FN; worlds of each kind: {seeds}.",
        ("", *(f"{preset}, {figure}" for preset in (SYNTHETIC[0], REAL[1]) for figure in ("ATE", "changes"))),
        tuple(lines),
        command("ablations", seeds),
    )


def nodes(results: Results, _: int) -> Table:
    """The node graph beside the pipeline, on the first world of each preset."""
    lines = []
    for preset in PRESETS:
        pipeline, graph = results.over_seeds("full", preset, 1)[0], results.of_nodes(preset)
        figures = (_run_cells(pipeline), _run_cells(graph) if graph else ("-",) * 3)
        lines.append((preset, *(cell for pair in zip(*figures, strict=True) for cell in pair)))
    names = ("ATE (m)", "changes", "objects")
    return Table(
        "The node graph beside the pipeline",
        "One world of each kind, played at its recorded pace to the three nodes as processes; changes as "
        "TP / FP / FN; objects mapped / to be mapped.",
        ("", *(f"{name}, {system}" for name in names for system in ("pipeline", "nodes"))),
        tuple(lines),
        "make evaluate",
    )


def _run_cells(run: Result) -> tuple[str, str, str]:
    counts = counts_cell([run["changes"]])
    return f"{run['ate_rmse_m']:.3f}", counts, f"{run['objects']['mapped']} / {run['objects']['true']}"


def speed(results: Results, _: int) -> Table:
    """Times, frames a second and memory beside the paper's: see bench.py."""
    return beside_paper(results.folder.parent / "bench" / "bench.json")


def _median(row: Row, runs: Sequence[Result]) -> str:
    values = [value for run in runs if (value := row.value(run)) is not None]
    if not values:
        return "-"
    worst = f" ({max(values):.{row.digits}f})" if row.tells_worst else ""
    return f"{median(values):.{row.digits}f}{worst}"


def _share_of_pairs(run: Result, count: int) -> float:
    return 100.0 * count / (run["frames"] - 1)


TABLES: dict[str, Callable[[Results, int], Table]] = {
    "worlds": worlds,
    "localisation": localisation,
    "external": beside_external_slam,
    "changes": changes,
    "geometric": beside_geometry,
    "returns": coming_back,
    "trust": trust,
    "ablations": ablations,
    "nodes": nodes,
    "speed": speed,
}


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for worlds, results and report.html")
    parser.add_argument("--docs", type=Path, help="Markdown file to write as well")
    parser.add_argument("--seeds", type=int, default=5, help="worlds of each preset (5)")
    parser.add_argument(
        "--first-seed", type=int, default=0, help="seeds from this one on, 100 for tuning (0)"
    )
    parser.add_argument("--frames", type=int, help="only the first frames of each world (all)")
    parser.add_argument("--tables", default=",".join(TABLES), help=f"which ({','.join(TABLES)})")
    args = parser.parse_args()
    results = Results(args.out, args.frames, args.first_seed)
    tables = [TABLES[name](results, args.seeds) for name in args.tables.split(",")]
    write_page(tables, args.docs, args.out / "report.html")
    print("\n".join(table.markdown() for table in tables))


if __name__ == "__main__":
    main()

"""How fast is everything on this machine, and how it grows; the figures beside their bars.

    python -m neuse.evaluation.bench --out DIR [--preset tabletop] [--frames 120] [--minutes 10]

Writes DIR/bench.json and DIR/growth.png. Times are by the wall; `cpu` is what all threads worked together,
which says more on a busy machine. What `neuse_bags bench --out DIR` has measured of the nodes is taken in.
"""

import argparse
import json
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from neuse.evaluation.growth import association_times, optimisation_times
from neuse.evaluation.stage_times import (
    Run,
    alignment_times,
    decoding_times,
    encoder_times,
    pipeline_run,
    window_alignment_times,
)
from neuse.evaluation.table import Table
from neuse.evaluation.timing import Times

SIZES = (10, 100, 1_000, 10_000)
COLUMNS = ("", "here", "95 % within", "processor", "bar", "kept", "paper")
Figures = dict[str, Any]
Reading = Callable[[Figures], float | None]


@dataclass(frozen=True)
class Line:
    """A line of the printed table: how to read its figure, its bar, and what the paper has (RTX 2070).

    work: the same by the processor's clock, None where that says nothing.    spread: the 95th percentile.
    """

    name: str
    value: Reading
    bar: str
    within: Callable[[float], bool]
    paper: str = "-"
    work: Reading = lambda _: None
    spread: Reading = lambda _: None


def _at_most(
    name: str, most_ms: float, read: Callable[[str], Reading], key: str = "median_ms", paper: str = "-"
) -> Line:
    value, spread, work = read(key), read("p95_ms"), read(f"cpu_{key}")
    return Line(name, value, f"<= {most_ms:g}", lambda ms: ms <= most_ms, paper, work, spread)


def _stage(name: str) -> Callable[[str], Reading]:
    return lambda key: lambda figures: figures["stages"][name][key]


def _grown(name: str, size: int) -> Callable[[str], Reading]:
    return lambda key: lambda figures: figures["growth"][name].get(str(size), {}).get(key)


def _latency(key: str) -> Reading:
    return _graph("latency_to_edge_ms", key)


def _graph(*keys: str) -> Reading:
    def value(figures: Figures) -> float | None:
        found: Any = figures.get("graph")
        for key in keys:
            found = found and found.get(key)
        return found

    return value


def _told(name: str, value: Reading, work: Reading = lambda _: None) -> Line:
    return Line(name, value, "-", lambda _: True, work=work)


LINES = (
    _at_most("encoder, an object (ms)", 6, _stage("encoder"), paper="6"),
    _at_most("alignment of two views, 5 objects (ms)", 0.2, _stage("alignment"), paper="1"),
    _at_most("each of a window of ten (ms)", 0.2, _stage("window_alignment"), paper="1"),
    _at_most("decoding 20 000 points (ms)", 30, _stage("decoding"), paper="30"),
    Line("front end (fps)", lambda f: f["run"]["front_end_fps"], ">= 28", lambda fps: fps >= 28, "28"),
    Line("whole pipeline (fps)", lambda f: f["run"]["system_fps"], ">= 25", lambda fps: fps >= 25, "11"),
    Line("nodes over DDS (fps), fed with 26", _graph("fps"), ">= 25", lambda fps: fps >= 25, "11"),
    Line("their frames lost", _graph("frames_lost"), "0", lambda lost: lost == 0),
    _told("objects in a frame, mean", _graph("objects_per_frame")),
    _at_most("depth stamp to edge (ms)", 100, _latency),
    _at_most("association, 10 000 objects (ms)", 2, _grown("association", 10_000)),
    _at_most("optimisation, 10 000 keyframes, mean (ms)", 25, _grown("optimisation", 10_000), "mean_ms"),
    _at_most("the same, worst of all (ms)", 250, _grown("optimisation", 10_000), "worst_ms"),
    _told("of them in the graph at the end", lambda f: f["growth"].get("keyframes_in_graph")),
    _told("map file, an object (bytes)", lambda f: f["run"]["map_bytes_per_object"]["file"]),
    _told("code and points alone (bytes)", lambda f: f["run"]["map_bytes_per_object"]["object_alone"]),
    _told("memory of the pipeline, most (MB)", lambda f: f["run"]["peak_memory_mb"]),
    *(
        _told(
            f"memory of {node}, most (MB); processor, a frame (ms)",
            _graph("processes", node, "peak_memory_mb"),
            _graph("processes", node, "cpu_ms_per_frame"),
        )
        for node in ("encoder_node", "slam_node", "mapper_node")
    ),
)


def measure(preset: str, frames: int, sizes: Sequence[int], budget_s: float) -> Figures:
    """All figures, ready for JSON."""
    run = pipeline_run(preset, frames)
    stages = {
        "encoder": encoder_times(),
        "alignment": alignment_times(),
        "window_alignment": window_alignment_times(),
        "decoding": decoding_times(),
    }
    optimisation = optimisation_times(max(sizes), budget_s)
    at = {size: optimisation.at(size) for size in sizes}
    return {
        "machine": {
            "processor": platform.processor() or platform.machine(),
            "cores": len(os.sched_getaffinity(0)),
            "torch_threads": torch.get_num_threads(),
            "load_1min": os.getloadavg()[0],
        },
        "stages": {name: times.summary() for name, times in stages.items()},
        "run": _run_figures(run, preset),
        "growth": {
            "association": {str(size): association_times(size).summary() for size in sizes},
            "optimisation": {str(size): row for size, row in at.items() if row},
            "keyframes": len(optimisation.times.wall_ms),
            "keyframes_in_graph": optimisation.in_graph,
            "loop_closures": optimisation.loop_closures,
            "final_error_m": optimisation.error_m,
        },
    }


def _run_figures(run: Run, preset: str) -> Figures:
    with_keyframes, alone = run.map_bytes
    return {
        "world": preset,
        "frames": len(run.system.wall_ms),
        "objects_per_frame": run.objects_per_frame,
        "front_end_fps": run.front_end_fps,
        "system_fps": run.system_fps,
        "system": run.system.summary(),
        "stage_ms": {stage: Times(values, values).summary() for stage, values in run.stage_ms.items()},
        "map_bytes_per_object": {"file": with_keyframes, "object_alone": alone},
        "peak_memory_mb": run.peak_memory_mb,
    }


def table(figures: Figures) -> str:
    """The figures beside their bars, as Markdown."""
    lines = [COLUMNS, ("---",) * len(COLUMNS), *_rows(figures)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def beside_paper(path: Path) -> Table:
    """The figures of a bench.json beside the paper's; where it is missing, all but the nodes is run first."""
    if not path.exists():
        run_bench(path.parent)
    figures = json.loads(path.read_text())
    cores = figures["machine"]["cores"]
    return Table(
        "Speed",
        f"Medians on {cores} cores without a GPU, by the wall and by the processor's clock (all threads). "
        "Bars are for 2 such cores that have nothing else to do; the paper's figures are of an RTX 2070.",
        COLUMNS,
        tuple(_rows(figures)),
        "make bench",
    )


def _rows(figures: Figures) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for line in LINES:
        value = line.value(figures)
        verdict = "" if value is None or line.bar == "-" else "yes" if line.within(value) else "no"
        numbers = (_number(reading(figures)) for reading in (line.value, line.spread, line.work))
        rows.append((line.name, *numbers, line.bar, verdict, line.paper))
    return rows


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def growth_figure(growth: Mapping[str, Any]) -> Figure:
    """Milliseconds a frame over the number of objects and of keyframes, on logarithmic axes."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    bars = {"association": (2.0, "known objects"), "optimisation": (25.0, "keyframes")}
    for axes, (name, (bar_ms, label)) in zip(figure.subplots(1, 2), bars.items(), strict=True):
        rows = growth[name]
        sizes = [int(size) for size in rows]
        for key, style in (("mean_ms", "o-"), ("cpu_mean_ms", "o--"), ("worst_ms", "v:")):
            axes.plot(sizes, [row[key] for row in rows.values()], style, label=key.replace("_", " "))
        axes.axhline(bar_ms, color="tab:red", linewidth=0.8, label="bar of the mean")
        axes.set(title=f"{name}, ms a frame", xlabel=label, xscale="log", yscale="log")
        axes.legend(fontsize=8)
    return figure


def run_bench(
    out: Path,
    preset: str = "tabletop",
    frames: int = 120,
    sizes: Sequence[int] = SIZES,
    minutes: float = 10.0,
) -> Figures:
    """Measure, take in what was measured of the nodes, and write bench.json and growth.png."""
    figures = measure(preset, frames, sizes, 60.0 * minutes)
    of_nodes = out / "graph.json"
    figures["graph"] = json.loads(of_nodes.read_text()) if of_nodes.exists() else None
    out.mkdir(parents=True, exist_ok=True)
    (out / "bench.json").write_text(json.dumps(figures, indent=2) + "\n")
    growth_figure(figures["growth"]).savefig(out / "growth.png", dpi=110)
    return figures


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for bench.json and growth.png")
    parser.add_argument("--preset", default="tabletop", help="world of the pipeline's run (tabletop)")
    parser.add_argument("--frames", type=int, default=120, help="how many of its frames (120)")
    parser.add_argument("--sizes", default=",".join(map(str, SIZES)), help="objects and keyframes to grow to")
    parser.add_argument("--minutes", type=float, default=10.0, help="at most so long for the keyframes (10)")
    args = parser.parse_args()
    sizes = [int(size) for size in args.sizes.split(",")]
    print(table(run_bench(args.out, args.preset, args.frames, sizes, args.minutes)))


if __name__ == "__main__":
    main()

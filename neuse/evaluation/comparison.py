"""Figures beside those of others (Tables II and IV): SLAM without objects, changes by geometry alone."""

from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import median
from typing import Any, Protocol

from neuse.evaluation.cells import counts_cell
from neuse.evaluation.changes import score_changes
from neuse.evaluation.encoded_world import EncodedWorld
from neuse.evaluation.estimate import Estimate
from neuse.evaluation.external_runs import FEATURES, SCANS, ExternalRun, external_runs
from neuse.evaluation.external_runs import SOURCES as EXTERNAL_SOURCES
from neuse.evaluation.occupied_space import geometric_changes
from neuse.evaluation.pose_errors import trajectory_errors
from neuse.evaluation.relocalization import PRESETS as RETURN_PRESETS
from neuse.evaluation.relocalization import Return, return_figures, return_of, summary
from neuse.evaluation.run import run_encoded
from neuse.evaluation.table import Table, command
from neuse.evaluation.trajectory import FramePose, Trajectory, trajectory_of
from neuse.pipeline import Pipeline
from neuse.records import OdometrySample

SOURCES = (
    *EXTERNAL_SOURCES,
    "evaluation/comparison.py",
    "evaluation/occupied_space.py",
    "evaluation/relocalization.py",
)
PRESETS = ("four-round", "triple-infinity")
GEOMETRIC_PRESETS = ("synthetic-planar", "synthetic-nonplanar", *PRESETS)

PAPER = {  # ORB-SLAM3 joined with NeuSE; the others alone
    "four-round": "0.079 (ORB-SLAM3 0.118, CubeSLAM 0.131, EM-Fusion 0.154, objects 0.111)",
    "triple-infinity": "0.082 (ORB-SLAM3 0.101, CubeSLAM 0.147, EM-Fusion 0.193, objects 0.106)",
}
PAPER_GEOMETRIC = {"synthetic-planar": "7 / 2 / 2", "four-round": "7 / 0 / 2", "triple-infinity": "5 / 2 / 2"}

Figures = dict[str, Any]


class SeededResults(Protocol):
    """What the tables read; see results.Results."""

    def over_seeds(self, variant: str, preset: str, seeds: int) -> list[Figures]:
        """Our own results."""

    def others_over_seeds(self, name: str, preset: str, seeds: int) -> list[Figures]:
        """Figures of one of OTHERS."""


def run_joined(world: EncodedWorld, external: ExternalRun) -> Estimate:
    """Ours with the odometry and the loop closures of an external SLAM, each at its time."""
    pipeline, frames = Pipeline(), list[FramePose]()
    for observed, odometry, closures in zip(world.frames, external.odometry, external.closures, strict=True):
        frames.append(FramePose.of(pipeline.track(observed, odometry).tracked))
        pipeline.slam.add_external_edges(closures)
    pipeline.mapper.finalize()
    return Estimate(tuple(frames), pipeline.slam.keyframes, changes=pipeline.mapper.changes)


def odometry_path(samples: Iterable[OdometrySample | None]) -> Trajectory:
    """Dead reckoning, as far as there is some."""
    told = [sample for sample in samples if sample is not None]
    return trajectory_of([s.stamp_ns for s in told], [s.T_odom_camera for s in told])


def external_figures(world: EncodedWorld, folder: Path) -> Figures:
    """ATE (m) of odometry alone, and of each external alone, by its odometry alone, and joined with ours.

    folder: of the cached runs of the externals.
    """
    length = len(world.frames)
    externals = external_runs(world.preset, world.seed, folder, length)
    figures = {"odometry": _ate_m(odometry_path(world.odometry), world)}
    for name, external in externals.items():
        joined = run_joined(world, external)
        figures[f"{name}, odometry"] = _ate_m(odometry_path(external.odometry), world)
        figures[name] = _ate_m(external.trajectory, world)
        figures[f"{name}, joined"] = _ate_m(joined.trajectory(), world)
    return figures


def geometric_figures(world: EncodedWorld, _: Path) -> Figures:
    """Changes that geometry alone finds along the path that ours has estimated."""
    path = run_encoded(world).trajectory()
    found = geometric_changes(world.frames, path)
    T_world_map = trajectory_errors(path, world.truth.trajectory).T_world_map
    score = score_changes(found, world.truth.changes, T_world_map)
    return {"tp": score.tp, "fp": score.fp, "fn": score.fn}


OTHERS: dict[str, Callable[[EncodedWorld, Path], Figures]] = {
    "external": external_figures,
    "geometric": geometric_figures,
    "returns": return_figures,
}


def beside_external_slam(results: SeededResults, seeds: int) -> Table:
    """Table II: median ATE on worlds with a real sensor's faults."""
    names = ("odometry", SCANS, f"{SCANS}, joined", FEATURES, f"{FEATURES}, joined")
    rows = []
    for preset in PRESETS:
        ours = [
            _median(run["ate_rmse_m"] for run in results.over_seeds(variant, preset, seeds))
            for variant in ("full-mugs", "full", "full-odometry-when-blind")
        ]
        others = results.others_over_seeds("external", preset, seeds)
        odometry, *externals = (_median(other[name] for other in others) for name in names)
        rows.append((preset, odometry, *ours, *externals, PAPER[preset]))
    columns = (
        "",
        "odometry",
        "ours, mugs",
        "ours, all",
        "ours, all, odometry when blind",
        SCANS,
        f"{SCANS} + ours",
        FEATURES,
        f"{FEATURES} + ours",
    )
    return Table(
        "Beside other SLAM (Table II)",
        f"Median ATE (m) over {seeds} seeds. Scans: matching by small_gicp from the turn of odometry, "
        "with loop closures in a pose graph. Features: ORB and PnP with depth, without odometry, in "
        "the same graph. Joined: their odometry and loop closures enter ours as odom and external edges.",
        (*columns, "paper, joined (alone)"),
        tuple(rows),
        command("external", seeds),
    )


def beside_geometry(results: SeededResults, seeds: int) -> Table:
    """Table IV's comparison: changes found by codes and by occupied space, on the same paths."""
    rows = [
        (
            preset,
            counts_cell([run["changes"] for run in results.over_seeds("full", preset, seeds)]),
            counts_cell(results.others_over_seeds("geometric", preset, seeds)),
            PAPER_GEOMETRIC.get(preset, "-"),
        )
        for preset in GEOMETRIC_PRESETS
    ]
    return Table(
        "Changes by geometry alone (Table IV)",
        f"TP / FP / FN summed over {seeds} seeds. Geometry: occupied against free space of each object, in "
        "the manner of panoptic multi-TSDFs, along the path that ours has estimated.",
        ("", "ours", "geometry", "paper, panoptic multi-TSDF"),
        tuple(rows),
        command("geometric", seeds),
    )


def coming_back(results: SeededResults, seeds: int) -> Table:
    """Sessions that come back to a saved map when a third of the objects has moved or gone."""
    rows, everything = [], list[Return]()
    for preset in RETURN_PRESETS:
        returns = [return_of(figures) for figures in results.others_over_seeds("returns", preset, seeds)]
        everything += returns
        rows.append((preset, *summary(returns)))
    return Table(
        "Coming back to a saved map",
        f"{len(everything)} random starts that show three objects which stayed, a third of all having "
        "moved or gone; by codes alone, in ten seconds. Found: within 0.05 m and 2 degrees; wrong: off by "
        "0.10 m or 10 degrees. Medians (worst) of the time it took and of the error; changes found / false; "
        "a move of which only one place has come into sight counts as false.",
        ("", "found", "wrong", "after (s)", "error (m)", "error (degrees)", "changes"),
        (*rows, ("all", *summary(everything))),
        command("returns", seeds),
    )


def _ate_m(path: Trajectory, world: EncodedWorld) -> float:
    return trajectory_errors(path, world.truth.trajectory).ate_rmse_m


def _median(values: Iterable[float]) -> str:
    return f"{median(values):.3f}"

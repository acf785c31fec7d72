"""Coming back to a place whose map was saved: is the camera found, how soon, how well, and what has changed?

    python -m neuse.evaluation.relocalization --out DIR [--seeds N] [--first-seed N] [--presets NAME,...]

Each world is mapped once, with odometry, and its map saved. Then a third of its objects move or go, and a new
session starts at a random pose that shows three objects that stayed; until it is found it has nothing but
codes, and odometry from then on. Writes
relocalization.json and relocalization.png into DIR.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from statistics import median
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from neuse.embedding.observe import Observer
from neuse.evaluation.cache import cached
from neuse.evaluation.changes import score_changes
from neuse.evaluation.encoded_world import SOURCES, EncodedWorld, encoded_world, fingerprint
from neuse.evaluation.pose_errors import trajectory_errors
from neuse.evaluation.report import write_json
from neuse.evaluation.trajectory import trajectory_of
from neuse.geometry import Array, inverse, rotation_angle
from neuse.pipeline import Pipeline
from neuse.records import ChangeKind, ObjectChange, ObservedFrame, OdometrySample
from neuse.simulation.returning import come_back
from neuse.simulation.worlds import World, make_world, simulate

PRESETS = ("synthetic-planar", "synthetic-nonplanar", "four-round", "triple-infinity")
FRAMES = 100  # ten seconds
BAR_M, BAR_DEG = 0.05, 2.0  # an error that is still good
WRONG_M, WRONG_DEG = 0.10, 10.0  # a place further off is a wrong one


@dataclass(frozen=True)
class Return:
    """What became of one start.

    after_s: data that it took until the camera was found, None if it was not.    error_m, error_deg: of the
    pose then, and median_m, median_deg of all poses from then on.    found, false: changes that it reported.
    """

    world: str
    after_s: float | None
    error_m: float | None = None
    error_deg: float | None = None
    median_m: float | None = None
    median_deg: float | None = None
    found: int = 0
    false: int = 0

    @property
    def is_wrong(self) -> bool:
        """Whether it took one place for another."""
        far = self.error_m is not None and self.error_m > WRONG_M
        return far or (self.error_deg is not None and self.error_deg > WRONG_DEG)

    @property
    def is_good(self) -> bool:
        """Whether it found the camera within the bars."""
        return self.error_m is not None and self.error_m <= BAR_M and (self.error_deg or 0.0) <= BAR_DEG


@dataclass(frozen=True)
class Later:
    """A return as the SLAM stage meets it, and its truth. changes: from the end of the first session on."""

    frames: tuple[ObservedFrame, ...]
    odometry: tuple[OdometrySample, ...]
    T_world_camera: Array
    changes: tuple[ObjectChange, ...]


def return_figures(world: EncodedWorld, folder: Path) -> dict[str, Any]:
    """One start in the world as it is later; see `Return`."""
    path = folder / f"{world.name}.map"
    T_world_map = map_and_save(world, path)
    later = later_frames(world, folder)
    return asdict(run_return(world.name, path, T_world_map, later))


def return_of(figures: Mapping[str, Any]) -> Return:
    """What `return_figures` has said."""
    return Return(**{entry.name: figures[entry.name] for entry in fields(Return)})


def map_and_save(world: EncodedWorld, path: Path) -> Array:
    """The first session; T_world_map of the map that it leaves."""
    pipeline = Pipeline()
    for observed, odometry in zip(world.frames, world.odometry, strict=True):
        pipeline.track(observed, odometry)
    pipeline.mapper.finalize()
    pipeline.mapper.save(path)
    stamps_ns, poses = zip(*pipeline.slam.trajectory(), strict=True)
    return trajectory_errors(trajectory_of(stamps_ns, poses), world.truth.trajectory).T_world_map


def later_frames(world: EncodedWorld, folder: Path) -> Later:
    """The frames of the return from the folder's cache, where they are put if they are missing."""
    path = folder / f"{world.name}-later-{fingerprint(SOURCES)}.world.npz"
    return cached(path, Later, lambda: _come_back_later(world))


def _come_back_later(world: EncodedWorld) -> Later:
    before = make_world(world.preset, world.seed)
    after = come_back(before, 0, FRAMES)
    observer = Observer()
    frames, odometry = zip(*[(observer.observe(s.frame), s.odometry) for s in simulate(after)], strict=True)
    return Later(frames, odometry, after.trajectory.T_world_camera, true_changes(before, after))


def true_changes(before: World, after: World) -> tuple[ObjectChange, ...]:
    """What has happened between the last frame of one session and the first of the next."""
    old = {o.object_id: o for o in before.timeline.objects_at(before.frames - 1)}
    new = {o.object_id: o for o in after.timeline.initial}
    changes = []
    for object_id, was in old.items():
        now = new.get(object_id)
        if now is was:
            continue
        kind = ChangeKind.REMOVED if now is None else ChangeKind.MOVED
        T_after = None if now is None else now.T_world_object
        changes.append(ObjectChange(0, kind, object_id, was.shape.category, was.T_world_object, T_after))
    return tuple(changes)


def run_return(name: str, path: Path, T_world_map: Array, later: Later) -> Return:
    """The second session: from a random start, by codes alone until it is found."""
    pipeline, errors = Pipeline(), list[tuple[float, float]]()
    pipeline.load_map(path)
    for observed, odometry, T_world_camera in zip(
        later.frames, later.odometry, later.T_world_camera, strict=True
    ):
        frames = pipeline.track(observed, None if pipeline.joiner.is_waiting else odometry).mapped
        if frames:
            off = inverse(T_world_camera) @ T_world_map @ frames[-1].T_map_camera
            errors.append((float(np.linalg.norm(off[:3, 3])), float(np.rad2deg(rotation_angle(off[:3, :3])))))
    pipeline.mapper.finalize()
    if not errors:
        return Return(name, None)
    score = score_changes(pipeline.mapper.changes, later.changes, T_world_map)
    after_s = (later.frames[-len(errors)].stamp_ns - later.frames[0].stamp_ns) * 1e-9
    middle_m, middle_deg = np.median(errors, axis=0).tolist()
    return Return(name, after_s, *errors[0], middle_m, middle_deg, score.tp, score.fp)


def summary(returns: Sequence[Return]) -> tuple[str, ...]:
    """Starts found; wrong; seconds; errors at first and from then on, median and worst; changes."""
    found = [r for r in returns if r.after_s is not None]
    if not found:
        return (f"0 of {len(returns)}", "0", "-", "-", "-", "-")
    return (
        f"{sum(r.is_good for r in found)} of {len(returns)}",
        str(sum(r.is_wrong for r in found)),
        _middle_and_worst([r.after_s for r in found], 1),
        _middle_and_worst([r.error_m for r in found], 3),
        _middle_and_worst([r.error_deg for r in found], 2),
        f"{sum(r.found for r in found)} / {sum(r.false for r in found)}",
    )


def _middle_and_worst(values: Sequence[float | None], digits: int) -> str:
    known = [value for value in values if value is not None]
    return f"{median(known):.{digits}f} ({max(known):.{digits}f})"


def picture(returns: Sequence[Return], path: Path) -> None:
    """Seconds until found and the error then, a dot each, with the bars."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    found = [(r.after_s, 100.0 * (r.error_m or 0.0)) for r in returns if r.after_s is not None]
    axes.scatter([after_s for after_s, _ in found], [error_cm for _, error_cm in found], s=25)
    axes.axhline(100 * BAR_M, color="tab:red", linewidth=1)
    axes.set(
        xlabel="data until the camera was found (s)", ylabel="error then (cm)", xlim=(0, None), ylim=(0, None)
    )
    axes.set_title(f"{len(found)} of {len(returns)} starts in changed worlds")
    figure.savefig(path, dpi=120)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder to write into")
    parser.add_argument("--seeds", type=int, default=5, help="worlds of each preset (5)")
    parser.add_argument(
        "--first-seed", type=int, default=0, help="seeds from this one on, 100 for tuning (0)"
    )
    parser.add_argument("--presets", default=",".join(PRESETS), help=f"which ({','.join(PRESETS)})")
    args = parser.parse_args()
    matplotlib.use("Agg")
    args.out.mkdir(parents=True, exist_ok=True)
    returns = []
    for preset in args.presets.split(","):
        for seed in range(args.first_seed, args.first_seed + args.seeds):
            world = encoded_world(preset, seed, args.out / "worlds")
            returns.append(return_of(return_figures(world, args.out / "worlds")))
            print(json.dumps(asdict(returns[-1])), flush=True)
    write_json(args.out / "relocalization.json", {"starts": [asdict(r) for r in returns]})
    picture(returns, args.out / "relocalization.png")
    print(" | ".join(summary(returns)))


if __name__ == "__main__":
    main()

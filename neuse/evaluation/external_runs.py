"""What two SLAM systems without objects make of a simulated world; computed once, then cached.

They see the pictures, which an encoded world has no longer, so that the world is rendered anew.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from neuse.evaluation.cache import cached
from neuse.evaluation.encoded_world import fingerprint
from neuse.evaluation.external_slam import ExternalSlam, ExternalSlamParams, ExternalStep
from neuse.evaluation.feature_matching import FeatureMatcher
from neuse.evaluation.scan_matching import ScanMatcher
from neuse.evaluation.trajectory import Trajectory
from neuse.records import Edge, OdometrySample
from neuse.simulation.worlds import make_world, simulate

SCANS, FEATURES = "scans", "features"
MODULES = ("external_slam", "scan_matching", "feature_matching", "external_runs")
SOURCES = ("simulation", *(f"evaluation/{module}.py" for module in MODULES))


@dataclass(frozen=True)
class ExternalRun:
    """One external SLAM on one world.

    odometry: of every frame, as published at the time, None where it was lost.
    closures: of every frame, as found at the time.
    trajectory: its own best answer in the end.    lost: frames that matched nothing.
    """

    odometry: tuple[OdometrySample | None, ...]
    closures: tuple[tuple[Edge, ...], ...]
    trajectory: Trajectory
    lost: int

    @classmethod
    def of(cls, slam: ExternalSlam[Any], steps: list[ExternalStep]) -> "ExternalRun":
        """What a SLAM has delivered by now."""
        odometry, closures = zip(*((step.odometry, step.closures) for step in steps), strict=True)
        return cls(odometry, closures, slam.trajectory(), slam.lost)


def external_slams() -> dict[str, ExternalSlam[Any]]:
    """The two systems by name: scans, which start from odometry, and features, which need none."""
    by_features = ExternalSlamParams(min_overlap=0.3, closure_overlap=0.3, closure_m=1.0)
    return {SCANS: ExternalSlam(ScanMatcher()), FEATURES: ExternalSlam(FeatureMatcher(), by_features)}


def external_runs(preset: str, seed: int, folder: Path, frames: int | None = None) -> dict[str, ExternalRun]:
    """Runs of both systems from the folder's cache, where they are put if missing or out of date.

    frames: only so many first frames; None for all.
    """
    path = folder / f"{preset}-{seed}-{frames or 'all'}-{fingerprint(SOURCES)}.external.npz"
    return cached(path, dict[str, ExternalRun], lambda: run_externals(preset, seed, frames))


def run_externals(preset: str, seed: int, frames: int | None) -> dict[str, ExternalRun]:
    """Render a world and run both systems on it."""
    world, slams = make_world(preset, seed), external_slams()
    total = min(world.frames, frames or world.frames)
    steps: dict[str, list[ExternalStep]] = {name: [] for name in slams}
    progress = tqdm(simulate(world, stop=total), total=total, unit="frame", desc=f"{preset}-{seed}, external")
    for simulated in progress:
        for name, slam in slams.items():
            hint = simulated.odometry if name == SCANS else None
            steps[name].append(slam.step(simulated.frame, hint))
    return {name: ExternalRun.of(slam, steps[name]) for name, slam in slams.items()}

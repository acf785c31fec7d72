"""How fast is each stage: the in-process pipeline on simulated frames, on this machine.

python -m neuse.evaluation.bench --out DIR [--preset tabletop] [--frames 150]
"""

import argparse
import json
from collections import defaultdict
from pathlib import Path

import numpy as np

from neuse.pipeline import Pipeline
from neuse.simulation.worlds import make_world, simulate

WARM_UP_FRAMES = 10


def stage_times(preset: str, frames: int) -> dict[str, list[float]]:
    """Milliseconds of each stage, frame by frame, without the first frames, which allocate."""
    pipeline, times_ms = Pipeline(), defaultdict[str, list[float]](list)
    world = make_world(preset, seed=0)
    for index, simulated in enumerate(simulate(world, stop=min(frames, world.frames))):
        result = pipeline.step(simulated.frame, simulated.odometry)
        if index >= WARM_UP_FRAMES:
            for stage, milliseconds in result.stage_ms.items():
                times_ms[stage].append(milliseconds)
    return dict(times_ms)


def summary(times_ms: dict[str, list[float]]) -> dict[str, dict[str, float]]:
    """Mean, median and 95th percentile by stage, milliseconds."""
    return {
        stage: {
            "mean": float(np.mean(values)),
            "median": float(np.median(values)),
            "p95": float(np.percentile(values, 95)),
        }
        for stage, values in times_ms.items()
    }


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for bench.json")
    parser.add_argument("--preset", default="tabletop", help="world (tabletop)")
    parser.add_argument("--frames", type=int, default=150, help="how many frames (150)")
    args = parser.parse_args()
    figures = summary(stage_times(args.preset, args.frames))
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "bench.json").write_text(json.dumps(figures, indent=2) + "\n")
    print(f"{'stage (ms)':<20}{'mean':>9}{'median':>9}{'p95':>9}")
    for stage, row in figures.items():
        print(f"{stage:<20}{row['mean']:>9.2f}{row['median']:>9.2f}{row['p95']:>9.2f}")


if __name__ == "__main__":
    main()

"""The table of an embedding: how well its codes tell poses, shapes and their own errors, on unseen shapes.

    python -m neuse.embedding.evaluate --out out/embedding

Writes embedding.json and prints the table. With --meshes DIR the shapes are DIR/<category>/*.obj|ply|stl.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from neuse.embedding.embedding import Embedding, load_embedding
from neuse.embedding.figures import (
    PairError,
    descriptor_figures,
    flip_rate,
    handle_seen,
    nees_by_bin,
    pair_errors,
    shape_figures,
    summarise,
)
from neuse.embedding.reconstruction import decode
from neuse.embedding.sightings import CATEGORIES, PER_CATEGORY, Condition, Sighting, draw_sightings
from neuse.embedding.views import SPLIT_SEEDS
from neuse.simulation.meshes import load_meshes
from neuse.simulation.shapes import Shape, sample_shape

CONDITIONS = (
    Condition("0 mm", 0.0),
    Condition("1.5 mm", 0.0015),
    Condition("3 mm", 0.003),
    Condition("1.5 mm, mask faults", 0.0015, mask_faults=True),
    Condition("far", 0.0015, growing=True, range_m=(2.6, 3.3)),
)
GROUPS = {
    "mug": {"mug": 1},
    "bottle": {"bottle": 1},
    "mug + bottle": {"mug": 1, "bottle": 1},
    "2 mugs + 2 bottles": {"mug": 2, "bottle": 2},
}
RECONSTRUCTIONS = 60


def evaluate(
    embeddings: Mapping[str, Embedding], shapes: Mapping[str, Sequence[Shape]], n_scenes: int, seed: int = 0
) -> dict[str, Any]:
    """All figures by condition, from scenes of 2 mugs and 2 bottles in 6 views each."""
    rng = np.random.default_rng([SPLIT_SEEDS["test"], seed])
    scenes = draw_sightings(shapes, embeddings, CONDITIONS, n_scenes, 6, rng)
    errors: dict[str, dict[str, list[PairError]]] = {c.name: {g: [] for g in GROUPS} for c in CONDITIONS}
    sightings: dict[str, list[Sighting]] = {c.name: [] for c in CONDITIONS}
    for condition, seen in tqdm(scenes, total=n_scenes * len(CONDITIONS), unit="scene"):
        sightings[condition.name] += seen
        for group, n_each in GROUPS.items():
            errors[condition.name][group] += pair_errors(seen, n_each)
    figures: dict[str, Any] = {name: condition_figures(errors[name], sightings[name], rng) for name in errors}
    for category in CATEGORIES:
        own = [s for s in sightings["1.5 mm"] if s.code.category == category and s.visible > 0.6]
        sample = own[:: max(len(own) // RECONSTRUCTIONS, 1)][:RECONSTRUCTIONS]
        figures[f"{category} shape"] = shape_figures(embeddings[category], sample, rng)
    return figures | {"speed": speed(embeddings["mug"])}


def condition_figures(
    errors: Mapping[str, list[PairError]], sightings: Sequence[Sighting], rng: np.random.Generator
) -> dict[str, Any]:
    """Rows of the table under one condition."""
    seen = handle_seen(errors["mug"])
    figures: dict[str, Any] = {
        "mug, handle seen, 0-30": summarise(seen, 0, 30),
        "mug, handle seen, 60-180": summarise(seen, 60, 180),
        "mug, handle seen": summarise(seen),
        "mug, any": summarise(errors["mug"]),
        "bottle": summarise(errors["bottle"]),
        "mug + bottle": summarise(errors["mug + bottle"]),
        "2 mugs + 2 bottles": summarise(errors["2 mugs + 2 bottles"]),
        "flips, mug with handle seen": flip_rate(seen),
        "flips, bottle": flip_rate(errors["bottle"]),
        "nees, mug": nees_by_bin(errors["mug"]),
        "nees, mug + bottle": nees_by_bin(errors["mug + bottle"]),
        "nees, 2 mugs + 2 bottles": nees_by_bin(errors["2 mugs + 2 bottles"]),
    }
    for category in CATEGORIES:
        own = [s for s in sightings if s.code.category == category]
        figures[f"descriptor, {category}"] = descriptor_figures(own, rng)
    return figures


def speed(embedding: Embedding, repeats: int = 20) -> dict[str, float]:
    """Milliseconds for an object in a batch of 5 with 500 points each, and to decode 20 000 points."""
    rng = np.random.default_rng(0)
    clouds = [rng.normal(size=(500, 3)) * [0.04, 0.03, 0.05] + [0, 0, 1] for _ in range(5)]
    code = embedding.encode(clouds)[0]
    points = rng.uniform(-0.1, 0.1, (20000, 3))
    return {
        "encode_ms_per_object": _milliseconds(lambda: embedding.encode(clouds), repeats) / len(clouds),
        "decode_20k_ms": _milliseconds(lambda: decode(embedding.network, code, points), repeats),
        "threads": torch.get_num_threads(),
    }


def _milliseconds(call: Any, repeats: int) -> float:
    """Median of `repeats` calls after three to warm up."""
    for _ in range(3):
        call()
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - begun))
    return float(np.median(times))


def unseen_shapes(meshes: Path | None, n_scenes: int, seed: int = 0) -> dict[str, list[Shape]]:
    """Shapes of the test split, or the user's own."""
    if meshes is not None:
        return {category: load_meshes(meshes, category) for category in CATEGORIES}
    n = min(PER_CATEGORY * n_scenes, 400)
    return {
        category: [
            sample_shape(
                category, np.random.default_rng([SPLIT_SEEDS["test"], seed, i, *category.encode()]), "test"
            )
            for i in range(n)
        ]
        for category in CATEGORIES
    }


def print_table(figures: Mapping[str, Any]) -> None:
    """Medians (90th percentiles) of the conditions, one row a figure."""
    for condition in CONDITIONS:
        print(f"\n{condition.name}")
        for row, figure in figures[condition.name].items():
            if "rotation_deg" in figure:
                angle, shift = figure["rotation_deg"], figure["translation_mm"]
                print(
                    f"  {row:26} n {angle['n']:5d}   {angle['median']:6.2f} ({angle['p90']:6.2f}) deg"
                    f"   {shift['median']:6.2f} ({shift['p90']:6.2f}) mm"
                )
            elif not row.startswith("nees"):
                print(f"  {row:26} " + "   ".join(f"{k} {v:.4g}" for k, v in figure.items()))
    nees = figures["1.5 mm"]["nees, mug + bottle"]
    print("\nNEES per degree of freedom, mug + bottle, 1.5 mm")
    for row, figure in nees.items():
        print(f"  {row:26} n {figure['n']:5d}   mean {figure['mean']:.2f}   median {figure['median']:.2f}")
    for row in ("mug shape", "bottle shape"):
        iou, surface = figures[row]["iou"], figures[row]["surface_mm"]
        print(f"{row}: IoU {iou['median']:.3f}, surface {surface['median']:.2f} mm (n {iou['n']})")
    print("speed: " + ", ".join(f"{k} {v:.3g}" for k, v in figures["speed"].items()))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--meshes", type=Path, help="folder of DIR/<category>/*.obj|ply|stl")
    parser.add_argument("--scenes", type=int, default=120)
    parser.add_argument("--weights", type=Path, help="folder of other weights than the shipped ones")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    names = {c: arguments.weights / f"{c}.safetensors" if arguments.weights else c for c in CATEGORIES}
    embeddings = {category: load_embedding(name) for category, name in names.items()}
    shapes = unseen_shapes(arguments.meshes, arguments.scenes, arguments.seed)
    figures = evaluate(embeddings, shapes, arguments.scenes, arguments.seed)
    (arguments.out / "embedding.json").write_text(json.dumps(figures, indent=1))
    print_table(figures)


if __name__ == "__main__":
    main()

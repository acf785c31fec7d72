"""The table of an embedding: how well its codes tell poses, shapes and their own errors, on unseen shapes.

    python -m neuse.embedding.evaluate --out out/embedding

Writes embedding.json and prints the table. With --meshes DIR the shapes are DIR/<category>/*.obj|ply|stl.
"""

import argparse
import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from neuse.embedding.embedding import WEIGHTS, Embedding, LightEmbedding, load_embedding
from neuse.embedding.figures import (
    PairError,
    by_frames,
    by_latents,
    descriptor_figures,
    flip_rate,
    frame_figures,
    handle_seen,
    nees_by_bin,
    pair_errors,
    shape_figures,
    summarise,
)
from neuse.embedding.network import load_network, read_card
from neuse.embedding.reconstruction import decode
from neuse.embedding.shards import SPLIT_SEEDS
from neuse.embedding.sightings import CATEGORIES, PER_CATEGORY, Condition, Sighting, draw_sightings
from neuse.embedding.table import FAR, USUAL, markdown_table, nees_table
from neuse.errors import MeshError
from neuse.simulation.meshes import load_meshes
from neuse.simulation.shapes import Shape, sample_shape

CONDITIONS = (
    Condition("0 mm", 0.0),
    Condition(USUAL, 0.0015),
    Condition("3 mm", 0.003),
    Condition("1.5 mm, mask faults", 0.0015, mask_faults=True),
    Condition(FAR, 0.0015, growing=True, range_m=(2.6, 3.3)),
)
USUAL_RANGE = tuple(condition.name for condition in CONDITIONS if condition.name != FAR)
GROUPS = {
    "mug": {"mug": 1},
    "bottle": {"bottle": 1},
    "mug + bottle": {"mug": 1, "bottle": 1},
    "2 mugs + 2 bottles": {"mug": 2, "bottle": 2},
}
VIEWS = 6
RECONSTRUCTIONS = 60


def evaluate(
    embeddings: Mapping[str, Embedding],
    shapes: Mapping[str, Sequence[Shape]],
    n_scenes: int,
    seed: int = 0,
    conditions: Sequence[Condition] = CONDITIONS,
) -> dict[str, Any]:
    """All figures by condition, from scenes of 2 mugs and 2 bottles in 6 views each."""
    rng = np.random.default_rng([SPLIT_SEEDS["test"], seed])
    has_frames = all(embedding.network.architecture == "shipped" for embedding in embeddings.values())
    register = by_frames if has_frames else by_latents
    errors: dict[str, dict[str, list[PairError]]] = {c.name: {g: [] for g in GROUPS} for c in conditions}
    sightings: dict[str, list[Sighting]] = {c.name: [] for c in conditions}
    scenes = draw_sightings(shapes, embeddings, conditions, n_scenes, VIEWS, rng)
    for condition, seen in tqdm(scenes, total=n_scenes * len(conditions), unit="scene"):
        sightings[condition.name] += seen
        for group, n_each in GROUPS.items():
            errors[condition.name][group] += pair_errors(seen, n_each, register)
    figures: dict[str, Any] = {}
    for name, seen in sightings.items():
        figures[name] = pose_figures(errors[name])
        for category in CATEGORIES:
            own = [s for s in seen if s.code.category == category]
            figures[name][f"descriptor, {category}"] = descriptor_figures(own, rng)
            if has_frames:
                figures[name][f"frame, {category}"] = frame_figures(own)
    for category in CATEGORIES:
        sample = _reconstructed(sightings.get(USUAL, []), category)
        figures[f"{category} shape"] = shape_figures(embeddings[category], sample, rng)
    return figures | {"speed": speed(embeddings["mug"])}


def pose_figures(errors: Mapping[str, Sequence[PairError]]) -> dict[str, Any]:
    """Rows of the table that are of pairs of views, under one condition, from the errors by group."""
    seen = handle_seen(errors["mug"])
    return {
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


def _reconstructed(sightings: Sequence[Sighting], category: str) -> list[Sighting]:
    """Every so many of the well visible ones."""
    own = [s for s in sightings if s.code.category == category and s.visible > 0.6]
    return own[:: max(len(own) // RECONSTRUCTIONS, 1)][:RECONSTRUCTIONS]


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


def _milliseconds(call: Callable[[], object], repeats: int) -> float:
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
    """Shapes of the test split, or the user's own.

    Raises:
        MeshError: a category has no meshes, or one cannot be used.
    """
    if meshes is not None:
        own = {category: load_meshes(meshes, category) for category in CATEGORIES}
        for category, shapes in own.items():
            if len(shapes) < PER_CATEGORY:
                raise MeshError(
                    f"{meshes}/{category} holds {len(shapes)} meshes; a scene takes {PER_CATEGORY}"
                )
        return own
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


def load_embeddings(folder: Path, descriptors: Path | None = None) -> dict[str, Embedding]:
    """By category from FOLDER/<category>.safetensors; `descriptors` is the other half of a light variant."""
    embeddings = {c: load_embedding(folder / f"{c}.safetensors") for c in CATEGORIES}
    if descriptors is None:
        return embeddings
    return {
        c: LightEmbedding(pose.network, load_network(descriptors / f"{c}.safetensors", c))
        for c, pose in embeddings.items()
    }


def table(figures: Mapping[str, Any]) -> str:
    """The table, a column a condition, and the consistency of the uncertainties; Markdown."""
    columns = {name: (figures, name) for name in figures if name in USUAL_RANGE}
    return f"{markdown_table(columns)}\n\n{nees_table(figures)}\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--meshes", type=Path, help="folder of DIR/<category>/*.obj|ply|stl")
    parser.add_argument("--scenes", type=int, default=120)
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="folder of other than the shipped ones")
    parser.add_argument("--descriptors", type=Path, help="folder of weights by --recipe light-shape")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    embeddings = load_embeddings(arguments.weights, arguments.descriptors)
    shapes = unseen_shapes(arguments.meshes, arguments.scenes, arguments.seed)
    figures = evaluate(embeddings, shapes, arguments.scenes, arguments.seed)
    figures["scenes"], figures["shapes"] = arguments.scenes, "meshes" if arguments.meshes else "simulated"
    figures["cards"] = {c: read_card(arguments.weights / f"{c}.safetensors") for c in CATEGORIES}
    (arguments.out / "embedding.json").write_text(json.dumps(figures, indent=1))
    print(table(figures))


if __name__ == "__main__":
    main()

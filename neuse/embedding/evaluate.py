"""The table of an embedding: how well its codes tell poses, shapes and their own errors, on unseen shapes.

    python -m neuse.embedding.evaluate --out out/embedding
    python -m neuse.embedding.evaluate --out out/kettle --categories kettle --meshes DIR --weights checkpoints

Writes embedding.json and prints the table. With --meshes DIR the shapes are DIR/<category>/*.obj|ply|stl|glb.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from neuse.embedding.embedding import WEIGHTS, Embedding, LightEmbedding
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
from neuse.embedding.sightings import PER_CATEGORY, Condition, Sighting, draw_sightings
from neuse.embedding.table import CATEGORIES, FAR, USUAL, markdown_table, nees_table, rows_of
from neuse.errors import MeshError, NeuseError
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
JOINT_GROUPS = {"mug + bottle": {"mug": 1, "bottle": 1}, "2 mugs + 2 bottles": {"mug": 2, "bottle": 2}}
VIEWS = 6
RECONSTRUCTIONS = 60


def evaluate(
    embeddings: Mapping[str, Embedding],
    shapes: Mapping[str, Sequence[Shape]],
    n_scenes: int,
    seed: int = 0,
    conditions: Sequence[Condition] = CONDITIONS,
) -> dict[str, Any]:
    """All figures by condition, from scenes of two objects of each category in 6 views each."""
    rng = np.random.default_rng([SPLIT_SEEDS["test"], seed])
    has_frames = all(embedding.network.architecture == "shipped" for embedding in embeddings.values())
    register = by_frames if has_frames else by_latents
    errors: dict[str, dict[str, list[PairError]]] = {
        c.name: {group: [] for group in _groups(shapes)} for c in conditions
    }
    sightings: dict[str, list[Sighting]] = {c.name: [] for c in conditions}
    scenes = draw_sightings(shapes, embeddings, conditions, n_scenes, VIEWS, rng)
    for condition, seen in tqdm(scenes, total=n_scenes * len(conditions), unit="scene"):
        sightings[condition.name] += seen
        for group, n_each in _groups(shapes).items():
            errors[condition.name][group] += pair_errors(seen, n_each, register)
    figures: dict[str, Any] = {}
    for name, seen in sightings.items():
        figures[name] = pose_figures(errors[name])
        for category in shapes:
            own = [s for s in seen if s.code.category == category]
            figures[name][f"descriptor, {category}"] = descriptor_figures(own, rng)
            if has_frames:
                figures[name][f"frame, {category}"] = frame_figures(own)
    for category in shapes:
        sample = _reconstructed(sightings.get(USUAL, []), category)
        figures[f"{category} shape"] = shape_figures(embeddings[category], sample, rng)
    return figures | {"speed": speed(next(iter(embeddings.values())))}


def _groups(categories: Iterable[str]) -> dict[str, dict[str, int]]:
    """What poses are estimated from: single objects, and mugs and bottles jointly."""
    alone = {category: {category: 1} for category in categories}
    joint = {name: n_each for name, n_each in JOINT_GROUPS.items() if n_each.keys() <= alone.keys()}
    return alone | joint


def pose_figures(errors: Mapping[str, Sequence[PairError]]) -> dict[str, Any]:
    """Rows of the table that are of pairs of views, under one condition, from the errors by group."""
    figures: dict[str, Any] = {}
    for group, own in errors.items():
        figures |= {
            group: summarise(own),
            f"flips, {group}": flip_rate(own),
            f"nees, {group}": nees_by_bin(own),
        }
    seen = handle_seen(errors.get("mug", ()))
    return figures | {
        "mug, handle seen, 0-30": summarise(seen, 0, 30),
        "mug, handle seen, 60-180": summarise(seen, 60, 180),
        "flips, mug with handle seen": flip_rate(seen),
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


def unseen_shapes(
    meshes: Path | None, n_scenes: int, seed: int = 0, categories: Sequence[str] = CATEGORIES
) -> dict[str, list[Shape]]:
    """Shapes of the test split, or the user's own.

    Raises:
        MeshError: a category has no meshes, or one cannot be used.
        InputError: no meshes are given, and a category is not simulated.
    """
    if meshes is not None:
        own = {category: load_meshes(meshes, category) for category in categories}
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
        for category in categories
    }


def load_embeddings(
    folder: Path, descriptors: Path | None = None, *, categories: Sequence[str] = CATEGORIES
) -> dict[str, Embedding]:
    """By category from FOLDER/<category>.safetensors; `descriptors` is the other half of a light variant.

    Raises:
        WeightsError: a file is missing, damaged or of another category.
    """
    embeddings = {c: Embedding(load_network(folder / f"{c}.safetensors", c)) for c in categories}
    if descriptors is None:
        return embeddings
    return {
        c: LightEmbedding(pose.network, load_network(descriptors / f"{c}.safetensors", c))
        for c, pose in embeddings.items()
    }


def table(figures: Mapping[str, Any]) -> str:
    """The table, a column a condition, and the consistency of the uncertainties; Markdown."""
    columns = {name: (figures, name) for name in figures if name in USUAL_RANGE}
    rows = markdown_table(columns, rows_of(figures["cards"]))
    return f"{rows}\n\n{nees_table(figures)}\n" if set(figures["cards"]) == set(CATEGORIES) else f"{rows}\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--categories", nargs="+", help="(mug bottle, of which --meshes needs to have a folder for one)"
    )
    parser.add_argument("--meshes", type=Path, help="folder of DIR/<category>/*.obj|ply|stl|glb")
    parser.add_argument("--scenes", type=int, default=120)
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="folder of other than the shipped ones")
    parser.add_argument("--descriptors", type=Path, help="folder of weights by --recipe light-shape")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    try:
        print(table(_evaluated(arguments)))
    except NeuseError as error:
        parser.exit(2, f"{parser.prog}: {error}\n")


def _evaluated(arguments: argparse.Namespace) -> dict[str, Any]:
    """All figures, written to embedding.json as well."""
    arguments.out.mkdir(parents=True, exist_ok=True)
    categories = arguments.categories or _default_categories(arguments.meshes)
    embeddings = load_embeddings(arguments.weights, arguments.descriptors, categories=categories)
    shapes = unseen_shapes(arguments.meshes, arguments.scenes, arguments.seed, categories)
    figures = evaluate(embeddings, shapes, arguments.scenes, arguments.seed)
    figures["scenes"], figures["shapes"] = arguments.scenes, "meshes" if arguments.meshes else "simulated"
    figures["cards"] = {c: read_card(arguments.weights / f"{c}.safetensors") for c in categories}
    (arguments.out / "embedding.json").write_text(json.dumps(figures, indent=1))
    return figures


def _default_categories(meshes: Path | None) -> Sequence[str]:
    """Mugs and bottles, or those of the two that there are meshes of."""
    found = [c for c in CATEGORIES if meshes is not None and (meshes / c).is_dir()]
    return found or CATEGORIES


if __name__ == "__main__":
    main()

"""Train by every recipe for equally long, and write one table of what came of it.

    python -m neuse.embedding.compare --minutes 60 --out out/compare

The light variant shares its time between its two networks. A recipe that is there already in --out is not
trained again. The table goes to docs/embedding.md.
"""

import argparse
import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from neuse.embedding.evaluate import evaluate, load_embeddings, unseen_shapes
from neuse.embedding.shards import ShapeSource
from neuse.embedding.sightings import Condition
from neuse.embedding.table import CATEGORIES, FAR, ROWS, USUAL, markdown_table
from neuse.embedding.train import load_views, run
from neuse.embedding.trainer import Trainer, recipe_params

COLUMNS = {"shipped": ("shipped",), "paper": ("paper",), "light": ("light-pose", "light-shape")}
TIMED_STEPS = 3
CONDITION = Condition(USUAL, 0.0015)
TEXT = """# Recipes compared

`{command}`

Each recipe is trained for {minutes:g} minutes a category on one CPU core, with {shards} shards of 25 shapes,
and evaluated on {scenes} scenes of unseen shapes (1.5 mm depth noise, hidden as in training). Medians (90th
percentiles), n pairs of views; bold: within the bar, which is meant for the finished weights. So short a time
shows how fast a recipe learns, not how far it gets.

- **shipped**: the object's frame is supervised directly, with a shape contrast and predicted uncertainties.
- **paper**: the paper's vector-neuron encoder and losses, Horn over all 512 latent points; 64 channels.
- **light**: the appendix's two codes of 128 points, for transforms and for shapes, half the time each.

{table}

Batches made in that time: {steps}.
"""


def train_for(category: str, recipe: str, minutes: float, shards: int, data: Path, out: Path) -> int:
    """Train into out/<recipe>/<category>.safetensors for about this long; returns the number of batches."""
    folder = out / recipe
    folder.mkdir(parents=True, exist_ok=True)
    weights, done = folder / f"{category}.safetensors", folder / f"{category}.json"
    if not done.exists():
        source = ShapeSource(category)
        params = replace(recipe_params(recipe, source.symmetry), shards=shards, validation_shards=1)
        views = load_views(source, params, data)
        steps = max(int(60 * minutes / _seconds_a_step(Trainer(category, params, *views))), 1)
        run(Trainer(category, replace(params, steps=steps, warmup=max(steps // 20, 1)), *views), weights)
        done.write_text(json.dumps({"steps": steps}))
    return json.loads(done.read_text())["steps"]


def _seconds_a_step(trainer: Trainer) -> float:
    """Of this process, before the last stretch, which is slower: the share of both is reckoned with."""
    p = trainer.params
    seconds = []
    for trainer.step in (0, p.steps - 1):
        begun = time.process_time()
        for _ in range(TIMED_STEPS):
            trainer.losses(trainer.draw(), trainer.anchors())["occupancy"].backward()
        seconds.append((time.process_time() - begun) / TIMED_STEPS)
    return (1 - p.last_stretch) * seconds[0] + p.last_stretch * seconds[1]


def compare(
    minutes: float, shards: int, scenes: int, data: Path, out: Path
) -> tuple[dict[str, Any], dict[str, int]]:
    """Figures by column of the table, and batches by recipe and category."""
    steps = {
        f"{recipe} {category}": train_for(category, recipe, minutes / len(recipes), shards, data, out)
        for recipes in COLUMNS.values()
        for recipe in recipes
        for category in CATEGORIES
    }
    shapes = unseen_shapes(None, scenes)
    figures = {
        column: evaluate(load_embeddings(*(out / r for r in recipes)), shapes, scenes, conditions=[CONDITION])
        for column, recipes in COLUMNS.items()
    }
    return figures, steps


def text(
    figures: Mapping[str, Any], steps: Mapping[str, int], minutes: float, shards: int, scenes: int
) -> str:
    """The page, Markdown."""
    columns = {name: (of_column, USUAL) for name, of_column in figures.items()}
    return TEXT.format(
        command=f"python -m neuse.embedding.compare --minutes {minutes:g} --shards {shards} --scenes "
        f"{scenes}",
        minutes=minutes,
        shards=shards,
        scenes=scenes,
        table=markdown_table(columns, [row for row in ROWS if row.path[0] != FAR]),
        steps=", ".join(f"{name} {n}" for name, n in steps.items()),
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--minutes", type=float, default=60.0, help="of training, a recipe and category (60)")
    add("--shards", type=int, default=40, help="training shards of 25 shapes (40)")
    add("--scenes", type=int, default=60, help="to evaluate on (60)")
    add("--data", type=Path, default=Path("data"), help="folder of generated views (data)")
    add("--out", type=Path, default=Path("out/compare"), help="folder of the weights (out/compare)")
    add("--page", type=Path, default=Path("docs/embedding.md"), help="where the table goes")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    budget = arguments.minutes, arguments.shards, arguments.scenes
    figures, steps = compare(*budget, arguments.data, arguments.out)
    arguments.page.parent.mkdir(parents=True, exist_ok=True)
    arguments.page.write_text(text(figures, steps, *budget))


if __name__ == "__main__":
    main()

"""Cards of weights: how they came about, their figures and limits, so that no card is written by hand.

    python -m neuse.embedding.card --figures out/embedding/embedding.json

Writes neuse/weights/<category>.md from the weights' own metadata and what `evaluate` found of them, for the
categories that were evaluated.
"""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from neuse.embedding.embedding import WEIGHTS
from neuse.embedding.network import Network, load_network, read_card
from neuse.embedding.table import CATEGORIES, USUAL, markdown_table, nees_table, rows_of
from neuse.errors import InputError, NeuseError

LOSSES = {
    "shipped": "frame, occupancy, shape contrast and likelihood losses",
    "paper": "the paper's transform, occupancy and batch-hard shape losses",
}


def card_text(path: Path, figures: Mapping[str, Any]) -> str:
    """The card of a weights file, Markdown.

    Raises:
        WeightsError: the weights cannot be read.
        InputError: the figures are of other weights.
    """
    network, card = load_network(path), read_card(path)
    category = network.category
    if json.dumps(figures["cards"].get(category)) != json.dumps(card):  # which may hold NaN
        raise InputError("card", f"the figures are not of {path}; run evaluate with these weights first")
    rows = rows_of([category])
    size_m = sum(weights.numel() for weights in network.parameters()) / 1e6
    return CARD.format(
        category=category,
        recipe=card["recipe"],
        start=f" --from {card['started_from']}" if card.get("started_from") else "",
        symmetry=f"{network.symmetry.name}: {network.symmetry.meaning}",
        losses=LOSSES[network.architecture],
        batches=_batches(card) + _before(card, "step", "batches"),
        data=_data(card),
        seed=card["params"]["seed"],
        hours=f"{card['hours']}{_before(card, 'hours', 'hours')}",
        commit=card["commit"],
        size=f"{size_m:.1f} million parameters, k = {network.config.n_latent} latent points",
        scenes=figures["scenes"],
        shapes=figures["shapes"],
        table=markdown_table({"median (p90), n": (figures, USUAL)}, rows),
        consistency=f"\n{nees_table(figures)}\n" if set(figures["cards"]) >= set(CATEGORIES) else "",
        limits="\n".join(f"- {limit}" for limit in _limits(network, figures)),
    )


CARD = """# Weights: {category}

| | |
|---|---|
| recipe | `neuse train --category {category} --recipe {recipe}{start}`: {losses} |
| symmetry | {symmetry} |
| batches | {batches} |
| data | {data} |
| seed | {seed} |
| hours | {hours} |
| commit | {commit} |
| size | {size} |

## Figures

Unseen {shapes} shapes, 1.5 mm depth noise, 0.3 to 5 m, hidden in part by other objects, {scenes} scenes
of 6 views (`python -m neuse.embedding.evaluate`). Bold: within the bar.

{table}
{consistency}
## Limits

{limits}
"""


def _batches(card: Mapping[str, Any]) -> str:
    p = card["params"]
    views = f"{p['shapes_per_batch']} shapes x {p['views_per_shape']} views"
    return f"{card['step']} of {views}, {p['anchors']} then {p['anchors_last']} anchors"


def _before(card: Mapping[str, Any], name: str, unit: str) -> str:
    """What went into the weights that these began with, as far as it is known."""
    parts, before = list[str](), card.get("before")
    while before:
        parts.append(f"{before[name]}")
        before = before.get("before")
    return f", after {' and '.join(reversed(parts))} {unit} of those that it began with" if parts else ""


def _data(card: Mapping[str, Any]) -> str:
    shapes = card["shapes"] if "shapes" in card else 25 * card["params"]["shards"]  # of the first files
    return f"{shapes} shapes of the training split, 16 views each (neuse/embedding/views.py)"


def _limits(network: Network, figures: Mapping[str, Any]) -> list[str]:
    """What the symmetry leaves open, and what the figures say of hard views."""
    category, usual, limits = network.category, figures[USUAL], []
    if category == "mug":
        limits += [
            "Where the handle is hidden the direction about the axis is not known, and the third sigma says "
            f"so: over all pairs of views the rotation is {_spread(usual['mug']['rotation_deg'])} deg.",
            f"{_percent(usual['flips, mug with handle seen'])} of the pairs with a seen handle, near and "
            f"well visible, are over 45 degrees wrong; {_percent(usual['flips, mug'])} of all such pairs.",
        ]
    if network.ambiguous:
        limits += [
            "A turn about the axis is never known: two objects with different axes are needed for a pose.",
            f"{_percent(usual[f'flips, {category}'])} of the near and well visible pairs are upside down.",
            "Bodies that are not round come out round.",
        ]
    if 0 in network.symmetry.untold:
        limits += ["A code tells its centre and its shape; its rotation takes part in no pose."]
    shape = figures[f"{category} shape"]
    tried = shape["failed"] + shape["iou"]["n"]
    nothing = f"{shape['failed']} of {tried} codes decoded to nothing"
    return [*limits, f"Reconstructions: IoU {_spread(shape['iou'])}; {nothing}."]


def _spread(figure: Mapping[str, float]) -> str:
    return f"{figure['median']:.2g} (90th percentile {figure['p90']:.2g})"


def _percent(figure: Mapping[str, float]) -> str:
    return f"{100 * figure['rate']:.1f} %"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--figures", type=Path, required=True, help="embedding.json of evaluate")
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="folder of the weights and cards")
    arguments = parser.parse_args()
    figures = json.loads(arguments.figures.read_text())
    try:
        for category in figures["cards"]:
            path = arguments.weights / f"{category}.safetensors"
            path.with_suffix(".md").write_text(card_text(path, figures))
    except NeuseError as error:
        parser.exit(2, f"{parser.prog}: {error}\n")


if __name__ == "__main__":
    main()

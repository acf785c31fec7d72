"""Compare what a run recorded with ground truth, and write report, tables and pictures into a folder.

DIR gets report.json, report.html, trajectory.tum, edges.csv, changes.json, trajectory.png, map.png and
reconstructions.png. Places in the map are compared with the world through the SE(3) alignment of the final
camera path. Without ground truth in BAG the figures that need it are null.
"""

import argparse
from collections.abc import Mapping, Sequence, Set
from pathlib import Path

from neuse.embedding.embedding import Embedding, load_embeddings, shipped_categories
from neuse.errors import BagError
from neuse.evaluation.map_scene import Reconstruct
from neuse.evaluation.outputs import write_outputs
from neuse.evaluation.report import summary_text
from neuse_bags.cli import add_weights, command_parser, run_command
from neuse_bags.recording import read_estimate, read_truth
from neuse_bags.views import read_observed, read_views

RECORDING = "recording.mcap"


def evaluate(args: argparse.Namespace) -> None:
    """The command."""
    print(evaluate_recording(args.recording, args.truth, args.out, args.weights))


def evaluate_recording(
    recording: Path, truth_bag: Path, folder: Path, weights: Sequence[Path] = (), namespace: str = ""
) -> str:
    """Write all outputs of a recorded run; returns the summary for people.

    weights: files of categories that are not shipped.    namespace: of the camera in the truth's bag.
    """
    estimate, truth = read_estimate(recording), read_truth(truth_bag, namespace)
    observed = read_observed(recording)
    mapped = (item.category for item in estimate.final_map().objects)
    seen = (o.code.category for frame in observed for o in frame.observations)
    decoders = _decoders({*mapped, *seen}, load_embeddings([*shipped_categories(), *weights]))
    views = read_views(truth_bag, observed, decoders, namespace)
    return summary_text(write_outputs(folder, recording.stem, estimate, truth, decoders, views))


def refuse_overwriting(bag: Path, recording: Path) -> None:
    """Raises BagError where the recording of a run would be written over the bag that is run."""
    if bag.resolve() == recording.resolve():
        raise BagError(f"{bag} would be overwritten by the recording of its own run; choose another --out")


def _decoders(categories: Set[str], embeddings: Mapping[str, Embedding]) -> Mapping[str, Reconstruct]:
    """Decoders of the categories that have weights; objects of others are drawn as boxes."""
    for category in sorted(categories - embeddings.keys()):
        print(f"evaluate: objects of category {category} are drawn as boxes; --weights names their decoder")
    return {name: embeddings[name].reconstruct for name in sorted(categories & embeddings.keys())}


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    made = command_parser("evaluate", __doc__)
    made.add_argument("recording", type=Path, metavar="RECORDING", help="bag with the topics of a run")
    made.add_argument(
        "--truth",
        type=Path,
        required=True,
        metavar="BAG",
        help="bag that was played, with ground truth if known",
    )
    made.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write into")
    add_weights(made)
    return made


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    return run_command(parser(), evaluate, argv)

"""Train the network of one category in simulation (NeuSE III-D).

    neuse train --category mug
    neuse train --category kettle --meshes DIR     (DIR/*.obj|ply|stl|glb or DIR/kettle/*)
    torchrun --nproc-per-node 4 -m neuse.embedding.train --category mug

The learning rate stays on a plateau and falls in the last stretch of `--steps` batches, so that a finished
run can be prolonged (`--resume --steps MORE`). A batch is a pure function of seed, step and process, so a run
that was stopped goes on from its checkpoint (`--resume`) exactly as if it had not been. A GPU is used where
there is one.
"""

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import torch
from tqdm import tqdm

from neuse.embedding.calibration import calibrate
from neuse.embedding.dataset import ViewSet
from neuse.embedding.embedding import WEIGHTS, weights_file
from neuse.embedding.encoder import FrameBlock
from neuse.embedding.network import Network, load_network, save_network
from neuse.embedding.parallel import ALONE, Group, join_group, leave_group
from neuse.embedding.pictures import save_curves, save_reconstructions
from neuse.embedding.shards import ShapeSource, ensure_shards
from neuse.embedding.trainer import RECIPES, Trainer, TrainParams, params_of, read_checkpoint, recipe_params
from neuse.embedding.validation import validate
from neuse.embedding.views import ViewParams
from neuse.errors import NeuseError, WeightsError
from neuse.simulation.shapes import categories
from neuse.symmetry import SYMMETRIES, Symmetry, symmetry_named

VALIDATE_EVERY = 500  # steps


def load_views(
    source: ShapeSource, params: TrainParams, folder: Path, group: Group = ALONE
) -> tuple[ViewSet, ViewSet]:
    """Training and validation views; the first process draws those that are missing.

    Raises:
        InputError: the folder holds shards that were drawn otherwise.
    """

    def paths(split: str, n: int) -> list[Path]:
        return ensure_shards(folder, source, split, n, ViewParams())

    wanted = {"train": params.shards, "validation": params.validation_shards}
    if group.is_first:
        for split, n in wanted.items():
            paths(split, n)
    group.wait()
    train_set, validation_set = (ViewSet(paths(split, n), source.symmetry) for split, n in wanted.items())
    return train_set, validation_set


def run(trainer: Trainer, weights: Path, every: int = VALIDATE_EVERY) -> None:
    """Train to the last step or until `stop_after_step`, validating and saving on the way and at the end.

    Beside the weights lie a checkpoint, <category>_curves.png and <category>_reconstructions.png.
    """
    params, first = trainer.params, trainer.group.is_first
    progress = tqdm(
        total=params.steps, initial=trainer.step, desc=trainer.category, unit="step", disable=not first
    )
    begun = time.monotonic() - trainer.seconds
    while trainer.step < params.steps and not trainer.group.any(trainer.stopping):
        trainer.train_step()
        trainer.seconds = time.monotonic() - begun
        progress.update()
        progress.set_postfix({name: f"{loss:.3f}" for name, loss in trainer.running.items()}, refresh=False)
        if first and (trainer.step % every == 0 or trainer.step == params.steps):
            figures = validate(trainer.network, trainer.validation_set)
            trainer.history.append({"step": trainer.step, **trainer.running, **figures})
            progress.write(_line(trainer))
            trainer.save_checkpoint(weights.with_suffix(".ckpt"))
            save_curves(trainer.history, weights.with_name(f"{trainer.category}_curves.png"))
    progress.close()
    if first:
        _finish(trainer, weights)


def _line(trainer: Trainer) -> str:
    """Losses, figures and time left, for people and logs."""
    last = trainer.history[-1]
    figures = "  ".join(f"{name} {value:.4g}" for name, value in last.items() if name != "step")
    left_min = trainer.seconds / trainer.step * (trainer.params.steps - trainer.step) / 60
    return f"{trainer.category} {trainer.step}/{trainer.params.steps}  {figures}  {left_min:.0f} min left"


def _finish(trainer: Trainer, weights: Path) -> None:
    if trainer.step < trainer.params.steps:
        print(f"{trainer.category}: stopped at step {trainer.step}; go on with --resume", file=sys.stderr)
    trainer.save_checkpoint(weights.with_suffix(".ckpt"))
    calibrate(trainer.network, trainer.validation_set)
    save_network(trainer.network, weights, trainer.card())
    pictures = weights.with_name(f"{trainer.category}_reconstructions.png")
    save_reconstructions(load_network(weights), trainer.validation_set, pictures)  # which is not compiled


def main(argv: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    argv = sys.argv[1:] if argv is None else argv
    parser = _parser()
    arguments = _checked(parser, parser.parse_args(argv))
    try:
        return train(arguments) if arguments.category else _train_all(argv)
    except NeuseError as error:
        parser.exit(2, f"{parser.prog}: {error}\n")
    except KeyboardInterrupt:
        parser.exit(130, f"{parser.prog}: stopped; the same command goes on with the views drawn so far\n")


def train(arguments: argparse.Namespace) -> int:
    """Train as the command line asks for."""
    torch.set_num_threads(arguments.threads)
    arguments.out.mkdir(parents=True, exist_ok=True)
    weights = arguments.out / f"{arguments.category}.safetensors"
    resumed = arguments.resume and weights.with_suffix(".ckpt").exists()
    start = arguments.start and weights_file(arguments.start)
    if start:
        load_network(start)  # fails now rather than after the views have been drawn
    group = join_group()
    source = _source(arguments)
    params = _params(arguments, source.symmetry, weights.with_suffix(".ckpt") if resumed else None)
    trainer = Trainer(arguments.category, params, *load_views(source, params, arguments.data, group), group)
    if resumed:
        trainer.load_checkpoint(weights.with_suffix(".ckpt"))
    elif start:
        trainer.start_from(start)
    if arguments.compile:
        compile_blocks(trainer.network)
    for stop in (signal.SIGTERM, signal.SIGINT):  # a shell's background processes would ignore SIGINT
        signal.signal(stop, trainer.stop_after_step)
    run(trainer, weights)
    if arguments.install and group.is_first and trainer.step == params.steps:
        shutil.copyfile(weights, WEIGHTS / weights.name)
    leave_group(group)
    return 0


def compile_blocks(network: Network) -> None:
    """Compile what most of the time goes into, when it is called first."""
    for module in network.modules():
        if isinstance(module, FrameBlock):
            module.compile()


def _source(arguments: argparse.Namespace) -> ShapeSource:
    told = symmetry_named(arguments.symmetry) if arguments.symmetry else None
    source = ShapeSource(arguments.category, arguments.meshes, told)
    if arguments.meshes and not told:
        symmetry = source.symmetry
        print(f"{source.category}: symmetry {symmetry.name} ({symmetry.meaning}); --symmetry overrules this")
    return source


def _params(arguments: argparse.Namespace, symmetry: Symmetry, checkpoint: Path | None) -> TrainParams:
    """Those of the checkpoint or of the recipe, with what the command line asks for."""
    if checkpoint is None:
        params = recipe_params(arguments.recipe or TrainParams().recipe, symmetry)
    else:
        params = params_of(checkpoint, read_checkpoint(checkpoint))
        if arguments.seed not in (None, params.seed):
            raise WeightsError(f"{checkpoint} has seed {params.seed}; leave out --seed, or --resume")
    given = {name: getattr(arguments, name) for name in ("recipe", "steps", "shards", "seed")}
    return replace(params, **{name: value for name, value in given.items() if value is not None})


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="neuse train", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add, default = parser.add_argument, TrainParams()
    add("--category", help=f"{', '.join(categories())} or, with --meshes, any; left out: all of the former")
    add("--recipe", choices=RECIPES, help=f"({default.recipe})")
    add("--meshes", type=Path, help="folder of obj, ply, stl or glb files; every fifth is held out")
    add("--symmetry", choices=SYMMETRIES, help="of the meshes (found from them; see docs/categories.md)")
    add("--steps", type=int, help=f"batches ({default.steps})")
    add("--shards", type=int, help=f"training shards of 25 shapes ({default.shards})")
    add("--seed", type=int, help="of weights and batches (0)")
    add("--data", type=Path, help="folder of generated views (data, or data/meshes)")
    add("--out", type=Path, default=Path("checkpoints"), help="folder (checkpoints)")
    add("--install", action="store_true", help="put finished weights into the library")
    add("--from", dest="start", metavar="WEIGHTS", help="begin with these: a shipped category or a file")
    add("--resume", action="store_true", help="go on from the checkpoint in --out")
    add("--threads", type=int, default=1, help="of torch (1)")
    add("--compile", action="store_true", help="a sixth faster, after a minute of compiling")
    return parser


def _checked(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> argparse.Namespace:
    """With the default of --data; ends the program where options contradict each other."""
    if arguments.meshes is None and arguments.category not in (None, *categories()):
        parser.error(f"no simulated shapes of {arguments.category!r}; give --meshes DIR")
    if arguments.category is None and (arguments.meshes or "RANK" in os.environ):
        parser.error("with --meshes or torchrun, name one --category")
    if arguments.threads < 1:
        parser.error(f"--threads {arguments.threads}: give 1 or more")
    if arguments.symmetry and not arguments.meshes:
        parser.error("--symmetry is told of --meshes; that of simulated shapes is known")
    if arguments.category and not re.fullmatch(r"[\w-]+", arguments.category):
        parser.error(f"--category {arguments.category!r} is to name files; use letters, digits, _ and -")
    arguments.data = arguments.data or Path("data") / ("meshes" if arguments.meshes else "")
    return arguments


def _train_all(argv: Sequence[str]) -> int:
    """Every category in a process of its own, one a core at a time; 0 if all have ended well."""
    command = [sys.executable, "-m", "neuse.embedding.train", *argv, "--category"]
    pool = ThreadPoolExecutor(os.cpu_count())
    try:
        codes = pool.map(lambda category: subprocess.call([*command, category]), categories())
        return max(abs(code) for code in codes)  # of one that was killed it is negative
    finally:
        pool.shutdown(cancel_futures=True)  # Ctrl-C has reached those that run, too; they save


if __name__ == "__main__":
    sys.exit(main())

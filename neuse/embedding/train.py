"""Train the network of one category in simulation (NeuSE III-D).

    python -m neuse.embedding.train --category mug

The learning rate stays on a plateau and falls in the last stretch of `--steps` batches, so that a finished
run can be prolonged (`--resume --steps MORE`). A batch is a pure function of seed and step, so a run that was
stopped goes on from its checkpoint (`--resume`) exactly as if it had not been.
"""

import argparse
import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from neuse.embedding.calibration import calibrate
from neuse.embedding.dataset import Batch, ViewSet
from neuse.embedding.embedding import WEIGHTS
from neuse.embedding.encoder import EncoderConfig, FrameBlock
from neuse.embedding.losses import encoding_losses, occupancy_loss
from neuse.embedding.network import Network, save_network
from neuse.embedding.validation import validate
from neuse.embedding.views import ViewParams, ensure_shards
from neuse.params import CheckedParams, param
from neuse.simulation.shapes import categories, is_ambiguous


@dataclass(frozen=True)
class TrainParams(CheckedParams):
    """One training run."""

    steps: int = param(20000, "batches", 1)
    shapes_per_batch: int = param(16, "N of the paper", 2)
    views_per_shape: int = param(4, "M of the paper", 2)
    n_points: int = param(512, "points of a view", 32)
    anchors: int = param(96, "anchors of a view, until the last stretch", 16)
    anchors_last: int = param(256, "anchors of a view in the last stretch", 16)
    last_stretch: float = param(0.2, "share of the steps", 0.0, 1.0)
    queries: int = param(48, "occupancy queries of a view", 1)
    lr: float = param(1e-3, "highest learning rate", 0.0, 1.0)
    warmup: int = param(300, "steps until it", 1)
    decay: float = param(0.4, "share of the steps in which it falls to a hundredth", 0.0, 1.0)
    weight_decay: float = param(1e-3, "of AdamW", 0.0, 1.0)
    frame_weight: float = param(3.0, "weight of the frame loss", 0.0)
    occupancy_weight: float = param(1.0, "weight of the occupancy loss", 0.0)
    shape_weight: float = param(0.3, "weight of the shape contrast", 0.0)
    sigma_weight: float = param(0.1, "weight of the likelihood", 0.0)
    shards: int = param(200, "training shards of 25 shapes", 1)
    validation_shards: int = param(6, "validation shards", 1)
    seed: int = param(0, "of weights and batches", 0)


class Trainer:
    """Network, optimiser and the step that they are at."""

    def __init__(self, category: str, params: TrainParams, data: Path) -> None:
        self.params, self.category = params, category
        torch.manual_seed(params.seed)
        ambiguous = is_ambiguous(category)
        self.network = Network(category, ambiguous, EncoderConfig(n_points=params.n_points))
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(),
            lr=params.lr,
            weight_decay=params.weight_decay,
            betas=(0.9, 0.98),
            fused=True,
        )
        self.step, self.seconds, self.stopping = 0, 0.0, False
        self.history: list[dict[str, float]] = []
        view_params = ViewParams()
        self.train_set = ViewSet(
            ensure_shards(data, category, "train", params.shards, view_params), ambiguous
        )
        self.validation_set = ViewSet(
            ensure_shards(data, category, "validation", params.validation_shards, view_params), ambiguous
        )

    def train_step(self) -> dict[str, float]:
        """One batch; returns the losses."""
        params = self.params
        rng = np.random.default_rng([params.seed, self.step])
        batch = self.train_set.draw(
            rng, params.shapes_per_batch, params.views_per_shape, params.n_points, params.queries
        )
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate()
        losses = self.losses(batch, self.anchors())
        weights = {
            "frame": params.frame_weight,
            "occupancy": params.occupancy_weight,
            "shape": params.shape_weight,
            "sigma": params.sigma_weight,
        }
        total = sum((weights[name] * loss for name, loss in losses.items()), torch.zeros(()))
        self.optimizer.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimizer.step()
        self.step += 1
        return {name: float(loss.detach()) for name, loss in losses.items()}

    def losses(self, batch: Batch, n_anchors: int) -> dict[str, Tensor]:
        """All losses of a batch by name."""
        with torch.autocast("cpu", torch.bfloat16):
            encoding = self.network.encode(batch.points, n_anchors)
            z = self.network.latent(encoding).float()  # (B, 3, k)
            center = encoding.frame[..., 0].float()  # (B, 3)
            logits = self.network.decoder(batch.queries - center[:, None], z - center[..., None])
        losses = encoding_losses(encoding, batch.target, batch.shape, self.network.ambiguous)
        return losses | {"occupancy": occupancy_loss(logits.float(), batch.occupied)}

    def stop_after_step(self, *_: object) -> None:
        """Signal handler: an exception within a step would leave weights and optimiser at odds."""
        self.stopping = True

    def learning_rate(self) -> float:
        """Warm-up, plateau, then linearly down to a hundredth."""
        p = self.params
        left = (p.steps - self.step) / max(p.decay * p.steps, 1.0)
        return p.lr * min(1.0, (self.step + 1) / p.warmup) * (0.01 + 0.99 * min(1.0, left))

    def anchors(self) -> int:
        """Anchors at this step."""
        p = self.params
        return p.anchors_last if self.step >= (1 - p.last_stretch) * p.steps else p.anchors

    def save_checkpoint(self, path: Path) -> None:
        """Everything that a resumed run needs."""
        state = {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "seconds": self.seconds,
            "history": self.history,
            "params": asdict(self.params),
        }
        partial = path.with_suffix(".partial")
        torch.save(state, partial)
        partial.rename(path)

    def load_checkpoint(self, path: Path) -> None:
        """Go on from where `save_checkpoint` was called."""
        state = torch.load(path, weights_only=True)
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.seconds, self.history = state["step"], state["seconds"], state["history"]

    def card(self) -> dict[str, object]:
        """How the weights came about."""
        commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True)
        return {
            "recipe": "shipped",
            "category": self.category,
            "params": asdict(self.params),
            "step": self.step,
            "hours": round(self.seconds / 3600, 2),
            "commit": commit.stdout.strip(),
            "validation": self.history[-1] if self.history else {},
        }


def checkpoint_params(path: Path) -> TrainParams:
    """The parameters of the run that a checkpoint belongs to."""
    return TrainParams(**torch.load(path, weights_only=True)["params"])


def run(trainer: Trainer, checkpoint: Path, weights: Path, every: int = 500) -> None:
    """Train to the last step or until `stop_after_step`, validating and saving on the way and at the end."""
    progress = tqdm(total=trainer.params.steps, initial=trainer.step, desc=trainer.category, unit="step")
    running: dict[str, float] = {}
    begun = time.monotonic() - trainer.seconds
    while trainer.step < trainer.params.steps and not trainer.stopping:
        losses = trainer.train_step()
        running = {name: 0.98 * running.get(name, loss) + 0.02 * loss for name, loss in losses.items()}
        trainer.seconds = time.monotonic() - begun
        progress.update()
        progress.set_postfix({name: f"{loss:.3f}" for name, loss in running.items()}, refresh=False)
        if trainer.step % every == 0 or trainer.step == trainer.params.steps:
            figures = validate(trainer.network, trainer.validation_set)
            trainer.history.append({"step": trainer.step, **running, **figures})
            progress.write(json.dumps({k: round(v, 4) for k, v in trainer.history[-1].items()}))
            trainer.save_checkpoint(checkpoint)
    if trainer.stopping:
        progress.write(f"stopped at step {trainer.step}; go on with --resume")
    progress.close()
    trainer.save_checkpoint(checkpoint)
    calibrate(trainer.network, trainer.validation_set)
    save_network(trainer.network, weights, trainer.card())


def main() -> None:
    """Command line."""
    arguments = _arguments()
    if arguments.category is None:
        sys.exit(_train_all())
    torch.set_num_threads(arguments.threads)
    if arguments.compile:
        FrameBlock.forward = torch.compile(FrameBlock.forward)  # type: ignore[method-assign]
    arguments.out.mkdir(parents=True, exist_ok=True)
    checkpoint = arguments.out / f"{arguments.category}.ckpt"
    weights = arguments.out / f"{arguments.category}.safetensors"
    resumed = arguments.resume and checkpoint.exists()
    params = checkpoint_params(checkpoint) if resumed else TrainParams()
    given = {name: getattr(arguments, name) for name in ("steps", "shards", "seed")}
    params = replace(params, **{name: value for name, value in given.items() if value is not None})
    trainer = Trainer(arguments.category, params, arguments.data)
    if resumed:
        trainer.load_checkpoint(checkpoint)
    for stop in (signal.SIGTERM, signal.SIGINT):  # a shell's background processes would ignore SIGINT
        signal.signal(stop, trainer.stop_after_step)
    run(trainer, checkpoint, weights)
    if arguments.install and trainer.step == params.steps:
        shutil.copyfile(weights, WEIGHTS / weights.name)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--category", choices=categories(), help="left out: all, one process each")
    parser.add_argument("--steps", type=int, help=f"batches ({TrainParams().steps})")
    parser.add_argument("--shards", type=int, help=f"training shards of 25 shapes ({TrainParams().shards})")
    parser.add_argument("--seed", type=int, help="of weights and batches (0)")
    parser.add_argument("--data", type=Path, default=Path("data"), help="folder of generated views (data)")
    parser.add_argument("--out", type=Path, default=Path("checkpoints"), help="folder (checkpoints)")
    parser.add_argument("--install", action="store_true", help="put finished weights into the library")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint in --out")
    parser.add_argument("--threads", type=int, default=1, help="of torch (1)")
    parser.add_argument("--compile", action="store_true", help="a sixth faster, after a minute of compiling")
    return parser.parse_args()


def _train_all() -> int:
    """Every category in a process of its own; the largest exit code."""
    command = [sys.executable, "-m", "neuse.embedding.train", *sys.argv[1:]]
    processes = [subprocess.Popen([*command, "--category", category]) for category in categories()]
    try:
        return max(process.wait() for process in processes)
    except KeyboardInterrupt:
        return max(process.wait() for process in processes)  # Ctrl-C has reached them too; they save


if __name__ == "__main__":
    main()

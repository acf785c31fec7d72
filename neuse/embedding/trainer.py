"""A training run of one category's network: parameters, recipes, steps and checkpoints (NeuSE III-D)."""

import subprocess
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.parallel import DistributedDataParallel

from neuse.embedding.dataset import Batch, ViewSet
from neuse.embedding.losses import occupancy_loss, shipped_losses
from neuse.embedding.network import ARCHITECTURES, Network, load_network, read_card
from neuse.embedding.paper_losses import paper_losses
from neuse.embedding.parallel import ALONE, Group
from neuse.errors import InputError, ParamError, WeightsError
from neuse.params import CheckedParams, param
from neuse.symmetry import Symmetry

RECIPES = {"shipped": "shipped", "paper": "paper", "light-pose": "paper", "light-shape": "paper"}
LOSSES = {"shipped": shipped_losses, "paper": paper_losses}
CHECKPOINT = {"network", "optimizer", "step", "seconds", "history", "params"}  # what one holds at least
ANCESTRY = ("step", "hours", "commit", "started_from", "before")


@dataclass(frozen=True)
class TrainParams(CheckedParams):
    """One training run."""

    recipe: str = param("shipped", "what is trained, and for which losses")
    steps: int = param(30000, "batches", 1)
    shapes_per_batch: int = param(16, "N of the paper", 2)
    views_per_shape: int = param(4, "M of the paper", 2)
    n_points: int = param(512, "points of a view", 32)
    anchors: int = param(96, "anchors of a view, until the last stretch", 16)
    anchors_last: int = param(256, "anchors of a view in the last stretch", 16)
    last_stretch: float = param(0.05, "share of the steps", 0.0, 1.0)
    latent: int = param(128, "k, latent points", 8)
    width: int = param(128, "channels of the encoder", 8)
    queries: int = param(48, "occupancy queries of a view", 1)
    surface: int = param(0, "points of the whole object, for the Chamfer loss", 0, 512)
    lr: float = param(1e-3, "highest learning rate", 0.0, 1.0)
    warmup: int = param(300, "steps until it", 1)
    decay: float = param(0.45, "share of the steps in which it falls to a hundredth", 0.0, 1.0)
    weight_decay: float = param(1e-3, "of AdamW", 0.0, 1.0)
    frame_weight: float = param(3.0, "weight of the frame loss", 0.0)
    transform_weight: float = param(0.0, "weight beta_1 of the paper's transform loss", 0.0)
    occupancy_weight: float = param(1.0, "weight of the occupancy loss", 0.0)
    shape_weight: float = param(0.5, "weight of the shape contrast, beta_2 of the paper", 0.0)
    sigma_weight: float = param(0.1, "weight of the likelihood", 0.0)
    shards: int = param(200, "training shards of 25 shapes", 1)
    validation_shards: int = param(6, "validation shards", 1)
    seed: int = param(0, "of weights and batches", 0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.recipe not in RECIPES:
            raise ParamError(f"parameter recipe = {self.recipe!r}; choose one of {', '.join(RECIPES)}")


def recipe_params(recipe: str, symmetry: Symmetry) -> TrainParams:
    """Defaults of a recipe: ours, the paper's, or either half of its light variant (appendix).

    The paper's have its losses and weights; net and batches are smaller, for CPUs.

    Raises:
        ParamError: an unknown recipe.
    """
    ambiguous = symmetry.ambiguous
    params = TrainParams(recipe=recipe)
    if RECIPES[recipe] == "shipped":
        return params
    params = replace(
        params,
        shapes_per_batch=8,
        n_points=500,
        anchors_last=192,
        latent=512,
        width=64,
        surface=128 if ambiguous else 0,
        transform_weight=1.0 if ambiguous else 0.1,
        shape_weight=0.1,
    )
    if recipe == "light-pose":
        return replace(params, latent=128, shape_weight=0.0)
    if recipe == "light-shape":
        return replace(params, latent=128, transform_weight=0.0)
    return params


class Trainer:
    """Network, optimiser and the step that they are at; one of `group`'s processes."""

    def __init__(
        self,
        category: str,
        params: TrainParams,
        train_set: ViewSet,
        validation_set: ViewSet,
        group: Group = ALONE,
    ) -> None:
        self.category, self.params, self.group = category, params, group
        self.train_set, self.validation_set = train_set, validation_set
        torch.manual_seed(params.seed)
        architecture = RECIPES[params.recipe]
        config = ARCHITECTURES[architecture].config(
            n_points=params.n_points,
            n_anchors=params.anchors_last,
            n_latent=params.latent,
            width=params.width,
        )
        self.network = Network(category, train_set.symmetry, config).to(group.device)
        self.parallel = DistributedDataParallel(self.network) if group.size > 1 else self.network
        self.losses_of = LOSSES[architecture]
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(),
            lr=params.lr,
            weight_decay=params.weight_decay,
            betas=(0.9, 0.98),
            fused=True,
        )
        self.step, self.seconds, self.stopping = 0, 0.0, False
        self.started_from = ""  # the name of weights, and
        self.before: dict[str, object] = {}  # how those came about
        self.running: dict[str, float] = {}  # means of the last losses
        self.history: list[dict[str, float]] = []

    def start_from(self, path: Path) -> None:
        """Begin with the weights of another network, of this category or of any other.

        Raises:
            WeightsError: they cannot be read, or are of another architecture or other sizes.
        """
        other = load_network(path)
        if other.config != self.network.config:
            raise WeightsError(
                f"{path} has {other.config}, this run trains {self.network.config}; start from another file"
            )
        weights = dict(other.named_parameters())
        self.network.load_state_dict(weights, strict=False)  # buffers are calibrated at the end of a run
        self.started_from, self.before = path.stem, ancestry(read_card(path))

    def train_step(self) -> dict[str, float]:
        """One batch; returns the losses.

        Raises:
            InputError: the loss is not finite; the weights are as before.
        """
        for settings in self.optimizer.param_groups:
            settings["lr"] = self.learning_rate()
        losses = self.losses(self.draw(), self.anchors())
        weights = {name: getattr(self.params, f"{name}_weight") for name in losses}
        used = [weights[name] * loss for name, loss in losses.items() if weights[name] > 0]
        total = torch.stack(used).sum()
        if not torch.isfinite(total):
            raise InputError(
                "loss",
                f"the loss of batch {self.step} is {float(total.detach())}: go on from the last checkpoint "
                "(--resume), or look for views that are not finite",
            )
        self.optimizer.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimizer.step()
        self.step += 1
        told = {name: float(loss.detach()) for name, loss in losses.items()}
        self.running = {
            name: 0.98 * self.running.get(name, loss) + 0.02 * loss for name, loss in told.items()
        }
        return told

    def draw(self) -> Batch:
        """The batch of this step and process: a pure function of seed, step and rank."""
        p = self.params
        rng = np.random.default_rng([p.seed, self.step, self.group.rank])
        batch = self.train_set.draw(
            rng, p.shapes_per_batch, p.views_per_shape, p.n_points, p.queries, p.surface
        )
        return batch.to(self.group.device)

    def losses(self, batch: Batch, n_anchors: int) -> dict[str, Tensor]:
        """All losses of a batch by name."""
        with torch.autocast(self.group.device.type, torch.bfloat16):
            encoding, logits = self.parallel(batch.points, batch.queries, n_anchors)
        losses = self.losses_of(encoding, batch, self.network.symmetry)
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
            "category": self.category,
            "symmetry": self.network.symmetry.name,
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "seconds": self.seconds,
            "history": self.history,
            "running": self.running,
            "started_from": self.started_from,
            "before": self.before,
            "params": asdict(self.params),
        }
        partial = path.with_suffix(".partial")
        torch.save(state, partial)
        partial.rename(path)

    def load_checkpoint(self, path: Path) -> None:
        """Go on from where `save_checkpoint` was called.

        Raises:
            WeightsError: the checkpoint is damaged, or of another category, symmetry or recipe.
        """
        state, symmetry = read_checkpoint(path), self.network.symmetry.name
        recipe = params_of(path, state).recipe
        found = state.get("category", self.category), recipe, state.get("symmetry", symmetry)
        wanted = self.category, self.params.recipe, symmetry
        if found != wanted:
            raise WeightsError(
                f"{path} is a checkpoint of {', '.join(found)}, not of {', '.join(wanted)} (category, "
                "recipe, symmetry); give another --out, or leave out --resume to begin anew"
            )
        try:
            self.network.load_state_dict(state["network"])
            self.optimizer.load_state_dict(state["optimizer"])
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise WeightsError(
                f"{path} does not fit this network ({error}); delete it to begin anew"
            ) from error
        self.step, self.seconds, self.history = state["step"], state["seconds"], state["history"]
        self.running, self.before = state.get("running", {}), state.get("before", {})
        self.started_from = state.get("started_from", "")

    def card(self) -> dict[str, object]:
        """How the weights came about."""
        return {
            "recipe": self.params.recipe,
            "category": self.category,
            "symmetry": self.network.symmetry.name,
            "started_from": self.started_from,
            "before": self.before,
            "params": asdict(self.params),
            "step": self.step,
            "shapes": self.train_set.n_shapes,
            "views": len(self.train_set),
            "processes": self.group.size,
            "hours": round(self.seconds / 3600, 2),
            "commit": commit_of(Path(__file__)),
            "validation": self.history[-1] if self.history else {},
        }


def read_checkpoint(path: Path) -> dict[str, Any]:
    """What `Trainer.save_checkpoint` wrote; executes nothing.

    Raises:
        WeightsError: no checkpoint, or a damaged one.
    """
    try:
        state = torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:  # the reader raises whatever the damage makes it raise
        raise WeightsError(f"{path} is no checkpoint ({error}); delete it to begin anew") from error
    if not isinstance(state, dict) or not state.keys() >= CHECKPOINT:
        raise WeightsError(f"{path} is no checkpoint: it lacks what one holds; delete it to begin anew")
    return state


def params_of(path: Path, checkpoint: dict[str, Any]) -> TrainParams:
    """The parameters in a checkpoint.

    Raises:
        WeightsError: there are others than this library has.
    """
    try:
        return TrainParams(**checkpoint["params"])
    except (TypeError, ParamError) as error:
        raise WeightsError(f"{path} is of another version ({error}); delete it to begin anew") from error


def ancestry(card: dict[str, Any]) -> dict[str, object]:
    """Of a card what tells how long its weights were trained, and from which they began."""
    return {name: card[name] for name in ANCESTRY if card.get(name)}


def commit_of(source: Path) -> str:
    """The commit of the repository that holds this file, marked where something was changed since."""
    git = ["git", "-C", str(source.parent)]
    try:
        tracked = subprocess.run([*git, "ls-files", "--error-unmatch", source.name], capture_output=True)
        described = subprocess.run(
            [*git, "describe", "--always", "--dirty", "--exclude=*"], capture_output=True, text=True
        )
    except OSError:
        return "unknown"
    return described.stdout.strip() if tracked.returncode == 0 else "unknown"

"""Encoder and decoder of one category, and their weights file (safetensors: data only, nothing runs)."""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import safetensors
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from neuse.embedding.decoder import Decoder
from neuse.embedding.encoder import N_SIGMAS, Encoder, EncoderConfig, Encoding
from neuse.embedding.paper_encoder import PaperEncoder, PaperEncoderConfig
from neuse.errors import InputError, WeightsError
from neuse.symmetry import AXIAL, NONE, Symmetry, symmetry_named

FORMAT_VERSION = "2"
UNIT_M = 0.1  # network units are decimetres
MIN_POINTS = 8  # of a cloud
MOST_OF_A_SIZE = 8192
LIMIT_BYTES = 2**30  # the paper's networks have 20 MB


class Architecture(NamedTuple):
    """An encoder and its sizes; the decoder is the same for all."""

    config: type
    encoder: type[nn.Module]


ARCHITECTURES = {
    "shipped": Architecture(EncoderConfig, Encoder),
    "paper": Architecture(PaperEncoderConfig, PaperEncoder),
}


class Network(nn.Module):
    """f_theta and Phi of one category (NeuSE eq. 2); the type of `config` chooses the architecture.

    sigma_scale: (7,) factors that make the predicted standard deviations right on held-out shapes.
    occupancy_logit: the threshold v_0 as a logit, the one of the best IoU on held-out shapes.
    """

    sigma_scale: Tensor
    occupancy_logit: Tensor

    def __init__(
        self, category: str, symmetry: Symmetry, config: EncoderConfig | PaperEncoderConfig | None = None
    ) -> None:
        super().__init__()
        self.category, self.symmetry, self.config = category, symmetry, config or EncoderConfig()
        self.encoder = ARCHITECTURES[self.architecture].encoder(self.config, symmetry.ambiguous)
        self.decoder = Decoder(self.config.n_latent)
        self.register_buffer("sigma_scale", torch.ones(N_SIGMAS))
        self.register_buffer("occupancy_logit", torch.zeros(()))

    @property
    def ambiguous(self) -> bool:
        """Whether a turn about the axis cannot be seen."""
        return self.symmetry.ambiguous

    @property
    def architecture(self) -> str:
        """Name in ARCHITECTURES."""
        return next(name for name, (config, _) in ARCHITECTURES.items() if type(self.config) is config)

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return self.sigma_scale.device

    def encode(self, points: Tensor, n_anchors: int | None = None) -> Encoding:
        """(B, N, 3) centred clouds in network units -> Encoding."""
        return self.encoder(points, n_anchors or self.config.n_anchors)

    def decode(self, encoding: Encoding, queries: Tensor) -> Tensor:
        """Occupancy logits (B, Q) at queries (B, Q, 3), about the partial centre (NeuSE eq. 4)."""
        center = encoding.frame[..., 0]  # (B, 3)
        return self.decoder(queries - center[:, None], encoding.z - center[..., None])

    def forward(
        self, points: Tensor, queries: Tensor, n_anchors: int | None = None
    ) -> tuple[Encoding, Tensor]:
        """`encode` and `decode` at once, for training."""
        encoding = self.encode(points, n_anchors)
        return encoding, self.decode(encoding, queries)


def save_network(network: Network, path: Path, card: dict[str, object]) -> None:
    """Write weights with what is needed to rebuild the network; `card` says how they came about."""
    metadata = {
        "format_version": FORMAT_VERSION,
        "category": network.category,
        "architecture": network.architecture,
        "symmetry": network.symmetry.name,
        "config": json.dumps(dataclasses.asdict(network.config)),
        "card": json.dumps(card),
    }
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    save_file(tensors, path, metadata)
    path.chmod(0o644)


def load_network(path: Path, category: str | None = None) -> Network:
    """Read a weights file; `category` refuses one that was made for something else.

    Raises:
        WeightsError: missing, damaged, of another version or category, or tensors that do not fit.
    """
    metadata, tensors = _read(path)
    if metadata.get("format_version") != FORMAT_VERSION:
        found = metadata.get("format_version")
        raise WeightsError(f"{path} has format version {found!r}, this library reads {FORMAT_VERSION!r}")
    if not metadata.get("category", "-"):
        raise WeightsError(f"{path} names no category")
    network = _rebuild(path, metadata, tensors)
    if category is not None and network.category != category:
        raise WeightsError(f"{path} holds category {network.category!r}, not {category!r}")
    return network


def read_card(path: Path) -> dict[str, Any]:
    """How the weights in `path` came about: recipe, data, seed, commit, figures.

    Raises:
        WeightsError: missing or damaged.
    """
    try:
        return dict(json.loads(_read(path)[0].get("card", "{}")))
    except (ValueError, TypeError, RecursionError) as error:
        raise WeightsError(f"the card of weights {path} is none: {error}") from error


def _read(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Metadata and tensors of a safetensors file."""
    if path.is_file() and path.stat().st_size > LIMIT_BYTES:
        raise WeightsError(f"{path} has {path.stat().st_size / 1e9:.3g} GB; no weights of this library have")
    try:
        with safetensors.safe_open(path, "pt") as file:
            return file.metadata() or {}, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, safetensors.SafetensorError) as error:
        raise WeightsError(f"cannot read weights {path}: {error}; train them with `make train`") from error


def _rebuild(path: Path, metadata: dict[str, str], tensors: dict[str, Tensor]) -> Network:
    architecture = metadata.get("architecture", "shipped")  # which the first files did not name
    if architecture not in ARCHITECTURES:
        known = ", ".join(ARCHITECTURES)
        raise WeightsError(f"weights {path} are of architecture {architecture!r}; known: {known}")
    try:
        config = ARCHITECTURES[architecture].config(**json.loads(metadata["config"]))
        _check_sizes(config, tensors)
        with torch.device("meta"):  # takes no memory
            planned = Network(metadata["category"], _symmetry(metadata), config)
        _check_kinds(planned.state_dict(), tensors)
        planned.load_state_dict(tensors, assign=True)  # raises where a shape is another
        network = Network(metadata["category"], _symmetry(metadata), config)
        network.load_state_dict(tensors)
    except (KeyError, TypeError, ValueError, RuntimeError, InputError) as error:
        raise WeightsError(f"weights {path} do not fit the network: {error}") from error
    for name, tensor in tensors.items():
        if not tensor.isfinite().all():
            raise WeightsError(f"weights {path} hold numbers in {name} that are not finite")
    if not (network.sigma_scale > 0).all():
        raise WeightsError(f"weights {path} scale sigmas by numbers that are not positive")
    return network


def _check_kinds(planned: Mapping[str, Tensor], tensors: Mapping[str, Tensor]) -> None:
    """Raises ValueError for numbers of another kind, which would lose what they say."""
    for name, tensor in tensors.items():
        if name in planned and tensor.dtype != planned[name].dtype:
            raise ValueError(f"{name} is of {tensor.dtype}, not {planned[name].dtype}")


def _check_sizes(config: EncoderConfig | PaperEncoderConfig, tensors: dict[str, Tensor]) -> None:
    """Raises ValueError for sizes that no network has, or more blocks than there are tensors."""
    for name, size in dataclasses.asdict(config).items():
        if type(size) is not int or not 0 < size <= MOST_OF_A_SIZE:
            raise ValueError(f"{name} is {str(size)[:50]}")
    if config.n_blocks > len(tensors):
        raise ValueError(f"{config.n_blocks} blocks of {len(tensors)} tensors")
    if config.n_points < MIN_POINTS or config.n_anchors > config.n_points:
        raise ValueError(f"{config.n_anchors} anchors of {config.n_points} points")
    if isinstance(config, PaperEncoderConfig) and config.n_neighbors >= config.n_points:
        raise ValueError(f"{config.n_neighbors} neighbours of {config.n_points} points")


def _symmetry(metadata: dict[str, str]) -> Symmetry:
    """The first files said only whether it is axial."""
    if "ambiguous" in metadata:
        return AXIAL if json.loads(metadata["ambiguous"]) else NONE
    return symmetry_named(metadata["symmetry"])

"""Small networks, and two shards of views that are rendered once for all tests."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from neuse.embedding.dataset import ViewSet
from neuse.embedding.embedding import Embedding
from neuse.embedding.network import Network
from neuse.embedding.shards import write_shard
from neuse.embedding.views import ViewParams
from neuse.symmetry import NONE

from .tiny import block_bottle, block_mug, make_network

CLEAN = ViewParams(
    views_per_shape=6, range_m=(0.35, 1.2), clutter=(1, 1), fixed_noise_m=0.0, mask_faults=False
)


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(params=["mug", "bottle"])
def network(request: pytest.FixtureRequest) -> Network:
    """A tiny network with random weights, of an unambiguous and of an ambiguous category."""
    return make_network(request.param)


@pytest.fixture
def embedding(network: Network) -> Embedding:
    """The tiny network as users meet it."""
    return Embedding(network)


@pytest.fixture(scope="session")
def shard_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One training and one validation shard of two solid mugs, free of faults."""
    folder = tmp_path_factory.mktemp("shards")
    for split, seed in (("train", 1), ("validation", 2)):
        path = folder / f"mug_{split}_0000.npz"
        shapes = [block_mug(), block_mug()]
        write_shard(path, shapes, [block_bottle()], CLEAN, np.random.default_rng(seed))
    return folder


@pytest.fixture(scope="session")
def mug_views(shard_folder: Path) -> ViewSet:
    """The training shard in memory."""
    return ViewSet([shard_folder / "mug_train_0000.npz"], NONE)


@pytest.fixture(scope="session")
def mug_views_held_out(shard_folder: Path) -> ViewSet:
    """The validation shard in memory."""
    return ViewSet([shard_folder / "mug_validation_0000.npz"], NONE)

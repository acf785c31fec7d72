import json
import pickle
import resource

import pytest
import safetensors
import torch
from safetensors.torch import save_file

from neuse.embedding.network import FORMAT_VERSION, load_network, read_card, save_network
from neuse.errors import WeightsError

from .tiny import CONFIG, make_network


@pytest.fixture
def path(tmp_path):
    """A good weights file of a mug."""
    path = tmp_path / "mug.safetensors"
    save_network(make_network("mug"), path, {"seed": 7})
    return path


def rewrite(path, change_metadata=lambda metadata: None, change_tensors=lambda tensors: None):
    """Write the file again with something in it changed."""
    with safetensors.safe_open(path, "pt") as file:
        metadata, tensors = file.metadata(), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    change_metadata(metadata)
    change_tensors(tensors)
    save_file(tensors, path, metadata)


def test_saved_weights_come_back_bit_for_bit(network, tmp_path):
    network.sigma_scale.copy_(torch.arange(1.0, 8.0))
    network.occupancy_logit.fill_(-0.4)
    save_network(network, tmp_path / "x.safetensors", {})
    loaded = load_network(tmp_path / "x.safetensors", network.category)
    assert (loaded.category, loaded.symmetry, loaded.config) == (
        network.category,
        network.symmetry,
        network.config,
    )
    assert loaded.state_dict().keys() == network.state_dict().keys()
    for name, tensor in network.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor), name


def test_loaded_network_encodes_as_the_saved_one(path):
    points = torch.randn(2, CONFIG.n_points, 3, dtype=torch.float64)
    with torch.no_grad():
        expected, found = make_network("mug").encode(points), load_network(path).encode(points)
    for a, b in zip(expected, found, strict=True):
        assert torch.equal(a, b)


def test_card_says_how_the_weights_came_about(path):
    assert read_card(path) == {"seed": 7}


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(WeightsError, match="make train"):
        load_network(tmp_path / "mug.safetensors")


def test_card_of_a_missing_file_is_refused(tmp_path):
    with pytest.raises(WeightsError, match="make train"):
        read_card(tmp_path / "mug.safetensors")


@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.999])
def test_truncated_file_is_refused(path, share):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(WeightsError, match=r"mug\.safetensors"):
        load_network(path)


def test_folder_instead_of_a_file_is_refused(tmp_path):
    with pytest.raises(WeightsError):
        load_network(tmp_path)


def test_weights_of_another_category_are_refused(path):
    with pytest.raises(WeightsError, match="'mug', not 'bottle'"):
        load_network(path, "bottle")


@pytest.mark.parametrize("version", ["0", str(int(FORMAT_VERSION) + 1)])
def test_another_format_version_is_refused(path, version):
    rewrite(path, lambda metadata: metadata.update(format_version=version))
    with pytest.raises(WeightsError, match=f"'{version}'"):
        load_network(path)


def test_safetensors_file_of_something_else_is_refused(tmp_path):
    save_file({"weight": torch.zeros(3)}, tmp_path / "other.safetensors")
    with pytest.raises(WeightsError, match="format version None"):
        load_network(tmp_path / "other.safetensors")


@pytest.mark.parametrize("category", [None, "mug"])
@pytest.mark.parametrize("key", ["category", "symmetry", "config"])
def test_incomplete_metadata_is_refused(path, key, category):
    rewrite(path, lambda metadata: metadata.pop(key))
    with pytest.raises(WeightsError, match=key):
        load_network(path, category)


@pytest.mark.parametrize(
    "config", ["{", "[1, 2]", '{"depth": 3}', json.dumps(vars(CONFIG) | {"width": 32})], ids=str
)
def test_config_that_does_not_describe_the_tensors_is_refused(path, config):
    rewrite(path, lambda metadata: metadata.update(config=config))
    with pytest.raises(WeightsError, match="do not fit"):
        load_network(path)


@pytest.mark.parametrize(
    "change",
    [
        lambda tensors: tensors.pop("encoder.embed.weight"),
        lambda tensors: tensors.update(surplus=torch.zeros(1)),
        lambda tensors: tensors.update({"encoder.embed.weight": torch.zeros(2, 2)}),
    ],
    ids=["missing", "surplus", "wrong size"],
)
def test_tensors_that_do_not_fit_are_refused(path, change):
    rewrite(path, change_tensors=change)
    with pytest.raises(WeightsError, match="do not fit"):
        load_network(path)


@pytest.mark.parametrize(
    "size",
    [
        {"n_latent": 10**9},
        {"width": 10**12},
        {"width": 8000},
        {"n_blocks": 8000},
        {"n_points": None},
        {"n_points": 2},
        {"n_anchors": 1000},
        {"n_weights": -4},
        {"width": 16.0},
    ],
    ids=str,
)
def test_size_that_no_network_has_is_refused_before_memory_is_taken(path, size):
    rewrite(path, lambda metadata: metadata.update(config=json.dumps(vars(CONFIG) | size)))
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(WeightsError, match="do not fit"):
        load_network(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib < 100_000


def test_file_of_absurd_size_is_refused(path):
    with path.open("r+b") as stream:
        stream.truncate(5 * 2**30)  # a hole takes no disk
    with pytest.raises(WeightsError, match=r"has 5\.37 GB"):
        load_network(path)


@pytest.mark.parametrize("card", ["[", "3", "[" * 100_000])
def test_card_that_is_none_is_refused(path, card):
    rewrite(path, lambda metadata: metadata.update(card=card))
    with pytest.raises(WeightsError, match="card"):
        read_card(path)


def test_weights_without_a_name_are_refused(path):
    rewrite(path, lambda metadata: metadata.update(category=""))
    with pytest.raises(WeightsError, match="names no category"):
        load_network(path)


def test_weights_that_are_not_finite_are_refused(path):
    rewrite(path, change_tensors=lambda tensors: tensors["encoder.embed.weight"].fill_(torch.nan))
    with pytest.raises(WeightsError, match=r"encoder\.embed\.weight"):
        load_network(path)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16, torch.complex64], ids=str)
def test_numbers_of_another_kind_are_refused(path, dtype):
    def change(tensors):
        tensors["encoder.embed.weight"] = tensors["encoder.embed.weight"].to(dtype)

    rewrite(path, change_tensors=change)
    with pytest.raises(WeightsError, match=r"encoder\.embed\.weight is of"):
        load_network(path)


@pytest.mark.parametrize("scale", [0.0, -1.0])
def test_sigmas_that_would_not_be_positive_are_refused(path, scale):
    rewrite(path, change_tensors=lambda tensors: tensors["sigma_scale"].fill_(scale))
    with pytest.raises(WeightsError, match="not positive"):
        load_network(path)


class Bomb:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, trace):
        self.trace = trace

    def __reduce__(self):
        return (open, (str(self.trace), "w"))


@pytest.mark.parametrize("write", [torch.save, lambda bomb, path: path.write_bytes(pickle.dumps(bomb))])
def test_pickle_under_the_name_of_weights_is_refused_and_nothing_runs(tmp_path, write):
    path, trace = tmp_path / "mug.safetensors", tmp_path / "trace"
    write(Bomb(trace), path)
    with pytest.raises(WeightsError):
        load_network(path)
    assert not trace.exists()


@torch.no_grad()
def test_first_half_of_the_latent_points_are_the_landmarks_of_the_frame(network):
    encoding = network.encode(torch.randn(2, CONFIG.n_points, 3, dtype=torch.float64))
    landmarks = encoding.z[..., : CONFIG.n_latent // 2]
    center, axes = encoding.frame[..., 0], encoding.frame[..., 1:]
    for j, direction in enumerate(network.encoder.template):
        torch.testing.assert_close(landmarks[..., j], center + axes @ direction)

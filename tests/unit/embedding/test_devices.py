"""On what the networks run."""

import pytest
import torch

from neuse.embedding.devices import device_named
from neuse.embedding.embedding import load_embedding
from neuse.errors import InputError

HAS_GPU = torch.cuda.is_available()


def test_auto_is_a_gpu_where_there_is_one():
    assert device_named("auto").type == ("cuda" if HAS_GPU else "cpu")


def test_gpu_that_torch_reports_is_taken(monkeypatch):
    asked = []
    empty = torch.empty
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch, "empty", lambda n, device: asked.append(device) or empty(n))
    device_named("auto")
    assert asked == ["cuda"]


@pytest.mark.parametrize("name", ["gpu", "", "cuda:99", "vulkan"])
def test_device_that_is_not_there_is_refused_by_name(name):
    with pytest.raises(InputError, match=f"no device '{name}' here .*; give auto, cpu or cuda"):
        device_named(name)


def test_embedding_runs_on_the_device_that_is_asked_for():
    assert load_embedding("mug", "cpu").network.device == torch.device("cpu")
    with pytest.raises(InputError, match="no device 'cuda:99'"):
        load_embedding("mug", "cuda:99")


@pytest.mark.skipif(not HAS_GPU, reason="this machine has no GPU")
def test_gpu_and_processor_give_the_same_codes():
    cloud = torch.randn(200, 3, generator=torch.Generator().manual_seed(0)).numpy() * 0.05
    (here,), (there,) = (load_embedding("mug", name).encode([cloud]) for name in ("cpu", "cuda"))
    assert abs(here.z - there.z).max() < 1e-4
    assert here.descriptor @ there.descriptor > 0.999

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from neuse.embedding.parallel import ALONE, join_group
from neuse.embedding.trainer import read_checkpoint

from .tiny import TRAIN

ROOT = Path(__file__).parents[3]
PROGRAM = """
import sys
from dataclasses import replace
from pathlib import Path
from neuse.embedding import train
from neuse.embedding.dataset import ViewSet
from neuse.embedding.parallel import join_group, leave_group
from neuse.embedding.trainer import Trainer, recipe_params
from neuse.symmetry import NONE

train.save_reconstructions = train.save_curves = lambda *arguments: None
folder, out = Path(sys.argv[1]), Path(sys.argv[2])
params = replace(recipe_params("shipped", NONE), **eval(sys.argv[3]))
views = ViewSet([folder / "mug_train_0000.npz"], NONE)
group = join_group()
for name in ("whole", "stopped"):
    trainer = Trainer("mug", params, views, views, group)
    trainer.stopping = name == "stopped" and group.rank == 1
    train.run(trainer, out / f"{name}.safetensors")
    trainer.save_checkpoint(out / f"{name}_{group.rank}.ckpt")
leave_group(group)
"""


@pytest.fixture(scope="module")
def trained(shard_folder, tmp_path_factory):
    """What two processes over gloo, started as torchrun does, left: of a whole run and of a stopped one."""
    out = tmp_path_factory.mktemp("out")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
        "CUDA_VISIBLE_DEVICES": "",
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": str(port),
        "WORLD_SIZE": "2",
    }
    params = repr(TRAIN | {"latent": 16, "steps": 2})
    command = [sys.executable, "-c", PROGRAM, str(shard_folder), str(out), params]
    ranks = [environment | {"RANK": str(rank), "LOCAL_RANK": str(rank)} for rank in range(2)]
    processes = [subprocess.Popen(command, env=rank) for rank in ranks]
    assert [process.wait(timeout=300) for process in processes] == [0, 0]
    return out


def test_two_processes_train_one_network(trained):
    first, second = (read_checkpoint(trained / f"whole_{rank}.ckpt") for rank in range(2))
    assert first["step"] == second["step"] == 2
    for name, weight in first["network"].items():
        if name not in ("sigma_scale", "occupancy_logit"):  # calibrated by the first, at the end
            assert torch.equal(weight, second["network"][name]), name


def test_first_process_alone_validates_and_writes(trained):
    first, second = (read_checkpoint(trained / f"whole_{rank}.ckpt") for rank in range(2))
    assert first["history"]
    assert second["history"] == []
    assert (trained / "whole.safetensors").exists()


def test_all_processes_stop_when_one_is_told_to(trained):
    steps = [read_checkpoint(trained / f"stopped_{rank}.ckpt")["step"] for rank in range(2)]
    assert steps == [0, 0]


def test_process_that_nobody_started_together_with_others_is_alone(monkeypatch):
    for name in ("RANK", "WORLD_SIZE", "LOCAL_RANK"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert join_group() == ALONE
    assert ALONE.is_first
    assert ALONE.any(True)
    assert not ALONE.any(False)
    ALONE.wait()

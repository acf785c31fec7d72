import signal
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from neuse.embedding import train
from neuse.embedding.network import load_network, read_card
from neuse.embedding.train import Trainer, TrainParams, run
from neuse.errors import ParamError

from .tiny import CONFIG

PARAMS = TrainParams(
    steps=4,
    shapes_per_batch=2,
    views_per_shape=2,
    n_points=64,
    anchors=16,
    anchors_last=32,
    queries=16,
    warmup=1,
    shards=1,
    validation_shards=1,
)


@pytest.fixture
def make_trainer(shard_folder, monkeypatch):
    """Factory of trainers of a tiny network on a tiny shard."""
    monkeypatch.setattr(train, "EncoderConfig", lambda n_points: replace(CONFIG, n_points=n_points))

    def make(**changes):
        return Trainer("mug", replace(PARAMS, **changes), shard_folder)

    return make


def assert_same_weights(a, b):
    for name, tensor in a.network.state_dict().items():
        assert torch.equal(tensor, b.network.state_dict()[name]), name


def test_every_loss_is_finite_and_reported(make_trainer):
    losses = make_trainer().train_step()
    assert losses.keys() == {"frame", "occupancy", "shape", "sigma"}
    assert np.isfinite(list(losses.values())).all()


def test_training_on_one_batch_lowers_its_frame_loss(make_trainer, monkeypatch):
    trainer = make_trainer(steps=30, lr=1e-2)
    draw = trainer.train_set.draw
    monkeypatch.setattr(trainer.train_set, "draw", lambda rng, *sizes: draw(np.random.default_rng(0), *sizes))
    frame = [trainer.train_step()["frame"] for _ in range(20)]
    assert frame[-1] < 0.6 * frame[0]


def test_every_weight_of_the_encoder_and_decoder_is_trained(make_trainer):
    trainer = make_trainer(weight_decay=0.0)
    before = {name: weight.detach().clone() for name, weight in trainer.network.named_parameters()}
    for _ in range(3):
        trainer.train_step()
    unmoved = [
        name for name, weight in trainer.network.named_parameters() if torch.equal(weight, before[name])
    ]
    assert unmoved == []


def test_same_seed_gives_the_same_weights_and_another_seed_others(make_trainer):
    a, b, other = make_trainer(), make_trainer(), make_trainer(seed=1)
    for trainer in (a, b, other):
        trainer.train_step()
    assert_same_weights(a, b)
    with pytest.raises(AssertionError):
        assert_same_weights(a, other)


def interrupt_in(trainer, step, monkeypatch):
    """Send the trainer a signal in the middle of this step."""
    losses = trainer.losses

    def interrupted(*arguments):
        if trainer.step == step:
            trainer.stop_after_step(signal.SIGINT, None)
        return losses(*arguments)

    monkeypatch.setattr(trainer, "losses", interrupted)


def test_stopped_and_resumed_run_gives_the_weights_of_an_uninterrupted_one(
    make_trainer, tmp_path, monkeypatch
):
    checkpoint, weights = tmp_path / "mug.ckpt", tmp_path / "mug.safetensors"
    whole = make_trainer()
    run(whole, tmp_path / "whole.ckpt", tmp_path / "whole.safetensors")

    stopped = make_trainer()
    interrupt_in(stopped, 1, monkeypatch)
    run(stopped, checkpoint, weights)
    assert stopped.step == 2
    assert weights.exists()

    resumed = make_trainer()
    resumed.load_checkpoint(checkpoint)
    assert resumed.step == 2
    run(resumed, checkpoint, weights)
    assert resumed.step == PARAMS.steps
    assert_same_weights(whole, resumed)
    assert weights.read_bytes()[-1000:] == (tmp_path / "whole.safetensors").read_bytes()[-1000:]


def test_weights_of_a_run_can_be_loaded_and_say_how_they_came_about(make_trainer, tmp_path):
    trainer = make_trainer(steps=1)
    run(trainer, tmp_path / "mug.ckpt", tmp_path / "mug.safetensors")
    network, card = load_network(tmp_path / "mug.safetensors", "mug"), read_card(tmp_path / "mug.safetensors")
    assert network.config == trainer.network.config
    assert (card["category"], card["step"], card["params"]["seed"]) == ("mug", 1, 0)
    assert {"recipe", "hours", "commit", "validation"} <= card.keys()
    assert card["validation"]["mm_all"] > 0


def test_checkpoint_holds_data_only(make_trainer, tmp_path):
    trainer = make_trainer()
    trainer.save_checkpoint(tmp_path / "mug.ckpt")
    state = torch.load(tmp_path / "mug.ckpt", weights_only=True)  # refuses anything that would run
    assert state["params"]["steps"] == PARAMS.steps
    assert not (tmp_path / "mug.partial").exists()


def test_learning_rate_warms_up_stays_then_falls_to_a_hundredth(make_trainer):
    trainer = make_trainer(steps=100, warmup=10, lr=1e-3, decay=0.4)

    def rate(step):
        trainer.step = step
        return trainer.learning_rate()

    rates = [rate(step) for step in range(100)]
    assert (np.diff(rates[:10]) > 0).all()
    assert rates[9:60] == pytest.approx([1e-3] * 51)
    assert (np.diff(rates[60:]) < 0).all()
    assert rate(100) == pytest.approx(1e-5)


def test_last_stretch_sees_more_anchors(make_trainer):
    trainer = make_trainer(steps=100, last_stretch=0.25)
    anchors = []
    for trainer.step in range(100):
        anchors.append(trainer.anchors())
    assert anchors == [PARAMS.anchors] * 75 + [PARAMS.anchors_last] * 25


@pytest.mark.parametrize(
    "change", [{"steps": 0}, {"lr": -1.0}, {"last_stretch": 1.5}, {"views_per_shape": 1}], ids=str
)
def test_parameter_outside_its_range_is_refused(change):
    with pytest.raises(ParamError, match=next(iter(change))):
        TrainParams(**change)


def test_command_line_trains_and_resumes(shard_folder, tmp_path, monkeypatch, make_trainer):
    for name in ("train", "validation"):
        (tmp_path / f"mug_{name}_0000.npz").symlink_to(shard_folder / f"mug_{name}_0000.npz")
    monkeypatch.setattr(train, "TrainParams", lambda **changes: replace(PARAMS, **changes))
    monkeypatch.setattr(train.signal, "signal", lambda *arguments: None)
    arguments = [
        "train",
        "--category",
        "mug",
        "--data",
        str(tmp_path),
        "--out",
        str(tmp_path),
        "--threads",
        "1",
    ]
    monkeypatch.setattr(sys, "argv", [*arguments, "--steps", "1", "--shards", "1"])
    train.main()
    assert read_card(tmp_path / "mug.safetensors")["step"] == 1
    monkeypatch.setattr(sys, "argv", [*arguments, "--steps", "2", "--shards", "1", "--resume"])
    train.main()
    assert read_card(tmp_path / "mug.safetensors")["step"] == 2

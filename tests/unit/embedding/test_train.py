import signal
from dataclasses import replace

import pytest
import torch

from neuse.embedding import train
from neuse.embedding.network import load_network, read_card
from neuse.embedding.shards import ShapeSource
from neuse.embedding.train import run
from neuse.embedding.trainer import Trainer, recipe_params
from neuse.symmetry import NONE

from .tiny import TRAIN


@pytest.fixture
def make_trainer(mug_views, mug_views_held_out):
    """Factory of trainers of a tiny network on a tiny shard."""

    def make(recipe="shipped", **changes):
        params = replace(recipe_params(recipe, NONE), **TRAIN | {"latent": 16} | changes)
        return Trainer("mug", params, mug_views, mug_views_held_out)

    return make


@pytest.fixture(autouse=True)
def _pictures_are_empty(monkeypatch):
    """Drawing takes longer than all else here; above all an untrained network, which fills all space."""
    monkeypatch.setattr(train, "save_curves", lambda history, path: path.touch())
    monkeypatch.setattr(train, "save_reconstructions", lambda network, views, path: path.touch())


@pytest.fixture
def shards_as_found(monkeypatch):
    """Shards are those in the folder, however they were drawn."""

    def found(folder, source, split, n, params):
        return sorted(folder.glob(f"{source.category}_{split}_*.npz"))

    monkeypatch.setattr(train, "ensure_shards", found)


def assert_same_weights(a, b):
    for name, tensor in a.network.state_dict().items():
        assert torch.equal(tensor, b.network.state_dict()[name]), name


def interrupt_in(trainer, step, monkeypatch):
    """Send the trainer a signal in the middle of this step."""
    losses = trainer.losses

    def interrupted(*arguments):
        if trainer.step == step:
            trainer.stop_after_step(signal.SIGINT, None)
        return losses(*arguments)

    monkeypatch.setattr(trainer, "losses", interrupted)


@pytest.mark.parametrize("recipe", ["shipped", "paper"])
def test_stopped_and_resumed_run_gives_the_weights_of_an_uninterrupted_one(
    make_trainer, tmp_path, monkeypatch, recipe
):
    weights = tmp_path / "mug.safetensors"
    whole = make_trainer(recipe)
    run(whole, tmp_path / "whole.safetensors")

    stopped = make_trainer(recipe)
    interrupt_in(stopped, 1, monkeypatch)
    run(stopped, weights)
    assert stopped.step == 2
    assert weights.exists()

    resumed = make_trainer(recipe)
    resumed.load_checkpoint(weights.with_suffix(".ckpt"))
    assert resumed.step == 2
    run(resumed, weights)
    assert resumed.step == TRAIN["steps"]
    assert_same_weights(whole, resumed)


@pytest.mark.parametrize("recipe", ["shipped", "paper"])
def test_weights_of_a_run_can_be_loaded_and_say_how_they_came_about(make_trainer, tmp_path, recipe):
    trainer = make_trainer(recipe, steps=1)
    run(trainer, tmp_path / "mug.safetensors")
    network, card = load_network(tmp_path / "mug.safetensors", "mug"), read_card(tmp_path / "mug.safetensors")
    assert network.config == trainer.network.config
    assert (card["recipe"], card["category"], card["step"], card["params"]["seed"]) == (recipe, "mug", 1, 0)
    assert (card["shapes"], card["views"]) == (2, len(trainer.train_set))
    assert {"hours", "commit"} <= card.keys()
    assert card["validation"]["mm_all"] > 0


def test_pictures_lie_beside_the_weights(make_trainer, tmp_path):
    run(make_trainer(steps=1), tmp_path / "mug.safetensors")
    assert {path.name for path in tmp_path.glob("*.png")} == {"mug_curves.png", "mug_reconstructions.png"}


def test_progress_tells_losses_figures_and_time_left(make_trainer, tmp_path, capsys):
    run(make_trainer(steps=2), tmp_path / "mug.safetensors", every=1)
    line = next(line for line in capsys.readouterr().out.splitlines() if "mug 1/2" in line)
    for word in ("frame ", "sigma ", "deg_seen ", "iou ", "min left"):
        assert word in line


def test_views_come_from_the_shards_of_their_splits(shard_folder, shards_as_found):
    params = replace(recipe_params("shipped", NONE), shards=1, validation_shards=1)
    train_set, validation_set = train.load_views(ShapeSource("mug"), params, shard_folder)
    assert (train_set.n_shapes, validation_set.n_shapes) == (2, 2)
    assert train_set.symmetry is NONE
    assert (train_set.arrays["points"][0] != validation_set.arrays["points"][0]).any()


@pytest.fixture
def command_line(shard_folder, tmp_path, monkeypatch, shards_as_found):
    """Runs `train` with tiny parameters on the tiny shards."""
    monkeypatch.setattr(
        train, "recipe_params", lambda *of: replace(recipe_params(*of), **TRAIN | {"latent": 16})
    )
    monkeypatch.setattr(train.signal, "signal", lambda *arguments: None)

    def call(*arguments):
        return train.main(
            ["--category", "mug", "--data", str(shard_folder), "--out", str(tmp_path), *arguments]
        )

    return call


def test_command_line_trains_and_resumes(command_line, tmp_path):
    command_line("--steps", "1")
    assert read_card(tmp_path / "mug.safetensors")["step"] == 1
    command_line("--steps", "2", "--resume")
    assert read_card(tmp_path / "mug.safetensors")["step"] == 2


def test_command_line_trains_by_the_recipe_of_the_paper(command_line, tmp_path, capsys):
    command_line("--steps", "1", "--recipe", "paper")
    assert load_network(tmp_path / "mug.safetensors").architecture == "paper"
    command_line("--steps", "2", "--resume")  # goes on with what it was
    assert read_card(tmp_path / "mug.safetensors")["recipe"] == "paper"
    with pytest.raises(SystemExit, match="2"):
        command_line("--resume", "--recipe", "shipped")
    assert "checkpoint of mug, paper, none, not of mug, shipped, none" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--category", "kettle"], "no simulated shapes of 'kettle'; give --meshes"),
        (["--meshes", "somewhere"], "name one --category"),
        (["--recipe", "secret"], "invalid choice"),
        (["--category", "mug", "--symmetry", "axial"], "--symmetry is told of --meshes"),
        (["--category", "a/b", "--meshes", "somewhere"], "is to name files"),
        (["--category", "mug", "--threads", "0"], "--threads 0: give 1 or more"),
        (["--category", "kettle", "--meshes", "nowhere"], "nowhere is not a directory"),
    ],
)
def test_command_line_that_makes_no_sense_is_refused(capsys, arguments, message):
    with pytest.raises(SystemExit, match="2"):
        train.main(arguments)
    assert message in capsys.readouterr().err


def test_training_starts_from_the_weights_of_another_category(command_line, tmp_path):
    command_line("--steps", "1", "--seed", "1")
    start = (tmp_path / "mug.safetensors").rename(tmp_path / "kettle.safetensors")
    command_line("--steps", "1", "--from", str(start))
    assert read_card(tmp_path / "mug.safetensors")["started_from"] == "kettle"
    command_line("--steps", "2", "--resume")
    assert read_card(tmp_path / "mug.safetensors")["started_from"] == "kettle"


def test_card_tells_what_was_trained_before(command_line, tmp_path):
    command_line("--steps", "2")
    start = (tmp_path / "mug.safetensors").rename(tmp_path / "first.safetensors")
    command_line("--steps", "1", "--from", str(start))
    before = read_card(tmp_path / "mug.safetensors")["before"]
    assert before["step"] == 2
    assert before.keys() <= {"step", "hours", "commit"}


def test_another_seed_is_no_way_to_go_on(command_line, capsys):
    command_line("--steps", "1", "--seed", "1")
    with pytest.raises(SystemExit, match="2"):
        command_line("--steps", "2", "--seed", "2", "--resume")
    assert "has seed 1" in capsys.readouterr().err


def test_training_of_all_fails_where_one_is_killed(monkeypatch):
    codes = {"bottle": -9}
    monkeypatch.setattr(train.subprocess, "call", lambda command: codes.get(command[-1], 0))
    assert train.main([]) == 9


def test_stop_before_the_first_batch_tells_how_to_go_on(command_line, monkeypatch, capsys):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "load_views", stop)
    with pytest.raises(SystemExit, match="130"):
        command_line("--steps", "1")
    assert "the same command goes on" in capsys.readouterr().err


def test_start_from_another_network_is_refused(command_line, tmp_path, capsys):
    command_line("--steps", "1", "--recipe", "paper")
    paper = (tmp_path / "mug.safetensors").rename(tmp_path / "paper.safetensors")
    with pytest.raises(SystemExit, match="2"):
        command_line("--steps", "1", "--from", str(paper))
    assert "start from another file" in capsys.readouterr().err


def test_start_from_nowhere_is_refused_before_views_are_drawn(command_line, monkeypatch, capsys):
    monkeypatch.delattr(train, "load_views")
    with pytest.raises(SystemExit, match="2"):
        command_line("--steps", "1", "--from", "teapot")
    assert "no weights for category 'teapot'" in capsys.readouterr().err

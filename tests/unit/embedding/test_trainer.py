from dataclasses import replace

import numpy as np
import pytest
import torch

from neuse.embedding.dataset import ViewSet
from neuse.embedding.trainer import RECIPES, Trainer, TrainParams, commit_of, recipe_params
from neuse.errors import InputError, ParamError, WeightsError
from neuse.symmetry import AXIAL, NONE

from .tiny import TRAIN


@pytest.fixture
def make_trainer(mug_views, mug_views_held_out):
    """Factory of trainers of a tiny network on a tiny shard."""

    def make(recipe="shipped", **changes):
        params = recipe_params(recipe, NONE)
        tiny = replace(params, **TRAIN | {"latent": 16} | changes)
        return Trainer("mug", tiny, mug_views, mug_views_held_out)

    return make


def assert_same_weights(a, b):
    for name, tensor in a.network.state_dict().items():
        assert torch.equal(tensor, b.network.state_dict()[name]), name


@pytest.mark.parametrize(
    ("recipe", "names"),
    [
        ("shipped", {"frame", "occupancy", "shape", "sigma"}),
        *((recipe, {"transform", "occupancy", "shape"}) for recipe in ("paper", "light-pose", "light-shape")),
    ],
)
def test_every_loss_of_the_recipe_is_finite_and_reported(make_trainer, recipe, names):
    losses = make_trainer(recipe).train_step()
    assert losses.keys() == names
    assert np.isfinite(list(losses.values())).all()


def test_paper_recipe_trains_ambiguous_objects_by_their_whole_surface(shard_folder):
    views = ViewSet([shard_folder / "mug_train_0000.npz"], AXIAL)
    params = replace(recipe_params("paper", AXIAL), **TRAIN | {"latent": 16})
    losses = Trainer("bottle", params, views, views).train_step()
    assert 0 < losses["transform"] < 10


def test_recipes_have_the_weights_of_the_paper():
    weights = {
        (recipe, category): (p.transform_weight, p.shape_weight, p.latent)
        for recipe in RECIPES
        for category, symmetry in (("mug", NONE), ("bottle", AXIAL))
        for p in [recipe_params(recipe, symmetry)]
        if recipe != "shipped"
    }
    assert weights == {
        ("paper", "mug"): (0.1, 0.1, 512),
        ("paper", "bottle"): (1.0, 0.1, 512),
        ("light-pose", "mug"): (0.1, 0.0, 128),
        ("light-pose", "bottle"): (1.0, 0.0, 128),
        ("light-shape", "mug"): (0.0, 0.1, 128),
        ("light-shape", "bottle"): (0.0, 0.1, 128),
    }


@pytest.mark.parametrize(("recipe", "loss"), [("shipped", "frame"), ("paper", "occupancy")])
def test_training_on_one_batch_lowers_its_loss(make_trainer, monkeypatch, recipe, loss):
    trainer = make_trainer(recipe, steps=60, lr=1e-2)
    batch = trainer.draw()
    monkeypatch.setattr(trainer, "draw", lambda: batch)
    losses = [trainer.train_step()[loss] for _ in range(40)]
    assert losses[-1] < 0.7 * losses[0]


@pytest.mark.parametrize("recipe", ["shipped", "paper", "light-pose", "light-shape"])
def test_every_weight_of_the_encoder_and_decoder_is_trained(make_trainer, recipe):
    trainer = make_trainer(recipe, weight_decay=0.0)
    before = {name: weight.detach().clone() for name, weight in trainer.network.named_parameters()}
    for _ in range(3):
        trainer.train_step()
    weights = dict(trainer.network.named_parameters())
    assert [name for name in weights if torch.equal(weights[name], before[name])] == []


def test_same_seed_gives_the_same_weights_and_another_seed_others(make_trainer):
    a, b, other = make_trainer(), make_trainer(), make_trainer(seed=1)
    for trainer in (a, b, other):
        trainer.train_step()
    assert_same_weights(a, b)
    with pytest.raises(AssertionError):
        assert_same_weights(a, other)


def test_batch_is_a_function_of_seed_step_and_process(make_trainer):
    def points(rank=0, **changes):
        trainer = make_trainer(seed=changes.get("seed", 0))
        trainer.step, trainer.group = changes.get("step", 0), replace(trainer.group, rank=rank)
        return trainer.draw().points

    assert torch.equal(points(), points())
    for other in (points(rank=1), points(seed=1), points(step=1)):
        assert not torch.equal(points(), other)


def test_checkpoint_holds_data_only(make_trainer, tmp_path):
    trainer = make_trainer()
    trainer.save_checkpoint(tmp_path / "mug.ckpt")
    state = torch.load(tmp_path / "mug.ckpt", weights_only=True)  # refuses anything that would run
    assert state["params"]["steps"] == TRAIN["steps"]
    assert not (tmp_path / "mug.partial").exists()


def test_checkpoint_of_another_recipe_is_refused(make_trainer, tmp_path):
    make_trainer("paper").save_checkpoint(tmp_path / "mug.ckpt")
    with pytest.raises(WeightsError, match="of mug, paper, none, not of mug, shipped, none"):
        make_trainer().load_checkpoint(tmp_path / "mug.ckpt")


def test_checkpoint_of_another_category_is_refused(make_trainer, tmp_path):
    trainer = make_trainer()
    trainer.category = "bottle"
    trainer.save_checkpoint(tmp_path / "mug.ckpt")
    with pytest.raises(WeightsError, match="of bottle"):
        make_trainer().load_checkpoint(tmp_path / "mug.ckpt")


def test_checkpoint_of_before_recipes_is_of_the_shipped_one(make_trainer, tmp_path):
    trainer = make_trainer()
    trainer.train_step()
    trainer.save_checkpoint(tmp_path / "mug.ckpt")
    state = torch.load(tmp_path / "mug.ckpt", weights_only=True)
    del state["category"], state["params"]["recipe"]
    torch.save(state, tmp_path / "mug.ckpt")
    later = make_trainer()
    later.load_checkpoint(tmp_path / "mug.ckpt")
    assert_same_weights(trainer, later)


@pytest.mark.parametrize("content", [b"", b"no checkpoint"])
def test_damaged_checkpoint_is_refused(make_trainer, tmp_path, content):
    (tmp_path / "mug.ckpt").write_bytes(content)
    with pytest.raises(WeightsError, match=r"mug\.ckpt is no checkpoint"):
        make_trainer().load_checkpoint(tmp_path / "mug.ckpt")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda state: state.clear(), "lacks what one holds"),
        (lambda state: state["params"].update(colour=3), "of another version"),
        (lambda state: state["network"].popitem(), "does not fit"),
    ],
    ids=["empty", "unknown parameter", "missing tensor"],
)
def test_checkpoint_that_lacks_something_is_refused(make_trainer, tmp_path, damage, message):
    make_trainer().save_checkpoint(tmp_path / "mug.ckpt")
    state = torch.load(tmp_path / "mug.ckpt", weights_only=True)
    damage(state)
    torch.save(state, tmp_path / "mug.ckpt")
    with pytest.raises(WeightsError, match=message):
        make_trainer().load_checkpoint(tmp_path / "mug.ckpt")


def test_means_of_losses_go_on_after_a_stop(make_trainer, tmp_path):
    trainer, later = make_trainer(), make_trainer()
    trainer.train_step()
    trainer.save_checkpoint(tmp_path / "mug.ckpt")
    later.load_checkpoint(tmp_path / "mug.ckpt")
    trainer.train_step()
    later.train_step()
    assert later.running == trainer.running


def test_loss_that_is_not_finite_stops_the_run_and_spoils_nothing(make_trainer, monkeypatch):
    trainer, untouched = make_trainer(), make_trainer()
    batch = trainer.draw()
    monkeypatch.setattr(trainer, "draw", lambda: batch._replace(target=batch.target * torch.nan))
    with pytest.raises(InputError, match="the loss of batch 0 is nan"):
        trainer.train_step()
    assert trainer.step == 0
    assert_same_weights(trainer, untouched)


def test_commit_is_unknown_without_git_and_outside_of_a_repository(tmp_path, monkeypatch):
    (tmp_path / "trainer.py").touch()
    assert commit_of(tmp_path / "trainer.py") == "unknown"
    monkeypatch.setenv("PATH", str(tmp_path))
    assert commit_of(tmp_path / "trainer.py") == "unknown"


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
    assert anchors == [TRAIN["anchors"]] * 75 + [TRAIN["anchors_last"]] * 25


@pytest.mark.parametrize(
    "change", [{"steps": 0}, {"lr": -1.0}, {"last_stretch": 1.5}, {"recipe": "secret"}], ids=str
)
def test_parameter_outside_its_range_is_refused(change):
    with pytest.raises(ParamError, match=next(iter(change))):
        TrainParams(**change)


def test_more_shapes_a_batch_than_there_are_is_refused(make_trainer):
    with pytest.raises(InputError, match="3 shapes a batch asked of 2"):
        make_trainer(shapes_per_batch=3).train_step()

from dataclasses import replace

import pytest

from neuse.embedding import compare
from neuse.embedding.trainer import RECIPES, recipe_params
from neuse.symmetry import NONE

from .tiny import TRAIN


@pytest.fixture(autouse=True)
def tiny(monkeypatch, mug_views, mug_views_held_out):
    """Tiny networks on tiny shards; steps that always take half a second."""
    monkeypatch.setattr(
        compare, "recipe_params", lambda *of: replace(recipe_params(*of), **TRAIN | {"latent": 16})
    )
    monkeypatch.setattr(compare, "load_views", lambda *arguments: (mug_views, mug_views_held_out))
    monkeypatch.setattr(compare, "_seconds_a_step", lambda trainer: 0.5)
    monkeypatch.setattr(compare, "run", lambda trainer, weights: weights.write_text(str(trainer.params)))


def test_budget_sets_the_number_of_steps(tmp_path):
    assert compare.train_for("mug", "paper", 0.1, 1, tmp_path, tmp_path) == 12
    assert "steps=12" in (tmp_path / "paper" / "mug.safetensors").read_text()


def test_recipe_that_was_trained_is_not_trained_again(tmp_path):
    compare.train_for("mug", "paper", 0.1, 1, tmp_path, tmp_path)
    assert compare.train_for("mug", "paper", 0.2, 1, tmp_path, tmp_path) == 12


def test_every_recipe_is_compared_and_the_light_one_shares_its_time(tmp_path, monkeypatch):
    monkeypatch.setattr(compare, "load_embeddings", lambda *folders: [folder.name for folder in folders])
    monkeypatch.setattr(compare, "evaluate", lambda names, shapes, n, conditions: names)
    figures, steps = compare.compare(0.1, 1, 1, tmp_path, tmp_path)
    assert figures == {"shipped": ["shipped"], "paper": ["paper"], "light": ["light-pose", "light-shape"]}
    assert {name.split()[0] for name in steps} == set(RECIPES)
    assert (steps["paper mug"], steps["light-pose mug"], steps["light-shape bottle"]) == (12, 6, 6)


def test_page_has_a_column_a_recipe_and_the_command():
    page = compare.text({"shipped": {}, "paper": {}, "light": {}}, {"paper mug": 12}, 0.1, 1, 2)
    head = next(line for line in page.splitlines() if "bar" in line and "|" in line)
    assert [cell.strip() for cell in head.split("|")[3:6]] == ["shipped", "paper", "light"]
    assert "--minutes 0.1 --shards 1 --scenes 2" in page
    assert "paper mug 12" in page


def test_steps_are_timed_without_training(mug_views, mug_views_held_out, monkeypatch):
    monkeypatch.undo()
    params = replace(recipe_params("shipped", NONE), **TRAIN | {"latent": 16})
    trainer = compare.Trainer("mug", params, mug_views, mug_views_held_out)
    before = trainer.network.decoder.to_logit.weight.clone()
    assert compare._seconds_a_step(trainer) > 0
    assert (trainer.network.decoder.to_logit.weight == before).all()

import json
import sys

import numpy as np
import pytest
import trimesh

from neuse.embedding import evaluate
from neuse.embedding.card import card_text
from neuse.embedding.embedding import Embedding, LightEmbedding
from neuse.embedding.network import Network, save_network
from neuse.embedding.sightings import Condition
from neuse.embedding.table import FAR, ROWS, USUAL, lookup, rows_of
from neuse.errors import InputError, MeshError
from neuse.simulation.shapes import make_shape, symmetry_of

from .test_paper_encoder import CONFIG as PAPER
from .tiny import block_bottle, block_mug, make_network

SHAPES = {"mug": [block_mug(), block_mug()], "bottle": [block_bottle(), block_bottle()]}
NEAR = (0.6, 0.9)
CONDITIONS = (
    Condition(USUAL, 0.0015, range_m=NEAR),
    Condition(FAR, 0.0015, growing=True, range_m=(1.5, 1.8)),
)
CARD = {
    "recipe": "shipped",
    "step": 3,
    "hours": 0.5,
    "commit": "abc1234",
    "shapes": 50,
    "params": {"seed": 4, "shapes_per_batch": 2, "views_per_shape": 2, "anchors": 16, "anchors_last": 32},
    "validation": {"deg_seen": float("nan")},
}


@pytest.fixture(scope="module", autouse=True)
def _little():
    """Two views a scene, no reconstructions of networks that fill all space, no waiting for speed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluate, "VIEWS", 2)
        patch.setattr(evaluate, "_reconstructed", lambda sightings, category: [])
        patch.setattr(
            evaluate, "speed", lambda embedding: {"encode_ms_per_object": 5.0, "decode_20k_ms": 9.0}
        )
        yield


def tiny_figures(networks):
    embeddings = {network.category: Embedding(network) for network in networks}
    return evaluate.evaluate(embeddings, SHAPES, 1, conditions=CONDITIONS)


@pytest.fixture(scope="module")
def figures():
    return tiny_figures([make_network("mug"), make_network("bottle")])


def test_every_row_of_the_table_has_its_figure(figures):
    for row in ROWS:
        assert lookup(figures, row.path, USUAL) is not None, row.title


def test_pairs_and_single_views_are_counted(figures):
    assert figures[USUAL]["bottle"]["rotation_deg"]["n"] == 1  # the two views of the scene
    assert figures[USUAL]["frame, bottle"]["axis_deg"]["n"] == 4  # two bottles in each


@pytest.fixture(scope="module")
def others():
    """Figures of bowls and boxes."""
    cube = trimesh.creation.box((0.08, 0.1, 0.12))
    shapes = {
        "bowl": [make_shape("bowl", "bowl", block_bottle().mesh)] * 2,
        "box": [make_shape("box", "box", cube) for _ in range(2)],
    }
    embeddings = {category: Embedding(make_network(category)) for category in shapes}
    return evaluate.evaluate(embeddings, shapes, 1, conditions=CONDITIONS)


def test_other_categories_have_rows_of_their_own(others):
    rows = rows_of(["bowl", "box"])
    assert {row.category for row in rows} == {"bowl", "box"}
    for row in rows:
        assert lookup(others, row.path, USUAL) is not None, row.title


def test_lone_box_gives_no_pose_but_a_centre(others):
    assert others[USUAL]["box"]["rotation_deg"]["n"] == 0
    assert others[USUAL]["frame, box"]["centre_mm"]["n"] == 4
    assert others[USUAL]["frame, box"]["axis_deg"]["median"] < 63.0  # the farthest that edges can be


def test_same_seed_gives_the_same_figures(figures):
    again = tiny_figures([make_network("mug"), make_network("bottle")])
    assert json.dumps(again) == json.dumps(figures)


def test_codes_of_the_paper_are_evaluated_by_horn_and_have_no_frames():
    figures = tiny_figures([Network(category, symmetry_of(category), PAPER) for category in SHAPES])
    assert np.isfinite(figures[USUAL]["bottle"]["rotation_deg"]["median"])
    assert "frame, mug" not in figures[USUAL]
    assert figures[USUAL]["nees, mug"]["0-30 deg, visible"]["n"] == 0


def test_light_variant_takes_descriptors_from_its_other_network(tmp_path):
    for folder, seed in (("pose", 0), ("shape", 1)):
        (tmp_path / folder).mkdir()
        for category in SHAPES:
            save_network(make_network(category, seed), tmp_path / folder / f"{category}.safetensors", {})
    light = evaluate.load_embeddings(tmp_path / "pose", tmp_path / "shape")["mug"]
    assert isinstance(light, LightEmbedding)
    cloud = [np.random.default_rng(0).normal(size=(90, 3)) * 0.05]
    pose, shape = (Embedding(make_network("mug", seed)).encode(cloud)[0] for seed in (0, 1))
    code = light.encode(cloud)[0]
    np.testing.assert_array_equal(code.z, pose.z)
    np.testing.assert_array_equal(code.descriptor, shape.descriptor)


def test_test_shapes_are_fixed_by_their_seed():
    def names(seed):
        return [shape.name for shape in evaluate.unseen_shapes(None, 1, seed)["mug"]]

    assert names(0) == names(0) != names(1)
    assert len(names(0)) == 2


def test_too_few_meshes_of_ones_own_are_refused(tmp_path):
    with pytest.raises(MeshError, match="mug holds 0 meshes"):
        evaluate.unseen_shapes(tmp_path, 1)


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory, _little):
    """A folder with tiny weights, and what the command line wrote there of them."""
    folder = tmp_path_factory.mktemp("evaluated")
    for category in SHAPES:
        card = CARD | {"category": category}
        save_network(make_network(category), folder / f"{category}.safetensors", card)
    arguments = ["evaluate", "--out", str(folder), "--weights", str(folder), "--scenes", "1"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluate, "unseen_shapes", lambda *arguments: SHAPES)
        patch.setattr(sys, "argv", arguments)
        evaluate.main()
    return folder


@pytest.fixture
def written(evaluated):
    return json.loads((evaluated / "embedding.json").read_text())


def test_command_line_writes_figures_of_every_condition(written):
    assert {condition.name for condition in evaluate.CONDITIONS} <= written.keys()
    assert written["cards"]["mug"]["commit"] == "abc1234"
    assert (written["scenes"], written["shapes"]) == (1, "simulated")


def test_printed_table_has_a_column_a_noise(written):
    head = evaluate.table(written).splitlines()[0]
    for name in ("bar", "0 mm", "1.5 mm", "3 mm", "mask faults"):
        assert name in head


def test_card_is_of_the_weights_and_their_figures(written, evaluated):
    figures = written | {
        f"{category} shape": {"iou": {"n": 8, "median": 0.5, "p90": 0.7}, "surface_mm": {}, "failed": 2}
        for category in SHAPES
    }
    figures["mug shape"]["surface_mm"] = {"n": 8, "median": 2.0, "p90": 3.0}
    text = card_text(evaluated / "mug.safetensors", figures)
    for part in ("--recipe shipped", "| abc1234 |", "| seed | 4 |", "k = 16", "3 of 2 shapes x 2 views"):
        assert part in text
    assert "2 of 10 codes decoded to nothing" in text
    assert "2 mugs + 2 bottles" in text
    assert "bottle: IoU" not in text
    assert "| symmetry | none: every turn shows" in text


def test_card_with_the_figures_of_other_weights_is_refused(written, evaluated):
    written["cards"]["mug"]["step"] = 4
    with pytest.raises(InputError, match=r"not of .*mug\.safetensors"):
        card_text(evaluated / "mug.safetensors", written)

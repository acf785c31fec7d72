from itertools import islice

import numpy as np
import trimesh

from neuse.simulation.population import population
from neuse.simulation.shapes import make_shape


def box(category, size=(0.06, 0.05, 0.2)):
    return make_shape(f"{category} {size}", category, trimesh.creation.box(size))


OWN = {
    category: [box(category, (0.05, 0.05, h)) for h in (0.1, 0.12, 0.14)] for category in ("mug", "bottle")
}


def drawn(n, objects=100, twins=0, lying_share=0.0, own=OWN, seed=0, categories=("mug", "bottle")):
    rng = np.random.default_rng(seed)
    return list(islice(population(categories, objects, twins, lying_share, own, rng), n))


def test_mugs_and_bottles_alternate():
    assert [shape.category for shape, _ in drawn(6)] == ["mug", "bottle"] * 3


def test_categories_come_by_turns_however_many():
    names = ("mug", "bowl", "kettle")
    own = {name: [box(name)] for name in names}
    assert [shape.category for shape, _ in drawn(7, own=own, categories=names)] == [*names, *names, "mug"]


def test_own_shapes_replace_procedural_ones_and_return_when_all_are_used():
    mugs = [shape for shape, _ in drawn(10) if shape.category == "mug"]
    assert mugs == [*OWN["mug"], *OWN["mug"][:2]]


def test_category_without_own_shapes_stays_procedural():
    shapes = [shape for shape, _ in drawn(4, own={"mug": OWN["mug"], "bottle": []})]
    assert shapes[0] is OWN["mug"][0]
    assert shapes[1].name.startswith("bottle_")


def test_twins_are_the_last_of_the_first_objects_and_repeat_earlier_shapes():
    own = {c: [box(c, (0.05, 0.05, 0.1 + 0.001 * i)) for i in range(20)] for c in ("mug", "bottle")}
    shapes = [shape for shape, _ in drawn(12, objects=10, twins=3, own=own)]
    assert len(set(shapes[:7])) == 7
    assert all(shape in shapes[:7] for shape in shapes[7:10])
    assert len(set(shapes[7:10])) == 3
    assert all(shape not in shapes[:10] for shape in shapes[10:])


def test_share_of_lying_objects():
    kinds = [kind for _, kind in drawn(400, lying_share=0.5)]
    assert 160 < kinds.count("lying") < 240
    assert {kind for _, kind in drawn(20)} == {"upright"}


def test_shape_that_cannot_lie_stands():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    dome = make_shape(
        "dome", "mug", trimesh.PointCloud(ball.vertices[ball.vertices[:, 2] > -1e-9]).convex_hull
    )
    [(shape, kind)] = drawn(1, lying_share=1.0, own={"mug": [dome]})
    assert shape is dome
    assert kind == "upright"

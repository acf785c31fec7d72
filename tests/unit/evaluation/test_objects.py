import numpy as np
import pytest

from neuse.evaluation.objects import MIN_FRAMES_SEEN, score_objects
from neuse.evaluation.truth import TrueObject
from neuse.geometry import Array, inverse, make_transform
from neuse.records import ObjectStatus


def _at(x: float, y: float = 0.0) -> Array:
    return make_transform(np.eye(3), [x, y, 0.0])


def _true(object_id: int, x: float, category: str = "mug", n_seen: int = 9) -> TrueObject:
    return TrueObject(object_id, category, _at(x), np.full(3, 0.1), n_seen)


WORLD = (_true(1, 0.0), _true(2, 1.0, "bottle"), _true(3, 2.0))


def test_a_perfect_map_maps_every_object_once(map_object, T_any: Array) -> None:
    T_map_world = inverse(T_any)
    mapped = [
        map_object(10 + item.object_id, T_map_world @ item.T_world_object, item.category) for item in WORLD
    ]
    score = score_objects(mapped, WORLD, T_any)
    assert (score.true, score.mapped, score.missed, score.duplicates, score.ghosts) == (3, 3, (), (), ())
    assert score.center_error_m == pytest.approx(0.0, abs=1e-12)


def test_objects_that_are_not_in_the_map_are_missed(map_object) -> None:
    score = score_objects([map_object(1, _at(0.0))], WORLD, np.eye(4))
    assert (score.true, score.mapped, score.missed) == (3, 1, (2, 3))


def test_an_object_mapped_twice_has_a_duplicate(map_object) -> None:
    score = score_objects([map_object(4, _at(0.02)), map_object(5, _at(0.0))], WORLD[:1], np.eye(4))
    assert (score.mapped, score.duplicates, score.ghosts) == (1, (4,), ())


@pytest.mark.parametrize(("x", "category"), [(0.5, "mug"), (0.0, "bottle")], ids=["place", "category"])
def test_a_map_object_where_nothing_such_stands_is_a_ghost(map_object, x: float, category: str) -> None:
    score = score_objects([map_object(4, _at(x), category)], WORLD[:1], np.eye(4))
    assert (score.mapped, score.missed, score.ghosts) == (0, (1,), (4,))


def test_removed_map_objects_do_not_count(map_object) -> None:
    score = score_objects([map_object(4, _at(5.0), status=ObjectStatus.REMOVED)], WORLD, np.eye(4))
    assert score.ghosts == ()


def test_hardly_seen_objects_need_not_be_mapped_but_may_be(map_object) -> None:
    hardly = (_true(1, 0.0, n_seen=MIN_FRAMES_SEEN - 1),)
    assert score_objects([], hardly, np.eye(4)).true == 0
    mapped = score_objects([map_object(4, _at(0.0))], hardly, np.eye(4))
    assert (mapped.true, mapped.mapped, mapped.ghosts) == (0, 0, ())


def test_center_error_is_unknown_without_a_pair() -> None:
    assert score_objects([], (), np.eye(4)).center_error_m is None

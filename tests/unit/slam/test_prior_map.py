"""What a session is told of a map that it did not make."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.records import ObjectMap, ObjectStatus
from neuse.slam.prior_map import SAME_PLACE_M, PriorMap, in_their_places

from .known_maps import map_of
from .synthetic import small_world


@pytest.fixture
def objects():
    return map_of(small_world().things[:4]).objects


def test_what_is_gone_or_has_no_sound_code_is_left_out_but_keeps_its_name(objects):
    gone = replace(objects[3], status=ObjectStatus.REMOVED)
    spoiled = replace(objects[2], code=replace(objects[2].code, sigmas=np.zeros(6)))
    prior = PriorMap.of(ObjectMap(1, (*objects[:2], spoiled, gone)))
    assert prior.ids == (20, 21)
    assert prior.next_id == 24


def test_map_without_objects_is_empty_and_has_used_no_name():
    prior = PriorMap.of(ObjectMap(1))
    assert (len(prior), prior.next_id, prior.neighbours(1.0)) == (0, 0, 0.0)


def test_centers_stand_in_the_order_of_the_ids(objects):
    prior = PriorMap.of(ObjectMap(1, objects[::-1]))
    for object_id, center in zip(prior.ids, prior.centers, strict=True):
        np.testing.assert_allclose(center, objects[object_id - 20].code.center, atol=1e-12)


def test_neighbours_are_counted_without_the_object_itself(objects):
    prior = PriorMap.of(ObjectMap(1, objects))
    assert prior.neighbours(1e-6) == 0.0
    assert prior.neighbours(100.0) == 3.0


@pytest.mark.parametrize(("n_moved", "expected"), [(0, True), (1, True), (2, False), (3, False)])
def test_most_of_the_shared_names_must_be_in_their_places(n_moved, expected):
    known = {i: np.array([float(i), 0.0, 0.0]) for i in range(5)}
    aside = np.array([0.0, 1.01 * SAME_PLACE_M, 0.0])
    seen = {i: known[i] + aside * (i <= n_moved) for i in (1, 2, 3)} | {9: np.zeros(3)}
    assert in_their_places(seen, known) is expected


def test_without_shared_names_nothing_is_known_of_places():
    assert in_their_places({1: np.zeros(3)}, {2: np.zeros(3)}) is None


def test_names_of_another_session_on_one_table_are_not_in_their_places():
    """Places are near to each other, but where one stands the map has another."""
    known = {i: np.array([0.15 * (i % 3), 0.15 * (i // 3), 0.0]) for i in range(6)}
    seen = {i: known[(i + 1) % 6] for i in range(6)}
    assert in_their_places(seen, known) is False
    before_a_camera = {0: [0.0, 0.05, 0.0], 1: [0.2, 0.05, 0.0], 2: [0.2, 0.15, 0.05]}
    assert in_their_places({i: np.array(center) for i, center in before_a_camera.items()}, known) is False
    assert in_their_places({i: center + 0.02 for i, center in known.items()}, known) is True


@pytest.mark.parametrize(("off_m", "expected"), [(0.02, True), (0.1, None)])
def test_two_objects_tell_a_map_only_where_they_stand_exactly(off_m, expected):
    known = {i: np.array([float(i), 0.0, 0.0]) for i in range(5)}
    assert in_their_places({1: known[1], 2: known[2] + [0, off_m, 0]}, known) is expected

import numpy as np
import pytest

from neuse.evaluation.changes import score_changes
from neuse.geometry import Array, inverse, make_transform
from neuse.records import ChangeKind, ObjectChange

ADDED, REMOVED, MOVED = ChangeKind.ADDED, ChangeKind.REMOVED, ChangeKind.MOVED
HERE, THERE, FAR = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]


def _change(
    kind: ChangeKind, before=None, after=None, category: str = "mug", stamp_ns: int = 10
) -> ObjectChange:
    T_before, T_after = (None if p is None else make_transform(np.eye(3), p) for p in (before, after))
    return ObjectChange(stamp_ns, kind, 1, category, T_before, T_after)


def _score(detected: list[ObjectChange], true: list[ObjectChange]) -> tuple[int, int, int]:
    score = score_changes(detected, true, np.eye(4))
    return score.tp, score.fp, score.fn


TRUE = [_change(ADDED, after=HERE), _change(REMOVED, before=THERE), _change(MOVED, HERE, FAR, "bottle")]


def test_changes_found_as_they_are_count_whatever_their_order() -> None:
    assert _score(TRUE[::-1], TRUE) == (3, 0, 0)


def test_nothing_found_is_all_missed() -> None:
    assert _score([], TRUE) == (0, 0, 3)


def test_changes_where_there_are_none_are_all_false() -> None:
    assert _score(TRUE, []) == (0, 3, 0)


def test_no_changes_at_all_score_nothing() -> None:
    assert _score([], []) == (0, 0, 0)


@pytest.mark.parametrize(
    "detected",
    [
        _change(REMOVED, before=HERE),
        _change(ADDED, after=HERE, category="bottle"),
        _change(ADDED, after=[0.0, 0.16, 0.0]),
        _change(ADDED, after=HERE, stamp_ns=9),
        _change(MOVED, HERE, HERE),
    ],
    ids=["kind", "category", "place", "too early", "moved"],
)
def test_detection_that_differs_is_false_and_leaves_the_change_missed(detected: ObjectChange) -> None:
    assert _score([detected], TRUE[:1]) == (0, 1, 1)


def test_move_needs_both_places() -> None:
    assert _score([_change(MOVED, HERE, THERE, "bottle")], TRUE[2:]) == (0, 1, 1)
    assert _score([_change(MOVED, THERE, FAR, "bottle")], TRUE[2:]) == (0, 1, 1)


def test_move_reported_as_removed_and_added_is_two_false_and_one_missed() -> None:
    halves = [_change(REMOVED, before=HERE, category="bottle"), _change(ADDED, after=FAR, category="bottle")]
    assert _score(halves, TRUE[2:]) == (0, 2, 1)


def test_a_change_reported_twice_counts_once() -> None:
    assert _score([TRUE[0], TRUE[0]], TRUE[:1]) == (1, 1, 0)


def test_two_changes_near_each_other_are_paired_so_that_both_count() -> None:
    true = [_change(ADDED, after=[0.0, 0, 0]), _change(ADDED, after=[0.2, 0, 0])]
    detected = [_change(ADDED, after=[0.1, 0, 0]), _change(ADDED, after=[0.06, 0, 0])]
    assert _score(detected, true) == (2, 0, 0)


def test_places_are_compared_in_the_world(T_any: Array) -> None:
    T_map_world = inverse(T_any)
    moved = TRUE[2]
    detected = ObjectChange(
        20, MOVED, 7, "bottle", T_map_world @ moved.T_map_before, T_map_world @ moved.T_map_after
    )
    assert score_changes([detected], [moved], T_any).matches == ((0, 0),)
    assert score_changes([detected], [moved], np.eye(4)).matches == ()

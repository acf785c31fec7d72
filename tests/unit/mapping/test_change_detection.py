from dataclasses import replace

import numpy as np
import pytest

from neuse.mapping.change_detection import ChangeDetector, ChangeParams, Move, settled_changes
from neuse.mapping.object_library import ObjectLibrary
from neuse.mapping.object_record import ObjectRecord
from neuse.mapping.views import View
from neuse.records import NO_ID, ChangeKind, ObjectChange, ObjectStatus

from .synthetic import make_code, standing

S = 1_000_000_000
HOLD, DOUBTFUL, PENDING, MEMORY = 2 * S, 10 * S, 60 * S, 120 * S


def library_of(*entries):
    """Objects (object_id, shape seed, since tick, last tick), a metre from each other."""
    library = ObjectLibrary()
    for i, (object_id, seed, since_tick, last_tick) in enumerate(entries):
        thing = standing("thing", float(i), 0.0, seed=seed)
        record = ObjectRecord(object_id, "bottle", {NO_ID: np.eye(4)}, 0, 0, since_tick, last_tick)
        code = make_code(thing, thing.T_world_object, np.random.default_rng(object_id))
        record.add_view(NO_ID, View(code, code.center[None]), 10)
        library.records[object_id] = record
    return library


def put(record, x, like, cosine=1.0):
    """Let a record of a library have stood so far along the row, and look so much like another one."""
    own = like.code.descriptor
    across = np.linalg.qr(np.stack([own, np.ones_like(own)], axis=1))[0][:, 1]
    T = like.code.T_frame_object.copy()
    T[0, 3] = x
    code = make_code(standing("thing", 0.0, 0.0, seed=5), T, np.random.default_rng(0), 0.0)
    code = replace(code, descriptor=cosine * own + np.sqrt(1.0 - cosine**2) * across)
    record.views.clear()
    record.add_view(NO_ID, View(code, code.center[None]), 10)


@pytest.fixture
def detector():
    return ChangeDetector(ChangeParams())


def decide(detector, library, stamp_ns=0, final=False, doubtful=frozenset()):
    """(moves, added, removed) as plain lists."""
    decision = detector.decide(library, stamp_ns, final, doubtful)
    return list(decision.moves), list(decision.added), list(decision.removed)


NOTHING = ([], [], [])


def test_object_gone_and_newcomer_of_its_shape_are_a_move(detector):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20))
    detector.note_gone(1, 0)
    detector.note_come(2, 0)
    assert decide(detector, library) == ([Move(1, 2)], [], [])
    assert decide(detector, library, final=True) == NOTHING


@pytest.mark.parametrize(("cosine", "has_moved"), [(0.995, True), (0.95, False)])
def test_object_hardly_shifted_must_look_the_same_or_else_another_stands_there(detector, cosine, has_moved):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20))
    put(library.records[2], 0.05, library.records[1], cosine)
    detector.note_gone(1, 0)
    detector.note_come(2, 0)
    expected = ([Move(1, 2)], [], []) if has_moved else ([], [2], [1])
    assert decide(detector, library, HOLD) == expected


def test_newcomer_of_another_shape_is_added_and_the_gone_one_removed_after_a_while(detector):
    library = library_of((1, 5, 0, 3), (2, 6, 10, 20))
    detector.note_gone(1, S)
    detector.note_come(2, 0)
    assert decide(detector, library, HOLD - 1) == NOTHING
    assert detector.waiting == {2}
    assert decide(detector, library, HOLD) == ([], [2], [])
    assert detector.waiting == set()
    assert decide(detector, library, S + HOLD - 1) == NOTHING
    assert decide(detector, library, S + HOLD) == ([], [], [1])
    assert decide(detector, library, S + HOLD, final=True) == NOTHING


def test_newcomer_waits_while_the_place_of_a_like_object_is_unseen(detector):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20))
    detector.note_come(2, 0)
    assert decide(detector, library) == NOTHING
    detector.note_gone(1, S)
    assert decide(detector, library, S) == ([Move(1, 2)], [], [])


def test_newcomer_is_added_once_the_like_object_is_seen_at_home(detector):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20))
    detector.note_come(2, 0)
    library.records[1].seen(21, 0, library.records[1].code)
    assert decide(detector, library, HOLD) == ([], [2], [])


def test_newcomer_is_added_when_it_waited_long_enough(detector):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20))
    detector.note_come(2, 0)
    assert decide(detector, library, PENDING - 1) == NOTHING
    assert decide(detector, library, PENDING) == ([], [2], [])
    assert decide(detector, library, PENDING) == NOTHING


def test_move_is_still_found_after_its_halves_were_reported(detector):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20))
    detector.note_come(2, 0)
    assert decide(detector, library, final=True) == ([], [2], [])
    detector.note_gone(1, S)
    assert decide(detector, library, S) == ([Move(1, 2)], [], [])


def test_doubtful_newcomer_of_the_very_shape_of_an_object_long_gone_is_that_object(detector):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20))
    assert decide(detector, library, doubtful={2}) == NOTHING
    detector.note_gone(1, 0)
    assert decide(detector, library, HOLD, doubtful={2}) == ([], [], [1])
    assert decide(detector, library, DOUBTFUL - 1, doubtful={2}) == NOTHING
    assert decide(detector, library, DOUBTFUL, doubtful={2}) == ([Move(1, 2)], [], [])
    assert decide(detector, library, PENDING, final=True, doubtful={2}) == NOTHING


def test_object_gone_is_rather_one_that_has_come_than_a_doubtful_newcomer(detector):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20), (3, 5, 11, 20))
    detector.note_gone(1, 0)
    assert decide(detector, library, S, doubtful={2}) == NOTHING
    detector.note_come(3, S)
    assert decide(detector, library, S, doubtful={2}) == ([Move(1, 3)], [], [])
    assert decide(detector, library, PENDING, doubtful={2}) == NOTHING


def test_doubtful_newcomer_is_never_added(detector):
    library = library_of((1, 5, 0, 3), (2, 6, 10, 20))
    detector.note_gone(1, 0)
    assert decide(detector, library, final=True, doubtful={2}) == ([], [], [1])


def test_doubtful_newcomer_met_long_before_is_not_an_object_that_went(detector):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20))
    detector.note_gone(1, PENDING)
    assert decide(detector, library, PENDING + HOLD, doubtful={2}) == ([], [], [1])


def test_doubtful_newcomer_must_look_more_like_an_object_gone_than_one_that_has_come(detector):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20))
    likeness = library.records[2].likeness(library.records[1])
    demanding = ChangeDetector(ChangeParams(move_likeness=likeness - 1.0))
    demanding.note_gone(1, 0)
    assert decide(demanding, library, DOUBTFUL, doubtful={2}) == ([], [], [1])
    demanding.note_come(2, DOUBTFUL)
    assert decide(demanding, library, DOUBTFUL, doubtful={2}) == ([Move(1, 2)], [], [])


def test_what_was_reported_long_ago_explains_nothing(detector):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20))
    detector.note_gone(1, 0)
    assert decide(detector, library, final=True) == ([], [], [1])
    library.records[1].status = ObjectStatus.REMOVED
    detector.note_come(2, MEMORY)
    assert decide(detector, library, MEMORY + HOLD) == ([], [2], [])


def test_removal_reported_minutes_ago_may_still_turn_out_a_move(detector):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20))
    detector.note_gone(1, 0)
    assert decide(detector, library, HOLD) == ([], [], [1])
    library.records[1].status = ObjectStatus.REMOVED
    detector.note_come(2, MEMORY)
    assert decide(detector, library, MEMORY) == ([Move(1, 2)], [], [])


def test_object_seen_again_is_not_gone(detector):
    detector.note_gone(1, 0)
    detector.note_present(1)
    assert decide(detector, library_of(), PENDING, final=True) == NOTHING


def test_id_that_means_another_object_is_neither_gone_nor_come(detector):
    detector.note_gone(1, 0)
    detector.note_come(2, 0)
    detector.forget(1)
    detector.forget(2)
    assert decide(detector, library_of((2, 5, 10, 20)), PENDING, final=True) == NOTHING


def test_object_seen_after_the_newcomer_came_did_not_move_there(detector):
    library = library_of((1, 5, 0, 15), (2, 5, 10, 20))
    detector.note_gone(1, 0)
    detector.note_come(2, 0)
    assert decide(detector, library, final=True) == ([], [2], [1])


def test_swapped_objects_are_two_moves_paired_by_shape(detector):
    library = library_of((1, 5, 0, 3), (2, 6, 0, 3), (3, 6, 10, 20), (4, 5, 10, 20))
    for i in (1, 2):
        detector.note_gone(i, 0)
    for i in (3, 4):
        detector.note_come(i, 0)
    moves, added, removed = decide(detector, library)
    assert sorted(moves, key=lambda move: move.object_id) == [Move(1, 4), Move(2, 3)]
    assert added == removed == []


@pytest.mark.parametrize("has_traded", [False, True])
def test_one_that_stands_where_that_stood_which_has_its_place_need_look_less_like_itself(
    detector, has_traded
):
    library = library_of((1, 5, 0, 3), (2, 6, 0, 3), (3, 5, 10, 20), (4, 6, 10, 20))
    known, other, newcomer, other_now = (library.records[i] for i in (1, 2, 3, 4))
    put(newcomer, float(other.center[0]), known, cosine=0.92)
    put(other_now, float(known.center[0]), other)
    if has_traded:
        library.move(2, 4)
    detector.note_gone(1, 0)
    detector.note_come(3, 0)
    expected = ([Move(1, 3)], [], []) if has_traded else ([], [3], [1])
    assert decide(detector, library, HOLD) == expected


@pytest.mark.parametrize("final", [False, True])
def test_one_newcomer_explains_one_of_two_twins(detector, final):
    library = library_of((1, 5, 0, 3), (2, 5, 0, 3), (3, 5, 10, 20))
    detector.note_gone(1, 0)
    detector.note_gone(2, 0)
    detector.note_come(3, 0)
    moves, added, removed = decide(detector, library, final=final)
    assert [move.newcomer_id for move in moves] == [3]
    assert added == []
    assert removed == ([] if not final else [({1, 2} - {moves[0].object_id}).pop()])


def test_one_gone_object_explains_one_of_two_like_newcomers(detector):
    library = library_of((1, 5, 0, 3), (2, 5, 10, 20), (3, 5, 10, 20))
    detector.note_gone(1, 0)
    detector.note_come(2, 0)
    detector.note_come(3, 0)
    moves, added, removed = decide(detector, library, final=True)
    assert [move.object_id for move in moves] == [1]
    assert added == [({2, 3} - {moves[0].newcomer_id}).pop()]
    assert removed == []


def change(kind, object_id, merged_id=NO_ID):
    before = None if kind == ChangeKind.ADDED else np.eye(4)
    after = None if kind == ChangeKind.REMOVED else np.eye(4)
    return ObjectChange(0, kind, object_id, "mug", before, after, merged_id)


def test_move_supersedes_its_halves_and_nothing_else():
    other = [change(ChangeKind.ADDED, 5), change(ChangeKind.REMOVED, 6)]
    halves = [change(ChangeKind.ADDED, 2), change(ChangeKind.REMOVED, 1)]
    move = change(ChangeKind.MOVED, 1, merged_id=2)
    assert settled_changes([*other, *halves, move]) == (*other, move)


def test_what_went_and_came_back_before_it_moved_stays_reported():
    history = [change(ChangeKind.REMOVED, 3), change(ChangeKind.ADDED, 3)]
    move = change(ChangeKind.MOVED, 3, merged_id=7)
    assert settled_changes([*history, move]) == (*history, move)
    again = change(ChangeKind.REMOVED, 3)
    assert settled_changes([*history, again, move]) == (*history, move)


def test_what_comes_after_a_move_is_kept():
    move, later = change(ChangeKind.MOVED, 1, merged_id=2), change(ChangeKind.REMOVED, 1)
    assert settled_changes([move, later]) == (move, later)


def test_what_is_gone_only_if_a_newcomer_is_what_it_seems_waits(detector):
    library = library_of((1, 5, 0, 3))
    detector.note_gone(1, 0)
    assert detector.decide(library, PENDING, True, disputed={1}).removed == ()
    assert detector.decide(library, PENDING, False).removed == (1,)

from neuse.records import ChangeKind, ObjectChange
from neuse.slam.feedback import ChangeFeedback

MS = 10**6


def change(stamp_ms: int, object_id: int = 0) -> ObjectChange:
    return ObjectChange(stamp_ms * MS, ChangeKind.REMOVED, object_id, "mug", None, None)


def due(feedback: ChangeFeedback, stamp_ms: int) -> list[tuple[int, int]]:
    return [(found.stamp_ns // MS, found.object_id) for found in feedback.due(stamp_ms * MS)]


def test_change_is_due_once_at_the_first_frame_after_its_delay():
    feedback = ChangeFeedback(delay_s=1.0)
    feedback.add(change(500))
    assert due(feedback, 1400) == []
    assert due(feedback, 1500) == [(500, 0)]
    assert due(feedback, 1600) == []


def test_order_of_changes_does_not_depend_on_the_order_of_arrival():
    changes = [change(300, 1), change(100, 7), change(300, 0), change(200, 3)]
    one, other = ChangeFeedback(delay_s=0.0), ChangeFeedback(delay_s=0.0)
    for found in changes:
        one.add(found)
    for found in reversed(changes):
        other.add(found)
    assert due(one, 1000) == due(other, 1000) == [(100, 7), (200, 3), (300, 0), (300, 1)]


def test_any_arrival_within_the_delay_gives_the_same_frame():
    applied_at = []
    for arrival_ms in (0, 400, 900):
        feedback = ChangeFeedback(delay_s=1.0)
        for frame_ms in range(0, 3000, 100):
            if frame_ms == arrival_ms:
                feedback.add(change(0))
            applied_at += [frame_ms] * len(due(feedback, frame_ms))
    assert applied_at == [1000, 1000, 1000]


def test_cleared_feedback_holds_nothing():
    feedback = ChangeFeedback(delay_s=0.0)
    feedback.add(change(0))
    feedback.clear()
    assert due(feedback, 1000) == []

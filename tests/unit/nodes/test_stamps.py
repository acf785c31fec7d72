from neuse_encoder_node.stamps import StampJoin, StampOrder, Succession

SECOND = 10**9


def test_stamps_may_only_grow_except_for_a_restart():
    order = StampOrder(restart_s=1.0)
    steps = [
        (100 * SECOND, Succession.NEXT),
        (101 * SECOND, Succession.NEXT),
        (101 * SECOND, Succession.STALE),
    ]
    steps += [
        (100 * SECOND, Succession.STALE),
        (102 * SECOND, Succession.NEXT),
        (5 * SECOND, Succession.RESTART),
    ]
    steps += [(6 * SECOND, Succession.NEXT)]
    for stamp_ns, succession in steps:
        assert order.follow(stamp_ns) == succession


def test_join_waits_for_all_topics_and_keeps_their_order():
    join = StampJoin(["depth", "mask"], capacity=5)
    assert join.add("mask", 1, "m1") is None
    assert join.add("depth", 2, "d2") is None
    assert join.add("depth", 1, "d1") == ("d1", "m1")
    assert join.add("mask", 2, "m2") == ("d2", "m2")
    assert join.take_lost() == []


def test_complete_stamp_gives_up_older_ones_and_names_what_they_lacked():
    join = StampJoin(["depth", "mask"], capacity=5)
    join.add("depth", 1, "d1")
    join.add("depth", 2, "d2")
    assert join.add("mask", 2, "m2") == ("d2", "m2")
    assert join.take_lost() == [(1, ["mask"])]
    assert join.take_lost() == []


def test_join_holds_no_more_than_its_capacity():
    join = StampJoin(["depth", "mask"], capacity=3)
    for stamp_ns in range(10):
        join.add("depth", stamp_ns, "d")
    assert [stamp_ns for stamp_ns, _ in join.take_lost()] == list(range(7))
    assert join.add("mask", 7, "m") == ("d", "m")
    assert join.add("mask", 3, "m") is None


def test_after_a_restart_new_stamps_are_joined_though_they_are_smaller():
    join = StampJoin(["depth", "mask"], capacity=3)
    for stamp_ns in (100, 101, 102):
        join.add("depth", stamp_ns, "old")
    for stamp_ns in (1, 2, 3):
        assert join.add("depth", stamp_ns, "d") is None
        assert join.add("mask", stamp_ns, "m") == ("d", "m")

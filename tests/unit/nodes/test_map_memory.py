from dataclasses import replace

from neuse.records import ObjectMap
from neuse_mapper_node.conversions import object_map_to_msg
from neuse_slam_node import map_memory
from neuse_slam_node.map_memory import PATIENCE_S, MapMemory

from . import samples


def message(*first_seen_ns: int):
    """A map of objects that were first seen then."""
    (known,) = samples.object_map().objects
    objects = tuple(replace(known, object_id=i, first_seen_ns=ns) for i, ns in enumerate(first_seen_ns))
    return object_map_to_msg(ObjectMap(samples.STAMP_NS, objects), "map")


def test_map_that_grows_or_merges_needs_nothing():
    memory = MapMemory()
    assert not any(memory.hear(message(*stamps)) for stamps in [(), (7,), (7, 9, 12), (7, 12), (7,)])


def test_map_that_begins_later_gets_back_the_one_before_until_it_knows_it():
    memory, whole = MapMemory(), message(7, 9)
    memory.hear(whole)
    assert memory.hear(message(9)) is whole
    assert memory.hear(message(9, 30)) is whole  # it had not been there to hear it
    assert memory.hear(message(7, 9, 30)) is None


def test_mapper_that_does_not_want_its_map_back_has_its_way(monkeypatch):
    clock = iter([0.0, 1.0, 1.0 + PATIENCE_S, 1.1 + PATIENCE_S, 2.0 + PATIENCE_S])
    monkeypatch.setattr(map_memory.time, "monotonic", lambda: next(clock))
    memory, whole, anew = MapMemory(), message(7, 9), message(20)
    memory.hear(whole)
    assert [memory.hear(anew) for _ in range(3)] == [whole, whole, None]
    assert memory.hear(message()) is anew


def test_empty_map_has_lost_everything():
    memory, whole = MapMemory(), message(7, 9)
    memory.hear(whole)
    assert memory.hear(message()) is whole


def test_new_run_remembers_nothing():
    memory = MapMemory()
    memory.hear(message(7))
    memory.forget()
    assert memory.hear(message(9)) is None


def test_map_that_has_seen_an_object_less_often_is_a_saved_one_and_gets_back_the_one_before():
    def seen(count):
        made = message(7, 9)
        made.objects[1].n_observations = count
        return made

    memory, whole = MapMemory(), seen(12)
    assert memory.hear(seen(5)) is None
    assert memory.hear(whole) is None
    assert memory.hear(seen(5)) is whole
    assert memory.hear(whole) is None

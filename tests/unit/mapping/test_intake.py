from dataclasses import replace

import pytest

from neuse.mapping.intake import Intake
from neuse.mapping.keyframe_memory import KeyframeMemory
from neuse.mapping.object_library import LibraryParams, ObjectLibrary
from neuse.records import NO_ID, MatchStatus, ObjectStatus

from .synthetic import make_world, orbit, standing


class Recognises:
    """A judge to whom every unmatched observation is the same object."""

    def __init__(self, object_id):
        self.object_id = object_id

    def recognise(self, unmatched, keyframe):
        return self.object_id


class Table:
    """One bottle, seen at each step from the same place, as object 0 from the third on."""

    def __init__(self):
        self.library, self.memory, self.judge = ObjectLibrary(), KeyframeMemory(10), Recognises(None)
        self.intake = Intake(self.library, self.memory, self.judge, LibraryParams())
        self.world = make_world([standing("a", 0.0, 0.0)])
        self.T_world_camera = orbit(count=1)[0]
        self.tick = 0
        for _ in range(2):
            assert self.see() == (set(), set())

    def see(self, **changed):
        """(new ids, ids seen for sure) of another frame, its observation changed so."""
        self.tick += 1
        frame = self.world.frame(self.T_world_camera)
        frame = replace(frame, observations=tuple(replace(seen, **changed) for seen in frame.observations))
        self.memory.update(frame, [], self.tick)
        created = self.intake.add(frame, self.tick)
        return created, self.intake.seen_for_sure(frame, self.memory.seen[frame.keyframe_id])


def test_object_is_new_once_and_gets_a_view_of_each_keyframe():
    table = Table()
    assert table.see() == ({0}, {0})
    assert table.see() == (set(), {0})
    assert list(table.library.records[0].views) == [2, 3]
    assert table.library.records[0].n_observations == 2


def test_observation_that_only_the_object_graph_recognises_counts_as_seen():
    table = Table()
    table.see()
    table.judge.object_id = 0
    assert table.see(status=MatchStatus.UNMATCHED, object_id=NO_ID) == (set(), {0})
    assert table.library.records[0].last_tick == table.tick


@pytest.mark.parametrize("status", [MatchStatus.TENTATIVE, MatchStatus.UNMATCHED])
def test_observation_of_nothing_known_changes_nothing(status):
    table = Table()
    table.see()
    assert table.see(status=status, object_id=NO_ID) == (set(), set())
    assert table.library.records[0].n_observations == 1


def test_object_taken_to_be_gone_that_is_matched_is_seen_but_gets_no_view():
    table = Table()
    table.see()
    table.library.records[0].status = ObjectStatus.REMOVED
    assert table.see() == (set(), {0})
    assert list(table.library.records[0].views) == [2]

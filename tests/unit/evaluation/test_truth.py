import numpy as np

from neuse.evaluation.trajectory import Trajectory
from neuse.evaluation.truth import TrueMap, TrueObject, Truth


def test_traversals_cover_the_whole_path_without_overlap(helix: Trajectory) -> None:
    start, middle = int(helix.stamps_ns[0]), int(helix.stamps_ns[20])
    parts = [helix.between(*span) for span in Truth(helix, traversal_starts_ns=(start, middle)).traversals()]
    assert [len(part) for part in parts] == [20, 40]


def test_a_bag_that_tells_no_traversals_has_one(helix: Trajectory) -> None:
    (span,) = Truth(helix).traversals()
    assert len(helix.between(*span)) == len(helix)


def test_final_objects_are_those_of_the_last_map(helix: Trajectory) -> None:
    mug, bottle = (TrueObject(i, c, np.eye(4), np.ones(3)) for i, c in ((1, "mug"), (2, "bottle")))
    truth = Truth(helix, maps=(TrueMap(1, (mug, bottle)), TrueMap(2, (bottle,))))
    assert truth.final_objects() == (bottle,)
    assert Truth(helix).final_objects() == ()

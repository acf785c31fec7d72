"""Truth of a simulation: poses, maps where they change, and how often objects were clearly seen."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.evaluation.simulated_truth import CLEARLY_SEEN_M, CLEARLY_SEEN_PX, TruthCollector, is_clearly_seen
from neuse.geometry import make_transform
from neuse.records import ChangeKind, ObjectChange, OdometrySample, RgbdFrame
from neuse.simulation.worlds import SimulatedFrame, make_world

S = 10**9


@pytest.fixture(scope="module")
def world():
    return make_world("tabletop", 0)


@pytest.fixture
def simulated(world):
    """The first object, seen large from a metre above it."""
    item = world.timeline.objects_at(0)[0]
    frame = RgbdFrame(S, np.zeros((1, 1)), np.zeros((1, 1), int), (), world.intrinsics)
    T_world_camera = make_transform(np.eye(3), item.position + np.array([0.0, 0.0, 1.0]))
    seen = {item.object_id: CLEARLY_SEEN_PX}
    return SimulatedFrame(frame, T_world_camera, OdometrySample(S, np.eye(4)), (item,), seen, (), 0)


def later(simulated, seconds, **values):
    return replace(simulated, frame=replace(simulated.frame, stamp_ns=seconds * S), **values)


def test_objects_are_clearly_seen_when_near_and_large(simulated):
    (item,) = simulated.objects
    far = simulated.T_world_camera.copy()
    far[2, 3] = item.position[2] + 1.01 * CLEARLY_SEEN_M
    small = replace(simulated, visible_px={item.object_id: CLEARLY_SEEN_PX - 1})
    views = (simulated, replace(simulated, T_world_camera=far), small, replace(simulated, visible_px={}))
    assert [is_clearly_seen(item, view) for view in views] == [True, False, False, False]


def test_last_map_counts_sights_and_traversals_have_starts(simulated):
    collector = TruthCollector()
    for seconds, traversal in ((1, 0), (2, 0), (3, 1)):
        collector.add(later(simulated, seconds, traversal=traversal))
    truth = collector.finish()
    assert truth.traversal_starts_ns == (S, 3 * S)
    assert [item.n_seen for item in truth.final_objects()] == [3]
    assert len(truth.trajectory) == 3


def test_change_starts_the_count_anew(simulated):
    (item,) = simulated.objects
    change = ObjectChange(2 * S, ChangeKind.MOVED, item.object_id, item.shape.category, np.eye(4), np.eye(4))
    collector = TruthCollector()
    collector.add(simulated)
    collector.add(later(simulated, 2, changes=(change,)))
    truth = collector.finish()
    assert truth.changes == (change,)
    assert [item.n_seen for item in truth.final_objects()] == [1]
    assert [m.stamp_ns for m in truth.maps] == [S, 2 * S, 2 * S]


def test_no_frames_are_an_empty_truth():
    truth = TruthCollector().finish()
    assert (len(truth.trajectory), truth.maps, truth.changes) == (0, (), ())

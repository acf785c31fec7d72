import numpy as np
import pytest

from neuse.evaluation.estimate import Estimate
from neuse.evaluation.trajectory import FramePose
from neuse.records import Edge, EdgeKind, ObjectMap


def test_front_end_rate_is_of_encoding_association_and_edges_alone() -> None:
    stage_ms = {
        "encode": 20.0,
        "associate": 4.0,
        "edge": 1.0,
        "slam": 15.0,
        "map": 15.0,
        "encode_per_object": 5.0,
    }
    estimate = Estimate(stage_ms=stage_ms)
    assert estimate.front_end_fps() == pytest.approx(40.0)
    assert estimate.system_fps() == pytest.approx(20.0)


def test_rates_are_unknown_unless_all_their_stages_were_measured() -> None:
    assert Estimate(stage_ms={"encode": 1.0, "associate": 4.0}).front_end_fps() is None
    assert Estimate(stage_ms={"encode": 1.0, "slam": 4.0}).system_fps() is None


def test_blind_pairs_are_those_that_end_in_a_blind_frame() -> None:
    blind = [True, False, True, True, False]
    frames = tuple(FramePose(i, np.eye(4), blind=b) for i, b in enumerate(blind))
    assert Estimate(frames=frames).blind_pairs() == 2


def test_edges_are_counted_by_kind() -> None:
    kinds = [EdgeKind.SHORT_RANGE, EdgeKind.SHORT_RANGE, EdgeKind.LOOP_CLOSURE]
    edges = tuple(Edge(0, 1, 0, 1, kind, np.eye(4), np.eye(6)) for kind in kinds)
    counts = [Estimate(edges=edges).edge_count(kind) for kind in EdgeKind]
    assert counts == [0, 2, 1, 0]


def test_the_final_map_of_a_run_without_maps_is_empty() -> None:
    assert Estimate().final_map() == ObjectMap(0)
    assert Estimate(maps=(ObjectMap(1), ObjectMap(2))).final_map().stamp_ns == 2

"""Edges between keyframes: which are tried, which pass the gates, what they say."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.geometry import exp, inverse, log
from neuse.records import EdgeKind
from neuse.slam.edges import EdgeBuilder, EdgeParams
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.object_frames import reduce_codes

from .synthetic import make_code, make_thing
from .test_association import scene_of

SIGMAS = np.array([0.02, 0.02, 0.03, 0.003, 0.003, 0.003])
SPOTS = np.array([[-0.3, 0.1, 1.2], [0.25, -0.05, 1.3], [0.0, 0.2, 1.7]])


class World:
    """Three objects (mug, bottle, mug) that keyframes see from a camera that steps to the right."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        self.things = [make_thing(i, i == 1, spot, rng) for i, spot in enumerate(SPOTS)]
        self.tracks = scene_of(self.things).library.tracks
        for track in self.tracks.values():
            track.in_graph = True
        self.records: list[KeyframeRecord] = []

    @staticmethod
    def pose(i):
        return exp([0, 0.01 * i, 0, 0.03 * i, 0, 0])

    def keyframe(self, i, keys=(0, 1, 2), sigmas=SIGMAS, spoil=0.0):
        """Keyframe i; `spoil` shifts the first object (metres)."""
        codes = []
        for n, key in enumerate(keys):
            T = inverse(self.pose(i)) @ self.things[key].T_world_object
            codes.append(make_code(self.things[key], exp([0, 0, 0, spoil * (n == 0), 0, 0]) @ T, sigmas))
        for key in keys:
            self.tracks[key].enter_keyframe(i, gap=3, spacing=4)
        record = KeyframeRecord(i, 100 * i, np.array(keys, dtype=int), reduce_codes(codes), None)
        self.records.append(record)
        return record


@pytest.fixture
def world():
    return World()


def short_range(world, record, params=None):
    builder, olds = EdgeBuilder(params), world.records[:-1]
    T_olds_new = np.array(
        [inverse(world.pose(old.keyframe_id)) @ world.pose(record.keyframe_id) for old in olds]
    )
    return builder.short_range(record, olds, world.tracks, T_olds_new), builder.rejected


def test_edges_say_where_the_later_keyframe_is_seen_from_the_earlier(world):
    world.keyframe(0)
    (edge,), rejected = short_range(world, world.keyframe(1))
    np.testing.assert_allclose(edge.T_from_to, inverse(world.pose(0)) @ world.pose(1), atol=1e-9)
    assert (edge.from_id, edge.to_id, edge.from_stamp_ns, edge.to_stamp_ns) == (0, 1, 0, 100)
    assert (edge.kind, edge.object_ids, rejected) == (EdgeKind.SHORT_RANGE, (0, 1, 2), 0)


def test_edges_reach_back_through_the_window_only(world):
    for i in range(5):
        world.keyframe(i)
    edges, _ = short_range(world, world.keyframe(5), EdgeParams(window=4))
    assert [edge.from_id for edge in edges] == [2, 3, 4]


def test_keyframes_are_paired_by_track_whatever_the_order(world):
    world.keyframe(0, keys=(2, 0, 1))
    (edge,), _ = short_range(world, world.keyframe(1, keys=(1, 2)))
    np.testing.assert_allclose(edge.T_from_to, inverse(world.pose(0)) @ world.pose(1), atol=1e-9)
    assert edge.object_ids == (1, 2)


def test_keyframes_without_a_common_object_are_not_candidates(world):
    world.keyframe(0, keys=(0,))
    assert short_range(world, world.keyframe(1, keys=(1, 2))) == ([], 0)


def test_lone_mug_ties_only_with_its_handle_in_view(world):
    world.keyframe(0, keys=(0,))
    assert len(short_range(world, world.keyframe(1, keys=(0,)))[0]) == 1
    hidden = np.where(np.arange(6) == 2, 0.5, SIGMAS)
    assert short_range(world, world.keyframe(2, keys=(0,), sigmas=hidden)) == ([], 2)


def test_lone_bottle_never_ties(world):
    world.keyframe(0, keys=(1,))
    assert short_range(world, world.keyframe(1, keys=(1,))) == ([], 1)


def test_objects_that_are_not_in_the_graph_do_not_tie(world):
    world.tracks[0].in_graph = False
    world.keyframe(0, keys=(0,))
    assert short_range(world, world.keyframe(1, keys=(0,))) == ([], 0)


def test_pair_that_contradicts_itself_is_refused(world):
    world.keyframe(0, keys=(0, 1))
    assert short_range(world, world.keyframe(1, keys=(0, 1), spoil=0.2)) == ([], 1)


def test_outvoted_object_is_not_named_by_the_edge(world):
    world.keyframe(0)
    (edge,), _ = short_range(world, world.keyframe(1, spoil=0.3))
    assert edge.object_ids == (1, 2)


def test_uncertain_edges_are_refused(world):
    world.keyframe(0)
    record = world.keyframe(1)
    assert short_range(world, record, EdgeParams(max_sigma_rad=1e-3)) == ([], 1)
    assert short_range(world, record, EdgeParams(max_sigma_m=1e-3)) == ([], 1)


def revisit(world, builder, i, keys=(0, 1, 2)):
    return builder.loop_closures(world.keyframe(i, keys=keys), world.records, world.tracks)


def test_edge_that_contradicts_the_tracked_motion_is_refused(world):
    world.keyframe(0)
    record = world.keyframe(1)
    T_0_1 = inverse(world.pose(0)) @ world.pose(1)
    for T, count in ((T_0_1, 1), (T_0_1 @ exp([0, 0, 0.3, 0, 0, 0]), 0)):
        builder = EdgeBuilder()
        assert len(builder.short_range(record, world.records[:-1], world.tracks, T[None])) == count
        assert builder.rejected == 1 - count


def test_loops_close_to_the_first_keyframe_of_every_earlier_period(world):
    for i in range(12):
        world.keyframe(i, keys=(0, 1, 2) if i in (0, 1, 6) else ())
    closures = revisit(world, EdgeBuilder(), 12)
    assert [edge.from_id for edge in closures] == [0, 6]
    assert {edge.kind for edge in closures} == {EdgeKind.LOOP_CLOSURE}
    error = log(inverse(closures[0].T_from_to) @ inverse(world.pose(0)) @ world.pose(12))
    np.testing.assert_allclose(error, 0.0, atol=1e-9)


def test_closure_that_the_solved_graph_contradicts_is_refused(world):
    for i in range(12):
        world.keyframe(i, keys=(0, 1, 2) if i in (0, 6) else ())
    builder = EdgeBuilder()
    closures = revisit(world, builder, 12)
    solved = np.array([inverse(world.pose(edge.from_id)) @ world.pose(12) for edge in closures])
    solved[1] = solved[1] @ exp([0, 0, 0, 0.3, 0, 0])
    assert builder.borne_out(closures, solved) == closures[:1]
    assert builder.rejected == 1
    assert builder.borne_out([], np.zeros((0, 4, 4))) == []


def test_loop_is_closed_once_per_view(world):
    for i in range(6):
        world.keyframe(i, keys=(0, 1, 2) if i == 0 else ())
    builder = EdgeBuilder()
    assert len(revisit(world, builder, 6)) == 1
    assert revisit(world, builder, 7) == []


def test_refused_closure_is_tried_again(world):
    world.keyframe(0)
    for i in range(1, 6):
        world.keyframe(i, keys=())
    builder = EdgeBuilder(EdgeParams(window=4))
    assert revisit(world, builder, 6, keys=(1,)) == []
    assert len(revisit(world, builder, 7)) == 1


def test_loop_is_closed_from_and_to_several_views_of_long_periods(world):
    for i in range(20):
        world.keyframe(i, keys=(0, 1, 2) if i < 6 else ())
    builder = EdgeBuilder()
    closures = [edge for i in range(20, 26) for edge in revisit(world, builder, i)]
    assert [(edge.from_id, edge.to_id) for edge in closures] == [(0, 20), (4, 20), (0, 24), (4, 24)]


def test_objects_in_view_all_along_close_no_loop(world):
    builder = EdgeBuilder()
    assert [revisit(world, builder, i) for i in range(8)] == [[]] * 8


def test_most_asked_keyframes_are_tried_first(world):
    world.keyframe(0, keys=(0, 1))
    for i in range(1, 11):
        world.keyframe(i, keys=(0, 1, 2) if i == 5 else ())
    builder = EdgeBuilder(replace(EdgeParams(), max_closures=1))
    assert [edge.from_id for edge in revisit(world, builder, 11)] == [5]

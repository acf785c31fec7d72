"""Edges of an external SLAM find our keyframes by stamp."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from neuse.geometry import exp, inverse
from neuse.records import Edge, EdgeKind
from neuse.slam.external import attach

from .test_keyframes import library_with

A, B = np.eye(4), exp([0, 0, 0.5, 1, 0, 0])
EDGE = Edge(77, 78, 0, 100, EdgeKind.LOOP_CLOSURE, inverse(A) @ B, np.diag([1.0, 2, 3, 4, 5, 6]))


def attached(edges, library=None):
    counters: Counter[str] = Counter()
    return attach(edges, library or library_with([A, B]), 1e-8, counters), counters


def test_edge_between_keyframes_gets_their_ids():
    (edge,), counters = attached([EDGE])
    assert (edge.from_id, edge.to_id, edge.kind) == (0, 1, EdgeKind.EXTERNAL)
    np.testing.assert_allclose(edge.T_from_to, EDGE.T_from_to)
    np.testing.assert_allclose(edge.covariance, EDGE.covariance, atol=1e-12)
    assert not counters


def test_edge_between_other_frames_is_carried_to_their_keyframes():
    library = library_with([A, B])
    C = B @ exp([0.1, 0.2, 0.3, 0.01, 0.02, 0])
    library.add_frame(200, C)
    (edge,), _ = attached([replace(EDGE, to_stamp_ns=200, T_from_to=inverse(A) @ C)], library)
    assert edge.to_id == 1
    np.testing.assert_allclose(edge.T_from_to, inverse(A) @ B, atol=1e-12)
    assert np.linalg.eigvalsh(edge.covariance)[0] > 0


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"to_stamp_ns": 150}, "external_edge_without_frame"),
        ({"to_stamp_ns": 0}, "external_edge_without_frame"),
        ({"T_from_to": np.zeros((4, 4))}, "external_edge_not_rigid"),
        ({"covariance": np.zeros((6, 6))}, "external_edge_covariance"),
    ],
)
def test_edge_that_cannot_be_used_is_counted(change, reason):
    edges, counters = attached([replace(EDGE, **change)])
    assert edges == []
    assert counters == {reason: 1}

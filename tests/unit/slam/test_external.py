"""Edges of an external SLAM find our keyframes by stamp."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from neuse.geometry import exp, inverse
from neuse.records import Edge, EdgeKind
from neuse.slam.external import DOUBT, ENOUGH, PATIENCE_S, WITNESSES, ExternalEdges, attach
from neuse.slam.odometry import Motion

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


KNOWN = np.diag([0.005] * 6) ** 2
STATED = replace(EDGE, covariance=np.diag([0.01] * 6) ** 2)


class Graph:
    """A and B, as the graph knows them, and how many objects are in sight; the last keyframe is later."""

    def __init__(self, objects, later_s=0.0):
        self.library = library_with([A, B])
        records = [replace(record, keys=np.arange(objects)) for record in self.library.records]
        records[-1] = replace(records[-1], stamp_ns=records[-1].stamp_ns + int(later_s * 1e9))
        self.library.records = records

    def motion(self, from_id, to_id):
        T_map_camera = (A, B)
        return Motion(inverse(T_map_camera[from_id]) @ T_map_camera[to_id], KNOWN)


def accepted(errors, objects=WITNESSES):
    """What is taken in of edges that are off by exp(error), and the counters."""
    counters: Counter[str] = Counter()
    external, graph = ExternalEdges(1e-8, counters), Graph(objects)
    edges = [replace(STATED, T_from_to=STATED.T_from_to @ exp(error)) for error in errors]
    return [external.accept([edge], graph) for edge in edges], counters


def noise(sigma, n=60):
    return sigma * np.random.default_rng(0).normal(size=(n, 6))


def test_edges_that_agree_with_what_objects_show_are_taken_as_stated():
    edges, counters = accepted(noise(0.01))
    assert all(len(each) == 1 for each in edges)
    np.testing.assert_allclose(np.diag(edges[-1][0].covariance), np.diag(STATED.covariance), rtol=0.6)
    assert not any(counters.values())


def test_edge_that_objects_contradict_is_refused_and_counted():
    edges, counters = accepted([np.zeros(6), np.array([0, 0, 0, 1.0, 0, 0])])
    assert [len(each) for each in edges] == [1, 0]
    assert +counters == {"external_edge_contradicted": 1}


def test_overconfident_edges_lose_their_weight():
    edges, _ = accepted(noise(0.05))
    sigmas = np.sqrt(np.diag(edges[-1][0].covariance))
    np.testing.assert_allclose(sigmas, 0.05, rtol=0.5)


DARK = WITNESSES - 1  # too few objects in sight to vouch for an edge


def external_after(errors):
    """Edges that objects have shown to be off by exp(error), and the counters from then on."""
    counters: Counter[str] = Counter()
    external = ExternalEdges(1e-8, counters)
    for error in errors:
        external.accept([replace(STATED, T_from_to=STATED.T_from_to @ exp(error))], Graph(WITNESSES))
    counters.clear()
    return external, counters


def test_edge_that_nobody_can_vouch_for_waits_until_others_like_it_have_proved_right():
    external, counters = external_after(noise(0.01, ENOUGH - 1))
    assert external.accept([STATED], Graph(DARK)) == []
    assert counters["external_edge_waiting"] == 1
    assert len(external.accept([STATED], Graph(WITNESSES))) == 2
    assert len(external.accept([STATED], Graph(DARK))) == 1


def test_edge_that_has_waited_for_long_is_taken_in_doubt():
    external, counters = external_after([])
    assert external.accept([STATED], Graph(DARK)) == []
    assert external.accept([STATED], Graph(DARK, PATIENCE_S - 1.0)) == []
    edge, _ = external.accept([], Graph(DARK, PATIENCE_S + 1.0))
    np.testing.assert_allclose(edge.covariance, DOUBT * STATED.covariance, atol=1e-9)
    assert len(external.accept([STATED], Graph(DARK, PATIENCE_S + 1.0))) == 1
    assert counters["external_edge_waiting"] == 2


def test_old_edge_waits_as_long_as_a_new_one():
    external, _ = external_after([])
    assert external.accept([STATED], Graph(DARK, 100.0)) == []
    assert external.accept([], Graph(DARK, 100.0 + PATIENCE_S - 1.0)) == []
    assert len(external.accept([], Graph(DARK, 100.0 + PATIENCE_S + 1.0))) == 1


def test_who_errs_beside_objects_is_not_believed_where_there_are_none():
    external, counters = external_after([])
    assert external.accept([STATED], Graph(DARK)) == []
    for error in noise(0.05):
        external.accept([replace(STATED, T_from_to=STATED.T_from_to @ exp(error))], Graph(WITNESSES))
    assert counters["external_edge_unwitnessed"] == 1
    assert external.accept([STATED], Graph(DARK)) == []
    assert counters["external_edge_unwitnessed"] == 2
    assert external.accept([STATED], Graph(WITNESSES))

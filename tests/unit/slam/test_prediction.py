"""Prediction of the camera's pose, and odometry edges."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from neuse.geometry import exp, inverse
from neuse.records import EdgeKind, OdometrySample
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.localization import Belief
from neuse.slam.object_frames import reduce_codes
from neuse.slam.odometry import OdometryParams
from neuse.slam.prediction import Predictor
from neuse.slam.tracker import Located

from .synthetic import make_code, make_thing

FRAME_NS = 100_000_000
SIGMAS = np.array([0.03, 0.03, np.pi, 0.003, 0.003, 0.003])
START = Belief(exp([0, 0, 0.3, 1, 2, 3]), 1e-6 * np.eye(6))


def pose(i):
    return exp([0, 0, 0.01 * i, 0.05 * i, 0, 0])


def sample(i):
    return OdometrySample(i * FRAME_NS, pose(i))


def record(i, fix):
    return KeyframeRecord(i, i * FRAME_NS, np.zeros(0, int), reduce_codes([]), fix)


@pytest.fixture
def predictor():
    return Predictor(OdometryParams(), Counter())


def predict(predictor, last, i, with_odometry=True):
    fix, (guess, *_) = predictor.predict(last, sample(i) if with_odometry else None, i * FRAME_NS)
    predictor.settle(fix, guess.belief)
    return fix, guess.motion, guess.belief


def test_prediction_follows_odometry(predictor):
    predictor.predict(START, sample(0), 0)
    predictor.settle(predictor.predict(START, sample(1), FRAME_NS)[0], START)
    _, _, belief = predict(predictor, START, 2)
    np.testing.assert_allclose(belief.T_map_camera, START.T_map_camera @ inverse(pose(1)) @ pose(2))


def test_prediction_without_odometry_stays_and_doubts(predictor):
    _, _, belief = predict(predictor, START, 1, with_odometry=False)
    np.testing.assert_array_equal(belief.T_map_camera, START.T_map_camera)
    later = predict(predictor, belief, 2, with_odometry=False)[2]
    assert np.all(np.diag(later.covariance) > np.diag(belief.covariance))


def test_prediction_after_a_gap_uses_all_of_the_motion(predictor):
    belief = predict(predictor, START, 1)[2]
    belief_in_gap = predict(predictor, belief, 2, with_odometry=False)[2]
    after = predict(predictor, belief_in_gap, 3)[2]
    np.testing.assert_allclose(after.T_map_camera, belief.T_map_camera @ inverse(pose(1)) @ pose(3))


def test_edges_join_keyframes_that_have_odometry(predictor):
    fixes = [predict(predictor, START, i)[0] for i in range(3)]
    (edge,), guessed = predictor.edge(record(0, fixes[0]), record(1, fixes[2]), [])
    np.testing.assert_allclose(edge.T_from_to, inverse(pose(0)) @ pose(2))
    assert edge.kind == EdgeKind.ODOMETRY
    assert guessed == []


def test_first_keyframe_has_no_edge(predictor):
    assert predictor.edge(None, record(0, None), []) == ([], [])


def test_keyframes_with_neither_odometry_nor_objects_are_tied_weakly(predictor):
    odometry, (guess,) = predictor.edge(record(0, None), record(1, None), [])
    assert odometry == []
    assert guess.covariance[3, 3] > 0.02**2


def test_keyframes_tied_by_objects_need_no_guess(predictor):
    fixes = [predict(predictor, START, i)[0] for i in range(2)]
    tie = predictor.edge(record(0, fixes[0]), record(1, fixes[1]), [])[0]
    assert predictor.edge(record(0, None), record(1, None), tie) == ([], [])


def test_odometry_only_where_blind_when_so_wished():
    predictor = Predictor(OdometryParams(use="blind"), Counter())
    fixes = [predict(predictor, START, i)[0] for i in range(2)]
    records = [record(i, fix) for i, fix in enumerate(fixes)]
    tie, _ = predictor.edge(*records, [])
    assert len(tie) == 1
    assert predictor.edge(*records, tie) == ([], [])


@pytest.mark.parametrize(("sigma_rad", "sigma_m"), [(0.001, 0.1), (0.03, 0.001)])
def test_pair_whose_objects_tell_less_than_odometry_is_blind(sigma_rad, sigma_m):
    predictor = Predictor(OdometryParams(use="blind"), Counter())
    fixes = [predict(predictor, START, i)[0] for i in range(2)]
    records = [record(i, fix) for i, fix in enumerate(fixes)]
    covariance = np.diag(np.repeat([sigma_rad, sigma_m], 3) ** 2)
    tie = replace(predictor.edge(*records, [])[0][0], kind=EdgeKind.SHORT_RANGE, covariance=covariance)
    (edge,), guessed = predictor.edge(*records, [tie])
    assert (edge.kind, guessed) == (EdgeKind.ODOMETRY, [])


def test_lone_bottle_sharpens_the_edge_of_a_blind_pair():
    predictor = Predictor(OdometryParams(use="blind"), Counter())
    fixes = [predict(predictor, START, i)[0] for i in range(2)]
    bottle = make_thing(0, True, np.array([0.0, 0.1, 1.0]), np.random.default_rng(0))
    shift = exp([0, 0, 0, 0.04, 0, 0])  # beside what odometry says, by one of its sigmas
    records = [
        replace(
            record(i, fixes[i]),
            keys=np.array([7]),
            frames=reduce_codes([make_code(bottle, inverse(T) @ bottle.T_world_object, SIGMAS)]),
        )
        for i, T in enumerate([np.eye(4), pose(1) @ shift])
    ]
    (alone,), _ = predictor.edge(record(0, fixes[0]), record(1, fixes[1]), [])
    (edge,), _ = predictor.edge(*records, [])
    np.testing.assert_allclose(edge.T_from_to, pose(1) @ shift, atol=2e-3)
    assert edge.covariance[3, 3] < 0.05 * alone.covariance[3, 3]


def test_prediction_follows_a_correction_of_the_map(predictor):
    predictor.settle(predictor.predict(START, sample(0), 0)[0], START)
    correction = exp([0, 0, 0.2, 1, 0, 0])
    predictor.correct(START.T_map_camera, correction @ START.T_map_camera)
    _, (guess, *_) = predictor.predict(START, sample(1), FRAME_NS)
    expected = correction @ START.T_map_camera @ inverse(pose(0)) @ pose(1)
    np.testing.assert_allclose(guess.belief.T_map_camera, expected)


def test_after_objects_in_sight_the_camera_may_also_go_on_as_before(predictor):
    located = Located(START, (), blind=False, relocalized=False)
    beliefs = [Belief(START.T_map_camera @ pose(i), START.covariance) for i in range(3)]
    for i in (0, 1):
        fix, _ = predictor.predict(beliefs[max(i - 1, 0)], sample(i), i * FRAME_NS)
        predictor.settle(predictor.judge(fix, located), beliefs[i])
    _, (by_odometry, as_before) = predictor.predict(beliefs[1], sample(2), 2 * FRAME_NS)
    expected = beliefs[1].T_map_camera @ pose(1)
    np.testing.assert_allclose(as_before.belief.T_map_camera, expected, atol=1e-12)
    np.testing.assert_allclose(by_odometry.motion.T_from_to, inverse(pose(1)) @ pose(2), atol=1e-12)


def test_odometry_that_led_away_from_all_objects_begins_a_segment(predictor):
    predictor.settle(predictor.predict(START, sample(0), 0)[0], START)
    leap = OdometrySample(FRAME_NS, pose(0) @ exp([0, 0, 0.3, 0.3, 0, 0]))
    fix, _ = predictor.predict(START, leap, FRAME_NS)
    stayed = Located(START, (), blind=False, relocalized=False, surprised=True)
    assert predictor.judge(fix, stayed).segment == fix.segment + 1
    assert predictor._odometry.counters == {"odometry_contradicted": 1}


def test_odometry_that_led_to_the_objects_keeps_its_segment(predictor):
    predictor.settle(predictor.predict(START, sample(0), 0)[0], START)
    fix, (guess,) = predictor.predict(START, sample(1), FRAME_NS)
    for located in (
        Located(guess.belief, (), blind=False, relocalized=False, surprised=True),
        Located(START, (), blind=True, relocalized=False),
    ):
        assert predictor.judge(fix, located) == fix

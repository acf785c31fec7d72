"""Which hypothesis of the camera's pose is borne out by the objects of the last frame."""

from types import SimpleNamespace

import numpy as np
import pytest

from neuse.geometry import exp
from neuse.slam.association import Association
from neuse.slam.hypotheses import Hypothesis, best_hypothesis
from neuse.slam.localization import Belief
from neuse.slam.odometry import Motion

LAST = 7
MOTION = Motion(exp([0, 0, 0.1, 0.2, 0, 0]), 1e-4 * np.eye(6))
FIRST, SECOND = (
    Hypothesis.after(Belief(np.eye(4), variance * np.eye(6)), MOTION) for variance in (1e-6, 1e-4)
)


def found(kept, older=0, relocalized=False):
    tracks = [SimpleNamespace(last_frame=LAST)] * kept + [SimpleNamespace(last_frame=LAST - 3)] * older
    return Association((*tracks, None), np.eye(4) if relocalized else None)


def chosen(first, second, expected=4):
    """The hypothesis taken, and how many were tried."""
    tried = []
    answers = {id(FIRST): first, id(SECOND): second}

    def associate(hypothesis):
        tried.append(hypothesis)
        return answers[id(hypothesis)]

    hypothesis, association = best_hypothesis([FIRST, SECOND], associate, LAST, expected)
    assert association is answers[id(hypothesis)]
    return hypothesis is SECOND, len(tried)


def test_guess_is_where_the_motion_leads():
    np.testing.assert_allclose(FIRST.belief.T_map_camera, MOTION.T_from_to)
    assert np.all(np.diag(FIRST.belief.covariance) > np.diag(MOTION.covariance))


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        (found(2), found(4), (False, 1)),  # half of the objects will do
        (found(1), found(4), (True, 2)),
        (found(1, older=3), found(2), (True, 2)),  # those of long ago do not count
        (found(1), found(1), (False, 2)),  # in doubt the first
        (found(0), found(0), (False, 2)),
        (found(4, relocalized=True), found(4), (True, 2)),  # it led elsewhere
        (found(4, relocalized=True), found(3), (False, 2)),
    ],
)
def test_second_guess_serves_where_the_first_loses_objects(first, second, expected):
    assert chosen(first, second) == expected


def test_where_no_objects_were_the_first_guess_stands():
    assert chosen(found(0), found(0), expected=0) == (False, 1)

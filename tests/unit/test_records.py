import numpy as np
import pytest

from neuse.embedding.code import Code, landmark_template
from neuse.records import Observation


def test_range_of_an_observation_is_the_distance_of_the_object_and_not_of_its_points():
    z = np.concatenate([landmark_template(8) * 0.05, np.zeros((4, 3))]) + np.array([2.0, 3.0, 6.0])
    code = Code("mug", False, z, np.full(8, 8**-0.5), np.full(6, 0.01))
    observation = Observation(1, 0.9, code, np.zeros((1, 3)), np.array([1.0, 1.0, 1.0]), 100)
    assert observation.range_m == pytest.approx(7.0)

import numpy as np
import pytest

from neuse.embedding.code import Code, landmark_template
from neuse.records import Intrinsics, Observation


def test_range_of_an_observation_is_the_distance_of_the_object_and_not_of_its_points():
    z = np.concatenate([landmark_template(8) * 0.05, np.zeros((4, 3))]) + np.array([2.0, 3.0, 6.0])
    code = Code("mug", False, z, np.full(8, 8**-0.5), np.full(6, 0.01))
    observation = Observation(1, 0.9, code, np.zeros((1, 3)), np.array([1.0, 1.0, 1.0]), 100)
    assert observation.range_m == pytest.approx(7.0)


@pytest.mark.parametrize("name", ["width", "height", "fx", "fy", "cx", "cy"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e9, 1e9])
def test_camera_with_a_number_beyond_reason_is_not_sound(name, value):
    numbers = {"width": 640, "height": 480, "fx": 500.0, "fy": 501.0, "cx": 0.0, "cy": -3.5}
    assert Intrinsics(**numbers).is_sound
    assert not Intrinsics(**numbers | {name: value}).is_sound


@pytest.mark.parametrize("name", ["width", "height", "fx", "fy"])
def test_camera_without_size_or_focal_length_is_not_sound(name):
    numbers = {"width": 640, "height": 480, "fx": 500.0, "fy": 501.0, "cx": 0.0, "cy": 0.0}
    assert not Intrinsics(**numbers | {name: 0}).is_sound

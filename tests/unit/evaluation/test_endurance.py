from mmap import mmap

import numpy as np
import pytest

from neuse.evaluation.endurance import FRAMES_AN_HOUR, Endurance, endure, resident_mb


def test_slope_is_that_of_the_second_half():
    hours = np.linspace(0.1, 1.0, 10)
    memory_mb = np.where(hours < 0.5, 300 + 200 * hours, 400 + 7 * hours)
    assert Endurance(hours, memory_mb, 0.0).slope_mb_per_hour == pytest.approx(7.0)


def test_resident_memory_follows_what_is_held():
    before_mb = resident_mb()
    with mmap(-1, 80_000_000) as held:  # of its own, whatever the process has kept of what it has freed
        held.write(bytes(len(held)))
        assert 70 < resident_mb() - before_mb < 90


def test_standing_camera_adds_next_to_nothing():
    found = endure(frames=600, speed_mps=0.0)
    assert len(found.hours) == 60
    assert found.hours[-1] == pytest.approx(600 / FRAMES_AN_HOUR)
    assert found.memory_mb[-1] - found.memory_mb[30] < 3.0  # MB in ten seconds; a keyframe a frame adds ten


def test_run_ends_when_its_time_is_over():
    assert len(endure(frames=6000, speed_mps=0.3, minutes=0.0).hours) == 1

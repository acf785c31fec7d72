"""Tests of the stopwatch."""

import time

import pytest

from neuse.stopwatch import Stopwatch


def test_times_of_one_stage_add_up_until_the_reset():
    stopwatch = Stopwatch()
    for _ in range(2):
        with stopwatch.timed("edge"):
            time.sleep(0.01)
    assert 20.0 <= stopwatch.stage_ms["edge"] < 200.0
    stopwatch.reset()
    assert stopwatch.stage_ms == {}


def test_a_stage_that_fails_is_timed_too():
    stopwatch = Stopwatch()
    with pytest.raises(ValueError, match="no"), stopwatch.timed("optimise"):
        raise ValueError("no")
    assert "optimise" in stopwatch.stage_ms

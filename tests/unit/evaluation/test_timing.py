"""Two clocks: the one on the wall goes on while the process sleeps."""

import time

import pytest

from neuse.evaluation.timing import WARM_UP, Times, TwoClocks, timed, timed_runs


def test_sleep_costs_wall_time_only():
    wall_ms, cpu_ms = timed(lambda: time.sleep(0.05))
    assert wall_ms >= 50.0
    assert cpu_ms < 40.0


def test_first_runs_are_not_counted():
    calls = []
    times = timed_runs(lambda: calls.append(1), 3)
    assert (len(calls), len(times.wall_ms), len(times.cpu_ms)) == (WARM_UP + 3, 3, 3)


def test_summary_and_share():
    summary = Times((1.0, 3.0, 8.0), (1.0, 2.0, 3.0)).per(2).summary()
    assert (summary["median_ms"], summary["mean_ms"], summary["worst_ms"]) == (1.5, 2.0, 4.0)
    assert (summary["cpu_mean_ms"], summary["cpu_worst_ms"], summary["n"]) == (1.0, 1.5, 3)


def test_stages_add_up_by_both_clocks_until_the_reset():
    clocks = TwoClocks()
    for _ in range(2):
        with clocks.timed("stage"):
            time.sleep(0.01)
    assert clocks.stage_ms["stage"] >= 20.0
    assert 0.0 <= clocks.cpu_ms["stage"] < clocks.stage_ms["stage"]
    clocks.reset()
    assert clocks.stage_ms == clocks.cpu_ms == {}


def test_stage_that_raises_is_not_swallowed():
    with pytest.raises(RuntimeError), TwoClocks().timed("stage"):
        raise RuntimeError

"""A loop closure that moves all of a graph is taken in by parts, and in the end as well as at once."""

import gtsam
import numpy as np
import pytest

from neuse.errors import SolverError
from neuse.geometry import exp, inverse, log
from neuse.slam.smoother import Smoother, SolverParams

N, MOST = 40, 7
NOISE = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)


def key(index):
    return gtsam.symbol("x", index)


def poses_on_a_circle(step):
    poses = [np.eye(4)]
    for _ in range(N - 1):
        poses.append(poses[-1] @ step)
    return poses


TRUE_STEP = exp(np.array([0, 0, 2 * np.pi / N, 0.3, 0, 0]))
TRUTH = poses_on_a_circle(TRUE_STEP)
DRIFTING_STEP = TRUE_STEP @ exp(np.array([0, 0, 0.01, 0.01, 0, 0]))


def edge(old, new, T_old_new):
    return gtsam.BetweenFactorPose3(key(old), key(new), gtsam.Pose3(T_old_new), NOISE)


def way_with_drift(every=1, most=MOST):
    """A way round a circle, before its loop is closed."""
    params = SolverParams(
        relinearize_m=1e-3, relinearize_rad=1e-3, relinearize_every=every, relinearize_most=most
    )
    smoother = Smoother(params)
    smoother.add(gtsam.PriorFactorPose3(key(0), gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)))
    for index, T in enumerate(poses_on_a_circle(DRIFTING_STEP)):
        smoother.insert(key(index), gtsam.Pose3(T))
        if index:
            smoother.add(edge(index - 1, index, DRIFTING_STEP))
    for _ in range(every):
        smoother.solve()
    return smoother


def close_loop(smoother):
    for index in range(5):
        smoother.add(edge(index, N - 5 + index, inverse(TRUTH[index]) @ TRUTH[N - 5 + index]))
    smoother.solve()


def solve(smoother, times):
    """For each solution the indices that it relinearised."""
    done = []
    for _ in range(times):
        before = gtsam.Values(smoother.isam.getLinearizationPoint())
        smoother.solve()
        after = smoother.isam.getLinearizationPoint()
        done.append([i for i in range(N) if not before.atPose3(key(i)).equals(after.atPose3(key(i)), 1e-12)])
    return done


def estimate(smoother):
    solution = smoother.isam.calculateEstimate()
    return [solution.atPose3(key(i)).matrix() for i in range(N)]


def test_graph_at_rest_is_left_alone():
    assert solve(way_with_drift(), 3) == [[], [], []]


def test_limited_number_is_relinearised_at_a_time():
    smoother = way_with_drift()
    close_loop(smoother)
    counts = [len(done) for done in solve(smoother, 60)]
    assert counts[:3] == [MOST] * 3
    assert max(counts) == MOST
    assert counts[-1] == 0


def test_neighbours_take_their_turns_together():
    smoother = way_with_drift()
    close_loop(smoother)
    first, second = solve(smoother, 2)
    assert np.ptp(first) < 2 * MOST
    assert min(second) > max(first)


def test_it_goes_on_until_nothing_waits_and_then_pauses():
    smoother = way_with_drift(every=3)
    close_loop(smoother)
    counts = [len(done) for done in solve(smoother, 90)]
    assert counts[0] == 0
    assert counts[1:5] == [MOST] * 4
    assert counts[-1] == 0


def test_smoother_tells_while_some_wait():
    smoother = way_with_drift()
    assert not smoother.is_behind
    close_loop(smoother)
    smoother.solve()
    assert smoother.is_behind
    solve(smoother, 60)
    assert not smoother.is_behind


@pytest.mark.parametrize("fails_before", [True, False], ids=["before", "after"])
def test_what_waits_survives_a_solution_that_fails(monkeypatch, fails_before):
    """Whether it fails before or after iSAM2 has taken in what is new."""
    smoother, failures = way_with_drift(), iter([True])
    update = Smoother._update

    def fail_once(self):
        if fails_before and next(failures, False):
            raise SolverError("by chance")
        update(self)
        if next(failures, False):
            raise SolverError("by chance")

    monkeypatch.setattr(Smoother, "_update", fail_once)
    smoother.insert(key(N), gtsam.Pose3(TRUTH[-1] @ TRUE_STEP))
    smoother.add(edge(N - 1, N, TRUE_STEP))
    smoother.solve()
    assert smoother.isam.valueExists(key(N))
    assert smoother.isam.getFactorsUnsafe().nrFactors() == N + 1


def test_by_parts_it_ends_where_all_at_once_ends():
    by_parts, at_once = way_with_drift(most=MOST), way_with_drift(most=10**6)
    drifted = estimate(by_parts)
    for smoother in (by_parts, at_once):
        close_loop(smoother)
        solve(smoother, 60)
    pairs = zip(estimate(by_parts), estimate(at_once), strict=True)
    apart = max(np.abs(log(inverse(a) @ b)).max() for a, b in pairs)
    moved = max(np.abs(log(inverse(a) @ b)).max() for a, b in zip(drifted, estimate(by_parts), strict=True))
    assert apart < 2e-3
    assert moved > 0.1


@pytest.mark.parametrize(("kind", "moves_m"), [("p", 0.02), ("q", 0.2)])
def test_each_kind_has_its_threshold(kind, moves_m):
    smoother, point = Smoother(SolverParams(relinearize_m=0.01, relinearize_every=1)), gtsam.symbol(kind, 0)
    smoother.insert(point, np.zeros(3))
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
    for way_m, linearised_at_m in ((0.4 * moves_m, 0.0), (1.6 * moves_m, moves_m)):
        smoother.add(gtsam.PriorFactorPoint3(point, np.array([way_m, 0, 0]), noise))
        smoother.solve()
        smoother.solve()
        assert smoother.isam.getLinearizationPoint().atPoint3(point)[0] == pytest.approx(linearised_at_m)

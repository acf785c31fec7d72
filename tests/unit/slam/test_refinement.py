"""Registration of object surfaces between near keyframes."""

import numpy as np
import pytest
import trimesh

from neuse.geometry import Array, exp, inverse, log, transform_points
from neuse.records import Edge, EdgeKind
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.object_frames import reduce_codes
from neuse.slam.refinement import RefinementParams, Refiner, _scan

SPOTS = {4: [-0.2, 0.1, 1.1], 7: [0.2, 0.0, 1.2], 9: [0.0, -0.1, 1.4]}
MOTION = exp([0.02, -0.03, 0.01, 0.05, 0.01, -0.02])
ROUGHLY = MOTION @ exp([0.01, 0, 0, 0.01, 0, 0])
NOISE_M = 0.001


def clouds(T_camera_map: Array, keys=tuple(SPOTS), seed=0) -> dict[int, np.ndarray]:
    """Points on mugs without handles, seen with noise."""
    rng = np.random.default_rng(seed)
    body = trimesh.creation.cylinder(radius=0.04, height=0.1)
    return {
        key: transform_points(T_camera_map, body.sample(256, seed=seed) + SPOTS[key])
        + NOISE_M * rng.normal(size=(256, 3))
        for key in keys
    }


def record(i) -> KeyframeRecord:
    return KeyframeRecord(i, 100 * i, np.zeros(0, dtype=int), reduce_codes([]), None)


def refined(refiner: Refiner, keys=tuple(SPOTS), T_tracked: Array = ROUGHLY) -> list[Edge]:
    assert refiner.edges(record(0), clouds(np.eye(4), keys, seed=1), np.zeros((0, 4, 4))) == []
    return refiner.edges(record(1), clouds(inverse(MOTION), keys, seed=2), T_tracked[None])


def test_refined_motion_is_right_to_millimetres_and_says_so():
    (edge,) = refined(Refiner())
    xi = log(inverse(edge.T_from_to) @ MOTION)
    assert np.linalg.norm(xi[:3]) < 0.005
    assert np.linalg.norm(xi[3:]) < 0.003
    assert xi @ np.linalg.solve(edge.covariance, xi) < 20.0
    assert (edge.from_id, edge.to_id, edge.kind, edge.object_ids) == (0, 1, EdgeKind.EXTERNAL, ())


def test_lone_object_is_not_refined():
    assert refined(Refiner(), keys=(7,)) == []


def test_surfaces_that_do_not_meet_are_not_refined():
    assert refined(Refiner(), T_tracked=MOTION @ exp([0, 0, 0, 0.5, 0, 0])) == []


@pytest.mark.parametrize(("lags", "count"), [(0, 0), (1, 1), (3, 3)])
def test_so_many_keyframes_back_are_registered(lags, count):
    refiner = Refiner(RefinementParams(lags=lags))
    T_olds_new = np.zeros((0, 4, 4))
    for i in range(5):
        edges = refiner.edges(record(i), clouds(np.eye(4), seed=i), T_olds_new)
        T_olds_new = np.tile(np.eye(4), (i + 1, 1, 1))
    assert [edge.from_id for edge in edges] == list(range(4 - count, 4))


@pytest.mark.parametrize("count", [0, 1, 10])
def test_objects_of_few_points_are_not_registered(count, capfd):
    refiner, nothing = Refiner(), np.zeros((0, 4, 4))
    few = [{key: cloud[:count] for key, cloud in clouds(np.eye(4), (4, 7)).items()} for _ in range(2)]
    assert refiner.edges(record(0), few[0], nothing) == []
    assert refiner.edges(record(1), few[1], np.eye(4)[None]) == []
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize(("count", "kept"), [(8, 8), (128, 128), (1000, 256)])
def test_so_many_points_of_an_object_are_registered(count, kept, monkeypatch):
    sizes = []
    monkeypatch.setattr(
        "neuse.slam.refinement._scan",
        lambda new, thin: sizes.extend(map(len, thin.values())) or _scan(new, thin),
    )
    refined(Refiner(RefinementParams(points_per_object=count)))
    assert set(sizes) == {kept}

import json
from pathlib import Path

import numpy as np
import pytest

from bags.layouts import DEPTH_M, color, labels, make_bop, write_json
from neuse.errors import InputError
from neuse.geometry import inverse
from neuse_bags.bop import open_bop


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return make_bop(tmp_path / "set" / "test" / "000001")


def test_scene_becomes_frames_in_the_order_of_their_numbers(scene: Path) -> None:
    first, second = open_bop(scene).frames()
    assert second.stamp_ns - first.stamp_ns == 300_000_000
    np.testing.assert_allclose(first.depth_m[labels() > 0], DEPTH_M, rtol=1e-6)
    assert [(i.label, i.category) for i in first.instances] == [(1, "mug"), (3, "bottle")]
    np.testing.assert_array_equal(first.mask == 3, labels() == 2)
    assert np.unique(first.mask).tolist() == [0, 1, 3]
    assert (first.intrinsics.fx, first.intrinsics.cy, first.intrinsics.width) == (30.0, 11.5, 32)
    assert first.color is not None
    assert np.abs(first.color.astype(int).mean() - color().mean()) < 5  # a lossy picture


def test_true_poses_are_inverted_and_in_metres(scene: Path) -> None:
    (first_ns, T_world_camera), _ = open_bop(scene).trajectories.ground_truth
    assert first_ns == next(iter(open_bop(scene).frames())).stamp_ns
    T_camera_world = inverse(T_world_camera)
    np.testing.assert_allclose(T_camera_world[:3, 3], [1.0, 0.0, 0.5])
    np.testing.assert_allclose(T_camera_world[:3, 0], [0, 1, 0], atol=1e-12)


def test_scene_without_poses_and_colour_is_read(scene: Path) -> None:
    cameras = json.loads((scene / "scene_camera.json").read_text())
    for camera in cameras.values():
        del camera["cam_R_w2c"]
    write_json(scene / "scene_camera.json", cameras)
    for path in (scene / "rgb").iterdir():
        path.unlink()
    source = open_bop(scene)
    assert source.trajectories.ground_truth == []
    assert all(frame.color is None for frame in source.frames())


def test_categories_and_rate_may_stand_with_the_data_set(scene: Path) -> None:
    (scene / "categories.json").unlink()
    write_json(scene.parent.parent / "categories.json", {"7": "toy", "rate_hz": 10, "13": "mug"})
    make = (scene / "mask_visib" / "000001_000000.png").read_bytes()
    for name in ("000001", "000010"):
        (scene / "mask_visib" / f"{name}_000001.png").write_bytes(make)
    first, second = open_bop(scene).frames()
    assert second.stamp_ns - first.stamp_ns == 900_000_000
    assert [i.category for i in first.instances] == ["mug", "toy"]


def _camera(**changes: object):
    entry = {"cam_K": [30.0, 0, 15.5, 0, 31.0, 11.5, 0, 0, 1], "depth_scale": 0.1} | changes
    return {"1": {name: value for name, value in entry.items() if value is not None}}


@pytest.mark.parametrize(
    ("file", "content", "told"),
    [
        ("scene_camera.json", None, r"scene_camera\.json cannot be read .*; write"),
        ("scene_camera.json", {"one": {}}, r"scene_camera\.json has no pictures by number; write"),
        ("scene_camera.json", {"1": []}, r"scene_camera\.json has no pictures by number; write"),
        ("scene_camera.json", _camera(cam_K=None), r"lacks 'cam_K' of picture 1; write \{\"cam_K\": \[fx"),
        ("scene_camera.json", _camera(depth_scale=None), "lacks 'depth_scale' of picture 1; write"),
        ("scene_camera.json", _camera(depth_scale=0), "depth_scale 0 in picture 1; all must be above zero"),
        ("scene_camera.json", _camera(cam_R_w2c=[1], cam_t_w2c=[1]), "picture 1 is no pose.*; write 9 and 3"),
        (
            "scene_camera.json",
            _camera(cam_R_w2c=[2, 0, 0, 0, 1, 0, 0, 0, 1], cam_t_w2c=[1, 2, 3]),
            "picture 1 is no pose .*not rigid",
        ),
        ("scene_camera.json", {"9" * 30: _camera()["1"]}, "has picture 99999999999999999999; number them"),
        ("scene_gt.json", None, r"scene_gt\.json cannot be read"),
        ("scene_gt.json", {"10": []}, r"scene_gt\.json lacks '1' of picture 1; write"),
        ("scene_gt.json", {"1": [{"obj": 1}]}, r"scene_gt\.json lacks 'obj_id' of picture 1"),
        ("categories.json", None, r'categories\.json cannot be read .*; write \{"13": "mug"'),
        ("categories.json", {}, r"categories\.json has no category"),
        ("categories.json", {"13": "mug", "rate_hz": 0}, r"categories\.json has no category or no rate_hz"),
        ("categories.json", {"7": "toy"}, r"000001_000001\.png does not exist; scene_gt\.json asks for it"),
    ],
)
def test_what_is_missing_or_wrong_is_told_by_file(scene: Path, file: str, content: object, told: str) -> None:
    if content is None:
        (scene / file).unlink()
    else:
        write_json(scene / file, content)
    with pytest.raises(InputError, match=told):
        list(open_bop(scene).frames())

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from neuse.errors import InputError
from neuse_bags.folder import FIRST_STAMP_NS, open_folder
from neuse_bags.trajectory_files import read_tum

Folder = Callable[..., Path]


def test_pictures_become_frames(picture_folder: Folder) -> None:
    path = picture_folder()
    first, second = open_folder(path).frames()
    assert second.stamp_ns - first.stamp_ns == 1_200_000_000
    assert [(i.label, i.category, i.score) for i in first.instances] == [(7, "mug", 1.0), (9, "bottle", 0.5)]
    depth_mm = cv2.imread(str(path / "12_depth.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_allclose(second.depth_m, depth_mm / 1e3, atol=1e-6)
    assert second.color is not None
    np.testing.assert_array_equal(second.color[..., ::-1], cv2.imread(str(path / "12_color.png")))


def test_rate_stamps_and_depth_scale_are_taken_from_frames_json(picture_folder: Folder) -> None:
    frames = [{"frame": 12, "instances": []}, {"frame": 0, "stamp_s": 0.25, "instances": []}]
    first, second = open_folder(picture_folder(frames=frames, rate_hz=4, depth_scale_m=1e-4)).frames()
    assert second.stamp_ns - first.stamp_ns == 2_750_000_000
    assert 0 < first.depth_m.max() <= 0.4


def test_color_pictures_may_be_missing(picture_folder: Folder) -> None:
    path = picture_folder()
    (path / "00_color.png").unlink()
    first, second = open_folder(path).frames()
    assert first.color is None
    assert second.color is not None


@pytest.mark.parametrize("name", ["00_depth.png", "00_mask.png"])
def test_missing_picture_is_refused_by_name(picture_folder: Folder, name: str) -> None:
    path = picture_folder()
    (path / name).unlink()
    with pytest.raises(InputError, match=f"{name} does not exist"):
        list(open_folder(path).frames())


@pytest.mark.parametrize(
    ("name", "pixels", "found"),
    [
        ("00_depth.png", np.zeros((24, 31), np.uint16), "31 x 24 pixels"),
        ("00_depth.png", np.zeros((24, 32), np.uint8), "8 bit"),
        ("00_mask.png", np.zeros((24, 32, 3), np.uint8), r"3 channel\(s\)"),
    ],
)
def test_picture_of_another_size_or_kind_is_refused(
    picture_folder: Folder, name: str, pixels: np.ndarray, found: str
) -> None:
    path = picture_folder()
    cv2.imwrite(str(path / name), pixels)
    with pytest.raises(InputError, match=f"{name} is .*{found}.* frames.json wants 32 x 24"):
        list(open_folder(path).frames())


def test_picture_that_is_none_is_refused(picture_folder: Folder) -> None:
    path = picture_folder()
    (path / "00_depth.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match="not a readable picture"):
        list(open_folder(path).frames())


def test_folder_without_frames_json_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"frames\.json cannot be read"):
        open_folder(tmp_path)


def test_frames_json_that_is_no_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "frames.json").write_text("{")
    with pytest.raises(InputError, match="is no JSON"):
        open_folder(tmp_path)


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"intrinsics": {"width": 32}}, "lacks 'height'"),
        ({"frames": [{"instances": []}]}, "lacks 'frame'"),
        ({"frames": [{"frame": 0}]}, "lacks 'instances'"),
        ({"frames": []}, "frames.json has no frames; write"),
        (
            {"frames": [{"frame": "first", "instances": []}]},
            r"frames\.json has a wrong entry \(invalid literal.*write \{",
        ),
        ({"rate_hz": 0}, "frames.json has rate_hz 0; write"),
        ({"depth_scale_m": -1}, "frames.json has depth_scale_m -1; write a number above zero"),
        ({"intrinsics": {"width": 32, "height": 24, "fx": 0, "fy": 1, "cx": 1, "cy": 1}}, "focal length 0"),
    ],
)
def test_frames_json_that_lacks_something_is_refused(
    picture_folder: Folder, changes: dict, found: str
) -> None:
    with pytest.raises(InputError, match=found):
        open_folder(picture_folder(**changes))


def test_instance_without_category_is_refused(picture_folder: Folder) -> None:
    folder = open_folder(picture_folder(frames=[{"frame": 0, "instances": [{"id": 1}]}]))
    with pytest.raises(InputError, match="lacks 'category' in an instance of frame 00"):
        list(folder.frames())


def test_trajectory_file_is_read_with_the_stamps_of_the_pictures(picture_folder: Folder) -> None:
    path = picture_folder()
    (path / "odometry.tum").write_text("# stamp x y z qx qy qz qw\n0.0 1 2 3 0 0 0 1\n1.2 1 2 4 0 0 1 0\n")
    (first_ns, T_first), (second_ns, T_second) = read_tum(path / "odometry.tum", FIRST_STAMP_NS)
    assert [first_ns, second_ns] == [frame.stamp_ns for frame in open_folder(path).frames()]
    np.testing.assert_array_equal(T_first[:3, 3], [1, 2, 3])
    np.testing.assert_allclose(T_second[:3, :3], np.diag([-1, -1, 1]), atol=1e-12)
    assert read_tum(path / "ground_truth.tum") == []


@pytest.mark.parametrize(
    "text", ["0.0 1 2 3\n", "a b c d e f g h\n", "0.0 1 2 3 0 0 0 2\n", "0.0 1e9 2 3 0 0 0 1\n"]
)
def test_trajectory_file_of_another_format_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "odometry.tum").write_text(text)
    with pytest.raises(InputError, match="stamp_s x y z"):
        read_tum(tmp_path / "odometry.tum")


@pytest.mark.parametrize("stamp_s", [-1.0, 1.7e18])
def test_stamp_that_no_message_can_hold_is_refused(picture_folder: Folder, stamp_s: float) -> None:
    with pytest.raises(InputError, match="write stamp_s in seconds"):
        open_folder(picture_folder(frames=[{"frame": 0, "stamp_s": stamp_s, "instances": []}]))


@pytest.mark.parametrize(
    ("instance", "told"),
    [
        ({"id": 0, "category": "mug"}, "has label 0, which no mask can have"),
        ({"id": 70000, "category": "mug"}, "has label 70000, which no mask can have"),
        ({"id": "one", "category": "mug"}, "'one'; write"),
        ({"id": 1, "category": "mug", "score": "high"}, "'high'; write"),
        ({"id": 1, "category": "mug", "score": 87}, "scores as shares of one"),
        ({"id": float("inf"), "category": "mug"}, "infinity"),
        ({"id": 1, "category": ["mug"]}, "write"),
        (3, "wrong entry .* in an instance of frame 00"),
    ],
)
def test_instance_that_no_mask_can_have_is_refused(
    picture_folder: Folder, instance: object, told: str
) -> None:
    folder = open_folder(picture_folder(frames=[{"frame": 0, "instances": [instance]}]))
    with pytest.raises(InputError, match=told):
        list(folder.frames())


def _frames(*entries: dict) -> list[dict]:
    return [{"instances": []} | entry for entry in entries]


def test_numbers_that_are_written_as_texts_are_taken(picture_folder: Folder) -> None:
    frames = _frames({"frame": "0", "stamp_s": "0.5"}, {"frame": 12.0, "stamp_s": 2})
    first, second = open_folder(picture_folder(frames=frames)).frames()
    assert (first.stamp_ns, second.stamp_ns) == (1_500_000_000, 3_000_000_000)


@pytest.mark.parametrize(
    ("frames", "told"),
    [
        (_frames({"frame": float("inf")}), r"frames\.json has a wrong entry .*; write \{"),
        (_frames({"frame": 0.5}), r"frames\.json has a wrong entry \(frame 0.5 is no count\)"),
        (_frames({"frame": 0, "stamp_s": "soon"}), r"wrong entry .*; write .*stamp_s in seconds"),
        (
            _frames({"frame": 0, "stamp_s": 1.0}, {"frame": 1, "stamp_s": 1.0}),
            "frames 0 and 1 at one time; write",
        ),
        (
            _frames({"frame": 3}, {"frame": 3, "stamp_s": 1.0}),
            "has frame 3 more than once; write each frame once",
        ),
        (7, "has no frames; write"),
        ([7], "has a wrong entry"),
    ],
)
def test_frames_that_no_bag_can_hold_are_refused_at_once(
    picture_folder: Folder, frames: object, told: str
) -> None:
    with pytest.raises(InputError, match=told):
        open_folder(picture_folder(frames=frames))


@pytest.mark.parametrize("changes", [{"intrinsics": {"width": 32}}, {"intrinsics": None}, {"rate_hz": "x"}])
def test_each_fault_names_the_file_once(picture_folder: Folder, changes: dict) -> None:
    with pytest.raises(InputError) as told:
        open_folder(picture_folder(**changes))
    assert str(told.value).count("frames.json") == 1
    assert "; write " in str(told.value)


def test_damaged_colour_is_left_out_and_counted(picture_folder: Folder) -> None:
    path = picture_folder()
    (path / "00_color.png").write_bytes(b"no picture")
    source = open_folder(path)
    assert [frame.color is None for frame in source.frames()] == [True, False]
    (fault,) = source.skipped
    assert "00_color.png is not a readable picture" in str(fault)


@pytest.mark.parametrize("name", ["odometry.tum", "ground_truth.tum"])
def test_poses_of_another_clock_are_refused_by_file(picture_folder: Folder, name: str) -> None:
    path = picture_folder()
    (path / name).write_text("1700000000.0 1 2 3 0 0 0 1\n")
    with pytest.raises(
        InputError, match=rf"{name}: no pose is at the time of a frame: poses are at 1700000000"
    ):
        open_folder(path)

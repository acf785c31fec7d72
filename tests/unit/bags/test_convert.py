from pathlib import Path

import numpy as np
import pytest
from real_frames import REAL_FRAMES, needs_real_frames

from neuse_bags.convert import main
from neuse_bags.frames import read_frames, read_odometry, with_color
from neuse_bags.mcap_file import BagReader


def test_folder_becomes_a_bag_that_gives_the_same_frames(picture_folder, tmp_path: Path) -> None:
    folder = picture_folder()
    (folder / "odometry.tum").write_text("0.0 1 2 3 0 0 0 1\n")
    assert main([str(folder), "--out", str(tmp_path / "own.mcap")]) == 0
    with BagReader(tmp_path / "own.mcap") as bag:
        frames = list(read_frames(bag, pytest.fail))
        assert read_odometry(bag).at(0).T_odom_camera[2, 3] == 3.0
        assert "/ground_truth/odometry" not in bag.topics
        assert bag.topics["/color/image"].n_messages == 2
    assert [frame.stamp_ns for frame in frames] == [1_000_000_000, 2_200_000_000]
    assert np.unique(frames[0].mask).tolist() == [0, 7, 9]


def test_bad_folder_is_told_in_one_line_with_exit_code_two(picture_folder, tmp_path: Path, capsys) -> None:
    folder = picture_folder()
    (folder / "12_mask.png").unlink()
    out = tmp_path / "own.mcap"
    assert main([str(folder), "--out", str(out)]) == 2
    last_line = capsys.readouterr().err.strip().splitlines()[-1]
    assert last_line.startswith("neuse_bags convert: ")
    assert "12_mask.png does not exist" in last_line
    assert not out.exists()


@pytest.mark.parametrize("argv", [[], ["folder"]])
def test_missing_arguments_end_with_exit_code_two(argv: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(argv)
    assert ended.value.code == 2


def test_help_documents_the_format_of_the_folder(capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    assert "00_depth.png       16 bit" in capsys.readouterr().out


def test_arguments_for_ros_are_left_alone(picture_folder, tmp_path: Path) -> None:
    arguments = [str(picture_folder()), "--out", str(tmp_path / "own.mcap"), "--ros-args", "-r", "a:=b"]
    assert main(arguments) == 0


@needs_real_frames
def test_real_frames_become_a_bag(tmp_path: Path) -> None:
    assert main([str(REAL_FRAMES), "--out", str(tmp_path / "real.mcap")]) == 0
    with BagReader(tmp_path / "real.mcap") as bag:
        frames = with_color(bag, list(read_frames(bag, pytest.fail)))
    assert [len(frame.instances) for frame in frames] == [3, 2, 1]
    assert all(frame.color is not None for frame in frames)

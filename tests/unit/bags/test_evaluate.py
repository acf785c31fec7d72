from pathlib import Path

import pytest

from neuse_bags.evaluate import main


def test_bag_that_is_no_recording_is_told_in_one_line(frames_bag: Path, tmp_path: Path, capsys) -> None:
    arguments = [str(frames_bag), "--truth", str(frames_bag), "--out", str(tmp_path / "out")]
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("neuse_bags evaluate: ")
    assert "lacks /neuse/frames" in line
    assert not (tmp_path / "out").exists()


def test_missing_recording_is_told_in_one_line(frames_bag: Path, tmp_path: Path, capsys) -> None:
    missing = str(tmp_path / "nothing.mcap")
    assert main([missing, "--truth", str(frames_bag), "--out", str(tmp_path / "out")]) == 2
    assert "nothing.mcap does not exist" in capsys.readouterr().err


def test_truth_must_be_given() -> None:
    with pytest.raises(SystemExit) as ended:
        main(["a.mcap", "--out", "b"])
    assert ended.value.code == 2

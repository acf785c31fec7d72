from pathlib import Path

import pytest

from neuse.errors import MapFileError
from neuse_mapper_node.save_place import check_place


def test_place_in_a_folder_is_taken_and_nothing_is_left_there(tmp_path: Path):
    check_place(str(tmp_path / "room.map"))
    assert not list(tmp_path.iterdir())


def test_place_of_an_earlier_map_is_taken_and_the_map_kept(tmp_path: Path):
    (tmp_path / "room.map").write_bytes(b"earlier")
    check_place(str(tmp_path / "room.map"))
    assert (tmp_path / "room.map").read_bytes() == b"earlier"


def test_place_by_a_bare_name_is_in_the_present_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    check_place("room.map")


def test_folder_that_does_not_exist_is_told_with_what_to_do(tmp_path: Path):
    with pytest.raises(MapFileError, match=rf"room.map.*{tmp_path}/nodir does not exist; make it"):
        check_place(str(tmp_path / "nodir" / "room.map"))


def test_folder_that_cannot_be_written_to_is_told():
    with pytest.raises(MapFileError, match="/proc cannot be written to"):
        check_place("/proc/room.map")


def test_file_in_place_of_the_folder_is_told(tmp_path: Path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(MapFileError, match="does not exist"):
        check_place(str(tmp_path / "file" / "room.map"))


def test_folder_instead_of_a_file_is_told(tmp_path: Path):
    with pytest.raises(MapFileError, match="is a folder"):
        check_place(str(tmp_path))


def test_name_that_the_system_does_not_take_is_told():
    with pytest.raises(MapFileError, match="save_path"):
        check_place("no\0dir/room.map")

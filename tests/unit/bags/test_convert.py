from pathlib import Path

import numpy as np
import pytest
from real_frames import REAL_FRAMES, needs_real_frames

from bags.layouts import depth, make_bop, make_tum, write_json, write_picture
from neuse.errors import BagError
from neuse_bags.convert import main
from neuse_bags.frames import read_frames, read_odometry, with_color
from neuse_bags.mcap_file import BagReader, BagWriter


def test_folder_becomes_a_bag_that_gives_the_same_frames(picture_folder, tmp_path: Path) -> None:
    folder = picture_folder()
    (folder / "odometry.tum").write_text("0.0 1 2 3 0 0 0 1\n")
    assert main([str(folder), "--out", str(tmp_path / "own.mcap")]) == 0
    with BagReader(tmp_path / "own.mcap") as bag:
        frames = list(read_frames(bag, pytest.fail))
        assert read_odometry(bag, pytest.fail).at(0).T_odom_camera[2, 3] == 3.0
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


@pytest.mark.parametrize("make", [make_tum, make_bop])
def test_layouts_of_others_are_known_by_their_files(make, tmp_path: Path) -> None:
    assert main([str(make(tmp_path / "own")), "--out", str(tmp_path / "own.mcap")]) == 0
    with BagReader(tmp_path / "own.mcap") as bag:
        frames = list(read_frames(bag, pytest.fail))
        assert "/ground_truth/odometry" in bag.topics
    assert len(frames) == 2
    assert {instance.category for instance in frames[0].instances} == {"mug", "bottle"}


def last_words(capsys) -> str:
    return capsys.readouterr().err.strip().splitlines()[-1]


def test_folder_of_no_layout_is_refused(tmp_path: Path, capsys) -> None:
    assert main([str(tmp_path), "--out", str(tmp_path / "own.mcap")]) == 2
    assert "has none of frames.json, depth.txt, scene_camera.json, and is no bag" in last_words(capsys)


@pytest.mark.parametrize(
    ("make", "pattern", "told"),
    [
        (
            make_tum,
            "depth/*.png",
            "write about 20 as depth_scale (now 0.2), the millimetres of one unit, in ",
        ),
        (
            make_bop,
            "depth/*.png",
            "write the millimetres of one unit, about 100 times those now, as depth_scale in ",
        ),
    ],
)
def test_wrong_unit_is_told_with_the_place_to_correct_it(make, pattern, told, tmp_path: Path, capsys) -> None:
    folder = make(tmp_path / "own")
    for path in folder.glob(pattern):
        write_picture(path, depth(100))
    assert main([str(folder), "--out", str(tmp_path / "own.mcap")]) == 2
    said = last_words(capsys)
    assert "the unit of depth is wrong" in said
    assert told in said
    assert not (tmp_path / "own.mcap").exists()


def test_bag_gets_the_names_of_the_graph(frames_bag: Path, tmp_path: Path) -> None:
    odd, back = tmp_path / "odd.mcap", tmp_path / "back.mcap"
    with BagReader(frames_bag) as bag, BagWriter(odd) as writer:
        for topic in bag.topics.values():
            writer.add_topic(f"/robot{topic.name}", topic.type_name, topic.qos)
        for message in bag.messages():
            writer.write_raw(f"/robot{message.topic}", message.data, message.stamp_ns)
    table = tmp_path / "names.yaml"
    with BagReader(frames_bag) as bag:
        table.write_text("".join(f"/robot{name}: {name}\n" for name in bag.topics))
        expected = list(bag.messages())
    assert main([str(odd), "--remap", str(table), "--out", str(back)]) == 0
    with BagReader(back) as bag:
        assert list(bag.messages()) == expected


def test_bag_that_the_graph_cannot_use_is_refused_and_none_is_written(
    frames_bag: Path, tmp_path: Path, capsys
) -> None:
    out = tmp_path / "own.mcap"
    names = ["/color/image:=/depth/image"]
    assert main([str(frames_bag), "--out", str(out), "--remap", *names]) == 2
    said = last_words(capsys)
    assert (
        f"{frames_bag}: /depth/image, /segmentation/mask: depth image has encoding 'rgb8'; send one" in said
    )
    assert not out.exists()


def test_bag_is_not_written_over_itself(frames_bag: Path, capsys) -> None:
    before = frames_bag.read_bytes()
    assert main([str(frames_bag), "--out", str(frames_bag)]) == 2
    assert "would be overwritten by its own copy" in last_words(capsys)
    assert frames_bag.read_bytes() == before


def test_names_for_a_folder_are_refused(tmp_path: Path, capsys) -> None:
    arguments = [str(make_tum(tmp_path / "own")), "--out", str(tmp_path / "a.mcap"), "--remap", "/a:=/odom"]
    assert main(arguments) == 2
    assert "--remap is for bags" in last_words(capsys)


def _spoil_mask(folder: Path) -> None:
    next(iter(sorted(folder.glob("masks/*.png"))[1:])).write_bytes(b"no picture")


def test_faulty_source_leaves_an_older_bag_as_it_was(tmp_path: Path, capsys) -> None:
    folder, out = make_tum(tmp_path / "own"), tmp_path / "out" / "own.mcap"
    assert main([str(folder), "--out", str(out)]) == 0
    before = out.read_bytes()
    _spoil_mask(folder)
    assert main([str(folder), "--out", str(out)]) == 2
    assert out.read_bytes() == before
    assert list(out.parent.iterdir()) == [out]


def test_bag_that_breaks_off_while_it_is_copied_leaves_nothing(
    frames_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(bag: BagReader, writer: BagWriter) -> None:
        raise BagError("damaged")

    monkeypatch.setattr("neuse_bags.convert._copy", fail)
    out = tmp_path / "out" / "own.mcap"
    assert main([str(frames_bag), "--out", str(out)]) == 2
    assert list(out.parent.iterdir()) == []


def test_folder_cannot_be_the_bag(frames_bag: Path, tmp_path: Path, capsys) -> None:
    (tmp_path / "a.mcap").mkdir()
    for out in (tmp_path / "a.mcap", tmp_path / "a"):
        assert main([str(frames_bag), "--out", str(out)]) == 2
        assert "its name must end in .mcap, and be no folder's" in last_words(capsys)


def test_damaged_colour_does_not_end_the_conversion_and_is_told(tmp_path: Path, capsys) -> None:
    folder = make_tum(tmp_path / "own")
    next(folder.glob("rgb/*.png")).write_bytes(b"no picture")
    assert main([str(folder), "--out", str(tmp_path / "own.mcap")]) == 0
    assert "convert: 1 colour picture(s) left out, which are for people only" in capsys.readouterr().err
    with BagReader(tmp_path / "own.mcap") as bag:
        assert (bag.topics["/depth/image"].n_messages, bag.topics["/color/image"].n_messages) == (2, 1)


@pytest.mark.parametrize(
    ("make", "file", "content", "example"),
    [
        (make_tum, "masks/instances.json", {"1.5": {"1": "mug"}}, '{"1305031102.180304": {"1": "mug"}, ...}'),
        (make_tum, "masks/instances.json", {"7": "mug"}, '{"1": "mug", "2": "bottle"}'),
        (make_bop, "categories.json", {"99": "mug"}, '{"13": "mug"}; it has 5, 7, 13'),
    ],
)
def test_categories_that_match_nothing_are_refused_by_file(
    make, file: str, content: dict, example: str, tmp_path: Path, capsys
) -> None:
    folder = make(tmp_path / "own")
    write_json(folder / file, content)
    assert main([str(folder), "--out", str(tmp_path / "own.mcap")]) == 2
    said = last_words(capsys)
    assert "no frame has an instance" in said
    assert f"write into {folder / file}" in said
    assert example in said
    assert not (tmp_path / "own.mcap").exists()


@pytest.mark.parametrize(("levels", "name"), [(1, "test"), (2, "set")])
def test_several_scenes_are_told_to_be_given_one_by_one(
    levels: int, name: str, tmp_path: Path, capsys
) -> None:
    scene = make_bop(tmp_path / "set" / "test" / "000048")
    assert main([str(scene.parents[levels - 1]), "--out", str(tmp_path / "own.mcap")]) == 2
    assert f"give one scene, such as {scene}" in last_words(capsys)


def test_source_that_is_not_there_is_told(tmp_path: Path, capsys) -> None:
    assert main([str(tmp_path / "no"), "--out", str(tmp_path / "own.mcap")]) == 2
    assert "does not exist" in last_words(capsys)

from pathlib import Path

import pytest

from neuse.errors import BagError, ParamError
from neuse_bags.mcap_file import BagReader
from neuse_bags.renamed import RenamedBag, read_names


def test_renamed_topic_has_its_messages_under_the_new_name_alone(frames_bag: Path) -> None:
    with BagReader(frames_bag) as plain, RenamedBag(frames_bag, {"/color/image": "/depth/image"}) as bag:
        expected = [message.data for message in plain.messages(["/color/image"])]
        found = list(bag.messages(["/depth/image"]))
        assert [message.data for message in found] == expected
        assert {message.topic for message in found} == {"/depth/image"}
        assert bag.topics["/depth/image"].name == "/depth/image"
        assert "/color/image" not in bag.topics
        assert len(list(bag.messages())) == len(list(plain.messages())) - len(expected)


def test_topic_that_the_bag_lacks_is_refused(frames_bag: Path) -> None:
    with pytest.raises(BagError, match=r"lacks /cam/depth, which is to be renamed; it has /color"):
        RenamedBag(frames_bag, {"/cam/depth": "/depth/image"})


def test_table_is_read_from_words_and_files(tmp_path: Path) -> None:
    table = tmp_path / "names.yaml"
    table.write_text("/cam/depth: /depth/image\ncam/info: depth/camera_info\n")
    names = read_names([str(table), "/vio:=odom"])
    assert names == {"/cam/depth": "/depth/image", "/cam/info": "/depth/camera_info", "/vio": "/odom"}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("- /a\n", "is no table of names; write lines such as"),
        ("/a: 3\n", "is no table of names; write lines such as"),
        ("a: [\n", "is neither FROM:=TO nor a YAML file"),
        ("/a: /depth/images\n", "the graph has no /depth/images; write one of /depth/image, "),
        ("/a: /odom\n/b: /odom\n", "gives /odom to more than one topic; write it once"),
    ],
)
def test_table_that_cannot_be_meant_is_refused(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "names.yaml").write_text(text)
    with pytest.raises(ParamError, match=told):
        read_names([str(tmp_path / "names.yaml")])


def test_word_that_is_no_assignment_is_refused() -> None:
    with pytest.raises(ParamError, match=r"--remap /a is neither FROM:=TO nor a YAML file"):
        read_names(["/a"])

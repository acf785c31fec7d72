"""Arguments of the demo; the graph itself is tested with real processes."""

from pathlib import Path

import pytest

from neuse_bags.demo import NODES, last_summaries, main


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--rate", "0"], "--rate 0.0 must be at least"),
        (["--bag", "nowhere.mcap"], "nowhere.mcap does not exist"),
        (["--preset", "nowhere"], "unknown preset 'nowhere'"),
        (["--weights", "nowhere.safetensors"], "cannot read weights nowhere.safetensors"),
    ],
)
def test_bad_argument_is_told_before_anything_starts(
    tmp_path: Path, capsys, arguments: list[str], complaint: str
) -> None:
    assert main(["--out", str(tmp_path / "demo"), *arguments]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("neuse_bags demo: ")
    assert complaint in line
    assert not (tmp_path / "demo" / "logs").exists()


def test_bag_is_not_overwritten_by_its_own_recording(frames_bag: Path, capsys) -> None:
    bag = frames_bag.rename(frames_bag.with_name("recording.mcap"))
    assert main(["--out", str(bag.parent), "--bag", str(bag)]) == 2
    assert "choose another --out" in capsys.readouterr().err


def test_last_summary_of_each_node_is_told(tmp_path: Path) -> None:
    said = "[INFO] [1.5] [slam_node]: {} frames, 9 objects, 3 edges, {} dropped, 0 refused"
    for name in NODES:
        (tmp_path / f"{name}.log").write_text("\n".join([said.format(10, 0), said.format(40, 7), "bye"]))
    (tmp_path / "mapper_node.log").write_text("")
    assert last_summaries(tmp_path) == [
        "encoder_node: 40 frames, 9 objects, 3 edges, 7 dropped, 0 refused",
        "slam_node: 40 frames, 9 objects, 3 edges, 7 dropped, 0 refused",
        "mapper_node: ended before its first summary",
    ]

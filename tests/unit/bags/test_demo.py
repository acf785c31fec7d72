"""Arguments of the demo; the graph itself is tested with real processes."""

from pathlib import Path

import pytest

from neuse.embedding.embedding import WEIGHTS
from neuse.errors import NeuseError
from neuse_bags.demo import NODES, Graph, last_summaries, main, running_graph


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


def test_nodes_get_the_shipped_weights_and_ones_own_by_their_whole_paths(tmp_path: Path, monkeypatch) -> None:
    started: dict[str, tuple[object, ...]] = {}
    monkeypatch.setattr(Graph, "start", lambda _, package, node, *words, name: started.update({node: words}))
    monkeypatch.chdir(tmp_path)
    Graph(tmp_path).start_nodes(("",), live=False, weights=[Path("kettle.safetensors"), Path("mug")])
    own = f'"{tmp_path}/kettle.safetensors", "{WEIGHTS.resolve()}/mug.safetensors"]'
    for node in ("encoder_node", "mapper_node"):
        (weights,) = (word for word in started[node] if str(word).startswith("weights:="))
        assert str(weights).startswith('weights:=["bottle", "bowl", "box", "mug", ')
        assert str(weights).endswith(own)
    assert "weights" not in str(started["slam_node"])


def test_process_that_fails_is_told_with_its_last_words(tmp_path: Path) -> None:
    told = r"play ended with code 2 \(neuse_bags play: .*nowhere.mcap does not exist.*\); see .*play.log"
    with running_graph(tmp_path) as graph:
        graph.start("neuse_bags", "play", tmp_path / "nowhere.mcap")
        with pytest.raises(NeuseError, match=told):
            graph.wait("play")

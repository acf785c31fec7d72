"""The bench's table and figure, and that its runs measure what they say."""

import json

import pytest

from neuse.evaluation.bench import beside_paper, growth_figure, table
from neuse.evaluation.stage_times import WARM_UP, pipeline_run

ROW = {
    "median_ms": 1.5, "p95_ms": 1.9, "mean_ms": 30.0, "worst_ms": 100.0,
    "cpu_median_ms": 1.2, "cpu_mean_ms": 20.0, "cpu_worst_ms": 90.0,
}  # fmt: skip


@pytest.fixture
def figures():
    return {
        "stages": {name: dict(ROW) for name in ("encoder", "alignment", "window_alignment", "decoding")},
        "machine": {"cores": 2},
        "run": {
            "front_end_fps": 30.0,
            "system_fps": 20.0,
            "map_bytes_per_object": {"file": 50000.0, "object_alone": 9000.0},
            "peak_memory_mb": 700.0,
        },
        "graph": None,
        "growth": {"association": {"10": ROW, "10000": ROW}, "optimisation": {"10": ROW}},
    }


def test_table_tells_which_bars_are_kept(figures):
    lines = {line.split(" | ")[0].strip("| "): line for line in table(figures).splitlines()}
    assert "| 1.5 | 1.9 | 1.2 | <= 6 | yes | 6 |" in lines["encoder, an object (ms)"]
    assert "| no |" in lines["alignment of two views, 5 objects (ms)"]
    assert "| 20 | - | - | >= 25 | no |" in lines["whole pipeline (fps)"]


def test_what_was_not_reached_has_no_verdict(figures):
    line = next(line for line in table(figures).splitlines() if "10 000 keyframes" in line)
    assert "| - | - | - | <= 25 |  |" in line


def test_nodes_have_their_lines_once_they_were_measured(figures):
    assert "| - | - | - | >= 25 |  | 11 |" in table(figures)
    node = {"peak_memory_mb": 400.0, "cpu_ms_per_frame": 20.0}
    figures["graph"] = {
        "fps": 25.9,
        "frames_lost": 3,
        "objects_per_frame": 5.3,
        "latency_to_edge_ms": {"median_ms": 60.0, "p95_ms": 80.0},
        "processes": dict.fromkeys(("encoder_node", "slam_node", "mapper_node"), node),
    }
    lines = {line.split(" | ")[0].strip("| "): line for line in table(figures).splitlines()}
    assert "| 25.9 | - | - | >= 25 | yes | 11 |" in lines["nodes over DDS (fps), fed with 26"]
    assert "| 3 | - | - | 0 | no |" in lines["their frames lost"]
    assert "| 60 | 80 | - | <= 100 | yes |" in lines["depth stamp to edge (ms)"]
    assert "| 400 | - | 20 | - |  |" in lines["memory of slam_node, most (MB); processor, a frame (ms)"]


def test_figures_of_a_file_stand_beside_the_papers(figures, tmp_path):
    (tmp_path / "bench.json").write_text(json.dumps(figures))
    text = beside_paper(tmp_path / "bench.json")
    assert all(len(row) == len(text.columns) for row in text.rows)
    assert text.rows[0] == ("encoder, an object (ms)", "1.5", "1.9", "1.2", "<= 6", "yes", "6")


def test_growth_is_drawn_over_the_sizes(figures):
    association, optimisation = growth_figure(figures["growth"]).axes
    assert list(association.lines[0].get_xdata()) == [10, 10000]
    assert list(optimisation.lines[0].get_ydata()) == [30.0]


def test_run_of_the_pipeline_has_all_stages():
    run = pipeline_run("tabletop", WARM_UP + 3)
    assert len(run.system.wall_ms) == len(run.front_end_ms) == 3
    assert {"encode", "associate", "slam", "map"} <= set(run.stage_ms)
    assert run.objects_per_frame > 0
    assert run.map_bytes[0] > run.map_bytes[1] > 1000
    assert 0 < run.system_fps <= run.front_end_fps
    assert run.peak_memory_mb > 100

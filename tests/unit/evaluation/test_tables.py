"""The tables: intervals, cells and pages, from canned results."""

from collections import defaultdict

import pytest

from neuse.evaluation import tables
from neuse.evaluation.cells import wilson
from neuse.evaluation.comparison import OTHERS
from neuse.evaluation.table import Table, write_page
from neuse.evaluation.tables import TABLES
from neuse.evaluation.variants import VARIANTS, params_of

NEES = {"mean": 9.0, "median": 6.0, "inside_95": 0.9, "n": 10, "dof": 6}


class Canned:
    """Results that depend on the seed alone."""

    def over_seeds(self, variant, preset, seeds):
        assert variant in VARIANTS
        return [self.result(seed) for seed in range(seeds)]

    def of_nodes(self, preset):
        return self.result(2) if preset == "four-round" else None

    def others_over_seeds(self, name, preset, seeds):
        assert name in OTHERS
        return [defaultdict(lambda: 0.5, tp=2, fp=1, fn=3)] * seeds

    @staticmethod
    def result(seed):
        return {
            "frames": 101,
            "blind_pairs": 5,
            "ate_rmse_m": 0.01 * (seed + 1),
            "ate_rmse_m_per_traversal": [0.02, None],
            "rpe_trans_rmse_m": 0.005,
            "rpe_trans_per_m_rmse_m": None,
            "changes": {"tp": 4, "fp": 1, "fn": 0},
            "objects": {"true": 12, "mapped": 11, "duplicates": [7], "ghosts": []},
            "edges": {"loop_closure": 8, "odometry": 20},
            "wrong_closures": 1,
            "trust": {"poses": None, "short_range/mug": NEES},
        }


def row_of(table, name):
    return next(row for row in table.rows if row[0].startswith(name))


def test_wilson_intervals_stay_inside_zero_and_one():
    assert wilson(9, 9) == pytest.approx((0.7009, 1.0), abs=1e-4)
    assert wilson(0, 9) == pytest.approx((0.0, 0.2991), abs=1e-4)
    assert wilson(1, 2) == pytest.approx((0.0945, 0.9055), abs=1e-4)


def test_without_trials_nothing_is_known():
    assert wilson(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize("name", sorted(TABLES.keys() - {"speed"}))
def test_every_row_of_every_table_fills_its_columns(name):
    table = TABLES[name](Canned(), 3)
    assert table.rows
    assert {len(row) for row in table.rows} == {len(table.columns)}
    assert name in table.command or table.command == "make evaluate"


def test_speed_is_that_of_the_bench_beside_the_folder(tmp_path, monkeypatch):
    read = []
    text = Table("Speed", "", ("", "here"), (("encoder", "4"),), "make bench")
    monkeypatch.setattr(tables, "beside_paper", lambda path: read.append(path) or text)
    results = Canned()
    results.folder = tmp_path / "evaluate"
    assert TABLES["speed"](results, 3) is text
    assert read == [tmp_path / "bench" / "bench.json"]


def test_localisation_gives_medians_and_dashes():
    table = TABLES["localisation"](Canned(), 3)
    assert row_of(table, "synthetic-planar: ATE, full")[1:] == (*["0.020 (0.030)"] * 4, "0.116 / 0.065")
    assert row_of(table, "synthetic-nonplanar: ATE, full")[-1] == "0.091 / 0.053"
    assert row_of(table, "synthetic-planar: pairs with odometry")[1] == "20.0"
    assert row_of(table, "synthetic-planar: ATE, 2nd")[1] == "-"
    assert row_of(table, "synthetic-planar: blind")[1] == "5.0"


def test_changes_are_summed_over_seeds_and_worlds():
    table = TABLES["changes"](Canned(), 2)
    assert row_of(table, "four-round")[1] == "8 / 2 / 0"
    assert row_of(table, "four-round")[4] == "22 / 24, 2 twice, 0 ghosts"
    assert row_of(table, "all")[1] == "40 / 10 / 0"
    assert row_of(table, "all")[2].startswith("0.800 [")


def test_trust_is_per_degree_of_freedom_and_leaves_out_what_is_unknown():
    table = TABLES["trust"](Canned(), 2)
    assert row_of(table, "short_range/mug")[1:] == ("1.50", "1.00", "80")
    assert row_of(table, "poses")[1:] == ("-", "-", "0")
    assert "8 of 64" in row_of(table, "loop closures off")[0]
    assert "8 of 64" in row_of(table, "the same before the gates")[0]
    assert "4 of 32" in row_of(table, "the same in the graph of paper mode")[0]


def test_nodes_stand_beside_the_pipeline_where_they_were_run():
    table = TABLES["nodes"](Canned(), 5)
    assert row_of(table, "four-round")[1:5] == ("0.010", "0.030", "4 / 1 / 0", "4 / 1 / 0")
    assert row_of(table, "tabletop")[1:] == ("0.010", "-", "4 / 1 / 0", "-", "11 / 12", "-")


def test_ablations_have_a_row_without_smooth_motion():
    assert row_of(TABLES["ablations"](Canned(), 1), "without smooth motion")[1:] == ("0.010", "4 / 1 / 0") * 2


def test_variants_are_parameters_of_the_pipeline():
    for variant in VARIANTS:
        params_of(variant)
    assert params_of("paper-mugs").slam.mode == "edges"
    assert not params_of("full-mugs").slam.use_ambiguous
    assert params_of("full-no-smooth-motion").slam.solver.acceleration_mps2 == 0.0


def test_pages_hold_every_cell(tmp_path):
    table = Table("Title", "note", ("", "a<b"), (("row", "1"),), "command")
    write_page([table], tmp_path / "docs" / "results.md", tmp_path / "page.html")
    assert "| row | 1 |" in (tmp_path / "docs" / "results.md").read_text()
    page = (tmp_path / "page.html").read_text()
    assert "<td>row</td><td>1</td>" in page
    assert "a&lt;b" in page


def test_all_worlds_are_told_by_the_median_seed_and_the_worst():
    table = tables.worlds(Canned(), seeds=3)
    assert [row[0] for row in table.rows] == list(tables.PRESETS)
    assert table.rows[0][1:] == ("0.0200 (0.0300)", "0.0050 (0.0050)")

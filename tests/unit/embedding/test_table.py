import pytest

from neuse.embedding.figures import nees_by_bin
from neuse.embedding.table import NEES_GROUPS, ROWS, USUAL, Row, lookup, markdown_table, nees_table

from .test_figures import error

LEAST = Row("least", ("*", "a", "b"), 2.0)
MOST = Row("most", ("shape", "iou"), 0.9, at_least=True)
FIGURES = {
    USUAL: {"a": {"b": {"n": 7, "median": 1.5, "p90": 9.0}}},
    "noisy": {"a": {"b": {"n": 7, "median": 2.5, "p90": 9.0}}},
    "shape": {"iou": 0.95},
}


def cells(text):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()]


def test_table_has_bars_and_a_column_a_condition():
    head, _, least, most = cells(
        markdown_table({"1.5": (FIGURES, USUAL), "3": (FIGURES, "noisy")}, [LEAST, MOST])
    )
    assert head == ["", "bar", "1.5", "3"]
    assert least == ["least", "2", "**1.5** (9), n 7", "2.5 (9), n 7"]
    assert most == ["most", "0.9", "**0.95**", ""]  # of no condition


@pytest.mark.parametrize(("value", "cell"), [(0.89, "0.89"), (0.9, "**0.9**"), (float("nan"), "-")])
def test_figure_is_bold_where_it_reaches_the_bar(value, cell):
    figures = {"shape": {"iou": value}}
    assert cells(markdown_table({"x": (figures, USUAL)}, [MOST]))[2][2] == cell


def test_figure_that_is_not_there_is_a_dash():
    assert lookup({}, ("*", "a", "b"), USUAL) is None
    assert cells(markdown_table({"x": ({}, USUAL)}, [LEAST]))[2][2] == "-"


def test_rows_have_titles_of_their_own():
    assert len({row.title for row in ROWS}) == len(ROWS)


def test_nees_table_has_a_row_a_bin():
    bins = nees_by_bin([error(nees=6.0)])
    head, _, *rows = cells(nees_table({USUAL: {f"nees, {group}": bins for group in NEES_GROUPS}}))
    assert head[1:] == list(NEES_GROUPS)
    assert len(rows) == len(bins) == 8
    assert ["30-60 deg, visible", *["1.00, n 1"] * 3] in rows
    assert ["0-30 deg, occluded", "-", "-", "-"] in rows

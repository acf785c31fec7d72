import numpy as np

from neuse.slam.growing import GrowingArray


def test_rows_are_those_that_were_appended():
    array, rows = GrowingArray((2, 3)), np.random.default_rng(0).normal(size=(100, 2, 3))
    for row in rows[:60]:
        array.append(row)
    array.extend(rows[60:])
    array.extend(rows[:0])
    np.testing.assert_array_equal(array.rows, rows)
    assert len(array) == 100


def test_rows_can_be_changed():
    array = GrowingArray((), np.int64)
    array.extend(np.arange(5))
    array.rows[2] = 7
    assert array.rows.tolist() == [0, 1, 7, 3, 4]


def test_array_of_nothing_is_empty():
    assert GrowingArray((4, 4)).rows.shape == (0, 4, 4)

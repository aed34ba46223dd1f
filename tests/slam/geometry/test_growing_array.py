"""Array that grows row by row."""

import numpy as np

from slam.geometry.growing_array import GrowingArray


def test_array_holds_the_rows_that_were_appended() -> None:
    rows = np.random.default_rng(0).normal(size=(200, 2, 3))
    array = GrowingArray((2, 3))
    for k, row in enumerate(rows):
        assert len(array) == k
        array.append(row)
    np.testing.assert_array_equal(array.rows, rows)


def test_last_row_can_be_appended_again_while_the_array_grows() -> None:
    array = GrowingArray((3,), [[1.0, 2.0, 3.0]])
    for _ in range(300):
        array.append(array.rows[-1])
    np.testing.assert_array_equal(array.rows, np.tile([1.0, 2.0, 3.0], (301, 1)))


def test_replaced_rows_are_independent_of_the_given_ones() -> None:
    array, rows = GrowingArray((2,)), np.ones((5, 2))
    array.replace(rows)
    rows[:] = 0.0
    array.rows[2] = 7.0
    np.testing.assert_array_equal(array.rows, [[1, 1], [1, 1], [7, 7], [1, 1], [1, 1]])

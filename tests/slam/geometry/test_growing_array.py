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
    np.testing.assert_array_equal(array.rows, np.ones((5, 2)))


def test_rows_that_were_read_stay_as_they_were() -> None:
    array = GrowingArray((1,), [[1.0], [2.0], [3.0]])
    before, last = array.rows, array.rows[-1]
    array.append([4.0])
    array.replace_last([[5.0], [6.0]])
    np.testing.assert_array_equal(array.rows, [[1.0], [2.0], [5.0], [6.0]])
    array.replace(array.rows[::-1])
    np.testing.assert_array_equal(before, [[1.0], [2.0], [3.0]])
    np.testing.assert_array_equal(last, [3.0])

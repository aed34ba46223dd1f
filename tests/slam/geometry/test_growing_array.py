"""Array that grows row by row."""

import resource
import sys
from pathlib import Path

import numpy as np
import pytest

from slam.geometry.growing_array import GrowingArray

from ...traced_memory import traced_memory


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


@pytest.mark.parametrize("count", [0, 3, 64, 100])
def test_an_array_and_its_copy_are_independent(count: int) -> None:
    array = GrowingArray((1,), np.arange(count)[:, None])
    copy = array.copy()
    array.append([-1.0])
    for _ in range(100):
        copy.append([-2.0])
    array.append([-3.0])
    assert array.rows[:, 0].tolist() == [*range(count), -1.0, -3.0]
    assert copy.rows[:, 0].tolist() == [*range(count), *[-2.0] * 100]
    again = copy.copy()
    again.replace_last([[-4.0]])
    copy.replace_last([[-5.0]])
    assert (copy.rows[-1, 0], again.rows[-1, 0]) == (-5.0, -4.0)


def test_an_overwritten_row_is_the_old_one_in_copies() -> None:
    array = GrowingArray((), [1.0, 2.0])
    copy = array.copy()
    for value in (3.0, 4.0):
        array.overwrite_last(value)
    assert (array.rows.tolist(), copy.rows.tolist()) == ([1.0, 4.0], [1.0, 2.0])
    copy.overwrite_last(5.0)
    again = copy.copy()
    copy.append(6.0)
    copy.overwrite_last(7.0)
    assert (copy.rows.tolist(), again.rows.tolist()) == ([1.0, 5.0, 7.0], [1.0, 5.0])
    assert array.rows.tolist() == [1.0, 4.0]


def test_to_overwrite_the_last_row_again_takes_no_memory() -> None:
    """Some bases send readings with equal stamps for hours."""
    array = GrowingArray((3,), np.ones((100_000, 3)))
    copy = array.copy()
    array.overwrite_last(np.zeros(3))
    with traced_memory() as memory:
        array.overwrite_last(np.ones(3))
    assert memory.peak < 0.01 * copy.rows.nbytes


def test_a_copy_takes_no_memory_for_the_rows() -> None:
    """Each save of a live run copies them, which are more the longer the robot drives."""
    array = GrowingArray((9,), np.ones((100_000, 9)))
    with traced_memory() as memory:
        copy = array.copy()
    assert memory.peak < 0.01 * copy.rows.nbytes


@pytest.mark.skipif(sys.platform != "linux", reason="resident memory is read from /proc")
def test_memory_for_rows_to_come_is_not_used_yet() -> None:
    """Otherwise the memory of a long run would double at times."""

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    array = GrowingArray((9,), np.ones((1_000_000, 9)))
    before = resident()
    array.append(np.ones(9))
    array.replace_last([np.ones(9)])
    assert resident() - before < 0.1 * array.rows.nbytes

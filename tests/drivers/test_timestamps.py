"""Stamps on the clocks of different computers."""

from __future__ import annotations

import math

import pytest

from drivers.timestamps import follows


@pytest.mark.parametrize(
    ("stamp", "latest", "expected"),
    [(2.0, 1.0, True), (1.0, 2.0, False), (1.7e9, 60.0, False), (60.0, 1.7e9, False), (1.7e9 + 1.0, 1.7e9, True)],
)
def test_stamps_follow_earlier_ones_of_the_same_clock(stamp: float, latest: float, expected: bool) -> None:
    assert follows(stamp, latest) == expected
    assert follows(stamp, -math.inf)

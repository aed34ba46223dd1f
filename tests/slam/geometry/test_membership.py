"""Membership of numbers in others."""

from __future__ import annotations

import numpy as np
import pytest

from slam.geometry.membership import is_among


@pytest.mark.parametrize(("count", "others"), [(0, 0), (0, 5), (5, 0), (1, 1), (40, 7), (7, 40)])
def test_the_numbers_among_others_are_found(count: int, others: int) -> None:
    random = np.random.default_rng(count)
    one, other = random.integers(0, 50, count), random.integers(0, 60, others)
    found = is_among(one, other)
    assert found.dtype == bool
    np.testing.assert_array_equal(found, np.isin(one, other))

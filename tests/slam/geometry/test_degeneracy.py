"""Degenerate directions of an information matrix, also if rounding errors exceed what it says about them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slam.geometry.degeneracy import weakest_direction


@given(
    heading=st.floats(-3.0, 3.0),
    exponent=st.floats(2.0, 11.0),
    levers=st.lists(st.floats(-30.0, 30.0), min_size=2, max_size=30),
)
def test_parallel_walls_leave_their_direction_undetermined_however_exact_they_are(
    heading: float, exponent: float, levers: list[float]
) -> None:
    rows = np.array([[-math.sin(heading), math.cos(heading), lever] for lever in levers])
    rows = np.vstack([rows, [0.0, 0.0, 1.0]])  # a wall determines the heading as well
    direction = weakest_direction(np.zeros(3), 10.0**exponent * rows.T @ rows, 0.05)
    assert direction is not None
    assert (direction - heading + 1.0) % math.pi - 1.0 == pytest.approx(0.0, abs=1e-6)

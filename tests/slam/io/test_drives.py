"""A path that was driven in several drives is split where one ends: what leads to the next would cross walls."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slam.io.drives import split_drives
from slam.io.tum import Trajectory

STAMPS = np.array([-0.1, 1.0, 2.0, 2.9, 4.0, 9.0])
TRAJECTORY = Trajectory(STAMPS, np.column_stack([STAMPS, 0.0 * STAMPS, 0.0 * STAMPS]))


@pytest.mark.parametrize(
    ("recordings", "expected"),
    [
        ([], [6]),
        ([{"first": 0.0, "last": 9.0}], [6]),
        ([{"first": 0.0, "last": 2.0}, {"first": 3.0, "last": 9.0}], [3, 3]),
        ([{"first": 3.0, "last": 4.0}, {"first": 0.0, "last": 2.0}, {"first": 8.0, "last": 9.0}], [3, 2, 1]),
        ([{"first": 0.0, "last": 9.0}, {"first": 20.0, "last": 30.0}], [6]),
        ([{"first": 0.0, "last": 2.0}, {"first": "3", "last": 9.0}, {}], [6]),
    ],
)
def test_drives_are_those_of_the_recordings(recordings: list[dict[str, Any]], expected: list[int]) -> None:
    drives = split_drives(TRAJECTORY, recordings)
    assert [len(drive) for drive in drives] == expected
    assert np.array_equal(np.concatenate([drive.stamps for drive in drives]), STAMPS)

"""The path in the review log: pieces that were driven."""

from __future__ import annotations

import numpy as np

from slam.visualisation.rerun_log.path_layer import driven_pieces


def drive(start: float, step: float, count: int = 50) -> np.ndarray:
    """Return poses (count, 3) along x."""
    return np.column_stack([start + step * np.arange(count), np.zeros(count), np.zeros(count)])


def test_two_drives_are_not_connected() -> None:
    first, second = drive(0.0, 0.02), drive(-8.0, 0.02)
    pieces = driven_pieces(np.vstack([first, second]))
    assert [piece.tolist() for piece in pieces] == [first.tolist(), second.tolist()]


def test_a_sparse_recording_is_one_piece() -> None:
    assert len(driven_pieces(drive(0.0, 1.2))) == 1


def test_a_robot_that_stands_or_does_nothing_is_one_piece() -> None:
    for poses in (np.zeros((3, 3)), np.zeros((1, 3)), np.zeros((0, 3))):
        assert [piece.tolist() for piece in driven_pieces(poses)] == [poses.tolist()]

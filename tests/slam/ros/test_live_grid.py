"""The grid of a running map follows corrections of the map."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from slam.io.exports import Occupancy
from slam.io.exports.occupancy import FREE, OCCUPIED
from slam.ros.live_grid import LiveGrid

WALL = np.column_stack([np.full(41, 2.0), np.linspace(-1.0, 1.0, 41)])
PATIENCE = 60.0


class Published:
    """Receiver of grids."""

    def __init__(self) -> None:
        self.grids: list[tuple[float, Occupancy]] = []
        self.changed = threading.Condition()

    def __call__(self, stamp: float, occupancy: Occupancy) -> None:
        with self.changed:
            self.grids.append((stamp, occupancy))
            self.changed.notify_all()

    def wait(self, count: int) -> Occupancy:
        with self.changed:
            assert self.changed.wait_for(lambda: len(self.grids) >= count, PATIENCE)
            return self.grids[-1][1]


def test_keyframes_are_added_and_moved() -> None:
    published = Published()
    grid = LiveGrid(0.05, 0.01, np.inf, published)
    assert grid.current() is None
    grid.add(1.0, WALL, np.zeros((1, 2)), np.zeros(3))
    wall = published.wait(1).centres(OCCUPIED)
    assert wall[:, 0] == pytest.approx(2.0, abs=0.05)
    grid.move(np.array([[0.01, 0.0, 0.0]]))  # less than a cell: nothing is drawn again
    grid.move(np.array([[5.0, 0.0, 0.0]]))
    wall = published.wait(2).centres(OCCUPIED)
    assert wall[:, 0] == pytest.approx(7.0, abs=0.05)
    grid.add(2.0, WALL, np.zeros((1, 2)), np.array([0.0, 0.0, np.pi]))
    grid.close()
    stamp, last = published.grids[-1]
    assert stamp == 2.0
    assert set(np.round(last.centres(OCCUPIED)[:, 0])) == {-2.0, 7.0}
    current = grid.current()
    assert current is not None
    assert np.array_equal(current[1].cells, last.cells)


def test_long_beams_are_not_drawn() -> None:
    published = Published()
    grid = LiveGrid(0.05, 0.01, 2.1, published)
    grid.add(1.0, np.vstack([WALL, [[10.0, 0.0]]]), np.zeros((1, 2)), np.zeros(3))
    grid.close()
    cells = published.grids[-1][1].centres(FREE)
    assert cells[:, 0].max() < 2.1


def test_beams_begin_at_the_nearer_of_two_lidars() -> None:
    """The wall ahead of the front lidar hides nothing between it and the rear lidar."""
    published = Published()
    grid = LiveGrid(0.05, 0.01, np.inf, published)
    lidars = np.array([[1.0, 0.0], [-1.0, 0.0]])
    grid.add(1.0, np.vstack([WALL, -WALL]), lidars, np.zeros(3))
    grid.close()
    free = published.grids[-1][1].centres(FREE)
    assert np.abs(free[:, 0]).min() > 0.9
    assert {-1.0, 1.0} == set(np.sign(free[:, 0]))

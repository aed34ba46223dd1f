"""The grid of a running map follows corrections of the map."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from drivers import se2
from slam.io.exports import Occupancy, OccupancyGrid, PlacedScan, live_grid
from slam.io.exports.live_grid import LiveGrid
from slam.io.exports.occupancy import FREE, OCCUPIED

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


class SteppedGrid(LiveGrid):
    """Grid without a thread: the test calls `update`."""

    def _run(self) -> None:
        pass


def room_keyframes(count: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Return points (n, 2) of keyframes in the base's frame and their poses, along a drive through a large room."""
    random = np.random.default_rng(2)
    poses = np.column_stack([np.linspace(-8.0, 8.0, count), random.uniform(-1.0, 1.0, (count, 2))])
    walls = np.column_stack([random.uniform(-10.0, 10.0, 300), np.where(np.arange(300) % 2, -4.0, 4.0)])
    return [se2.transform(se2.inverse(pose), walls) for pose in poses], poses


def test_a_corrected_grid_is_that_of_the_corrected_map() -> None:
    published = Published()
    grid = SteppedGrid(0.05, 0.0, np.inf, published)
    points, poses = room_keyframes(40)
    for k, some in enumerate(points):
        grid.add(float(k), some, np.zeros((1, 2)), poses[k])
    assert grid.update(np.inf)
    poses[25:] = se2.compose(np.array([0.4, -0.3, 0.1]), poses[25:])
    grid.move(poses)
    assert grid.update(np.inf)
    fresh = OccupancyGrid(0.05)
    for some, pose in zip(points, poses, strict=True):
        stored = some.astype(np.float32).astype(np.float64)
        fresh.add(PlacedScan(0.0, pose[:2], se2.transform(pose, stored)))
    expected, corrected = fresh.occupancy(), published.grids[-1][1]
    assert np.array_equal(corrected.cells, expected.cells)
    assert corrected.origin == pytest.approx(expected.origin)


def test_only_what_has_moved_is_drawn_again_and_in_small_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[float] = []

    class CountingGrid(OccupancyGrid):
        def add(self, scan: PlacedScan) -> None:
            drawn.append(scan.stamp)
            super().add(scan)

    monkeypatch.setattr(live_grid, "OccupancyGrid", CountingGrid)
    published = Published()
    grid = SteppedGrid(0.05, 60.0, np.inf, published)
    points, poses = room_keyframes(20)
    for k, some in enumerate(points):
        grid.add(float(k), some, np.zeros((1, 2)), poses[k])
    assert grid.update(np.inf)
    drawn.clear()
    poses[17:, 0] += 0.5
    grid.move(poses)
    steps = 1
    while not grid.update(1e-9):
        steps += 1
        assert len(published.grids) == 1  # the next one is due in a minute
    assert steps > 1
    assert drawn == [19.0, 18.0, 17.0]
    assert len(published.grids) == 2

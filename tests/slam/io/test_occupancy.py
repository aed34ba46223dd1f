"""Occupancy grids, and their pictures as map_server reads them."""

from itertools import pairwise
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import drivers
from drivers.messages import GroundTruth
from slam.config import Config, LidarConfig
from slam.errors import MapError
from slam.io.exports import Occupancy, OccupancyGrid, PlacedScan, Thresholds, place_scans, write_pgm, write_pgm_yaml
from slam.io.exports.occupancy import FREE, OCCUPIED, TILE, UNKNOWN, trace_beams
from slam.io.tum import Trajectory

from ...traced_memory import traced_memory

ROOM = np.array([[-1.033, -0.527], [2.987, 0.964]])  # lowest and highest x, y: not symmetric, not on cell edges
ORIGIN = np.array([0.31, 0.17])
ANGLES = np.linspace(-np.pi, np.pi, 360, endpoint=False)
CIRCLE = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])


def room_scan(count: int = 3600, origin: np.ndarray = ORIGIN) -> PlacedScan:
    """Return a scan of the room whose beams end on its walls."""
    angles = np.linspace(-np.pi, np.pi, count, endpoint=False) + 1e-4
    direction = np.column_stack([np.cos(angles), np.sin(angles)])
    distance = np.where(direction > 0, ROOM[1] - origin, ROOM[0] - origin) / direction
    return PlacedScan(0.0, origin, origin + distance.min(axis=1)[:, None] * direction)


def occupancy(*scans: PlacedScan, resolution: float = 0.05) -> Occupancy:
    grid = OccupancyGrid(resolution)
    grid.add_all(scans)
    return grid.occupancy()


@pytest.mark.parametrize("resolution", [0.05, 0.02, 0.1])
def test_map_server_reads_walls_at_their_positions(tmp_path: Path, map_server: Any, resolution: float) -> None:
    drawn = occupancy(room_scan(), resolution=resolution)
    write_pgm(tmp_path / "map.pgm", drawn)
    write_pgm_yaml(tmp_path / "map.yaml", drawn, image="map.pgm")
    served = map_server(tmp_path / "map.yaml")
    for y in np.linspace(-0.4, 0.85, 15):
        assert served.at(ROOM[0, 0], y) == served.at(ROOM[1, 0], y) == 100
        assert all(served.at(x, y) == 0 for x in np.linspace(-0.8, 2.7, 30))
    for x in np.linspace(-0.8, 2.7, 30):
        assert served.at(x, ROOM[0, 1]) == served.at(x, ROOM[1, 1]) == 100


def test_cells_that_no_beam_reached_are_unknown_to_map_server(tmp_path: Path, map_server: Any) -> None:
    drawn = occupancy(PlacedScan(0.0, np.zeros(2), np.array([[2.0, 0.01], [0.01, 1.0]])))
    write_pgm(tmp_path / "map.pgm", drawn)
    write_pgm_yaml(tmp_path / "map.yaml", drawn, image="map.pgm")
    served = map_server(tmp_path / "map.yaml")
    assert (served.width, served.height) == (41, 21)
    assert served.at(2.0, 0.01) == 100
    assert served.at(0.01, 1.01) == 100
    assert served.at(1.0, 0.01) == 0
    assert served.at(1.5, 0.5) == -1


def test_state_of_a_cell_depends_on_the_share_of_beams_that_end_in_it() -> None:
    far, near = np.array([[1.02, 0.02]]), np.array([[0.52, 0.02]])
    for passed, state in ((1, OCCUPIED), (3, OCCUPIED), (5, UNKNOWN), (12, FREE)):
        scan = PlacedScan(0.0, np.array([0.02, 0.02]), np.concatenate([near, np.repeat(far, passed, axis=0)]))
        assert occupancy(scan).cells[0].tolist() == [FREE] * 10 + [state] + [FREE] * 9 + [OCCUPIED]
    strict = OccupancyGrid(0.05)
    strict.add(PlacedScan(0.0, np.array([0.02, 0.02]), np.concatenate([near, far])))
    assert strict.occupancy(Thresholds(occupied=0.6, free=0.55)).cells[0, 10] == FREE


coordinate = st.floats(0.0, 19.999)


@given(st.tuples(coordinate, coordinate), st.tuples(coordinate, coordinate))
def test_beam_is_counted_in_the_cells_that_it_crosses(start: tuple[float, float], end: tuple[float, float]) -> None:
    ended, passed = np.zeros((1, TILE, TILE), np.int32), np.zeros((1, TILE, TILE), np.int32)
    slots, low = np.zeros((1, 1), np.int32), np.zeros(2, dtype=np.int64)
    trace_beams(ended, passed, slots, low, np.array(start), np.array([end]), 1)
    ended, passed = ended[0], passed[0]
    (row, column), first = np.argwhere(ended)[0], np.floor(start).astype(int)
    assert ended.sum() == 1
    assert (column, row) == tuple(np.floor(end).astype(int))
    assert passed.sum() == abs(row - first[1]) + abs(column - first[0])
    assert passed.max() <= 1
    for y, x in np.argwhere(passed):  # the cell's centre is no farther from the beam than its corners
        direction = np.subtract(end, start)
        centre = np.array([x + 0.5, y + 0.5]) - start
        along = np.clip(centre @ direction / max(direction @ direction, 1e-12), 0, 1)
        assert np.linalg.norm(centre - along * direction) <= np.sqrt(0.5) + 1e-9


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=1, max_size=6), st.randoms())
@example([(8.999999999999998, 0.0)], Random(0))  # ends on the edge of two cells except for rounding
@example([(8.999999999999998, 0.0)], Random(1))
def test_grid_does_not_depend_on_the_order_of_scans(places: list[tuple[float, float]], random: object) -> None:
    scans = [room_scan(60, ORIGIN), *(PlacedScan(0.0, np.array(p), np.array(p) + np.eye(2)) for p in places)]
    shuffled = list(scans)
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    one, other = occupancy(*scans, resolution=0.3), occupancy(*shuffled, resolution=0.3)
    np.testing.assert_array_equal(one.cells, other.cells)
    np.testing.assert_array_equal(one.origin, other.origin)


def test_too_large_or_empty_grid_is_an_error() -> None:
    with pytest.raises(MapError, match=r"cells of 0\.0001 m make a grid of more than 400 million; make them larger"):
        OccupancyGrid(1e-4).add(room_scan(60))
    with pytest.raises(MapError, match=r"cells of 0\.005 m make a grid of more than 100 million; make them larger"):
        OccupancyGrid(0.005).add(PlacedScan(0.0, np.zeros(2), 28.0 * CIRCLE))
    for place in (1e20, np.inf, np.nan):
        with pytest.raises(MapError, match=r"a scan is too far from the origin of the map for cells of 0\.05 m"):
            OccupancyGrid(0.05).add(PlacedScan(0.0, np.full(2, place), place + CIRCLE))
    with pytest.raises(MapError, match="a resolution of 0 m is not possible"):
        OccupancyGrid(0.0)
    with pytest.raises(MapError, match="no beam of any scan hit anything"):
        OccupancyGrid(0.05).occupancy()


def test_memory_is_that_of_what_scans_have_seen(tmp_path: Path) -> None:
    """A drive around a square of 200 m, of which the middle is not seen."""
    corners = np.array([[0.0, 0.0], [200.0, 0.0], [200.0, 200.0], [0.0, 200.0], [0.0, 0.0]])
    places = np.concatenate([np.linspace(a, b, 40, endpoint=False) for a, b in pairwise(corners)])
    grid = OccupancyGrid(0.05)
    with traced_memory() as memory:
        for place in places:
            grid.add(PlacedScan(0.0, place, place + 4.0 * CIRCLE))
        drawn = grid.occupancy()
        write_pgm(tmp_path / "map.pgm", drawn)
    assert drawn.cells.size > 4000**2
    assert memory.peak < 5 * drawn.cells.size  # nine bytes for each cell of the square would be more
    assert (tmp_path / "map.pgm").stat().st_size > drawn.cells.size


@pytest.mark.parametrize("mount", ["0.1,0,0", "-0.2,0.15,2.5"])
def test_placed_scans_lie_on_the_walls_for_any_mount(mount: str) -> None:
    """On the true trajectory, de-skewed scans fit the world up to the noise of the ranges."""
    source = drivers.open(f"sim:room?duration=6&mount={mount}")
    messages = list(source)
    truth = [message for message in messages if isinstance(message, GroundTruth)]
    path = Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))
    scans = list(place_scans(messages, path, Config(lidar=LidarConfig(range_max=20.0))))
    assert 50 < len(scans) <= 60
    walls = np.array(source.world.segments)  # type: ignore[attr-defined]
    starts, ends = walls[:, :2], walls[:, 2:]
    points = np.concatenate([scan.points for scan in scans])[::20]
    along = ends - starts
    share = ((points[:, None] - starts) * along).sum(axis=2) / (along**2).sum(axis=1)
    nearest = starts + share.clip(0, 1)[..., None] * along
    distance = np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1)
    assert np.median(distance) < 0.01
    assert np.mean(distance < 0.04) > 0.97  # some beams end between two surfaces
    short = list(place_scans(messages, path, Config(lidar=LidarConfig(range_max=1.5))))
    reach = np.concatenate([np.linalg.norm(scan.points - scan.origin, axis=1) for scan in short])
    assert reach.max() < 1.55
    assert not list(place_scans(messages, Trajectory(path.stamps + 100, path.poses), Config()))


def test_removed_beams_leave_no_trace() -> None:
    random = np.random.default_rng(3)
    kept, removed = (PlacedScan(0.0, random.normal(size=2), random.normal(size=(90, 2)) * size) for size in (3.0, 9.0))
    one, other = OccupancyGrid(0.05), OccupancyGrid(0.05)
    one.add_all([kept, removed])
    assert one.occupancy().cells.size > 20_000
    one.remove(removed)
    other.add(kept)
    assert np.array_equal(one.occupancy().cells, other.occupancy().cells)
    assert one.occupancy().origin == pytest.approx(other.occupancy().origin)
    one.remove(kept)
    with pytest.raises(MapError, match="nothing to draw"):
        one.occupancy()

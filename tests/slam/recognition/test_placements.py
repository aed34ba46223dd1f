"""The submaps of a drive are placed together: what was moved beside one of them does not bend the drive."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import pytest

from drivers import se2
from slam.geometry.segments import Floats
from slam.mapping.mapper import Mapper
from slam.recognition import placements
from slam.recognition.map_index import index_map
from slam.recognition.placements import Placement, find_placements
from slam.recognition.scanned_map import CellPoints, DriveSubmap, ScannedDrive, ScannedMap, scan_map, scan_submap

DISTANCE = 10.0  # metres between the two rooms
MOVED = 0.4  # metres by which the second room is beside where the drive has it


def room(side: float) -> Floats:
    """Return the points, with normals, of the four walls of a room around the origin, `side` metres long."""
    along = np.arange(-0.5 * side, 0.5 * side, 0.05)
    walls = []
    for turn in 0.5 * np.pi * np.arange(4):
        wall = se2.transform(np.array([0.0, 0.0, turn]), np.column_stack([np.full(len(along), 0.5 * side), along]))
        walls.append(np.column_stack([wall, np.tile([-np.cos(turn), -np.sin(turn)], (len(wall), 1))]))
    points = np.concatenate(walls)
    return np.column_stack([points, np.zeros(len(points)), np.ones(len(points))])


def drive_and_map(sides: tuple[float, float]) -> tuple[ScannedDrive, ScannedMap]:
    """Return a drive with a submap in each of two rooms, and a map in which the second one is MOVED to the right."""
    rooms, index = [room(side) for side in sides], index_map(Mapper())
    old = scan_map(index, np.array([[0.0, 0.0, 0.0], [DISTANCE, 0.0, 0.0]]), rooms)
    submaps = []
    for k, pose in enumerate(np.array([[0.0, 0.0, 0.0], [DISTANCE, MOVED, 0.0]])):
        scan = scan_submap(range(k, k + 1), index.descriptor, np.zeros((1, 3)), [rooms[k]])
        submaps.append(DriveSubmap(scan, pose, CellPoints(scan.points, np.zeros(len(scan.points), dtype=np.int64))))
    relative, drift = np.array([DISTANCE, MOVED, 0.0]), np.diag([0.03, 0.03, 0.003]) ** 2
    back = se2.adjoint(relative) @ drift @ se2.adjoint(relative).T
    return ScannedDrive(submaps, 1, {(0, 1): (relative, drift), (1, 0): (se2.inverse(relative), back)}), old


Candidate: TypeAlias = tuple[int, se2.Pose]
FIRST: Candidate = (0, np.zeros(3))
SECOND: Candidate = (1, np.array([DISTANCE, 0.0, 0.0]))


def place(monkeypatch: pytest.MonkeyPatch, sides: tuple[float, float], *candidates: Candidate) -> list[Placement]:
    """Return the placements that candidates lead to, poses of one submap each."""
    monkeypatch.setattr(placements, "_candidates", lambda *_: iter(candidates))
    return find_placements(*drive_and_map(sides), None)


def test_a_submap_stays_where_the_drift_of_the_drive_allows_it_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """One room fits, and the other one is where the drive has it, although it would fit beside that."""
    for fitting, candidate in enumerate((FIRST, SECOND)):
        (placement,) = place(monkeypatch, (4.0, 4.0), candidate)
        np.testing.assert_allclose(placement.poses[fitting], candidate[1], atol=0.05)
        np.testing.assert_allclose(se2.between(*placement.poses), [DISTANCE, MOVED, 0.0], atol=0.05)
        assert placement.informations.any(axis=(1, 2)).tolist() == [fitting == 0, fitting == 1]


@pytest.mark.parametrize("candidates", [(FIRST, SECOND), (SECOND, FIRST)])
def test_of_placements_at_one_place_the_best_counts(
    candidates: tuple[Candidate, Candidate], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The drive is at one place, whichever of the rooms fits; the larger room has more points."""
    (placement,) = place(monkeypatch, (6.0, 3.0), *candidates)
    np.testing.assert_allclose(placement.poses, [[0.0, 0.0, 0.0], [DISTANCE, MOVED, 0.0]], atol=0.05)

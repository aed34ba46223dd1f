"""Points where people stood for a moment are left out of a place; walls, also seen at grazing angles, stay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from slam.geometry.segments import Floats
from slam.recognition.points_at_rest import THINNED_SPACING, points_at_rest


def scan_points(xy: Sequence[tuple[float, float]] | Floats, normal: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """Return points (p, 6) with one normal."""
    points = np.zeros((len(xy), 6))
    points[:, :2], points[:, 2:4], points[:, 5] = xy, normal, 1.0
    return points


def corridor(lidar_x: float) -> Floats:
    """Return the points of a scan in a corridor of 20 m, which sees most of both walls at grazing angles."""
    angles = np.radians(np.arange(3.0, 178.0))
    along = lidar_x + 1.0 / np.tan(angles)
    along = along[(along > 0.0) & (along < 20.0)]
    sides = [scan_points(np.column_stack([along, np.full(len(along), side)]), (0.0, -side)) for side in (1.0, -1.0)]
    end = np.linspace(-0.9, 0.9, 20)
    return np.concatenate([*sides, scan_points(np.column_stack([np.full(20, 20.0), end]), (-1.0, 0.0))])


def at_rest(positions: Sequence[tuple[float, float]], scans: Sequence[Floats]) -> Floats:
    return points_at_rest(np.repeat(positions, [len(scan) for scan in scans], axis=0), np.concatenate(scans))


def test_walls_seen_at_grazing_angles_stay() -> None:
    positions = [(x, 0.0) for x in np.arange(1.0, 19.0)]
    scans = [corridor(x) for x, _ in positions]
    every = np.concatenate(scans)
    squares = np.unique(np.floor(every[:, :2] / THINNED_SPACING), axis=0)
    assert len(at_rest(positions, scans)) == len(squares)


@pytest.mark.parametrize("normal", [(0.0, 0.0), (-1.0, 0.0)])
def test_a_person_who_walked_past_is_left_out(normal: tuple[float, float]) -> None:
    """Each scan sees a person elsewhere, and the wall behind where it was before."""
    wall = scan_points(np.column_stack([np.full(60, 6.0), np.linspace(-3.0, 3.0, 60)]), (-1.0, 0.0))
    people = [scan_points([(3.0, y), (3.0, y + 0.05)], normal) for y in (-1.0, 0.0, 1.0)]
    hidden = [np.abs(wall[:, 1] / 6.0 - y / 3.0) < 0.1 for y in (-1.0, 0.0, 1.0)]
    scans = [np.concatenate([wall[~h], person]) for h, person in zip(hidden, people, strict=True)]
    kept = at_rest([(0.0, 0.0)] * 3, scans)
    assert np.all(kept[:, 0] == 6.0)
    assert len(kept) > 55


def test_what_stands_still_stays_whatever_is_seen_behind_it() -> None:
    """A table leg, which half of the beams miss."""
    leg = scan_points([(3.02, 0.02)])
    behind = scan_points([(6.0, 0.05)], (-1.0, 0.0))
    kept = at_rest([(0.0, 0.0)] * 2, [leg, behind])
    assert kept[:, 0].tolist() == [3.02, 6.0]


def test_no_points_are_none() -> None:
    assert points_at_rest(np.zeros((0, 2)), np.zeros((0, 6))).shape == (0, 6)

"""A known map is searched in bounded memory, wherever its keyframes are, and without what moved in it."""

from __future__ import annotations

import numpy as np

from slam.geometry.segments import Floats
from slam.mapping.mapper import Mapper
from slam.matching.offset_tiles import MAX_DISTANCE
from slam.recognition.map_index import index_map
from slam.recognition.scanned_map import MAX_REACH, ScannedMap, scan_map

WALL = np.column_stack(
    [np.linspace(-3.0, 3.0, 61), np.full(61, 2.0), np.zeros(61), np.full(61, -1.0), np.zeros(61), np.ones(61)]
)
"""Points of a wall with normals, as a keyframe sees it."""


def scanned(positions: list[list[float]]) -> ScannedMap:
    """Return a map of keyframes at some positions, which all see a wall."""
    poses: Floats = np.column_stack([np.array(positions), np.zeros(len(positions))])
    return scan_map(index_map(Mapper()), poses, [WALL] * len(poses))


def test_a_keyframe_that_is_far_away_needs_no_memory_for_the_space_between() -> None:
    near = [[float(k), 0.0] for k in range(5)]
    usual, spoiled = scanned(near), scanned([*near, [50e3, -80e3]])
    half_width = MAX_REACH + MAX_DISTANCE
    assert np.abs(spoiled.field.centre - usual.field.centre).max() < half_width
    assert len(spoiled.field.seen) ** 2 < 1e8
    assert spoiled.cells < 1e7
    assert spoiled.seen_area == usual.seen_area


def test_all_of_a_large_building_is_searched() -> None:
    assert scanned([[0.0, 0.0], [1500.0, 0.0]]).seen_area == 2.0 * scanned([[0.0, 0.0]]).seen_area


def test_people_who_walk_past_are_no_part_of_the_place() -> None:
    """Each is in one scan only, where other scans see the wall behind."""
    angles = np.linspace(-1.0, 1.0, 200)
    wall = np.column_stack([np.full(200, 5.0), 5.0 * np.tan(angles)])
    poses = np.column_stack([np.zeros(6), 0.3 * np.arange(6), np.zeros(6)])
    scans = []
    for k, pose in enumerate(poses):
        points = wall - pose[:2]
        if k >= 2:
            points[60 + 10 * k : 70 + 10 * k] *= 0.5
        scans.append(np.column_stack([points, np.tile([-1.0, 0.0, 0.0, 1.0], (200, 1))]))
    found = scan_map(index_map(Mapper()), poses, scans).points.points
    assert np.unique(found[:, 0].round(3)).tolist() == [5.0]
    assert len(found) > 50

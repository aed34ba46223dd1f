"""A submap is found along a corridor by what stands in it, though its walls tell the direction only."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from drivers import se2
from slam.geometry.roughness import Roughness
from slam.geometry.segments import Floats
from slam.mapping.landmarks import Landmarks
from slam.recognition.grid_search import parallel_headings, search_grid
from slam.recognition.map_descriptor import MapDescriptor, describe_map
from slam.recognition.map_index import MapIndex
from slam.recognition.scanned_map import CellPoints, DriveSubmap, ScannedMap, scan_map, scan_submap
from slam.recognition.wall_pairs import build_pair_table

LENGTH, HALF_WIDTH, RANGE = 40.0, 1.2, 6.0
"""Metres: of the corridor, and how far scans see."""
BOXES = 3.0, 8.5, 11.0, 19.0, 21.5, 30.0, 36.5
"""Metres along the corridor of boxes at its left wall."""


def surface(start: Floats, end: Floats) -> Floats:
    """Return points (p, 6) on a surface that is seen from its left side."""
    along = end - start
    count = int(np.hypot(*along) / 0.05)
    points = start + np.linspace(0.0, 1.0, count)[:, None] * along
    normal = np.array([-along[1], along[0]]) / np.hypot(*along)
    return np.column_stack([points, np.tile(normal, (count, 1)), np.zeros(count), np.ones(count)])


def corridor() -> Floats:
    """Return points (p, 6) with normals on both walls of a corridor along the x axis, and on the boxes in it."""
    corners = [[(0.0, -HALF_WIDTH), (LENGTH, -HALF_WIDTH)], [(LENGTH, HALF_WIDTH), (0.0, HALF_WIDTH)]]
    for x in BOXES:
        front = HALF_WIDTH - 0.4
        outline = (x, HALF_WIDTH), (x, front), (x + 0.5, front), (x + 0.5, HALF_WIDTH)
        corners += [list(pair) for pair in itertools.pairwise(outline)]
    return np.concatenate([surface(*np.array(pair)) for pair in corners])


def seen_from(pose: se2.Pose) -> Floats:
    """Return the points within RANGE of a pose, in its frame."""
    points = corridor()
    points = points[np.hypot(*(points[:, :2] - pose[:2]).T) < RANGE]
    back = se2.inverse(pose)
    points[:, :2] = se2.transform(back, points[:, :2])
    points[:, 2:4] = se2.transform(np.array([0.0, 0.0, back[2]]), points[:, 2:4])
    return points


def walls(pose: se2.Pose, *directions: float) -> MapDescriptor:
    """Return the walls of the corridor, or those with some directions (radians), in the frame of a pose."""
    frame = np.array([[20.0, -HALF_WIDTH, direction] for direction in directions or (0.0, math.pi)])
    frame[1:2, 1] = HALF_WIDTH
    count = len(frame)
    half, covariance = np.full(count, 0.5 * LENGTH), np.tile(1e-4 * np.eye(2), (count, 1, 1))
    relative = se2.between(pose, frame).reshape(-1, 3)
    return MapDescriptor(np.arange(count), relative, half, covariance, np.zeros((0, 2)), np.zeros(0, dtype=np.int64))


@pytest.fixture(scope="module")
def known() -> ScannedMap:
    poses = np.array([[x, 0.0, 0.0] for x in np.arange(1.0, LENGTH, 1.0)])
    descriptor = walls(np.zeros(3))
    return scan_map(MapIndex(descriptor, build_pair_table(descriptor)), poses, [seen_from(pose) for pose in poses])


def submap_at(pose: se2.Pose) -> DriveSubmap:
    scan = scan_submap(range(1), walls(pose), np.zeros((1, 3)), [seen_from(pose)])
    return DriveSubmap(scan, np.zeros(3), CellPoints(scan.points, np.zeros(len(scan.points), dtype=np.int64)))


@pytest.mark.parametrize("true", [(9.3, 0.2, 0.4), (20.4, -0.3, 2.9), (31.1, 0.1, -1.6)])
def test_the_pose_that_fits_best_is_the_true_one(true: tuple[float, float, float], known: ScannedMap) -> None:
    found = search_grid(submap_at(np.array(true)), known, 8)
    error = se2.between(np.array(true), found[0])
    assert np.hypot(*error[:2]) < 0.25
    assert abs(error[2]) < np.radians(3.0)
    assert len(found) <= 8


def test_headings_are_those_at_which_walls_are_parallel_as_seen_from_their_side() -> None:
    submap, both = walls(np.array([5.0, 0.0, 0.5])), walls(np.zeros(3))
    np.testing.assert_allclose(np.sort(parallel_headings(submap, both)), [0.5 - math.pi, 0.5], atol=1e-9)
    one_side = walls(np.array([5.0, 0.0, 0.5]), 0.0), walls(np.zeros(3), 0.0)
    np.testing.assert_allclose(parallel_headings(*one_side), [0.5], atol=1e-9)


def test_a_submap_without_walls_has_no_headings(known: ScannedMap) -> None:
    nothing = describe_map(Landmarks(), Roughness(0.0, 0.0))
    assert not len(parallel_headings(nothing, known.index.descriptor))

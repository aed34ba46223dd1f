"""Local field: it holds the keyframes near along the drive, and those linked to them."""

from __future__ import annotations

import numpy as np

from slam.geometry.segments import CornerPoints, Floats, Segments
from slam.localisation.local_field import (
    MAX_CENTRE_DISTANCE,
    MAX_DISPLACEMENT,
    MAX_PATH,
    REFERENCE_DISTANCE,
    LocalField,
)
from slam.matching.distance_field import ALL_POINTS
from slam.matching.line_matcher import ScanFeatures
from slam.matching.offset_tiles import FIELD_CELL, NOWHERE
from slam.matching.scan_points import ScanPoints

from ..outlines import offsets_of

STEP = 0.5  # metres between keyframes
POINTS = np.array([[0.5, 1.0], [0.7, 1.0]])
NOTHING = Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))
NO_CORNERS = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int), np.zeros((0, 2)))
SCAN = ScanFeatures(NOTHING, NO_CORNERS, ScanPoints(POINTS))


def straight_drive(count: int) -> Floats:
    """Return the poses (count, 3) of keyframes along a line."""
    return np.column_stack([STEP * np.arange(count), np.zeros((count, 2))])


def drive(field: LocalField, poses: Floats) -> None:
    """Add a keyframe at each pose, with an update after each."""
    for keyframe in range(len(poses)):
        field.add(SCAN)
        field.update(keyframe, poses, (STEP * np.arange(len(poses))).tolist())


def test_field_holds_the_keyframes_of_the_last_metres_and_the_new_ones() -> None:
    poses, field = straight_drive(120), LocalField()
    drive(field, poses)
    inserted = list(field.inserted)
    assert inserted == list(range(inserted[0], 120))
    driven = STEP * (119 - inserted[0])
    assert MAX_PATH - STEP <= driven <= MAX_PATH + MAX_CENTRE_DISTANCE + STEP
    assert field.field.centre_distance(poses[-1]) <= MAX_CENTRE_DISTANCE + STEP


def test_points_of_new_keyframes_enter_at_their_poses() -> None:
    poses, field = straight_drive(10), LocalField()
    drive(field, poses)
    known = offsets_of(field.field)[ALL_POINTS, ..., 0] != NOWHERE
    assert known.any(axis=1).sum() * FIELD_CELL > 9 * STEP
    np.testing.assert_allclose(field.points(3)[:, :2], POINTS, atol=1e-6)


def test_old_keyframes_enter_by_a_link() -> None:
    poses, field = straight_drive(120), LocalField()
    drive(field, poses)
    assert 10 not in field.inserted
    field.link(10, 118)
    field.update(119, poses, (STEP * np.arange(120)).tolist())
    assert {0, 10, 40, 119} <= set(field.inserted)
    assert 60 not in field.inserted


def test_links_of_a_pass_with_earlier_keyframes_can_be_removed() -> None:
    poses, field = straight_drive(120), LocalField()
    drive(field, poses)
    for one, other in ((10, 118), (105, 117), (10, 60)):
        field.link(one, other)
    field.unlink(range(100, 120))
    assert field.state.links == ((105, 117), (10, 60))
    field.update(119, poses, (STEP * np.arange(120)).tolist())
    assert 10 not in field.inserted
    assert 119 in field.inserted


def test_a_field_that_contradicts_the_last_metres_parts_from_earlier_passes() -> None:
    poses, field = straight_drive(120), LocalField()
    travelled = (STEP * np.arange(120)).tolist()
    drive(field, poses)
    for one, other in ((10, 110), (105, 117), (10, 60)):
        field.link(one, other)
    field.unlink_earlier_passes(travelled)
    assert field.state.links == ((105, 117), (10, 60))
    field.update(119, poses, travelled)
    assert 10 not in field.inserted
    recent = field.recent(poses, travelled)
    known = offsets_of(recent)[ALL_POINTS, ..., 0] != NOWHERE
    columns = recent.origin[0] + FIELD_CELL * np.flatnonzero(known.any(axis=1))
    assert poses[-1, 0] - REFERENCE_DISTANCE < columns.max()
    assert columns.min() > poses[-1, 0] - REFERENCE_DISTANCE - 2 * STEP


def test_field_is_built_anew_if_poses_have_changed() -> None:
    poses, field = straight_drive(10), LocalField()
    drive(field, poses)
    before, travelled = field.field, (STEP * np.arange(10)).tolist()
    field.update(9, poses + np.array([0.0, 0.5 * MAX_DISPLACEMENT, 0.0]), travelled)
    assert field.field is before
    field.update(9, poses + np.array([0.0, 2.0 * MAX_DISPLACEMENT, 0.0]), travelled)
    assert field.field is not before
    assert list(field.inserted) == list(range(10))


def test_restored_field_continues_as_the_saved_one() -> None:
    poses, field = straight_drive(30), LocalField()
    drive(field, poses)
    field.link(2, 28)
    restored = LocalField()
    for _ in range(30):
        restored.add(SCAN)
    restored.restore(field.state)
    np.testing.assert_array_equal(offsets_of(restored.field), offsets_of(field.field))
    assert restored.state.links == ((2, 28),)
    assert list(restored.inserted) == list(field.inserted)

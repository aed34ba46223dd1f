"""Local field: it holds the keyframes near along the drive, and those linked to them."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from slam.geometry.segments import CornerPoints, Floats, Segments
from slam.localisation.field_successor import KEYFRAMES_PER_STEP
from slam.localisation.local_field import (
    FAR_FROM_CENTRE,
    MAX_CENTRE_DISTANCE,
    MAX_DISPLACEMENT,
    MAX_PATH,
    REFERENCE_DISTANCE,
    LocalField,
    LocalFieldState,
)
from slam.matching.distance_field import ALL_POINTS
from slam.matching.offset_tiles import FIELD_CELL, NOWHERE
from slam.matching.scan_features import ScanFeatures
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


def restored_from(state: LocalFieldState, count: int) -> LocalField:
    """Return the field of a saved state, with the points of `count` keyframes."""
    field = LocalField()
    for _ in range(count):
        field.add(SCAN)
    field.restore(state)
    return field


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


def test_field_of_the_last_metres_follows_the_drive_and_corrections() -> None:
    """Also if the memory of the one before is used again."""
    poses, field, other, travelled = straight_drive(60), LocalField(), LocalField(), (STEP * np.arange(60)).tolist()
    drive(field, poses[:50])
    before = field.recent(poses[:50], travelled[:50])
    assert field.recent(poses[:50], travelled[:50]) is before
    for _ in range(10):
        field.add(SCAN)
    drive(other, poses)
    for drift in (0.0, 0.3):
        corrected = poses + np.array([0.0, drift, 0.0])
        recent, expected = field.recent(corrected, travelled), other.recent(corrected, travelled)
        assert np.array_equal(recent.origin, expected.origin)
        assert np.array_equal(offsets_of(recent), offsets_of(expected))
        assert np.array_equal(recent.seen, expected.seen)


def test_field_is_built_anew_if_poses_have_changed() -> None:
    poses, field = straight_drive(10), LocalField()
    drive(field, poses)
    before, travelled = field.field, (STEP * np.arange(10)).tolist()
    field.update(9, poses + np.array([0.0, 0.5 * MAX_DISPLACEMENT, 0.0]), travelled)
    assert field.field is before
    field.update(9, poses + np.array([0.0, 2.0 * MAX_DISPLACEMENT, 0.0]), travelled)
    assert field.field is not before
    assert list(field.inserted) == list(range(10))


def slow_drive(step: float, until: float) -> tuple[Floats, list[float], LocalField]:
    """Drive along a line with a keyframe every `step` metres; return their poses, the metres driven, and the field."""
    poses = np.zeros((round(until / step), 3))
    poses[:, 0] = step * np.arange(len(poses))
    travelled, field = poses[:, 0].tolist(), LocalField()
    for keyframe in range(len(poses)):
        field.add(SCAN)
        field.update(keyframe, poses[: keyframe + 1], travelled[: keyframe + 1])
    return poses, travelled, field


def test_field_around_the_robot_is_built_in_steps_and_is_the_same_as_one_built_at_once() -> None:
    step = 0.03
    poses, travelled, field = slow_drive(step, MAX_CENTRE_DISTANCE + 2 * step)
    before, last = field.field, len(poses) - 1
    near, steps = len(field.inserted), 0
    assert field.state.successor is not None
    while field.state.successor is not None:  # a robot that stands
        inserted = len(field.state.successor.poses)
        field.update(last, poses, travelled)
        steps += 1
        successor = field.state.successor
        assert (near if successor is None else len(successor.poses)) - inserted <= KEYFRAMES_PER_STEP
        assert (field.field is before) == (successor is not None)
    assert 1 <= steps <= near / KEYFRAMES_PER_STEP
    assert field.field.centre_distance(poses[-1]) < MAX_CENTRE_DISTANCE / 2
    assert sorted(field.inserted) == list(range(len(poses)))
    at_once = restored_from(field.state, len(poses))
    np.testing.assert_array_equal(offsets_of(at_once.field), offsets_of(field.field))


def test_restored_field_continues_to_build_its_successor() -> None:
    poses, travelled, field = slow_drive(0.03, MAX_CENTRE_DISTANCE + 0.1)
    restored = restored_from(field.state, len(poses))
    assert field.state.successor is not None
    for _ in range(KEYFRAMES_PER_STEP):
        for one in (field, restored):
            one.update(len(poses) - 1, poses, travelled)
        assert (restored.state.successor is None) == (field.state.successor is None)
        np.testing.assert_array_equal(restored.inserted, field.inserted)
    assert field.state.successor is None
    np.testing.assert_array_equal(offsets_of(restored.field), offsets_of(field.field))


def test_field_is_built_at_once_if_the_robot_is_far_from_its_middle() -> None:
    poses, travelled, field = slow_drive(0.03, MAX_CENTRE_DISTANCE + 0.1)
    poses = np.vstack([poses, [FAR_FROM_CENTRE + 1.0, 0.0, 0.0]])
    field.add(SCAN)
    field.update(len(poses) - 1, poses, [*travelled, float(poses[-1, 0])])
    assert field.state.successor is None
    assert field.field.centre_distance(poses[-1]) < 1.0
    assert len(poses) - 1 in field.inserted


def test_restored_field_continues_as_the_saved_one() -> None:
    poses, field = straight_drive(30), LocalField()
    drive(field, poses)
    field.link(2, 28)
    restored = restored_from(field.state, 30)
    np.testing.assert_array_equal(offsets_of(restored.field), offsets_of(field.field))
    assert restored.state.links == ((2, 28),)
    assert list(restored.inserted) == list(field.inserted)


@pytest.mark.parametrize("displacement", [pytest.param(0.0, marks=pytest.mark.slow), 2.0 * MAX_DISPLACEMENT])
@pytest.mark.parametrize("changed", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_copy_and_original_do_not_change_each_other(changed: int, displacement: float) -> None:
    """Either is changed: it gets a keyframe, with which it is also built anew if the other poses have changed."""
    poses, travelled, field = slow_drive(0.03, MAX_CENTRE_DISTANCE + 0.1)
    other = copy.deepcopy(field)
    assert other.field is field.field  # takes no memory before a change
    kept, continued = (field, other)[1 - changed], (field, other)[changed]
    before, offsets = kept.state, offsets_of(kept.field).copy()
    continued.add(SCAN)
    moved = poses + np.array([0.0, displacement, 0.0])
    poses = np.vstack([moved, [0.0, 2.0, 0.0]])
    continued.update(len(poses) - 1, poses, [*travelled, travelled[-1] + 3.0])
    np.testing.assert_array_equal(offsets_of(kept.field), offsets)
    np.testing.assert_array_equal(kept.inserted, before.inserted)
    assert before.successor is not None
    assert kept.state.successor is not None
    np.testing.assert_array_equal(kept.state.successor.poses, before.successor.poses)
    at_once = restored_from(continued.state, len(poses))
    np.testing.assert_array_equal(offsets_of(continued.field), offsets_of(at_once.field))


def test_field_whose_memory_was_freed_continues_as_before() -> None:
    poses, travelled, field = slow_drive(0.03, MAX_CENTRE_DISTANCE + 0.1)
    freed = copy.deepcopy(field)
    freed.free()
    assert freed.field.seen.size == 0
    for one in (field, freed):
        one.link(1, len(poses) - 1)
    assert freed.state.links == field.state.links
    assert freed.state.successor is not None
    freed.rebuild()
    for one in (field, freed):
        one.update(len(poses) - 1, poses, travelled)
    np.testing.assert_array_equal(offsets_of(freed.field), offsets_of(field.field))
    np.testing.assert_array_equal(freed.inserted, field.inserted)
    assert (freed.state.successor is None) == (field.state.successor is None)


def test_references_are_keyframes_nearby_from_the_oldest_to_the_latest_one() -> None:
    poses, field = straight_drive(30), LocalField()
    drive(field, poses)
    references = field.references(poses[-1])
    oldest, *later, latest = (keyframe for keyframe, _ in references)
    assert latest == 29
    assert STEP * (latest - oldest) == REFERENCE_DISTANCE - STEP
    assert later == sorted(later)
    assert abs(later[0] - (oldest + latest) / 2) <= 1
    assert len(references) < 3 + np.log2(REFERENCE_DISTANCE / STEP)
    np.testing.assert_array_equal([pose for _, pose in references], poses[[keyframe for keyframe, _ in references]])
    ((alone, _),) = field.references(poses[-1] + [REFERENCE_DISTANCE - 0.5 * STEP, 0.0, 0.0])
    assert alone == latest
    assert not field.references(poses[-1] + [REFERENCE_DISTANCE, 0.0, 0.0])

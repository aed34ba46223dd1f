"""The checks of a finished run: silent if it is right, and close in time to each error that is put into it."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from drivers import se2
from drivers.elapsed import parse_elapsed
from slam.checks import Suspect
from slam.checks.displaced_scans import map_gain, refit_scans
from slam.checks.drive import Drive
from slam.checks.report import find_suspects
from slam.checks.suspect import MAP, ODOMETRY, PLACEMENT

from .drives import carried, moved_from, only, row_at, simulated_drive

SECONDS = 3.0  # from the injected error to the suspect


def of(check: str, suspects: list[Suspect]) -> list[Suspect]:
    return [suspect for suspect in suspects if suspect.check == check]


def with_path(drive: Drive, poses: np.ndarray) -> Drive:
    return replace(drive, poses=poses)


@pytest.mark.parametrize(
    "world", ["corridor", *(pytest.param(world, marks=pytest.mark.slow) for world in ("office", "moved_furniture"))]
)
def test_a_right_path_has_no_suspects(world: str) -> None:
    assert find_suspects(simulated_drive(world)) == []


def test_a_path_as_blurred_as_a_usable_map_has_no_suspects() -> None:
    drive = simulated_drive("office")
    noise = np.random.default_rng(1).normal(0.0, [0.02, 0.02, 0.005], (len(drive), 3))
    assert find_suspects(with_path(drive, drive.poses + noise)) == []


@pytest.mark.parametrize("degrees", [-60.0, 20.0, 80.0])
def test_a_wrong_turn_is_found_where_it_is(degrees: float) -> None:
    drive = simulated_drive("office")
    turned = moved_from(drive.poses, row_at(drive, 40.0), np.array([0.0, 0.0, np.radians(degrees)]))
    found = of(PLACEMENT, find_suspects(with_path(drive, turned)))
    assert abs(found[0].stamp - 40.0) < SECONDS
    stated = re.search(r"(\d+) degrees", found[0].text)
    assert stated is not None
    assert float(stated[1]) == pytest.approx(abs(degrees), abs=3.0)


def test_a_wrong_pose_behind_a_hole_in_the_scans_is_found() -> None:
    """In the hole the robot drives farther than scans can be compared: odometry alone contradicts the pose."""
    drive = simulated_drive("office")
    kept = (drive.stamps < 30.0) | (drive.stamps > 46.0)
    with_hole = only(drive, np.flatnonzero(kept))
    behind = row_at(with_hole, 46.0)
    assert find_suspects(with_hole) == []
    moved = moved_from(with_hole.poses, behind, np.array([-8.0, 0.0, 0.0]))
    found = of(PLACEMENT, find_suspects(with_path(with_hole, moved)))
    assert [one.stamp for one in found if "no scan shows anything" in one.text] == [with_hole.stamps[behind]]
    assert "departs from odometry" in found[0].text
    predicted = of(PLACEMENT, find_suspects(with_path(replace(with_hole, has_odometry=False), moved)))
    assert "departs from the motion at constant velocity" in predicted[0].text
    assert not re.search("odometry|wheels", predicted[0].text)


def with_dropped_scans(drive: Drive, first: float, last: float) -> Drive:
    """Return the drive as if the robot had been in a familiar place from `first` to `last`, seconds."""
    dropped = (drive.stamps > first) & (drive.stamps < last)
    points = [points[:0] if is_dropped else points for points, is_dropped in zip(drive.points, dropped, strict=True)]
    return replace(drive, points=points, dropped=dropped)


@pytest.mark.parametrize("motion", [[0.0, -8.0, 0.0], [-8.0, 0.0, 0.0]])
def test_odometry_is_not_compared_over_a_stretch_whose_scans_were_dropped(motion: list[float]) -> None:
    """The scans matched the map while driving, so the path is known better than by odometry."""
    drive = with_dropped_scans(simulated_drive("office"), 30.0, 46.0)
    drifted = replace(drive, odometry=moved_from(drive.odometry, row_at(drive, 38.0), np.array(motion)))
    assert find_suspects(drifted) == []
    (found,) = find_suspects(replace(drifted, dropped=np.zeros(len(drive), dtype=bool)))
    assert abs(found.stamp - 46.0) < SECONDS


def test_a_slip_beside_a_stretch_whose_scans_were_dropped_is_found() -> None:
    drive = with_dropped_scans(simulated_drive("office"), 30.0, 46.0)
    slipped = moved_from(drive.odometry, row_at(drive, 48.0), np.array([3.0, 0.0, 0.0]))
    (found,) = find_suspects(replace(drive, odometry=slipped))
    assert (found.check, abs(found.stamp - 48.0) < SECONDS) == (ODOMETRY, True)


def test_a_turn_in_a_row_of_wrong_steps_makes_one_suspect() -> None:
    drive = simulated_drive("office")
    poses = drive.poses
    for stamp in (40.0, 41.0, 42.0):
        poses = moved_from(poses, row_at(drive, stamp), np.array([0.0, 0.0, np.radians(20.0)]))
    (found,) = of(PLACEMENT, find_suspects(with_path(drive, poses)))
    assert found.first > 40.0 - SECONDS
    assert found.last < 42.0 + SECONDS


def without_readings(drive: Drive, first: float, last: float) -> Drive:
    """Return the drive as if odometry had no reading between two times, and were interpolated over the gap."""
    gap = np.arange(row_at(drive, first), row_at(drive, last) + 1)
    begin, end = drive.odometry[gap[0]], drive.odometry[gap[-1]]
    shares = (drive.stamps[gap] - drive.stamps[gap[0]]) / (drive.stamps[gap[-1]] - drive.stamps[gap[0]])
    odometry = drive.odometry.copy()
    odometry[gap] = se2.compose(begin, shares[:, None] * se2.between(begin, end))
    return replace(drive, odometry=odometry, readings=np.delete(drive.stamps, gap[1:-1]))


def test_an_uneven_motion_without_odometry_readings_is_no_wrong_odometry() -> None:
    gap = without_readings(simulated_drive("office"), 26.0, 30.0)
    assert of(ODOMETRY, find_suspects(replace(gap, readings=gap.stamps)))
    assert not of(ODOMETRY, find_suspects(gap))


def test_odometry_that_ends_before_the_drive_is_not_wrong() -> None:
    drive = simulated_drive("office")
    last = row_at(drive, 30.0)
    odometry = np.concatenate([drive.odometry[:last], np.repeat(drive.odometry[last : last + 1], len(drive) - last, 0)])
    ending = replace(drive, odometry=odometry, readings=drive.stamps[: last + 1])
    assert of(ODOMETRY, find_suspects(replace(ending, readings=drive.stamps)))
    assert not of(ODOMETRY, find_suspects(ending))


def test_odometry_that_begins_after_the_drive_is_not_wrong() -> None:
    drive = simulated_drive("office")
    first = row_at(drive, 30.0)
    odometry = np.concatenate([np.repeat(drive.odometry[first : first + 1], first, 0), drive.odometry[first:]])
    beginning = replace(drive, odometry=odometry, readings=drive.stamps[first:])
    assert of(ODOMETRY, find_suspects(replace(beginning, readings=drive.stamps)))
    assert not of(ODOMETRY, find_suspects(beginning))


def slipping(drive: Drive, stamp: float, metres: float) -> np.ndarray:
    """Return odometry whose wheels turn for some metres too much, over two seconds."""
    odometry = drive.odometry
    for part in range(8):
        odometry = moved_from(odometry, row_at(drive, stamp + 0.25 * part), np.array([metres / 8, 0.0, 0.0]))
    return odometry


def test_slipping_wheels_in_a_corridor_are_found() -> None:
    drive = simulated_drive("corridor")
    found = find_suspects(replace(drive, odometry=slipping(drive, 30.0, 2.0)))
    assert [suspect.check for suspect in found] == [ODOMETRY]
    assert abs(found[0].stamp - 31.0) < SECONDS
    assert "slipped" in found[0].text
    assert "direction" not in found[0].text


def test_wheels_that_turned_backwards_are_named() -> None:
    drive = simulated_drive("corridor")
    (found, *_) = find_suspects(replace(drive, odometry=slipping(drive, 30.0, -4.0)))
    assert found.check == ODOMETRY
    stated = re.search(r"in a direction that differs by (\d+) degrees", found.text)
    assert stated is not None
    assert float(stated[1]) > 150.0


def test_a_path_that_follows_slipping_wheels_in_a_corridor_is_found_on_the_way_back() -> None:
    """The few doors in view during the slip are not enough, but the same doors at two places are."""
    drive = simulated_drive("corridor")
    slipped = slipping(drive, 30.0, 2.0)
    error = se2.between(se2.between(drive.odometry[0], drive.odometry), se2.between(slipped[0], slipped))
    followed = replace(drive, odometry=slipped, poses=se2.compose(drive.poses, error))
    found = find_suspects(followed)
    assert {suspect.check for suspect in found} == {MAP}
    seen_through = [suspect for suspect in found if "saw through" in suspect.text]
    earlier = [re.search(r"around (\d+:\d\d) saw", suspect.text) for suspect in seen_through]
    assert earlier
    assert all(match is not None and parse_elapsed(match[1]) < 31.0 for match in earlier)
    assert all(suspect.first > 31.0 for suspect in seen_through)


def test_frozen_odometry_is_found() -> None:
    drive = simulated_drive("office")
    frozen, begin, end = drive.odometry.copy(), row_at(drive, 40.0), row_at(drive, 50.0)
    frozen[begin:end] = frozen[begin]
    frozen[end:] = se2.compose(frozen[begin], se2.between(frozen[end], frozen[end:]))
    (found,) = find_suspects(replace(drive, odometry=frozen))
    assert found.check == ODOMETRY
    assert found.first > 40.0 - SECONDS
    assert found.last < 50.0 + SECONDS


def test_steps_are_not_compared_with_odometry_that_is_known_to_fail() -> None:
    drive = simulated_drive("corridor")
    frozen, begin, end = drive.odometry.copy(), row_at(drive, 40.0), row_at(drive, 44.0)
    frozen[begin:end] = frozen[begin]
    frozen[end:] = se2.compose(frozen[begin], se2.between(frozen[end], frozen[end:]))
    measured = np.ones(len(drive), dtype=bool)
    measured[begin : end + 1] = False
    assert of(PLACEMENT, find_suspects(replace(drive, odometry=frozen)))
    found = find_suspects(replace(drive, odometry=frozen, measured=measured))
    assert [suspect.check for suspect in found] == [ODOMETRY]


def test_frozen_odometry_is_found_although_a_scan_is_misplaced_meanwhile() -> None:
    """The path may be wrong by the displacement of the scan, which is far less than what odometry has missed."""
    drive = simulated_drive("office")
    frozen, begin, end = drive.odometry.copy(), row_at(drive, 40.0), row_at(drive, 50.0)
    frozen[begin:end] = frozen[begin]
    frozen[end:] = se2.compose(frozen[begin], se2.between(frozen[end], frozen[end:]))
    poses, middle = drive.poses.copy(), row_at(drive, 45.0)
    poses[middle] = se2.compose(poses[middle], np.array([0.3, 0.3, 0.0]))
    found = find_suspects(replace(with_path(drive, poses), odometry=frozen))
    assert {suspect.check for suspect in found} == {PLACEMENT, ODOMETRY}


def test_a_wrong_loop_correction_is_found_where_a_place_is_seen_again() -> None:
    drive = simulated_drive("office")
    share = np.clip((np.arange(len(drive)) - 0.4 * len(drive)) / (0.1 * len(drive)), 0.0, 1.0)
    bent = drive.poses + share[:, None] * np.array([1.2, 0.8, 0.0])
    found = find_suspects(with_path(drive, bent))
    assert found[0].check == MAP
    match = re.search(r"around (\d+:\d\d) saw", found[0].text)
    assert match is not None
    first, last = sorted((found[0].stamp, parse_elapsed(match[1])))
    assert first < 0.5 * drive.stamps[-1] < last
    continued = replace(with_path(drive, bent), start=0.9 * drive.stamps[-1])  # only the end is of this session
    assert any("where the scans of an earlier session saw through" in one.text for one in find_suspects(continued))


def test_scans_that_slide_off_together_are_found_by_the_others() -> None:
    """Each fits the scans before it, and odometry follows: only scans from elsewhere show that they are displaced."""
    drive = simulated_drive("office")
    share = np.clip(1.0 - np.abs(drive.stamps - 40.0) / 1.5, 0.0, 1.0)
    slid = drive.poses + share[:, None] * np.array([0.0, 0.5, 0.0])
    (found,) = find_suspects(replace(with_path(drive, slid), odometry=slid))
    assert found.check == MAP
    assert "3 scans fit the map of the others better elsewhere" in found.text
    assert abs(found.stamp - 40.0) < SECONDS


def test_a_corrected_map_is_more_likely() -> None:
    right = simulated_drive("office").sampled()
    share = np.clip(1.0 - np.abs(right.stamps - 40.0) / 1.5, 0.0, 1.0)
    slid = with_path(right, right.poses + share[:, None] * np.array([0.0, 0.5, 0.0]))
    assert map_gain(right, right) == 0.0
    assert map_gain(slid, right) > refit_scans(slid).threshold
    assert map_gain(right, slid) < 0.0


@pytest.mark.parametrize("relocalised", [True, False])
def test_a_carried_robot_is_found(relocalised: bool) -> None:
    """Whether the path has noticed, or follows odometry."""
    drive = carried(simulated_drive("office"), 40.0, 60.0)
    if not relocalised:
        row = row_at(drive, 40.0)
        poses = drive.poses.copy()
        poses[row:] = se2.compose(poses[row - 1], se2.between(poses[row], poses[row:]))
        drive = with_path(drive, poses)
    assert any(abs(suspect.stamp - 40.0) < SECONDS for suspect in find_suspects(drive))


def test_where_odometry_starts_anew_no_step_is_judged() -> None:
    drive = carried(simulated_drive("office"), 40.0, 60.0)
    segment = (np.arange(len(drive)) >= row_at(drive, 40.0)).astype(np.int64)
    assert find_suspects(replace(drive, segment=segment)) == []


def test_a_slip_where_odometry_starts_anew_is_measured_from_there() -> None:
    drive = simulated_drive("office")
    begin = row_at(drive, 40.0)
    segment = (np.arange(len(drive)) >= begin).astype(np.int64)
    odometry = moved_from(drive.odometry, begin, np.array([20.0, 0.0, 0.0]))
    slipped = moved_from(odometry, begin + 1, np.array([3.0, 0.0, 0.0]))
    (found,) = find_suspects(replace(drive, segment=segment, odometry=slipped))
    assert "odometry contradicts the scans by 3.0" in found.text


def test_a_crowd_is_not_an_error_of_the_map() -> None:
    """People stand around the robot while it passes a place that it has seen before, and will see again, empty."""
    drive = simulated_drive("office")
    random = np.random.default_rng(3)
    crowd = [
        points * np.where(random.random(len(points)) < 0.5, random.uniform(0.2, 0.8, len(points)), 1.0)[:, None]
        if 100.0 < stamp < 130.0
        else points
        for stamp, points in zip(drive.stamps, drive.points, strict=True)
    ]
    assert of(MAP, find_suspects(replace(drive, points=crowd))) == []


@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_drive_of_hardly_any_scans_has_no_suspects(count: int) -> None:
    drive = simulated_drive("office")
    assert find_suspects(only(drive, np.arange(count))) == []


def test_scans_without_returns_are_left_out() -> None:
    drive = simulated_drive("office")
    empty = [points if row % 3 else np.zeros((0, 2)) for row, points in enumerate(drive.points)]
    assert find_suspects(replace(drive, points=empty)) == []


def test_the_worst_suspects_come_first() -> None:
    drive = simulated_drive("office")
    poses = moved_from(drive.poses, row_at(drive, 40.0), np.array([0.0, 0.0, np.radians(15.0)]))
    poses = moved_from(poses, row_at(drive, 80.0), np.array([0.6, 0.0, np.radians(70.0)]))
    weights = [suspect.weight for suspect in find_suspects(with_path(drive, poses)) if suspect.check != ODOMETRY]
    assert len(weights) >= 2
    assert weights == sorted(weights, reverse=True)
    assert min(weights) >= 1.0

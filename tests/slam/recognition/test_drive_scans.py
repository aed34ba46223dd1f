"""A drive is recognised by the evidence of its submaps, and a place that was seen again is no further evidence."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message
from drivers.simulation import LidarModel, Simulation
from slam import Slam
from slam.estimation.slam_state import SlamState
from slam.io.tum import Trajectory
from slam.loop_closure.submap_search import SUBMAP_LENGTH
from slam.mapping.mapper import Mapper
from slam.recognition import drive_scans, evidence, location
from slam.recognition.drive_scans import DriveScans
from slam.recognition.location import LOST, locate
from slam.recognition.map_index import index_map
from slam.recognition.scanned_map import ScannedMap, scan_drive, scan_map

LIDAR = LidarModel(beams=180, rate=4.0)
ROUNDING = 1e-9
"""Metres, more than the rounding errors of distances driven."""


def mapped(world: str, seed: int, begin: float, end: float) -> tuple[SlamState, se2.Pose]:
    """Return the state after a part of a drive, in seconds, and the true pose of its map's frame."""
    messages: list[Message] = [m for m in Simulation(world, seed=seed, duration=end, lidar=LIDAR) if m.stamp >= begin]
    slam = Slam()
    for message in messages:
        slam.add(message)
    slam.finish()
    true = [m for m in messages if isinstance(m, GroundTruth)]
    truth, state = Trajectory(np.array([m.stamp for m in true]), np.array([m.pose for m in true])), slam.slam_state
    first = truth.at(np.array(state.keyframe_stamps[:1])).poses[0]
    return state, se2.compose(first, se2.inverse(state.mapper.keyframe_poses[0]))


def known(state: SlamState) -> ScannedMap:
    points = state.local_field.points_of(np.arange(state.mapper.keyframe_count))
    return scan_map(index_map(state.mapper), state.mapper.keyframe_poses, points)


@pytest.fixture(scope="module")
def first() -> tuple[ScannedMap, se2.Pose]:
    state, frame = mapped("office", 1, 0.0, 30.0)
    return known(state), frame


@pytest.fixture(scope="module")
def second() -> tuple[SlamState, se2.Pose]:
    return mapped("office", 2, 4.0, 30.0)


def test_drive_is_located_at_its_place(first: tuple[ScannedMap, se2.Pose], second: tuple[SlamState, se2.Pose]) -> None:
    (old, frame), (state, own) = first, second
    found = locate(DriveScans().take(state.mapper, state.local_field, 0), old, LOST)
    assert found.accepted, found.reason
    for member in found.members:
        np.testing.assert_allclose(se2.between(se2.between(frame, own), member.motion), 0.0, atol=0.05)
        assert member.fit > 0.8
        assert 0.4 < member.known <= 1.0


def test_submaps_follow_one_another_up_to_the_last_keyframe(second: tuple[SlamState, se2.Pose]) -> None:
    state, _ = second
    drive = DriveScans().take(state.mapper, state.local_field, 0)
    keyframes = [keyframe for submap in drive.submaps for keyframe in submap.scan.keyframes]
    assert keyframes == list(range(state.mapper.keyframe_count))
    travelled = np.asarray(state.mapper.travelled)
    assert len(drive.submaps) == int(travelled[-1] // SUBMAP_LENGTH) + 1
    for submap in drive.submaps:
        assert np.ptp(travelled[list(submap.scan.keyframes)]) < SUBMAP_LENGTH


def test_only_the_last_submaps_of_a_long_drive_are_searched_for(
    second: tuple[SlamState, se2.Pose], monkeypatch: pytest.MonkeyPatch
) -> None:
    state, _ = second
    whole = DriveScans().take(state.mapper, state.local_field, 0).submaps
    monkeypatch.setattr(drive_scans, "MAX_SUBMAPS", 2)
    last = DriveScans().take(state.mapper, state.local_field, 0).submaps
    assert [submap.scan.keyframes for submap in last] == [submap.scan.keyframes for submap in whole[-2:]]


def test_complete_submaps_are_built_once(second: tuple[SlamState, se2.Pose]) -> None:
    state, _ = second
    scans = DriveScans()
    before = scans.take(state.mapper, state.local_field, 0).submaps
    after = copy.deepcopy(scans).take(state.mapper, state.local_field, 0).submaps
    assert all(one.scan is other.scan for one, other in zip(before[:-1], after[:-1], strict=True))
    scans.clear()
    assert scans.take(state.mapper, state.local_field, 0).submaps[0].scan is not before[0].scan


def test_search_is_due_when_the_drive_shows_more(second: tuple[SlamState, se2.Pose]) -> None:
    """A robot that turns on the spot travels nowhere, but has new keyframes."""
    state, _ = second
    scans, count = DriveScans(), state.mapper.keyframe_count

    def due(more: int, metres: float, first: int = 0) -> bool:
        travelled = [*state.mapper.travelled, *[state.mapper.travelled[-1] + metres] * more]
        return scans.is_due(cast("Mapper", SimpleNamespace(keyframe_count=count + more, travelled=travelled)), first)

    assert due(0, 0.0)
    scans.take(state.mapper, state.local_field, 0)
    share = math.ceil(drive_scans.SEARCH_SHARE * count)
    assert not due(0, 0.0)
    assert not due(share - 1, 0.0)
    assert due(share + 2, 0.0)
    assert due(1, drive_scans.MAX_SEARCH_DISTANCE + ROUNDING)
    assert due(1, 0.0, first=count), "another drive has begun"
    assert not due(drive_scans.SEARCH_KEYFRAMES - 1, 0.0, first=count - 3)
    assert due(drive_scans.SEARCH_KEYFRAMES, 0.0, first=count - 3)


@pytest.mark.slow
def test_places_seen_again_are_no_further_evidence(
    first: tuple[ScannedMap, se2.Pose], second: tuple[SlamState, se2.Pose], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same cells count: those with enough points if each is seen once."""
    state, _ = second
    scans = [submap.scan for submap in DriveScans().take(state.mapper, state.local_field, 0).submaps][:2]
    once = locate(scan_drive(state.mapper, scans), first[0], LOST)
    monkeypatch.setattr(evidence, "MIN_CELL_POINTS", 3 * evidence.MIN_CELL_POINTS)
    thrice = locate(scan_drive(state.mapper, scans * 3), first[0], LOST)
    assert thrice.evidence == pytest.approx(once.evidence, rel=0.02)


def test_drive_that_leaves_the_map_is_not_located(
    first: tuple[ScannedMap, se2.Pose], second: tuple[SlamState, se2.Pose], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is decided by the share that is mapped, and by nothing else."""
    state, _ = second
    drive = DriveScans().take(state.mapper, state.local_field, 0)
    monkeypatch.setattr(location, "MEAN_UNMAPPED", 0.001)
    assert locate(drive, first[0], replace(LOST, fully_mapped=False)).accepted
    refused = locate(drive, first[0], LOST)
    assert not refused.accepted
    assert refused.evidence > refused.required
    assert "mapped (requires 99" in refused.reason


def test_what_is_known_before_counts(first: tuple[ScannedMap, se2.Pose], second: tuple[SlamState, se2.Pose]) -> None:
    state, _ = second
    drive = DriveScans().take(state.mapper, state.local_field, 0)
    even, likely = (locate(drive, first[0], replace(LOST, prior=prior)).evidence for prior in (0.5, 0.9))
    assert even < likely <= even + np.log(9.0) + 1e-6


@pytest.mark.parametrize("world", [pytest.param("museum", marks=pytest.mark.slow), "room"])
def test_drive_in_another_building_is_not_located(first: tuple[ScannedMap, se2.Pose], world: str) -> None:
    state, _ = mapped(world, 3, 0.0, 25.0)
    scans = [submap.scan for submap in DriveScans().take(state.mapper, state.local_field, 0).submaps]
    for count in range(1, len(scans) + 1):
        assert not locate(scan_drive(state.mapper, scans[:count]), first[0], LOST).accepted

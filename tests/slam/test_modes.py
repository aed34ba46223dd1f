"""Switching between mapping and localisation while a run goes on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan
from drivers.simulation import LidarModel, Simulation
from slam import Slam
from slam.config import Config, config_to_toml
from slam.errors import MapError
from slam.estimation.journal import UNDECIDED_SCANS
from slam.evaluation.metrics import score_reference
from slam.events import EventRecorder, Finished, ModeChanged
from slam.io.output_dir import CONFIG
from slam.io.sessions import StoredSession, read_session, write_session
from slam.io.tum import Trajectory

DURATION = 40.0
FREEZE, UNFREEZE = 14.0, 26.0
"""Seconds after the start between which the map is only localised in."""


def drive(seed: int = 3, world: str = "office", duration: float = DURATION) -> list[Message]:
    return list(Simulation(world, seed=seed, duration=duration, lidar=LidarModel(beams=180, rate=5.0)))


@pytest.fixture(scope="module")
def messages() -> list[Message]:
    return drive()


def add_until(slam: Slam, messages: list[Message], seconds: float) -> list[Message]:
    """Add the messages up to some seconds after the first one; return the others."""
    end = messages[0].stamp + seconds
    for message in messages:
        if message.stamp <= end:
            slam.add(message)
    return [message for message in messages if message.stamp > end]


def largest_error(finished: Finished, messages: list[Message]) -> float:
    truth = [message for message in messages if isinstance(message, GroundTruth)]
    reference = Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))
    return float(score_reference(Trajectory(finished.stamps, finished.poses), reference).figures()["ate_max"])


@pytest.mark.parametrize("options", [{"frozen": True}, {"start": np.zeros(3)}], ids=["frozen", "start"])
def test_a_run_needs_a_map_to_be_localised_in(options: dict[str, Any]) -> None:
    with pytest.raises(MapError, match="there is no map"):
        Slam(**options)


def test_the_map_stays_as_it_is_between_and_the_path_has_no_gap(messages: list[Message], tmp_path: Path) -> None:
    events = EventRecorder()
    slam = Slam(sinks=[events])
    with pytest.raises(MapError, match="nothing is mapped yet"):
        slam.freeze()
    rest = add_until(slam, messages, FREEZE)
    slam.freeze()
    before = slam.slam_state.mapper.keyframe_poses, slam.walls.frame.copy(), len(slam.corners)
    rest = add_until(slam, rest, UNFREEZE - FREEZE)
    assert slam.frozen
    np.testing.assert_array_equal(slam.slam_state.mapper.keyframe_poses, before[0])
    np.testing.assert_array_equal(slam.walls.frame, before[1])
    assert len(slam.corners) == before[2]
    slam.unfreeze()
    add_until(slam, rest, DURATION)
    assert [event.frozen for event in events.of(ModeChanged)] == [True, False]
    finished = slam.finish()
    stamps = np.array(slam.slam_state.keyframe_stamps) - messages[0].stamp
    assert not ((stamps > FREEZE) & (stamps < UNFREEZE - 0.5)).any()
    assert (stamps > UNFREEZE).sum() > 5
    assert np.diff(finished.stamps).max() < 0.1
    assert largest_error(finished, messages) < 0.03
    (tmp_path / CONFIG).write_text(config_to_toml(Config()))
    write_session(tmp_path, slam.session)
    assert len(read_session(tmp_path).scans) == sum(isinstance(message, Scan) for message in messages)


@pytest.mark.slow
def test_modes_that_are_set_again_change_nothing(messages: list[Message]) -> None:
    paths = []
    for again in (False, True):
        events = EventRecorder()
        slam = Slam(sinks=[events])
        rest = add_until(slam, messages, 10.0)
        if again:
            slam.unfreeze()
        slam.freeze()
        if again:
            slam.freeze()
        add_until(slam, rest, 5.0)
        paths.append(slam.finish().poses)
        assert len(events.of(ModeChanged)) == 1
    np.testing.assert_array_equal(*paths)


@pytest.fixture(scope="module")
def session(messages: list[Message]) -> StoredSession:
    slam = Slam()
    add_until(slam, messages, 20.0)
    slam.finish()
    return slam.session


def later(messages: list[Message], begin: float) -> list[Message]:
    """Return the messages from some seconds after the first one on, stamped later; odometry begins elsewhere."""
    elsewhere, found = np.array([3.0, -2.0, 1.0]), list[Message]()
    for message in messages:
        if message.stamp - messages[0].stamp < begin:
            continue
        moved = replace(message, stamp=message.stamp + 1000.0)
        found.append(replace(moved, pose=se2.compose(elsewhere, moved.pose)) if isinstance(moved, Odometry) else moved)
    return found


@pytest.mark.slow
def test_a_map_that_was_localised_in_is_extended(messages: list[Message], session: StoredSession) -> None:
    slam = Slam(resumed=session.copy(), frozen=True)
    keyframes = slam.slam_state.mapper.keyframe_count
    second = later(messages, 12.0)
    rest = add_until(slam, second, 8.0)
    assert slam.state.status.value == "OK"
    assert not slam.extends_map
    slam.unfreeze()
    assert slam.extends_map
    add_until(slam, rest, DURATION)
    finished = slam.finish()
    assert len(finished.keyframes) > keyframes + 5
    assert finished.stamps[0] < messages[0].stamp + 1.0  # of the whole session
    assert len(slam.session.starts) == 2
    now = finished.stamps > 1000.0
    assert largest_error(replace(finished, stamps=finished.stamps[now], poses=finished.poses[now]), second) < 0.05


@pytest.mark.slow
def test_a_robot_that_is_lost_maps_in_a_new_part(session: StoredSession) -> None:
    """It is in another building, of which a map alone remains, as the session's was never recognised."""
    slam = Slam(resumed=session.copy(), frozen=True)
    elsewhere = [replace(message, stamp=message.stamp + 1000.0) for message in drive(3, "room", 12.0)]
    rest = add_until(slam, elsewhere, 4.0)
    assert slam.state.status.value == "LOST"
    slam.unfreeze()
    with pytest.raises(MapError, match="the robot is LOST"):
        slam.freeze()
    add_until(slam, rest, 20.0)
    assert len(slam.slam_state.mapper.landmarks.parts) == 2
    finished = slam.finish()
    assert finished.stamps[0] >= 1000.0
    assert largest_error(finished, elsewhere) < 0.03


@pytest.mark.slow
def test_only_features_of_scans_that_were_localised_are_dropped(
    messages: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slam.estimation.journal.LOCALISED_SCANS", 30)
    slam = Slam(keep_all_features=False)
    rest = add_until(slam, messages, FREEZE)
    mapped = slam.snapshot().session.scans.has_features
    slam.freeze()
    rest = add_until(slam, rest, UNFREEZE - FREEZE)
    slam.unfreeze()
    add_until(slam, rest, DURATION)
    kept = slam.snapshot().session.scans.has_features
    np.testing.assert_array_equal(kept[: len(mapped)], mapped)
    localised = slice(len(mapped), len(mapped) + round(5.0 * (UNFREEZE - FREEZE)) - UNDECIDED_SCANS - 1)
    assert not kept[localised].any()
    keyframes = np.isin(slam.snapshot().session.scans.stamps, slam.slam_state.keyframe_stamps)
    assert kept[keyframes].all()

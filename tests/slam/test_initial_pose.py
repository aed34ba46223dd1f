"""Starting at a given pose in the map of a session, and a pose that is set while the robot drives."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers import se2
from drivers.messages import GroundTruth, InitialPose, Message, Odometry
from drivers.simulation import LidarModel, Simulation
from slam import Slam
from slam.cli.app import app
from slam.errors import MapError
from slam.events import EventRecorder, Finished
from slam.io.sessions import StoredSession

DURATION = 14.0
LATER = 10.0
"""Seconds after the start at which the second run begins."""


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    return list(Simulation("office", seed=4, duration=DURATION, lidar=LidarModel(beams=180, rate=5.0)))


@pytest.fixture(scope="module")
def session(drive: list[Message]) -> StoredSession:
    slam = Slam()
    for message in drive:
        slam.add(message)
    slam.finish()
    return slam.session


def later(drive: list[Message]) -> list[Message]:
    """Return the last seconds of the drive, stamped after it; odometry begins elsewhere."""
    elsewhere = np.array([3.0, -2.0, 1.0])
    messages: list[Message] = []
    for message in drive:
        if message.stamp >= LATER and not isinstance(message, GroundTruth):
            moved = copy.copy(message)
            object.__setattr__(moved, "stamp", message.stamp + 1000.0)
            if isinstance(moved, Odometry):
                object.__setattr__(moved, "pose", se2.compose(elsewhere, moved.pose))
            messages.append(moved)
    return messages


def true_pose(drive: list[Message], stamp: float) -> se2.Pose:
    """Return the true pose in the map, whose origin is the pose at the start."""
    truth = [message for message in drive if isinstance(message, GroundTruth)]
    last = next(message for message in truth if message.stamp >= stamp)
    return se2.between(truth[0].pose, last.pose)


def rough(pose: se2.Pose) -> se2.Pose:
    return se2.compose(pose, np.array([0.4, -0.3, np.radians(15.0)]))


def localise(session: StoredSession, messages: list[Message], start: se2.Pose | None) -> tuple[Slam, Finished]:
    slam = Slam(resumed=copy.deepcopy(session), frozen=True, start=start)
    for message in messages:
        slam.add(message)
    return slam, slam.finish()


@pytest.mark.parametrize("frozen", [True, False])
def test_the_robot_is_localised_from_the_first_scan(drive: list[Message], session: StoredSession, frozen: bool) -> None:
    events = EventRecorder()
    start = rough(true_pose(drive, LATER))
    slam = Slam(sinks=[events], resumed=copy.deepcopy(session), frozen=frozen, start=start)
    for message in later(drive):
        slam.add(message)
    assert slam.state.status.value != "LOST"
    error = se2.between(true_pose(drive, DURATION - 0.1), slam.pose)
    assert np.hypot(error[0], error[1]) < 0.1  # the last scan is a moment older
    finished = slam.finish()
    assert not any(suspect["check"] == "parts" for suspect in finished.summary["suspects"])
    if frozen:
        first = se2.between(true_pose(drive, finished.stamps[0] - 1000.0), finished.poses[0])
        assert np.hypot(first[0], first[1]) < 0.1


def test_the_initial_pose_may_be_a_list_of_any_numbers(drive: list[Message], session: StoredSession) -> None:
    for start in ([50, 50, 0], (50.0, 50, np.float32(0.0))):
        slam = Slam(resumed=copy.deepcopy(session), frozen=True, start=start)
        for message in later(drive)[:10]:
            slam.add(message)
    for wrong in ([1.0, 2.0], "1,2,3", [0.0, 0.0, np.nan]):
        with pytest.raises(MapError, match=r"start: .* must be three numbers"):
            Slam(resumed=session, frozen=True, start=wrong)


def test_a_pose_can_be_set_while_the_robot_drives(drive: list[Message], session: StoredSession) -> None:
    messages = later(drive)
    half = len(messages) // 2
    messages.insert(half, InitialPose(messages[half].stamp, rough(true_pose(drive, messages[half].stamp - 1000.0))))
    slam, _ = localise(session, messages, None)
    error = se2.between(true_pose(drive, DURATION - 0.1), slam.pose)
    assert np.hypot(error[0], error[1]) < 0.1


def test_a_wrong_pose_is_not_used(drive: list[Message], session: StoredSession) -> None:
    slam = Slam(resumed=copy.deepcopy(session), frozen=True, start=np.array([50.0, 50.0, 0.0]))
    for message in later(drive)[:40]:
        slam.add(message)
    assert slam.state.status.value == "LOST"


@pytest.mark.parametrize(("text", "expected"), [("1,2", "three numbers"), ("1,2,3", "needs a map")])
def test_a_start_that_cannot_be_used_is_one_line(text: str, expected: str) -> None:
    result = CliRunner().invoke(app, ["run", "sim:room", "--out", "unused", "--start", text])
    assert result.exit_code == 2
    assert expected in " ".join(result.output.split())

"""A bare corridor, whose ends are out of sight: what walls do not determine must not seem certain."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry
from drivers.simulation import LidarModel, Simulation
from slam import Slam
from slam.evaluation.metrics import score_reference
from slam.events import EventRecorder, StateChanged
from slam.io.tum import Trajectory

SHORT_SIGHTED = LidarModel(beams=180, range_max=12.0)


@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_a_bare_corridor_leaves_the_way_along_it_to_odometry(seed: int) -> None:
    listener, truth = EventRecorder(), []
    slam = Slam(sinks=[listener])
    for message in Simulation("bare_corridor", seed=seed, duration=18.0, lidar=SHORT_SIGHTED):
        if isinstance(message, GroundTruth):
            truth.append([message.stamp, *message.pose])
        slam.add(message)
    result = slam.finish()
    changes = listener.of(StateChanged)

    assert [change.state for change in changes] == ["DEGENERATE"]  # once, and to the end
    assert changes[0].stamp < 1.0
    assert changes[0].direction is not None
    assert abs(np.sin(changes[0].direction)) < np.sin(np.radians(2.0))  # the corridor runs along x

    stamps, *columns = np.array(truth).T
    true = np.array([np.interp(result.keyframes.stamps, stamps, column) for column in columns]).T
    driven, found = se2.between(true[0], true), se2.between(result.keyframes.poses[0], result.keyframes.poses)
    error, covariance = se2.between(driven, found), result.keyframes.covariance
    sigmas = np.sqrt(covariance[:, [0, 1, 2], [0, 1, 2]])
    claimed = slam.config.odometry.translation_error * driven[-1, 0]  # nothing has shown that wheels are any better
    assert sigmas[-1, 0] > claimed
    assert (np.diff(sigmas[1:, 0]) > 0).all()  # no view of the two walls makes it any smaller
    assert (np.abs(error[1:]) < 3 * sigmas[1:]).all()
    assert sigmas[:, 1].max() < 0.02  # across, and in heading, the walls hold the robot
    assert sigmas[:, 2].max() < np.radians(0.5)


def largest_error(messages: Iterable[Message], truth: Trajectory) -> float:
    """Return the largest error of the path of a run, metres."""
    slam = Slam()
    for message in messages:
        slam.add(message)
    result = slam.finish()
    return float(score_reference(Trajectory(result.stamps, result.poses), truth).figures()["ate_max"])


@pytest.mark.slow
@pytest.mark.parametrize("rate", [10.0, 40.0])
def test_the_way_along_a_corridor_is_interpolated_over_a_gap_of_odometry(rate: float) -> None:
    """The wheels count on while their readings are lost, as on a disturbed connection."""
    whole = Simulation("bare_corridor", seed=2, duration=16.0, lidar=replace(SHORT_SIGHTED, rate=rate))
    drive = [message for message in whole if message.stamp > 4.0]
    true = [message for message in drive if isinstance(message, GroundTruth)]
    truth = Trajectory(np.array([one.stamp for one in true]), np.array([one.pose for one in true]))
    with_gap = [m for m in drive if not (isinstance(m, Odometry) and 8.0 < m.stamp < 12.5)]
    assert largest_error(with_gap, truth) < largest_error(drive, truth) + 0.02

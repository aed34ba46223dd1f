"""A drive often ends just after the robot has come back: its evidence then decides on a loop that few looks support."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth
from drivers.simulation import LIDAR_MODELS, Simulation
from slam import Slam
from slam.evaluation.benchmarks.lookalike import run_world
from slam.events import EventRecorder, Finished, LoopDecided
from slam.io.tum import Trajectory
from slam.loop_closure.loop_status import LoopStatus

from ..simulated_worlds import limit_drives


def drive_round(world: str, seed: int, duration: float) -> tuple[Slam, Finished, float, list[LoopDecided]]:
    """Return the run of a drive, its results, the error (metres) of its end, and the decisions on loops."""
    lidar, events = replace(LIDAR_MODELS["short"], rate=3.0), EventRecorder()
    messages = list(Simulation(world, seed=seed, duration=duration, lidar=lidar))
    slam = Slam(sinks=[events])
    for message in messages:
        slam.add(message)
    finished = slam.finish()
    true = [message for message in messages if isinstance(message, GroundTruth)]
    truth = Trajectory(np.array([message.stamp for message in true]), np.array([message.pose for message in true]))
    true_ends = truth.at(finished.stamps[[0, -1]]).poses
    error = se2.between(se2.between(*true_ends), se2.between(*finished.poses[[0, -1]]))
    return slam, finished, float(np.hypot(*error[:2])), events.of(LoopDecided)


@pytest.mark.slow
def test_a_loop_at_the_end_of_a_drive_is_closed_by_its_evidence() -> None:
    """The drive ends some metres after the return."""
    slam, finished, error, decided = drive_round("large_loop", 66, 113.0)
    assert [event.status for event in decided] == [LoopStatus.ACCEPTED]
    assert error < 0.05
    keyframes = slam.session.slam_state.mapper.keyframe_poses
    assert np.hypot(*(keyframes - finished.keyframes.poses)[:, :2].T).max() < 0.05  # the session has the closure, too
    assert [decision["status"] for decision in slam.session.loop_decisions] == [LoopStatus.ACCEPTED]


def test_a_loop_at_the_end_of_a_drive_stays_open_if_its_place_is_ambiguous() -> None:
    *_, decided = drive_round("square", 60, 135.0)
    assert {event.status for event in decided} == {LoopStatus.REJECTED}


@pytest.mark.slow
@pytest.mark.parametrize(("variant", "seed", "duration"), [("standard", 51, 162.64), ("half-circle", 8968, 165.36)])
def test_no_loop_is_closed_between_equal_offices(
    variant: str, seed: int, duration: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The evidence is for offices that look alike, 4.5 metres beside the right ones: looks extend over less than the
    uncertainty of the position, the right place is a rival, or the estimate itself is at the office beside, and
    much of what the drive shows is not mapped.
    """
    limit_drives(monkeypatch, duration)
    run = run_world("equal_offices", seed, variant)
    assert run.needed
    assert not run.wrong

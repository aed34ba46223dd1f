"""Places that a person states to be one are matched, or refused with the reason."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry, Scan
from drivers.simulation import LidarModel, Simulation
from slam import Slam
from slam.errors import MapError
from slam.estimation.slam_state import SlamState
from slam.io.sessions.corrections import Place, PlaceClosing
from slam.io.tum import Trajectory
from slam.loop_closure.submap_search import SubmapMatch
from slam.offline.corrections import correct_session, place_match
from slam.offline.corrections.place_match import match_places

LIDAR = LidarModel(beams=180, rate=4.0)
WORLD = """
title = "two rooms"
speed = 0.8
path = [[1.0, 1.0], [5.0, 1.2], [10.5, 1.5], [12.0, 4.0], [10.0, 4.2], [10.0, 1.5], [5.0, 1.2], [1.0, 1.2]]

[[walls]]
from = [0, 0]
to = [6, 0]
[[walls]]
from = [6, 0]
to = [6, 0.7]
[[walls]]
from = [6, 2.0]
to = [6, 4]
[[walls]]
from = [6, 4]
to = [0, 3.2]
[[walls]]
from = [0, 3.2]
to = [0, 0]
[[walls]]
from = [6.2, 0]
to = [13, 0]
[[walls]]
from = [13, 0]
to = [13, 6]
[[walls]]
from = [13, 6]
to = [8, 6]
[[walls]]
from = [8, 6]
to = [6.2, 3]
[[walls]]
from = [6.2, 3]
to = [6.2, 2.0]
[[walls]]
from = [6.2, 0.7]
to = [6.2, 0]

[[boxes]]
at = [3.0, 2.4]
size = [1.2, 0.7]
turn = 10
"""


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = Path(tmp_path_factory.mktemp("world") / "rooms.toml")
    path.write_text(WORLD)
    return path


def measurements(world: Path, seed: int, duration: float | None = None) -> list[Scan | Odometry]:
    simulation = Simulation(world, seed=seed, duration=duration, lidar=LIDAR)
    return [message for message in simulation if isinstance(message, Scan | Odometry)]


@pytest.fixture(scope="module")
def state(world: Path) -> SlamState:
    """State after a drive from one room into another one and back."""
    slam = Slam()
    for message in measurements(world, 1):
        slam.add(message)
    slam.finish()
    return slam.slam_state


def test_one_place_is_matched_from_wherever_it_is_in_the_map(state: SlamState) -> None:
    last, poses = state.mapper.keyframe_count - 1, state.mapper.keyframe_poses
    old = int(np.argmin(np.hypot(*(poses[: last // 3, :2] - poses[last, :2]).T)))
    look, match = match_places(state, old, last, None)
    assert look.last == last
    np.testing.assert_allclose(match.pose, se2.between(poses[old], poses[last]), atol=0.05)
    _, proposed = match_places(state, old, last, np.array([0.2, -0.1, 0.05]))
    np.testing.assert_allclose(proposed.pose, match.pose, atol=0.01)
    _, outdated = match_places(state, old, last, np.array([8.0, -3.0, 0.5]))
    np.testing.assert_allclose(outdated.pose, match.pose, atol=0.01)


def test_other_places_are_refused_with_the_reason(state: SlamState) -> None:
    travelled = np.array(state.mapper.travelled)
    with pytest.raises(MapError, match=r"keyframes 0 and 5: only .* m of driving apart"):
        match_places(state, 0, 5, None)
    elsewhere = int(np.searchsorted(travelled, 14.0))
    with pytest.raises(MapError, match=rf"keyframes 0 and {elsewhere} are not one place: .* fit"):
        match_places(state, 0, elsewhere, None)


def test_the_reason_is_the_criterion_that_no_match_meets(state: SlamState, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the older scans have seen nothing, nothing contradicts a pose: that all points fit there says little."""
    covariance, last = np.diag([1e-4, 1e-4, 1e-6]), state.mapper.keyframe_count - 1
    outside = SubmapMatch(np.zeros(3), covariance, fit=1.0, known=0.0)
    partly = replace(outside, fit=0.9, known=0.2)
    misfit = replace(outside, fit=0.6, known=0.9)
    sliding = replace(misfit, fit=0.9, covariance=np.diag([100.0, 1e-4, 1e-6]))
    for found, reason in (
        ([], "fit at no pose"),
        ([misfit], "60 % of the points fit"),
        ([outside], "fit only where the older ones have seen 0 %"),
        ([partly, outside, misfit], "fit only where the older ones have seen 20 %"),
        ([partly, sliding], "do not determine the position"),
    ):
        monkeypatch.setattr(place_match, "search_submap", lambda *_, found=found: found)
        with pytest.raises(MapError, match=reason):
            match_places(state, 0, last, None)


def test_a_part_of_the_map_that_was_not_recognised_is_joined_by_hand(world: Path) -> None:
    """The robot is carried back to its start, and drives there for too short a way to be recognised."""
    messages = measurements(world, 1, 12.0)
    last, later = messages[-1], measurements(world, 2, 4.0)
    odometry = next(message.pose for message in reversed(messages) if isinstance(message, Odometry))
    start = next(message.pose for message in later if isinstance(message, Odometry))
    slam = Slam()
    for message in messages:
        slam.add(message)
    carried = slam.slam_state.mapper.keyframe_count
    for message in later:
        stamp = message.stamp + last.stamp + 1.0
        if isinstance(message, Odometry):
            message = replace(message, pose=se2.compose(odometry, se2.between(start, message.pose)))
        slam.add(replace(message, stamp=stamp))
    finished = slam.finish()
    parts = slam.slam_state.mapper.landmarks.parts
    assert parts.apart == [1]
    first = parts.firsts[1]
    assert first >= carried - 1
    places = (Place(keyframe=0), Place(keyframe=len(finished.keyframes) - 1))
    path = Trajectory(finished.stamps, finished.poses)
    corrected = correct_session(slam.session, path, [PlaceClosing(places=places)])
    mapper = corrected.session.slam_state.mapper
    assert not mapper.landmarks.parts.apart
    assert not [row for row in corrected.finished.summary["suspects"] if "no scan connects" in row["sentence"]]
    assert len(corrected.finished.walls) < len(finished.walls)
    # Both drives begin at the same place, and are the same.
    poses, stamps = mapper.keyframe_poses, np.array(corrected.session.slam_state.keyframe_stamps)
    again = np.abs(stamps[:first, None] - (stamps[first:] - last.stamp - 1.0)).argmin(axis=0)
    assert np.hypot(*(poses[again, :2] - poses[first:, :2]).T).max() < 0.3
    assert np.hypot(*(finished.keyframes.poses[again, :2] - finished.keyframes.poses[first:, :2]).T).min() > 1.0

"""A robot is localised in its map although its wheels measure otherwise than when it mapped."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry
from drivers.simulation import LidarModel, Simulation, WheelModel
from slam import Slam
from slam.config import Config, config_to_toml
from slam.evaluation.benchmarks.scenarios.buildings import random_building
from slam.events import Finished
from slam.geometry.pose_covariance import position_sigma
from slam.io.output_dir import CONFIG
from slam.io.sessions import read_session, write_session

pytestmark = pytest.mark.slow

BUILDING = random_building(1295)
DURATION, LATER = 75.0, 1000.0  # seconds of each drive, and from one to the other
LIDAR = LidarModel(beams=180, rate=5.0, field_of_view=np.pi, range_max=6.0)
WHEELS = WheelModel(scale_bias=0.0, difference_bias=0.0, wheelbase_bias=0.0)
LENGTHS = 1.06  # of a motion by odometry on the second day, relative to the first


def drive(seed: int, shift: float, lengths: float) -> list[Message]:
    """Return a drive along the same path, in which odometry has the given scale of lengths."""
    simulation = Simulation(BUILDING, seed=seed, duration=DURATION, lidar=LIDAR, wheels=WHEELS)
    return [
        replace(m, stamp=m.stamp + shift, pose=m.pose * np.array([lengths, lengths, 1.0]))
        if isinstance(m, Odometry)
        else replace(m, stamp=m.stamp + shift)
        for m in simulation
    ]


def add_all(slam: Slam, messages: Iterable[Message]) -> Finished:
    for message in messages:
        if not isinstance(message, GroundTruth):
            slam.add(message)
    return slam.finish()


@pytest.fixture(scope="module")
def map_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    mapping, folder = Slam(), tmp_path_factory.mktemp("map")
    add_all(mapping, drive(1, 0.0, 1.0))
    (folder / CONFIG).write_text(config_to_toml(Config()))
    write_session(folder, mapping.session)
    return folder


@pytest.mark.parametrize("lengths", [LENGTHS, 1.0 / LENGTHS])
def test_other_wheels_do_not_move_the_robot_along_a_corridor_of_a_known_map(map_folder: Path, lengths: float) -> None:
    localising = Slam(resumed=read_session(map_folder), frozen=True, start=np.zeros(3))
    messages = drive(2, LATER, lengths)
    finished = add_all(localising, messages)
    truth = [message for message in messages if isinstance(message, GroundTruth)]
    stamps, true = np.array([m.stamp for m in truth]), np.array([m.pose for m in truth])
    rows = np.minimum(np.searchsorted(stamps, finished.stamps), len(stamps) - 1)
    errors = np.hypot(*(finished.poses - se2.between(true[0], true[rows]))[:, :2].T)
    assert errors.max() < 0.2
    assert localising.slam_state.odometry_model.systematic_errors.length == pytest.approx(1.0 / lengths, abs=0.02)
    tracker = localising.slam_state.tracker.state
    assert tracker is not None
    assert 1e-3 < position_sigma(tracker.reference.covariance) < 0.1


def test_a_slip_in_a_known_map_ends_where_the_robot_is_found_again(map_folder: Path) -> None:
    """Odometry's errors are learned from then on, and predict the motion."""
    localising = Slam(resumed=read_session(map_folder), frozen=True, start=np.zeros(3))
    slipped, begin = list[bool](), LATER + 16.0
    for message in drive(2, LATER, 1.0):
        if message.stamp > LATER + 22.0:
            break
        if isinstance(message, Odometry):
            spun = np.clip(message.stamp - begin, 0.0, 1.0)  # metres that the wheels have spun
            message = replace(message, pose=message.pose + np.array([spun, 0.0, 0.0]))
        if not isinstance(message, GroundTruth):
            localising.add(message)
            slipped.append(localising.slam_state.slipped)
    assert any(slipped)
    assert not slipped[-1]

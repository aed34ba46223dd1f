"""Which scans become keyframes, and what is learned from those between them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Message, Odometry, Scan
from drivers.simulation import WHEEL_MODELS, LidarModel, Simulation, WheelModel, World, load_world
from slam import Slam
from slam.config import Config, MappingConfig, OdometryConfig, config_to_toml
from slam.estimation.keyframe_selection import CLOSE_SHARE, MIN_EXPLAINED, is_due
from slam.estimation.slam_state import SlamState
from slam.estimation.tracking_checkpoint import Anchor
from slam.io.sessions import read_session, write_session
from slam.matching.point_matcher import Prediction

from ..tracking_results import tracking_result

ANCHOR = np.array([1.0, 2.0, math.pi / 2])
MAPPING = Config().mapping


def due(motion: se2.Pose, explained: float) -> bool:
    """Return True if a scan is due that is predicted at `motion` from the anchor, and of which a share is mapped."""
    state = SlamState(Config())
    state.mapper.keyframe_poses = ANCHOR[None]
    state.set_anchor(Anchor(0, np.zeros(3), np.zeros((3, 3)), Odometry(0.0, np.zeros(3))))
    predicted = Prediction(se2.compose(ANCHOR, motion), np.eye(3))
    return is_due(state, tracking_result(predicted=predicted, explained=explained))


@pytest.mark.parametrize(
    "step",
    [[MAPPING.keyframe_distance, 0.0, 0.0], [0.0, -MAPPING.keyframe_distance, 0.0], [0.0, 0.0, -MAPPING.keyframe_turn]],
    ids=["ahead", "aside", "turning"],
)
def test_keyframes_are_closer_where_much_is_new(step: list[float]) -> None:
    motion = np.array(step)
    shares = {1.0: 1.0, MIN_EXPLAINED: 1.0, MIN_EXPLAINED - 0.01: CLOSE_SHARE, 0.0: CLOSE_SHARE}
    for explained, share in shares.items():
        assert not due(0.99 * share * motion, explained)
        assert due(1.01 * share * motion, explained)


def test_the_first_scan_is_due() -> None:
    assert is_due(SlamState(Config()), tracking_result())


def test_odometry_is_learned_between_keyframes_too() -> None:
    slam = Slam()
    for message in Simulation(load_world("office"), 3, 20.0, LidarModel(beams=460, rate=5.0), WHEEL_MODELS["good"]):
        slam.add(message)
    state = slam.slam_state
    samples = state.odometry_model.samples
    assert len(samples) > 1.2 * state.mapper.keyframe_count
    assert np.abs(samples[:, :2] - samples[:, 3:5]).max() < 0.05  # odometry and scans measured the same motion


@pytest.mark.slow
def test_where_learning_stopped_is_kept_with_a_session(tmp_path: Path) -> None:
    slam = Slam()
    for message in Simulation(load_world("office"), 3, 60.0, LidarModel(beams=460), WHEEL_MODELS["good"]):
        slam.add(message)
        if message.stamp > 10.0 and slam.slam_state.learned_until is not None:
            break  # in a room that is known: the scan that waits for odometry does not become a keyframe
    slam.finish()
    expected = slam.slam_state.learned_until
    assert expected is not None
    (tmp_path / "config.toml").write_text(config_to_toml(Config()))
    write_session(tmp_path, slam.session)
    restored = read_session(tmp_path).slam_state.learned_until
    assert restored is not None
    assert restored.keyframe == expected.keyframe
    for field in ("relative", "covariance"):
        np.testing.assert_array_equal(getattr(restored, field), getattr(expected, field))
    assert restored.odometry.stamp == expected.odometry.stamp
    np.testing.assert_array_equal(restored.odometry.pose, expected.odometry.pose)


VEER, OPEN = 0.1, 3.2
"""Error of odometry (rad/m), and metres driven up to which something is in range."""


def leaving_a_room() -> Iterator[Message]:
    """Yield a drive out of a room to where nothing is in range; odometry veers as long as something is."""
    walls = np.array([[0.0, 0.0, 0.0, 3.0], [0.0, 3.0, 3.5, 3.0], [0.0, 0.0, 3.5, 0.0]])
    world = World("room", "an open room", walls, np.zeros((0, 3)), np.array([[1.0, 1.5], [9.0, 1.5]]), 0.4)
    exact = WheelModel(slip=0.0, encoder=0.0, scale_bias=0.0, difference_bias=0.0, wheelbase_bias=0.0)
    for message in Simulation(world, 0, lidar=LidarModel(beams=360, range_max=2.0), wheels=exact):
        if isinstance(message, Odometry):
            driven = float(message.pose[0])
            heading, beyond = VEER * min(driven, OPEN), max(driven - OPEN, 0.0)
            end_of_arc = np.array([math.sin(heading), 1.0 - math.cos(heading), VEER * heading]) / VEER
            yield replace(message, pose=se2.compose(end_of_arc, np.array([beyond, 0.0, 0.0])))
        else:
            yield message


@pytest.mark.slow
def test_the_last_view_before_nothing_is_seen_is_a_keyframe() -> None:
    """Up to it, scans correct odometry, however long ago the last keyframe was."""
    mapping, odometry = MappingConfig(keyframe_distance=4.4), OdometryConfig(learn=False)
    slam = Slam(Config(mapping=mapping, odometry=odometry))
    for message in leaving_a_room():
        slam.add(message)
    before, last = slam.finish().keyframes.poses[-2:]
    assert last[0] > OPEN
    assert abs(last[2]) < 0.04 < 0.5 * VEER * (last[0] - before[0])


def test_a_robot_that_stands_where_scans_come_and_go_adds_no_keyframes() -> None:
    slam = Slam()
    messages = [message for message in leaving_a_room() if message.stamp < 8.5]
    for message in messages:
        slam.add(message)
    before = slam.slam_state.mapper.keyframe_count
    scan = next(message for message in reversed(messages) if isinstance(message, Scan))
    last = next(message for message in reversed(messages) if isinstance(message, Odometry))
    empty = np.full_like(scan.ranges, np.inf)
    for k in range(1, 80):
        stamp = scan.stamp + 0.1 * k
        slam.add(replace(scan, stamp=stamp, ranges=empty if k % 2 else scan.ranges))
        slam.add(replace(last, stamp=stamp + 0.1))
    assert slam.slam_state.mapper.keyframe_count <= before + 1

"""Which scans become keyframes, and what is learned from those between them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from drivers import se2
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation, load_world
from slam import Slam
from slam.config import Config, config_to_toml
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
    state.set_anchor(Anchor(0, np.zeros(3), np.zeros((3, 3)), np.zeros(3)))
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
    for message in Simulation(load_world("office"), 3, 20.0, LIDAR_MODELS["long"], WHEEL_MODELS["good"]):
        slam.add(message)
    state = slam.slam_state
    samples = state.odometry_model.samples
    assert len(samples) > 1.2 * state.mapper.keyframe_count
    assert np.abs(samples[:, :2] - samples[:, 3:5]).max() < 0.05  # odometry and scans measured the same motion


def test_where_learning_stopped_is_kept_with_a_session(tmp_path: Path) -> None:
    slam = Slam()
    for message in Simulation(load_world("office"), 3, 60.0, LIDAR_MODELS["long"], WHEEL_MODELS["good"]):
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
    for field in ("relative", "covariance", "odometry"):
        np.testing.assert_array_equal(getattr(restored, field), getattr(expected, field))

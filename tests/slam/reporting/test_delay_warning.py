"""A run warns of a lidar whose stamps are late against odometry, as it cannot look ahead."""

from dataclasses import replace

import pytest

from drivers.messages import Scan
from drivers.simulation import Simulation
from slam.config import Config, LidarConfig
from slam.events import EventRecorder, Notice
from slam.pipeline import Slam

LATE = 0.1
"""Seconds by which the scans are stamped late."""


def warnings_of_drive(late: float, config: Config) -> list[Notice]:
    """Return the warnings of a delay in 40 seconds of driving whose scans are stamped `late` seconds late."""
    recorder = EventRecorder()
    pipeline = Slam(config, [recorder])
    messages = [
        replace(message, stamp=message.stamp + late) if isinstance(message, Scan) else message
        for message in Simulation("office", seed=3, duration=40.0)
    ]
    for message in sorted(messages, key=lambda message: message.stamp):
        pipeline.add(message)
    pipeline.finish()
    return [notice for notice in recorder.of(Notice) if "lidar.delay" in notice.text]


def test_a_late_lidar_is_named_once_while_the_robot_drives() -> None:
    (warning,) = warnings_of_drive(LATE, Config())
    assert warning.level == "WARN"
    assert warning.stamp < 35.0
    seconds = float(warning.text.split("add ")[1].split()[0])
    assert seconds == pytest.approx(LATE, abs=0.03)


@pytest.mark.parametrize(("late", "config"), [(0.0, Config()), (LATE, Config(lidar=LidarConfig(delay=LATE)))])
def test_a_lidar_that_is_not_late_or_whose_delay_is_set_is_not_named(late: float, config: Config) -> None:
    assert warnings_of_drive(late, config) == []

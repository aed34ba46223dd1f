"""Choice between several topics with scans."""

from __future__ import annotations

import numpy as np
import pytest

import drivers
from drivers import Scan
from drivers.recordings.scan_topics import ScanTopic, choose_scan_topic

from ...recordings import dataset_file


def topic(name: str, stamps: list[float], returns: int = 90, defect: str = "") -> ScanTopic:
    scans = ScanTopic(name, defect)
    ranges = np.where(np.arange(100) < returns, 1.0, np.nan)
    for stamp in stamps:
        scans.add(Scan(stamp, ranges, np.linspace(-1, 1, 100), np.zeros(100), 0.1, 10.0))
    return scans


STEADY = [0.2 * i for i in range(200)]
RANDOM = np.random.default_rng(1)
SENT_LATE = [stamp + RANDOM.uniform(0.0, 0.2) for stamp in STEADY]


@pytest.mark.parametrize(
    ("worse", "better"),
    [
        (topic("late", [*SENT_LATE, 41.0, 41.1]), topic("steady", STEADY)),
        (topic("doubled", [s for stamp in STEADY for s in (stamp, stamp)]), topic("steady", STEADY)),
        (topic("few returns", STEADY, returns=30), topic("steady", STEADY)),
        (topic("rare", STEADY[::4]), topic("steady", STEADY)),
        (topic("late", SENT_LATE), topic("with losses", [s for s in STEADY if RANDOM.random() < 0.8])),
        (topic("one scan", STEADY[:1]), topic("steady", STEADY)),
        (topic("unreadable", []), topic("steady", STEADY)),
        (topic("one stamp", [1.0] * 300), topic("steady", STEADY)),
        (topic("tilting", STEADY, defect="of a lidar that moves on the robot"), topic("steady", STEADY, returns=30)),
    ],
    ids=lambda topic: topic.name,
)
def test_topic_with_more_returns_at_even_stamps_is_chosen(worse: ScanTopic, better: ScanTopic) -> None:
    assert choose_scan_topic([worse, better])[0] == better.name
    name, reason = choose_scan_topic([better, worse])
    assert name == better.name
    assert worse.name in reason
    assert reason.endswith("; lidar.topic names another topic")
    assert "\n" not in reason


def test_first_of_equal_topics_is_chosen() -> None:
    assert choose_scan_topic([topic("a", STEADY), topic("b", STEADY)])[0] == "a"


@pytest.mark.parametrize("name", ["left_side", "middle", "right_side"])
def test_scans_stamped_with_their_measurement_are_preferred(name: str) -> None:
    source = drivers.open(dataset_file(f"neato/{name}.bag"), "forward")
    assert sum(isinstance(message, Scan) for message in source) > 170
    (reason,) = source.report.interpretations
    assert reason.startswith("scans of /stable_scan: ")

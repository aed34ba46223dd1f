"""The delay between lidar and odometry is found with its standard deviation, and objected to if it does not matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import drivers
from drivers.messages import GroundTruth, Message, Odometry, Scan, delay_odometry
from drivers.recordings.rosbag import BagReader
from drivers.simulation import WHEEL_MODELS, Simulation
from drivers.timing.delay import estimate_delay
from drivers.timing.turns import Turns

from ...recordings import dataset_file
from .drives import office_drive, with_few_returns, with_late_scans


@pytest.mark.parametrize(
    ("seed", "seconds"), [(0, 0.0), (0, 0.05), pytest.param(1, -0.3, marks=pytest.mark.slow), (1, 0.5)]
)
def test_known_delay_is_found_within_three_standard_deviations(seed: int, seconds: float) -> None:
    delay = estimate_delay(Turns(with_late_scans(office_drive(seed, 30.0), seconds)))
    assert delay is not None
    assert abs(delay.seconds - seconds) < 3.0 * delay.sigma
    assert delay.sigma < 0.02
    assert (delay.objection is None) == (abs(seconds) > 0.1)  # less is not significant


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_delay_is_found_where_most_scans_have_too_few_returns_to_be_matched(seed: int) -> None:
    late = with_few_returns(with_late_scans(office_drive(seed, 30.0), 0.35))
    turns = Turns(late)
    assert sum(len(run.scans) for run in turns.runs) < 0.4 * turns.scans
    delay = estimate_delay(turns)
    assert delay is not None
    assert delay.objection is None
    assert abs(delay.seconds - 0.35) < 3.0 * delay.sigma
    assert delay.sigma < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.0, 0.3])
@pytest.mark.parametrize("world", ["square", "equal_doors"])
def test_straight_corridor_with_few_turns_does_not_determine_a_delay(world: str, seconds: float) -> None:
    drive = tuple(drivers.open(f"sim:{world}?duration=45&lidar=short"))
    assert estimate_delay(Turns(with_late_scans(drive, seconds))) is None


def test_scans_without_surfaces_do_not_determine_a_delay() -> None:
    scattered = with_few_returns(office_drive(0, 30.0), every=6, reach=2.0)
    assert not Turns(scattered).runs
    assert estimate_delay(Turns(scattered)) is None


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [1.1, 1.3])
def test_delay_beyond_those_that_are_tried_is_not_taken_for_a_shorter_one(seconds: float) -> None:
    assert estimate_delay(Turns(with_few_returns(with_late_scans(office_drive(0, 30.0), seconds)))) is None


def test_delay_of_a_drive_that_is_mostly_straight_is_compensated() -> None:
    """The typical error of the turns from scan to scan is that of scan matching, which a delay does not change."""
    drive = tuple(drivers.open("sim:equal_offices?duration=45&lidar=short&seed=2"))
    delay = estimate_delay(Turns(with_late_scans(drive, 0.3)))
    assert delay is not None
    assert delay.objection is None


def test_gaps_of_the_odometry_do_not_hide_a_delay() -> None:
    late = with_late_scans(office_drive(), 0.4)
    start = late[0].stamp
    gappy = [m for m in late if isinstance(m, Scan) or (m.stamp - start) % 10.0 > 0.8]
    delay = estimate_delay(Turns(gappy))
    assert delay is not None
    assert delay.objection is None
    assert abs(delay.seconds - 0.4) < 3.0 * delay.sigma


def test_drive_without_turns_does_not_determine_a_delay() -> None:
    delay = estimate_delay(Turns(drivers.open("sim:corridor?duration=15&lidar=short")))
    assert delay is None or delay.objection is not None
    assert estimate_delay(Turns([])) is None


@pytest.mark.parametrize("noise", [1e-5, 1e-3])
@pytest.mark.parametrize("seed", [*(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3)), 3])
def test_noise_of_a_robot_that_stands_does_not_determine_a_delay(seed: int, noise: float) -> None:
    source, drive = np.random.default_rng(seed), office_drive()
    first = next(message for message in drive if isinstance(message, Scan))
    standing: list[Message] = []
    for message in drive:
        if isinstance(message, Scan):
            ranges = first.ranges + source.normal(0.0, 0.01, len(first.ranges))
            standing.append(replace(first, stamp=message.stamp, ranges=ranges))
        elif isinstance(message, Odometry):
            standing.append(replace(message, pose=source.normal(0.0, noise, 3)))
    assert estimate_delay(Turns(standing)) is None


def test_odometry_is_moved_onto_the_clock_of_the_lidar() -> None:
    scan = next(message for message in office_drive() if isinstance(message, Scan))
    reading = next(message for message in office_drive() if isinstance(message, Odometry))
    assert delay_odometry(reading, 0.3).stamp == reading.stamp + 0.3
    assert delay_odometry(scan, 0.3) is scan
    assert delay_odometry(GroundTruth(1.0, reading.pose), 0.3).stamp == 1.3  # which is on the clock of odometry


def test_delay_of_a_public_recording_is_compensated_even_if_it_is_shorter_than_the_period_of_its_scans() -> None:
    reader = drivers.source_factory.recording_of(drivers.open(dataset_file("fr079/fr079.clf")))
    assert reader is not None
    assert reader.delay is not None
    assert reader.delay.objection is None
    assert 0.1 < reader.delay.seconds < 0.2


def test_delay_of_a_public_recording_is_found() -> None:
    """Its scans are published as they were sent, and with stamps that somebody has corrected."""
    file = dataset_file("neato/middle.bag")
    sent = BagReader(file, scan_topic="/scan").delay
    assert sent is not None
    assert sent.objection is None
    assert 0.2 < sent.seconds < 0.5
    corrected = BagReader(file, scan_topic="/stable_scan").delay
    assert corrected is not None
    assert corrected.objection is not None


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 10])
def test_a_delay_that_does_not_explain_the_turns_from_scan_to_scan_is_objected_to(seed: int) -> None:
    """With worn wheels and few turns, the drift of odometry looks like a significant delay, of 0.35 and 0.28 s here."""
    delay = estimate_delay(Turns(Simulation("office", seed, 15.0, wheels=WHEEL_MODELS["bad"])))
    assert delay is not None
    assert delay.objection == "contradicted by the turns from scan to scan"

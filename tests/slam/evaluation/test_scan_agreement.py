"""Agreement of scans along a path."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Scan
from drivers.simulation import LidarModel, Simulation
from slam.evaluation.scan_agreement import BeamTable
from slam.io.tum import Trajectory

ANGLES = np.radians(np.arange(-60.0, 61.0))


def wall(stamp: float, distance: float, mount: tuple[float, float, float] | None = None) -> Scan:
    """Return a scan of a wall across the view at a distance from the lidar."""
    return Scan(stamp, distance / np.cos(ANGLES), ANGLES, np.zeros(len(ANGLES)), 0.0, 40.0, mount)


def standing(*poses: tuple[float, float, float]) -> Trajectory:
    return Trajectory(np.arange(len(poses), dtype=float), np.array(poses))


def test_scans_from_their_true_poses_agree() -> None:
    scans = [wall(0.0, 3.0125), wall(1.0, 2.0125), wall(2.0, 1.0125)]
    agreement = BeamTable(scans).agreement(standing((0, 0, 0), (1, 0, 0), (2, 0, 0)))
    assert agreement.conflict == 0.0
    assert agreement.entropy < 0.05
    assert agreement.placed == 1.0


def test_a_wall_that_other_scans_see_through_is_in_conflict() -> None:
    scans = [wall(float(k), 3.0125 if k < 8 else 2.0125) for k in range(12)]
    agreement = BeamTable(scans).agreement(standing(*[(0, 0, 0)] * 12))
    assert agreement.conflict == pytest.approx(1 / 3, abs=0.05)
    assert agreement.entropy > 0.2


def test_the_mount_and_the_motion_during_a_scan_are_used() -> None:
    lidar = LidarModel(beams=180, sigma_range=0.001, sigma_bearing=0.0, mixed=0.0, dropouts=0.0)
    drive = Simulation("room", duration=8.0, lidar=lidar, mount=(0.3, 0.1, 2.0))
    scans = [message for message in drive if isinstance(message, Scan)]
    stamps = np.arange(0.0, 8.0, 0.02)
    truth = drive.trajectory.poses_at(stamps)
    right = BeamTable(scans).agreement(Trajectory(stamps, truth))
    swaying = se2.compose(truth, np.outer(np.sin(stamps), [0.0, 0.0, 0.1]))
    other = BeamTable(scans).agreement(Trajectory(stamps, swaying))
    assert right.conflict < 0.02
    assert right.entropy < 0.2 * other.entropy


def test_scans_far_from_the_path_in_time_are_not_placed() -> None:
    scans = [wall(0.0, 3.0), wall(1.0, 3.0), wall(1.4, 3.0), wall(9.0, 3.0)]
    assert BeamTable(scans).agreement(standing((0, 0, 0), (0, 0, 0))).placed == 0.75
    late = Trajectory(np.array([50.0]), np.zeros((1, 3)))
    agreement = BeamTable(scans).agreement(late)
    assert agreement.placed == 0.0
    assert np.isnan([agreement.entropy, agreement.conflict]).all()
    assert np.isnan(BeamTable().agreement(late).entropy)


def test_an_absurd_path_has_no_value() -> None:
    agreement = BeamTable([wall(0.0, 3.0), wall(1.0, 3.0)]).agreement(standing((0, 0, 0), (1e6, 1e6, 0)))
    assert np.isnan(agreement.entropy)
    assert agreement.placed == 1.0

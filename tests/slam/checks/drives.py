"""Simulated drives for the checks: true poses as the path, so that every error in it is one that a test put there."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from drivers import se2
from drivers.messages import GroundTruth
from drivers.simulation import LidarModel, Simulation
from slam.checks.drive import Drive
from slam.config import Config
from slam.odometry.error_model import OdometryModel
from slam.preprocessing.preprocessor import Preprocessor

LIDAR = LidarModel(beams=180, rate=4.0, range_max=20.0)


@cache
def simulated_drive(world: str, seed: int = 0) -> Drive:
    """Return a drive whose path is the true one; odometry has the simulator's errors."""
    simulation, config = Simulation(world, seed=seed, lidar=LIDAR), Config()
    preprocessor, model = Preprocessor(config), OdometryModel(config.odometry)
    for message in simulation:
        if not isinstance(message, GroundTruth):
            preprocessor.add(message)
    scans = []
    while (scan := preprocessor.next_scan(flush=True)) is not None:
        scans.append(preprocessor.process(scan, model))
    stamps = np.array([scan.stamp for scan in scans])
    return Drive(
        stamps=stamps,
        poses=simulation.trajectory.poses_at(stamps),
        odometry=np.array([scan.odometry for scan in scans]),
        segment=np.zeros(len(scans), dtype=np.int64),
        points=[scan.features.points.xy for scan in scans],
        deviations=np.array([0.04, 0.04, 0.03, 0.03]),
        floors=np.array([config.odometry.translation_floor, config.odometry.rotation_floor]),
        measured=np.ones(len(scans), dtype=bool),
        dropped=np.zeros(len(scans), dtype=bool),
    )


def moved_from(poses: np.ndarray, row: int, motion: np.ndarray) -> np.ndarray:
    """Return the poses (n, 3), with those from `row` on moved as if an additional motion led to the pose of `row`."""
    moved = poses.copy()
    moved[row:] = se2.compose(se2.compose(poses[row], motion), se2.between(poses[row], poses[row:]))
    return moved


def row_at(drive: Drive, stamp: float) -> int:
    """Return the first scan from a stamp on."""
    return int(np.searchsorted(drive.stamps, stamp))


def carried(drive: Drive, first: float, last: float) -> Drive:
    """Return the drive as if the robot had been carried from where it was at `first` to where it was at `last`.

    The scans in between are missing, and odometry has not noticed; the path is right.
    """
    before, after = row_at(drive, first), row_at(drive, last)
    kept = np.r_[0:before, after : len(drive)]
    odometry = drive.odometry.copy()
    odometry[after:] = se2.compose(odometry[before - 1], se2.between(odometry[after], odometry[after:]))
    stamps = drive.stamps.copy()
    stamps[after:] -= last - first
    return only(replace(drive, stamps=stamps, odometry=odometry), kept)


def only(drive: Drive, rows: np.ndarray) -> Drive:
    """Return the drive with some of its scans only."""
    names = "stamps", "poses", "odometry", "segment", "measured", "dropped"
    points = [drive.points[row] for row in rows.tolist()]
    return replace(drive, points=points, **{name: getattr(drive, name)[rows] for name in names})

"""Fit of scans along a path and by relations: it tells which of both is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import Scan, se2
from drivers.simulation import LidarModel, Simulation
from slam.errors import MapError
from slam.evaluation.metrics import Relations
from slam.evaluation.relation_fit import compare_fits
from slam.io.tum import Trajectory

WRONG = np.array([0.1, 0.0, 0.0])  # error of a motion, metres along it
EVERY = 3  # motions, one of which is wrong


@pytest.fixture(scope="module")
def drive() -> tuple[Trajectory, Relations, list[Scan]]:
    """Return the true path of a drive, relations between scans one second apart, and the scans."""
    simulation = Simulation("office", seed=3, duration=30.0, lidar=LidarModel(beams=360, rate=5.0))
    scans = [message for message in simulation if isinstance(message, Scan)]
    stamps = np.array([scan.stamp for scan in scans])
    middles = np.array([scan.stamp + np.mean(scan.time_offsets) for scan in scans])
    path = Trajectory(stamps, simulation.trajectory.poses_at(middles))
    first, second = np.arange(0, len(scans) - 10, 5), np.arange(10, len(scans), 5)
    motion = se2.between(path.poses[first], path.poses[second])
    return path, Relations(stamps[first], stamps[second], motion), scans


def with_errors(motion: np.ndarray) -> np.ndarray:
    changed = motion.copy()
    changed[::EVERY] = se2.compose(changed[::EVERY], WRONG)
    return changed


def test_the_path_fits_better_where_relations_are_wrong(drive: tuple[Trajectory, Relations, list[Scan]]) -> None:
    path, relations, scans = drive
    fit = compare_fits(path, Relations(relations.first, relations.second, with_errors(relations.motion)), scans)
    wrong = fit.errors > 0.05
    assert wrong.sum() == len(relations.motion[::EVERY])
    assert np.mean(fit.by_path[wrong] > fit.by_relation[wrong]) > 0.95
    np.testing.assert_allclose(fit.by_path[~wrong], fit.by_relation[~wrong])
    figures = fit.figures()
    assert figures["path_fits_better_of_large"] == 1.0
    assert figures["large_errors_from"] > 0.05


def test_relations_fit_better_where_the_path_is_wrong(drive: tuple[Trajectory, Relations, list[Scan]]) -> None:
    path, relations, scans = drive
    bent = Trajectory(path.stamps, path.poses * np.array([1.05, 1.0, 1.0]))
    fit = compare_fits(bent, relations, scans[::-1])  # in any order
    assert np.mean(fit.by_path > fit.by_relation) < 0.2


def test_relations_may_name_the_middle_of_a_sweep(drive: tuple[Trajectory, Relations, list[Scan]]) -> None:
    """As in a log that states no times of the beams, if these are found."""
    path, relations, scans = drive
    half = 0.5 * scans[0].duration
    assert half > 0.05
    later = Relations(relations.first + half, relations.second + half, relations.motion)
    fit = compare_fits(Trajectory(path.stamps + half, path.poses), later, scans)
    np.testing.assert_array_equal(fit.by_path, compare_fits(path, relations, scans).by_path)


def test_relations_of_another_drive_are_refused(drive: tuple[Trajectory, Relations, list[Scan]]) -> None:
    path, relations, scans = drive
    for others in (Relations(relations.first + 1e4, relations.second + 1e4, relations.motion), relations):
        with pytest.raises(MapError, match="same drive"):
            compare_fits(path, others, scans if others is not relations else [])

"""Odometry with inexact stamps: the error of stamps, and the motion during a sweep."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers import se2
from slam.odometry.history import OdometryHistory, error_of_stamps
from slam.odometry.smoothing import ACCELERATION_DENSITY, JITTER, REACH, smoothed_poses

TWIST = np.array([0.6, 0.0, 0.4])


def poses_at(stamps: Any) -> Any:
    """Poses of a robot that drives along a circle."""
    angle = TWIST[2] * np.asarray(stamps)
    radius = TWIST[0] / TWIST[2]
    return np.column_stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), angle])


def history_of(sigma: float, period: float = 0.02, seed: int = 0) -> OdometryHistory:
    """Readings of 20 s with errors of their stamps."""
    true = np.arange(0.0, 20.0, period)
    stamps = true + sigma * np.random.default_rng(seed).standard_normal(len(true))
    order = np.argsort(stamps)
    return OdometryHistory.from_arrays(
        np.maximum.accumulate(stamps[order] + 1e-9 * np.arange(len(true))), poses_at(true)
    )


@pytest.mark.parametrize("sigma", [0.0, 0.001, 0.003])
def test_the_error_of_stamps_shows_where_the_robot_drives_evenly(sigma: float) -> None:
    history = history_of(sigma)
    assert history.stamp_error(20.0) == pytest.approx(sigma, rel=0.2, abs=1e-4)


def test_no_error_of_stamps_is_known_of_a_standing_robot_or_from_few_readings() -> None:
    stamps = np.arange(0.0, 5.0, 0.02)
    assert error_of_stamps(stamps, np.zeros((len(stamps), 3))) == 0.0
    assert error_of_stamps(stamps[:10], poses_at(stamps[:10])) == 0.0
    assert OdometryHistory().stamp_error(0.0) == 0.0


def test_the_error_of_stamps_does_not_depend_on_later_readings() -> None:
    history = history_of(0.003)
    until_now = OdometryHistory.from_arrays(history.stamps[:700], history.poses[:700])
    assert until_now.stamp_error(12.0) == history.stamp_error(12.0) != history.stamp_error(18.0)


def test_slips_do_not_look_like_errors_of_stamps() -> None:
    stamps = np.arange(0.0, 5.0, 0.02)
    poses = poses_at(stamps)
    poses[100:, 0] += 0.3
    assert error_of_stamps(stamps, poses) < 1e-4


def test_exact_readings_are_kept() -> None:
    sweep = 10.0 + np.linspace(0.003, 0.103, 9)
    difference = se2.between(poses_at(sweep), smoothed_poses(history_of(0.0), sweep)[0])
    np.testing.assert_allclose(difference, 0.0, atol=5e-5)


@pytest.mark.parametrize("sigma", [0.003, 0.01])
def test_inexact_stamps_bend_a_sweep_several_times_less(sigma: float) -> None:
    history, errors = history_of(sigma), []
    for begin in np.arange(2.0, 18.0, 0.4):
        sweep = begin + np.linspace(0.0, 0.1, 9)
        true = se2.between(poses_at(sweep)[4], poses_at(sweep))
        both = [smoothed_poses(history, sweep)[0], history.at_each(sweep)]
        errors.append([np.hypot(*(se2.between(poses[4], poses) - true)[:, :2].T).max() for poses in both])
    smoothed, interpolated = np.sqrt(np.mean(np.square(errors), axis=0))
    assert smoothed < 0.4 * interpolated


def test_the_smoothed_motion_is_that_of_a_gaussian_process() -> None:
    history, sweep = history_of(0.01, period=0.05, seed=5), 8.0 + np.linspace(0.0, 0.2, 9)
    times, readings = history.readings_between(sweep[0] - REACH, sweep[-1])
    origin = readings[np.searchsorted(times, sweep[0]) - 1]
    speed = (TWIST[0] + 0.25 * TWIST[2]) * (len(times) - 1) * 0.05 / (times[-1] - times[0])
    ratio = ((speed * history.stamp_error(sweep[0])) ** 2 + JITTER[0] ** 2) / ACCELERATION_DENSITY

    def covariance(a: Any, b: Any) -> Any:
        x, y = np.meshgrid(a - times[0], b - times[0], indexing="ij")
        low = np.minimum(x, y)
        return low**3 / 3.0 + low**2 * np.abs(x - y) / 2.0 + 1e4 * x * y + 1e4

    weights = np.linalg.solve(covariance(times, times) + ratio * np.eye(len(times)), se2.between(origin, readings))
    expected = se2.compose(origin, covariance(sweep, times) @ weights)
    np.testing.assert_allclose(smoothed_poses(history, sweep)[0], expected, atol=1e-5)


def test_stamps_outside_of_the_readings_or_few_readings_are_interpolated() -> None:
    history = history_of(0.0)
    for sweep in (np.array([-0.1, 0.0, 0.1]), np.array([19.9, 20.0, 20.1])):
        np.testing.assert_array_equal(smoothed_poses(history, sweep)[0], history.at_each(sweep))
    few = OdometryHistory.from_arrays(np.array([0.0, 1.0, 2.0]), poses_at([0.0, 1.0, 2.0]))
    sweep = np.array([0.9, 1.0, 1.1])
    np.testing.assert_array_equal(smoothed_poses(few, sweep)[0], few.at_each(sweep))


@pytest.mark.parametrize("period", [0.02, 0.05])
@pytest.mark.parametrize("sigma", [0.003, 0.01])
def test_the_error_of_the_speed_is_stated(sigma: float, period: float) -> None:
    history, errors, stated = history_of(sigma, period), [], []
    for begin in np.arange(3.0, 19.0, 0.05):
        poses, error = smoothed_poses(history, begin + np.linspace(0.0, 0.1, 9))
        errors.append(se2.between(poses[0], poses[-1])[2] / (0.1 * TWIST[2]) - 1.0)
        stated.append(error)
    assert 0.8 < np.std(errors) / np.sqrt(np.mean(np.square(stated))) < 1.5  # readings also change places


def test_the_speed_of_exact_readings_has_no_error() -> None:
    assert smoothed_poses(history_of(0.0), 10.0 + np.linspace(0.003, 0.103, 9))[1] < 1e-3

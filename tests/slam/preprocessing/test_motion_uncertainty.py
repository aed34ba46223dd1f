"""The covariances with the motion's uncertainty imply the true covariance of the robot's pose."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from slam.config import OdometryConfig
from slam.geometry.segments import CornerPoints, Segments
from slam.odometry.error_model import OdometryModel
from slam.preprocessing.motion_uncertainty import add_motion_uncertainty

BEAMS = 400
END = 0.04
"""Metres of travel from the middle of the sweep to either end."""
SWEEPS = 3000
MODEL = OdometryModel(OdometryConfig(translation_error=0.02, rotation_walk=0.01))
NO_CORNERS = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))


@pytest.mark.parametrize("sigma", [1e-4, 2e-3, 0.02], ids=["motion dominates", "both", "sensor dominates"])
@pytest.mark.parametrize("count", [4, 20])
@pytest.mark.parametrize("fitted", [0.0, 0.01, END], ids=["not fitted", "over a quarter", "over the whole sweep"])
def test_pose_estimates_have_the_covariance_that_independent_segments_imply(
    count: int, sigma: float, fitted: float
) -> None:
    random = np.random.default_rng(count)
    segments, beams, travel = scan(random, count, sigma)
    sweep = SimpleNamespace(travel=np.abs(travel), fitted=fitted)
    lines = SimpleNamespace(first=beams, last=beams)
    claimed = add_motion_uncertainty(segments, NO_CORNERS, lines, sweep, MODEL)[0].covariance  # type: ignore[arg-type]
    jacobians = pose_jacobians(segments)
    weights = np.linalg.inv(claimed)
    normal = np.einsum("nki,nkl,nlj->ij", jacobians, weights, jacobians)
    motions = motion_errors(random, travel, fitted, SWEEPS)[:, beams]
    noise = sigma * random.standard_normal((SWEEPS, count, 2))
    measured = np.einsum("nki,mni->mnk", jacobians, motions) + noise
    gradients = np.einsum("nki,nkl,mnl->mi", jacobians, weights, measured, optimize=True)
    errors = np.linalg.solve(normal, gradients.T).T
    nees = np.einsum("ni,ij,nj->n", errors, normal, errors).mean() / 3
    assert 0.85 < nees < 1.15


def test_a_segment_is_at_least_as_uncertain_as_its_own_error() -> None:
    segments, beams, travel = scan(np.random.default_rng(1), 12, 1e-3)
    sweep = SimpleNamespace(travel=np.abs(travel), fitted=0.0)
    lines = SimpleNamespace(first=beams, last=beams)
    widened = add_motion_uncertainty(segments, NO_CORNERS, lines, sweep, MODEL)[0]  # type: ignore[arg-type]
    rotation = MODEL.variances(np.abs(travel[beams]))[1]
    added = widened.covariance[:, 1, 1] - segments.covariance[:, 1, 1]
    assert (added >= rotation * (1.0 - 1e-9)).all()


def scan(random: np.random.Generator, count: int, sigma: float) -> tuple[Segments, np.ndarray, np.ndarray]:
    """Return segments around the robot, the beam in the middle of each, and the signed travel at all beams."""
    beams = np.sort(random.choice(BEAMS, count, replace=False))
    bearings, distances = 2 * np.pi * beams / BEAMS, random.uniform(1.0, 5.0, count)
    frames = np.column_stack(
        [
            distances * np.cos(bearings),
            distances * np.sin(bearings),
            bearings - np.pi / 2 + random.normal(0, 0.5, count),
        ]
    )
    segments = Segments(frames, np.full(count, 0.5), np.tile(sigma**2 * np.eye(2), (count, 1, 1)))
    return segments, beams, np.linspace(-END, END, BEAMS)


def pose_jacobians(segments: Segments) -> np.ndarray:
    """Return (n, 2, 3) the derivatives of offsets and headings by the pose."""
    across = np.column_stack([-np.sin(segments.frame[:, 2]), np.cos(segments.frame[:, 2])])
    lever = across[:, 1] * segments.frame[:, 0] - across[:, 0] * segments.frame[:, 1]
    zero = np.zeros(len(lever))
    return np.stack([np.column_stack([across, lever]), np.column_stack([zero, zero, zero + 1.0])], axis=1)


def motion_errors(random: np.random.Generator, travel: np.ndarray, fitted: float, count: int) -> np.ndarray:
    """Return (m, p, 3) errors of position and heading at beams of `count` sweeps: proportional to travel, and a random
    walk both ways.

    They are relative to the middle of a parabola fitted within `fitted` metres from the middle; if that is zero, to the
    middle itself.
    """
    translation, rotation = MODEL.variances(np.ones(()))
    step = np.diff(travel).mean()
    walks = np.cumsum(np.sqrt(rotation * step) * random.standard_normal((count, len(travel))), axis=1)
    inside = np.abs(travel) <= fitted
    if fitted:
        middles = np.polyfit(travel[inside], walks[:, inside].T, 2)[-1]
    else:
        middles = np.array([np.interp(0.0, travel, walk) for walk in walks])
    positions = np.sqrt(translation) * random.standard_normal((count, 1, 2)) * travel[:, None]
    return np.concatenate([positions, (walks - middles[:, None])[..., None]], axis=2)

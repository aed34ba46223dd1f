"""Segmentation into walls: simulated rooms, openings, spurious returns, grazing walls, the end of a revolution."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from features import Extractor, Features, Noise
from features.kernel import TRIMMED_RAYS
from features.splitting import argmax_positive

FINE = Noise(0.01, np.radians(0.05))
COARSE = Noise(0.05, np.radians(0.196))


def scan_of(distance: Callable[[np.ndarray], np.ndarray], angles: np.ndarray, noise: float = 0.005) -> np.ndarray:
    return distance(angles) + np.random.default_rng(1).normal(0, noise, len(angles))


def extract(ranges: np.ndarray, angles: np.ndarray, noise: Noise = FINE, **options: object) -> Features:
    return Extractor(noise, adapt_noise=False, **options).extract(ranges, angles)


@pytest.mark.parametrize(
    ("noise", "outliers", "precision", "recall", "corner_recall", "corner_precision"),
    [
        (FINE, 0.0, 0.99, 0.99, 0.98, 0.98),
        pytest.param(FINE, 0.01, 0.97, 0.98, 0.96, 0.97, marks=pytest.mark.slow),
        pytest.param(COARSE, 0.0, 0.97, 0.96, 0.92, 0.92, marks=pytest.mark.slow),
    ],
)
def test_walls_and_corners_of_rooms_are_found(
    score_rooms: Callable[..., object],
    noise: Noise,
    outliers: float,
    precision: float,
    recall: float,
    corner_recall: float,
    corner_precision: float,
) -> None:
    extractor = Extractor(noise, adapt_noise=False)
    sigmas = {"sigma_range": noise.sigma_range, "sigma_bearing": noise.sigma_bearing}
    score = score_rooms(extractor, 60, outliers=outliers, **sigmas)
    assert score.precision > precision
    assert score.recall > recall
    assert score.corner_recall > corner_recall
    assert score.corner_precision > corner_precision
    # two dimensions: a mean of 2, a median of 1.39
    assert 1.2 < np.median(score.line_nees) < 1.6
    assert 1.1 < np.median(score.corner_nees) < 1.6
    assert 1.6 < np.mean(score.corner_nees) < 2.4


def test_tracking_requires_little_noise(score_rooms: Callable[..., object]) -> None:
    """The paper's threshold of 20 mm suits noise far below it, and splits walls at 10 mm of noise."""
    quiet = score_rooms(
        Extractor(Noise(0.003, np.radians(0.02)), adapt_noise=False, method="tracking"),
        20,
        sigma_range=0.003,
        sigma_bearing=np.radians(0.02),
    )
    assert quiet.recall > 0.97
    loud = score_rooms(
        Extractor(FINE, adapt_noise=False, method="tracking"), 20, sigma_range=0.01, sigma_bearing=np.radians(0.05)
    )
    assert loud.recall < 0.9


def test_isolated_returns_are_not_walls() -> None:
    rng = np.random.default_rng(2)
    angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    assert len(extract(rng.uniform(0.5, 8.0, 720), angles).lines) == 0


def test_mixed_pixels_are_not_walls() -> None:
    """A post in front of a wall, with three returns between them at either edge."""
    angles = np.radians(np.arange(-45, 45, 0.33))
    ranges = scan_of(lambda a: 4.0 / np.cos(a), angles)
    post = np.abs(angles) < 0.12
    ranges[post] = 1.5 / np.cos(angles[post])
    edges = np.flatnonzero(np.diff(post.astype(int)))
    for edge in edges:
        for k, share in enumerate((0.25, 0.5, 0.75)):
            ranges[edge - 1 + k] = 1.5 + 2.5 * (share if edge == edges[1] else 1 - share)
    lines = extract(ranges, angles).lines
    assert len(lines) == 3
    np.testing.assert_allclose(1 / np.hypot(*lines.uv.T), [4.0, 1.5, 4.0], atol=0.02)


@pytest.mark.parametrize("opening", [0.0, 0.15])
def test_wall_continues_across_a_small_gap(opening: float) -> None:
    angles = np.radians(np.arange(-60, 60, 1.0))
    ranges = scan_of(lambda a: 3.0 / np.cos(a), angles)
    ranges[np.abs(3.0 * np.tan(angles) - 0.7) < opening / 2] = 6.0
    lines = extract(ranges, angles).lines
    assert len(lines) == 1
    assert lines.count[0] > 115 - 2 * TRIMMED_RAYS


@pytest.mark.parametrize("behind", [3.4, 6.0, np.nan, np.inf, 100.0])
@pytest.mark.parametrize("step", [0.33, 1.0])
def test_opening_separates_two_walls(behind: float, step: float) -> None:
    angles = np.radians(np.arange(-60, 60, step))
    ranges = scan_of(lambda a: 3.0 / np.cos(a), angles)
    opening = np.abs(3.0 * np.tan(angles) - 0.7) < 0.4
    ranges[opening] = behind / np.cos(angles[opening])
    lines = extract(ranges, angles).lines
    at_wall = np.abs(1 / np.hypot(*lines.uv.T) - 3.0) < 0.05
    assert at_wall.sum() == 2
    assert len(lines) <= 3


def test_spurious_returns_do_not_split_a_wall() -> None:
    angles = np.radians(np.arange(-60, 60, 0.5))
    ranges = scan_of(lambda a: 3.0 / np.cos(a), angles)
    for ray, length in ((30, 1), (77, 2), (120, 1), (170, 3)):
        ranges[ray : ray + length] *= 0.6
    lines = extract(ranges, angles).lines
    assert len(lines) == 1
    assert lines.count[0] == len(angles) - 7 - 2 * TRIMMED_RAYS


def test_wall_at_grazing_incidence_is_one_line() -> None:
    """Along a corridor, with one degree between beams, neighbouring returns on a wall are metres apart."""
    angles = np.radians(np.arange(-90, 91, 1.0))
    with np.errstate(divide="ignore"):
        ranges = np.minimum(1.0 / np.maximum(np.abs(np.sin(angles)), 1e-9), 15.0 / np.cos(angles))
    ranges = ranges + np.random.default_rng(4).normal(0, 0.01, len(angles))
    lines = extract(ranges, angles, Noise(0.01, 0.001)).lines
    sides = np.flatnonzero(np.abs(1 / np.hypot(*lines.uv.T) - 1.0) < 0.02)
    assert len(sides) == 2
    assert (np.hypot(*(lines.end - lines.start)[sides].T) > 10).all()


def test_wall_across_the_end_of_a_revolution_is_one_line() -> None:
    angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    ranges = scan_of(lambda a: 2.0 / np.maximum(np.abs(np.cos(a)), np.abs(np.sin(a))), angles)
    features = extract(ranges, angles)
    lines = features.lines
    assert len(lines) == 4
    assert len(features.corners) == 4
    assert (np.diff(lines.first) > 0).all()
    across = np.flatnonzero(lines.last < lines.first)
    assert list(across) == [3]
    np.testing.assert_allclose(lines.uv[3], [-0.5, 0.0], atol=0.005)
    assert lines.count.sum() == 720 - 4 * 2 * TRIMMED_RAYS
    assert [3, 0] in features.corners.lines.tolist()


def test_lines_run_counter_clockwise_around_the_lidar(simulate: Callable[..., object]) -> None:
    scan = simulate(3)
    lines = extract(scan.ranges, scan.angles).lines
    cross = lines.start[:, 0] * lines.end[:, 1] - lines.start[:, 1] * lines.end[:, 0]
    assert (cross > 0).all()
    for point in (lines.start, lines.end):
        np.testing.assert_allclose((lines.uv * point).sum(axis=1), 1.0)


@pytest.mark.parametrize("estimator", ["wclm", "arras-siegwart", "siadat"])
def test_all_estimators_agree(simulate: Callable[..., object], estimator: str) -> None:
    scan = simulate(4)
    expected, found = (extract(scan.ranges, scan.angles, estimator=e) for e in ("wclm-ml", estimator))
    assert (found.lines.first == expected.lines.first).all()
    difference = found.lines.uv - expected.lines.uv
    deviation = np.sqrt(np.einsum("nii->ni", expected.lines.covariance))
    assert (np.abs(difference) < 3 * deviation).all()
    np.testing.assert_allclose(found.lines.covariance, expected.lines.covariance, atol=1.0 * deviation.max() ** 2)


@settings(deadline=None)  # the first call compiles
@given(
    hnp.arrays(np.float64, st.integers(1, 60), elements=st.floats(width=16) | st.sampled_from([1.0, np.inf])), st.data()
)
def test_argmax_positive_is_the_first_maximum(gains: np.ndarray, data: st.DataObject) -> None:
    low = data.draw(st.integers(0, len(gains) - 1))
    high = data.draw(st.integers(low, len(gains) - 1))
    positive = np.where(gains[low : high + 1] > 0.0, gains[low : high + 1], 0.0)
    assert argmax_positive(gains, low, high) == (low + positive.argmax() if positive.any() else -1)
    assert argmax_positive(np.array([1.0, -np.nan, np.nan, 2.0, 2.0]), 0, 4) == 3


def test_minimum_length_and_count_are_respected(simulate: Callable[..., object]) -> None:
    scan = simulate(6)
    lines = extract(scan.ranges, scan.angles, minimum_length=1.0, minimum_count=40).lines
    assert 0 < len(lines) < len(extract(scan.ranges, scan.angles).lines)
    assert (np.hypot(*(lines.end - lines.start).T) >= 1.0).all()
    assert (lines.count >= 40).all()


def test_tracking_continues_across_the_end_of_a_revolution() -> None:
    angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    ranges = scan_of(lambda a: 2.0 / np.maximum(np.abs(np.cos(a)), np.abs(np.sin(a))), angles, noise=0.001)
    lines = extract(ranges, angles, Noise(0.001, 0.0005), method="tracking").lines
    assert len(lines) == 4
    assert (lines.last < lines.first).sum() == 1


@pytest.mark.parametrize("sigma", [0.002, 0.01, 0.02])
@pytest.mark.parametrize("radius", [0.3, 0.6, 1.5])
def test_round_column_has_no_corners(radius: float, sigma: float) -> None:
    """A column one metre in front of a wall: only the column is curved, and it does not touch the wall."""
    noise = Noise(sigma, np.radians(0.05))
    angles = np.linspace(-1.3, 1.3, 600)
    beside = (2.0 + radius) * np.sin(angles)
    with np.errstate(invalid="ignore"):
        column = (2.0 + radius) * np.cos(angles) - np.sqrt(radius**2 - beside**2)
    wall = (3.0 + 2.0 * radius) / np.cos(angles)
    corners = 0
    for seed in range(5):
        shift = np.random.default_rng(seed).normal(0.0, sigma, len(angles))
        features = extract(np.fmin(column, wall) + shift, angles, noise)
        corners += len(features.corners)
        assert not features.lines.curved[np.abs(features.lines.uv[:, 0] * (3.0 + 2.0 * radius) - 1.0) < 0.05].any()
    assert corners <= 1  # two to four in each scan without the test for curves


@pytest.mark.parametrize("sigma", [0.002, 0.005, 0.01])
@pytest.mark.parametrize("radius", [3.0, 8.0])
def test_lines_on_an_arc_are_marked_as_curved(radius: float, sigma: float) -> None:
    """In a round room all lines are chords, also those at angles of a few degrees, which form no corner."""
    angles, random = np.linspace(-np.pi, np.pi, 900, endpoint=False), np.random.default_rng(1)
    extractor = Extractor(Noise(0.01, np.radians(0.05)))
    scans = [extractor.extract(radius + random.normal(0.0, sigma, len(angles)), angles) for _ in range(10)]
    for features in scans[5:]:  # the noise has been learned
        assert len(features.corners) == 0
        assert len(features.lines) >= 6
        assert features.lines.curved.mean() > 0.95


@given(
    gap=st.floats(0.1, 0.6),
    offset=st.floats(1.0, 4.0),
    sigma=st.sampled_from([0.002, 0.01, 0.02]),
    seed=st.integers(0, 1000),
)
@settings(max_examples=30, deadline=None)
def test_parts_of_a_wall_beside_a_gap_are_no_chords(gap: float, offset: float, sigma: float, seed: int) -> None:
    """One straight line explains both as well as a curve does."""
    angles = np.linspace(-1.2, 1.2, 500)
    ranges = offset / np.cos(angles) + np.random.default_rng(seed).normal(0.0, sigma, len(angles))
    ranges[np.abs(offset * np.tan(angles)) < 0.5 * gap] = np.nan
    assert not extract(ranges, angles, Noise(sigma, np.radians(0.05))).lines.curved.any()


def test_lines_of_boxes_are_not_marked_as_curved(simulate: Callable[..., object]) -> None:
    extractor = Extractor(FINE, adapt_noise=False)
    curved = [extractor.extract(scan.ranges, scan.angles).lines.curved for scan in map(simulate, range(20))]
    assert np.concatenate(curved).mean() < 0.01

"""Conversion of lines and corners of a scan to the base's frame, with their covariances."""

import numpy as np
import pytest

from drivers import se2
from features.types import Corners, Lines
from slam.geometry.line_segments import corner_points, segments_from_lines
from slam.geometry.segments import Segments


def lines_of(frames: np.ndarray, half_length: np.ndarray, covariance: np.ndarray) -> Lines:
    """Return lines through segments whose frames (n, 3) have x along the wall and the lidar at y > 0."""
    along = np.column_stack([np.cos(frames[:, 2]), np.sin(frames[:, 2])])
    normal = np.column_stack([along[:, 1], -along[:, 0]])  # away from the lidar
    distance = np.sum(normal * frames[:, :2], axis=1)
    count = len(frames)
    return Lines(
        uv=normal / distance[:, None],
        covariance=covariance,
        start=frames[:, :2] - half_length[:, None] * along,
        end=frames[:, :2] + half_length[:, None] * along,
        first=np.arange(count),
        last=np.arange(count),
        count=np.full(count, 20),
        chi2=np.full(count, 18.0),
        curved=np.zeros(count, dtype=bool),
    )


def around(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return random frames of walls around the lidar, which is on their left, and their half lengths."""
    random = np.random.default_rng(seed)
    bearing, distance = random.uniform(-np.pi, np.pi, count), random.uniform(0.5, 8.0, count)
    slant = random.uniform(-1.2, 1.2, count)
    centre = distance[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    frames = np.column_stack([centre, se2.wrap(bearing + np.pi / 2 + slant)])
    return frames, random.uniform(0.15, 3.0, count)


def uv_covariances(lines: Lines, seed: int = 1) -> np.ndarray:
    """Return correlated covariances of (u, v), with standard deviations of about one percent."""
    factor = 0.01 * np.random.default_rng(seed).normal(size=(len(lines), 2, 2))
    size = np.sum(lines.uv**2, axis=1)
    return size[:, None, None] * (factor @ factor.transpose(0, 2, 1) + 1e-6 * np.eye(2))


def offset_and_heading(frame: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Return (n, 2) the intersections of lines uv (n, 2) with the y axis of a frame, and their headings in it."""
    heading = np.arctan2(uv[:, 1], uv[:, 0]) + np.pi / 2
    normal = np.array([-np.sin(frame[2]), np.cos(frame[2])])
    return np.column_stack([(1.0 - uv @ frame[:2]) / (uv @ normal), se2.wrap(heading - frame[2])])


@pytest.fixture
def walls() -> tuple[np.ndarray, Lines]:
    frames, half = around(40)
    lines = lines_of(frames, half, np.zeros((40, 2, 2)))
    return frames, lines_of(frames, half, uv_covariances(lines))


def test_the_frame_lies_on_the_wall_with_the_lidar_on_its_left(walls: tuple[np.ndarray, Lines]) -> None:
    frames, lines = walls
    segments = segments_from_lines(lines, np.zeros(3))
    np.testing.assert_allclose(segments.frame[:, :2], frames[:, :2], atol=1e-12)
    np.testing.assert_allclose(se2.wrap(segments.frame[:, 2] - frames[:, 2]), 0.0, atol=1e-12)
    assert (se2.transform(se2.inverse(segments.frame), np.zeros(2))[:, 1] > 0).all()


def test_the_covariance_agrees_with_finite_differences(walls: tuple[np.ndarray, Lines]) -> None:
    frames, lines = walls
    segments = segments_from_lines(lines, np.zeros(3))
    for k, frame in enumerate(frames):
        step = 1e-6 * np.hypot(*lines.uv[k])
        ahead, behind = (offset_and_heading(frame, lines.uv[k] + sign * step * np.eye(2)) for sign in (1, -1))
        jacobian = (ahead - behind).T / (2 * step)
        expected = jacobian @ lines.covariance[k] @ jacobian.T
        np.testing.assert_allclose(segments.covariance[k], expected, rtol=1e-6, atol=1e-15)


def test_the_covariance_agrees_with_sampled_lines(walls: tuple[np.ndarray, Lines]) -> None:
    frames, lines = walls
    segments = segments_from_lines(lines, np.zeros(3))
    random = np.random.default_rng(2)
    for k in range(0, 40, 8):
        sampled = offset_and_heading(
            frames[k], random.multivariate_normal(lines.uv[k], 0.01 * lines.covariance[k], 20_000)
        )
        whitened = np.linalg.solve(np.linalg.cholesky(0.01 * segments.covariance[k]), sampled.T)
        np.testing.assert_allclose(np.cov(whitened), np.eye(2), atol=0.05)


@pytest.mark.parametrize("mount", [(0.0, 0.0, np.radians(100.0)), (0.4, -0.2, 0.0), (-0.3, 0.25, np.radians(-170.0))])
def test_the_mount_transforms_frames_but_not_covariances(
    walls: tuple[np.ndarray, Lines], mount: tuple[float, float, float]
) -> None:
    _, lines = walls
    pose = np.array(mount)
    plain, moved = segments_from_lines(lines, np.zeros(3)), segments_from_lines(lines, pose)
    np.testing.assert_array_equal(moved.covariance, plain.covariance)
    np.testing.assert_array_equal(moved.half_length, plain.half_length)
    back = se2.between(pose, moved.frame)
    np.testing.assert_allclose(back[:, :2], plain.frame[:, :2], atol=1e-12)
    np.testing.assert_allclose(se2.wrap(back[:, 2] - plain.frame[:, 2]), 0.0, atol=1e-12)


def test_corners_are_transformed_by_the_mount() -> None:
    frames, half = around(4)
    segments = segments_from_lines(lines_of(frames, half, np.tile(np.eye(2), (4, 1, 1))), np.zeros(3))
    mount = np.array([0.4, -0.2, np.radians(100.0)])
    covariance = np.array([[[4e-4, 1e-4], [1e-4, 1e-4]]])
    corners = Corners(np.array([[2.0, 1.0]]), covariance, np.array([[0, 2]]))
    moved = corner_points(corners, segments, mount)
    np.testing.assert_allclose(moved.position, se2.transform(mount, corners.position))
    np.testing.assert_allclose(np.linalg.eigvalsh(moved.covariance), np.linalg.eigvalsh(covariance))
    rays = np.column_stack([moved.position[0] - mount[:2], np.zeros(2)])[:, :1]
    across = np.array([-rays[1, 0], rays[0, 0]])
    seen = np.array([-1.0, 2.0])
    assert across @ moved.covariance[0] @ across == pytest.approx(seen @ covariance[0] @ seen)
    np.testing.assert_array_equal(moved.headings[0], segments.frame[[0, 2], 2])


def test_no_lines_give_no_segments() -> None:
    nothing = lines_of(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))
    segments = segments_from_lines(nothing, np.array([0.1, 0.0, 1.0]))
    assert len(segments) == 0
    assert segments.reach() == 0.0
    corners = corner_points(
        Corners(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int)), segments, np.zeros(3)
    )
    assert len(corners) == 0
    assert corners.headings.shape == (0, 2)


def test_the_reach_bounds_the_distance_of_the_farthest_end() -> None:
    segments = Segments(np.array([[3.0, 4.0, 0.0], [1.0, 0.0, 0.0]]), np.array([0.5, 2.0]), np.zeros((2, 2, 2)))
    assert segments.reach() == pytest.approx(5.5)
